//! Speed from the autocorrelation at 125 Hz.
//!
//! The energy of the stack Σ_w a(t + offset_w / v) over all t is R(0) · N + 2 Σ R(distance / v) over all pairs of
//! axles, with R the autocorrelation of the recording. R is computed once, so a trial speed costs one look-up per
//! pair, whatever the length of the recording.

use crate::decimate::RATE_HZ;
use crate::kaiser;
use crate::pace::Pace;
use crate::passage::CAPACITY;
use crate::timing::{FASTEST_M_S, SLOWEST_M_S};

/// Samples of the recording per sample of the coarse signal.
const FACTOR: usize = 8;
/// Rate of the coarse signal, Hz.
const COARSE_RATE_HZ: f32 = RATE_HZ / FACTOR as f32;
/// Longest coarse signal.
const COARSE_LEN: usize = CAPACITY / FACTOR;
/// Scratch space: coarse signal and autocorrelation.
pub const WORK_LEN: usize = 2 * COARSE_LEN;
/// Only pairs of axles nearer than this are used, m: it bounds the work for long trains, and 100 m already give
/// the speed to 0.2 %.
const LONGEST_BASE_M: f32 = 100.0;
/// Step of the scan: the delay over the longest base moves by this much per step, s. The coarse signal ends at
/// 45 Hz, where this is 1/7 of a period.
const DELAY_STEP_S: f32 = 3e-3;
/// Low-pass before it: flat to 20 Hz, −6 dB at 45 Hz, 50 dB from 70 Hz. What folds, folds above 55 Hz.
static SMOOTHING: [f32; 65] = kaiser::low_pass(45.0 / RATE_HZ as f64, 50.0);

/// Result of the scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comb {
    /// Best speed, m/s.
    pub speed_m_s: f32,
    /// See [`crate::timing::TrainMatch::coherence`].
    pub coherence: f32,
}

/// Scans all speeds.
pub async fn scan(
    samples: &[f32],
    mean: f32,
    offsets_m: &[f32],
    work: &mut [f32],
    pace: &mut Pace,
) -> Option<Comb> {
    let base = offsets_m.last()?.min(LONGEST_BASE_M);
    let (signal, rest) = work.split_at_mut_checked(COARSE_LEN)?;
    let signal = signal.get_mut(..(samples.len() / FACTOR).min(COARSE_LEN))?;
    let correlation = rest.get_mut(..signal.len())?;
    if base <= 0.0 || signal.is_empty() {
        return None;
    }
    smooth(samples, mean, signal, pace).await;
    autocorrelate(signal, correlation, pace).await;
    let energy = correlation.first().copied().filter(|energy| *energy > 0.0)?;
    let best = scan_slowness(correlation, offsets_m, base, pace).await?;
    let coherence = best.comb / (energy * identical_axles(offsets_m, pace).await);
    Some(Comb { speed_m_s: 1.0 / best.slowness, coherence })
}

/// Low-passes and decimates by [`FACTOR`].
async fn smooth(samples: &[f32], mean: f32, out: &mut [f32], pace: &mut Pace) {
    let reach = SMOOTHING.len() / 2;
    for (k, y) in out.iter_mut().enumerate() {
        // Before the recording there was the same silence as at its beginning.
        let (skipped, from) = (reach.saturating_sub(k * FACTOR), (k * FACTOR).saturating_sub(reach));
        let near = samples.get(from..).unwrap_or(&[]);
        *y = SMOOTHING.iter().skip(skipped).zip(near).map(|(tap, x)| tap * (x - mean)).sum();
        pace.spend(SMOOTHING.len()).await;
    }
}

async fn autocorrelate(signal: &[f32], out: &mut [f32], pace: &mut Pace) {
    for (lag, r) in out.iter_mut().enumerate() {
        let later = signal.get(lag..).unwrap_or(&[]);
        *r = signal.iter().zip(later).map(|(a, b)| a * b).sum();
        pace.spend(later.len()).await;
    }
}

#[derive(Clone, Copy)]
struct Trial {
    slowness: f32,
    comb: f32,
}

/// Steps evenly in slowness 1/v, because the delays are proportional to it.
async fn scan_slowness(r: &[f32], offsets_m: &[f32], base: f32, pace: &mut Pace) -> Option<Trial> {
    let step = DELAY_STEP_S / base;
    let steps = ((1.0 / SLOWEST_M_S - 1.0 / FASTEST_M_S) / step) as u32 + 1;
    let mut best: Option<(Trial, f32)> = None; // with the neighbour before it
    let mut after = 0.0;
    let mut previous = 0.0;
    let mut follows_best = false;
    for k in 0..=steps {
        let slowness = 1.0 / FASTEST_M_S + k as f32 * step;
        let comb = comb_energy(r, offsets_m, slowness, pace).await;
        if follows_best {
            after = comb;
        }
        follows_best = best.is_none_or(|(trial, _)| comb > trial.comb);
        if follows_best {
            best = Some((Trial { slowness, comb }, previous));
            after = comb;
        }
        previous = comb;
    }
    let (peak, before) = best?;
    let shift = crate::peaks::vertex(before, peak.comb, after);
    Some(Trial { slowness: peak.slowness + shift * step, ..peak })
}

/// Σ R(distance · slowness) over all pairs of axles.
async fn comb_energy(r: &[f32], offsets_m: &[f32], slowness: f32, pace: &mut Pace) -> f32 {
    let per_metre = slowness * COARSE_RATE_HZ;
    let mut sum = 0.0;
    for (w, &front) in offsets_m.iter().enumerate() {
        let behind = offsets_m.get(w + 1..).unwrap_or(&[]);
        for &offset in behind.iter().take_while(|&&offset| offset - front <= LONGEST_BASE_M) {
            sum += look_up(r, (offset - front) * per_metre);
        }
        pace.spend(8 * behind.len()).await;
    }
    sum
}

/// Cubic (Catmull-Rom) interpolation; 0 beyond the recording.
fn look_up(r: &[f32], lag: f32) -> f32 {
    let k = lag as usize;
    let u = lag - k as f32;
    let Some(&[a, b, c, d]) = k.checked_sub(1).and_then(|first| r.get(first..)?.first_chunk::<4>()) else {
        return 0.0;
    };
    b + 0.5 * u * (c - a + u * (2.0 * a - 5.0 * b + 4.0 * c - d + u * (3.0 * (b - c) + d - a)))
}

/// The comb of a train of equal, well separated axles relative to R(0): every distance that n pairs share counts n²
/// in the comb, because R holds all n of them.
async fn identical_axles(offsets_m: &[f32], pace: &mut Pace) -> f32 {
    /// Distances that differ by less are the same, m.
    const SAME_M: f32 = 0.01;
    let pairs = || {
        offsets_m.iter().enumerate().flat_map(|(w, &front)| {
            let behind = offsets_m.get(w + 1..).unwrap_or(&[]).iter().map(move |&offset| offset - front);
            behind.take_while(|&distance| distance <= LONGEST_BASE_M)
        })
    };
    let mut same = 0_u32;
    for distance in pairs() {
        let mut count = 0;
        for other in pairs() {
            count += u32::from((other - distance).abs() < SAME_M);
        }
        same = same.saturating_add(count);
        pace.spend(offsets_m.len() * offsets_m.len()).await;
    }
    same.max(1) as f32 / offsets_m.len().max(1) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_cubic_look_up() {
        let r: [f32; 10] = core::array::from_fn(|k| (k * k) as f32);
        assert!((look_up(&r, 4.3) - 18.49).abs() < 1e-4, "a parabola is exact");
        assert_eq!(look_up(&r, 0.5), 0.0);
        assert_eq!(look_up(&r, 9.0), 0.0);
        assert_eq!(look_up(&r, f32::NAN), 0.0);
    }

    #[test]
    fn analytic_identical_axles() {
        // 0, 3, 10, 13: distances 3 (twice), 10 (twice), 7, 13: 4 + 4 + 1 + 1 over 4 axles.
        let offsets = [0.0, 3.0, 10.0, 13.0];
        let count = embassy_futures::block_on(identical_axles(&offsets, &mut Pace::default()));
        assert_eq!(count, 2.5);
    }
}
