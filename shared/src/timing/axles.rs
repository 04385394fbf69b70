//! Axles one by one: every wheel hits the crossing, so the energy has one hump per axle.
//!
//! The humps are found without the pattern and then compared with it.

use heapless::Vec;

use crate::decimate::RATE_HZ;
use crate::pace::Pace;
use crate::package::MAX_AXLES;

/// Most axles that are told apart: half as many again as a pattern can have, so that a longer train shows.
pub const MAX_FOUND: usize = MAX_AXLES * 3 / 2;
/// Half width of the triangle over which energy is averaged, m of track: a third of the shortest wheel base of
/// usual bogies, so that the wheels of one stay apart.
const SMOOTHING_M: f32 = 0.8;
/// A hump counts from this fraction of the mean hump on.
const LEAST_HUMP: f32 = 0.1;
/// Between two humps the energy must fall below this fraction of either.
const VALLEY: f32 = 0.6;
/// An axle belongs to an axle of the pattern when it is no farther from it than this, m: a little less than half
/// of the shortest wheel base.
const NEAR_M: f32 = 0.9;

/// A recording and its bias.
#[derive(Clone, Copy, Debug)]
pub struct Signal<'a> {
    /// Decimated samples, m/s².
    pub samples: &'a [f32],
    /// Bias, m/s².
    pub mean: f32,
}

impl Signal<'_> {
    /// Triangle-weighted mean of the squared signal around sample `middle`, ± `reach` samples, (m/s²)².
    fn energy(&self, middle: usize, reach: usize) -> f32 {
        let from = middle.saturating_sub(reach);
        let to = middle.saturating_add(reach + 1).min(self.samples.len());
        let mut sum = 0.0;
        for (i, x) in self.samples.get(from..to).unwrap_or(&[]).iter().enumerate() {
            let x = x - self.mean;
            sum += (reach + 1).saturating_sub((from + i).abs_diff(middle)) as f32 * (x * x);
        }
        sum / ((reach + 1) * (reach + 1)) as f32
    }
}

/// Smoothing half width and step of the energy at a speed, in samples.
struct Grid {
    reach: usize,
    step: usize,
}

impl Grid {
    fn new(speed_m_s: f32) -> Self {
        let reach = ((SMOOTHING_M / speed_m_s * RATE_HZ) as usize).clamp(2, 400);
        Self { reach, step: (reach / 8).max(1) }
    }

    /// Work of one value of the energy, in multiplications: the weights are calculated, not tabulated.
    fn work(&self) -> usize {
        8 * self.reach
    }
}

/// Time of the first axle: where the energy seen through the pattern is largest, s. `None` when the recording is
/// shorter than the train at this speed.
pub async fn first_axle(
    signal: Signal<'_>,
    offsets_m: &[f32],
    speed_m_s: f32,
    pace: &mut Pace,
) -> Option<f32> {
    let grid = Grid::new(speed_m_s);
    let per_metre = RATE_HZ / speed_m_s;
    let length = (offsets_m.last()? * per_metre) as usize;
    let room = signal.samples.len().checked_sub(length)?;
    let mut best = (0, 0.0);
    let mut curve = [0.0_f32; 3]; // around the best
    let mut previous = 0.0;
    for start in (0..room).step_by(grid.step) {
        let mut sum = 0.0;
        for offset in offsets_m {
            sum += signal.energy(start + (offset * per_metre + 0.5) as usize, grid.reach);
            pace.spend(grid.work()).await;
        }
        if best.0 + grid.step == start {
            curve[2] = sum;
        }
        if sum > best.1 {
            best = (start, sum);
            curve = [previous, sum, sum];
        }
        previous = sum;
    }
    let shift = crate::peaks::vertex(curve[0], curve[1], curve[2]);
    (best.1 > 0.0).then(|| (best.0 as f32 + shift * grid.step as f32) / RATE_HZ)
}

/// Times of all axles that can be told apart, s, ascending. The pattern only sets the scale of what counts.
pub async fn detect(
    signal: Signal<'_>,
    offsets_m: &[f32],
    speed_m_s: f32,
    first_axle_s: f32,
    pace: &mut Pace,
) -> Vec<f32, MAX_FOUND> {
    let grid = Grid::new(speed_m_s);
    let mut scale = 0.0;
    for offset in offsets_m {
        let middle = ((first_axle_s + offset / speed_m_s) * RATE_HZ + 0.5) as usize;
        scale += signal.energy(middle, grid.reach) / offsets_m.len() as f32;
        pace.spend(grid.work()).await;
    }
    let mut humps = Humps::new(LEAST_HUMP * scale);
    for middle in (0..signal.samples.len()).step_by(grid.step) {
        humps.push(middle, signal.energy(middle, grid.reach));
        pace.spend(grid.work()).await;
    }
    humps.times_s
}

/// Finds humps in a curve, with hysteresis.
struct Humps {
    least: f32,
    rising: bool,
    extreme: f32,
    top: usize,
    times_s: Vec<f32, MAX_FOUND>,
}

impl Humps {
    fn new(least: f32) -> Self {
        Self { least, rising: true, extreme: 0.0, top: 0, times_s: Vec::new() }
    }

    fn push(&mut self, sample: usize, energy: f32) {
        if self.rising {
            if energy > self.extreme {
                (self.extreme, self.top) = (energy, sample);
            } else if energy < VALLEY * self.extreme {
                if self.extreme > self.least {
                    // When there are more than fit, the count alone already says that the train is another.
                    let _ = self.times_s.push(self.top as f32 / RATE_HZ);
                }
                (self.rising, self.extreme) = (false, energy);
            }
        } else if energy < self.extreme {
            self.extreme = energy;
        } else if VALLEY * energy > self.extreme && energy > 0.5 * self.least {
            (self.rising, self.extreme, self.top) = (true, energy, sample);
        }
    }
}

/// How axles found compare with a pattern.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// Axles of the pattern where none was found.
    pub missing: u16,
    /// Axles found where the pattern has none.
    pub extra: u16,
    /// Scatter of the others around the pattern, m, rms, a common shift taken off.
    pub scatter_m: f32,
}

/// Compares axles found, s, with a pattern.
pub fn compare(found_s: &[f32], offsets_m: &[f32], speed_m_s: f32, first_axle_s: f32) -> Fit {
    let (mut matched, mut sum, mut squares) = (0_u16, 0.0, 0.0);
    for offset in offsets_m {
        let expected = first_axle_s + offset / speed_m_s;
        let distances = found_s.iter().map(|t| (t - expected) * speed_m_s);
        let nearest = distances.fold(f32::MAX, |best, d| if d.abs() < best.abs() { d } else { best });
        if nearest.abs() < NEAR_M {
            matched += 1;
            sum += nearest;
            squares += nearest * nearest;
        }
    }
    let n = f32::from(matched.max(1));
    let variance = (squares / n - (sum / n) * (sum / n)).max(0.0);
    Fit {
        missing: (offsets_m.len() as u16).saturating_sub(matched),
        extra: (found_s.len() as u16).saturating_sub(matched),
        scatter_m: libm::sqrtf(variance),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PATTERN: [f32; 4] = [0.0, 3.0, 18.0, 21.0];

    fn train(v: f32, offsets: &[f32]) -> [f32; 3000] {
        core::array::from_fn(|k| {
            let t = k as f32 / RATE_HZ - 0.6;
            let burst = |x: f32| {
                let u = (t * v - x) / 0.5;
                libm::expf(-u * u) * libm::cosf(300.0 * (t - x / v))
            };
            0.1 + offsets.iter().map(|&x| 20.0 * burst(x)).sum::<f32>()
        })
    }

    fn found(samples: &[f32], v: f32) -> (f32, Vec<f32, MAX_FOUND>) {
        let signal = Signal { samples, mean: 0.1 };
        embassy_futures::block_on(async {
            let mut pace = Pace::default();
            let t = first_axle(signal, &PATTERN, v, &mut pace).await.unwrap();
            (t, detect(signal, &PATTERN, v, t, &mut pace).await)
        })
    }

    #[test]
    fn analytic_finds_and_counts() {
        let samples = train(30.0, &PATTERN);
        let (t, axles) = found(&samples, 30.0);
        assert!((t - 0.6).abs() < 0.003, "{t}");
        let fit = compare(&axles, &PATTERN, 30.0, t);
        assert_eq!((axles.len(), fit.missing, fit.extra), (4, 0, 0));
        assert!(fit.scatter_m < 0.06, "{}", fit.scatter_m);
    }

    #[test]
    fn property_a_longer_train_shows() {
        let samples = train(30.0, &[0.0, 3.0, 18.0, 21.0, 26.0, 29.0]);
        let (t, axles) = found(&samples, 30.0);
        let fit = compare(&axles, &PATTERN, 30.0, t);
        assert_eq!((axles.len(), fit.missing, fit.extra), (6, 0, 2));
    }

    #[test]
    fn property_a_short_recording_is_no_train() {
        let signal = Signal { samples: &[1.0; 100], mean: 0.0 };
        let t = embassy_futures::block_on(first_axle(signal, &PATTERN, 30.0, &mut Pace::default()));
        assert_eq!(t, None);
    }
}
