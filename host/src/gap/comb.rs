//! Speed and time of a train from the envelope of its recording: where the wheels hit the crossing.
//!
//! Coherent stacking (`reconstruct::estimate_speed`) is far more accurate, but a transducer that clips shifts its baseline,
//! and the low frequencies then find another speed. The envelope stands that, and only has to tell neighbouring maxima of
//! the stack apart.

use crate::reconstruct::Recording;
use crate::vehicle::AxlePattern;

/// Rate of the envelope, Hz.
const RATE_HZ: f64 = 500.0;
/// Band of the hits: above the deflection, below the contact resonance.
const BAND_HZ: [f64; 2] = [40.0, 250.0];
/// The envelope is smoothed over this long, s: 0.4 m of track at 40 m/s.
const SMOOTH_S: f64 = 0.01;
/// Speeds of trains, m/s.
pub const SPEEDS_M_S: [f64; 2] = [10.0, 80.0];
/// Relative step of the speed: half a smoothing length over a train of 75 m.
const STEP: f64 = 2e-3;

/// Speed (m/s) and time (s) at which the first wheel hits the crossing, such that most of the envelope lies under the axles, among
/// speeds from `low` to `high`.
/// `None` for a silent recording, or one shorter than any train.
pub fn comb(recording: &Recording, pattern: &AxlePattern, [low, high]: [f64; 2]) -> Option<(f64, f64)> {
    let envelope = envelope(recording);
    let total: f64 = envelope.iter().sum();
    if total <= 0.0 {
        return None;
    }
    let count = ((high / low).ln() / STEP) as usize;
    let length_m = pattern.offset_m.last().copied().unwrap_or(0.0);
    let mut best: Option<(f64, f64, f64)> = None;
    for speed in (0..count).map(|i| low * (i as f64 * STEP).exp()) {
        let last = envelope.len() as f64 - 1.0 - length_m / speed * RATE_HZ;
        let at: Vec<usize> =
            pattern.offset_m.iter().map(|o| (o / speed * RATE_HZ).round() as usize).collect();
        for start in 0..last.max(0.0) as usize {
            let sum: f64 = at.iter().filter_map(|k| envelope.get(start + k)).sum();
            if best.is_none_or(|b| sum > b.0) {
                best = Some((sum, speed, start as f64 / RATE_HZ));
            }
        }
    }
    best.map(|(_, speed, start)| (speed, start))
}

/// Smoothed magnitude, held below a few times its mean under the train so that one hard wheel does not decide alone.
fn envelope(recording: &Recording) -> Vec<f64> {
    let n = (recording.duration_s() * 2.0 * RATE_HZ) as usize;
    let low = recording.window(0.0, 2.0 * RATE_HZ, n, [BAND_HZ[0], 1.2 * BAND_HZ[0]]);
    let all = recording.window(0.0, 2.0 * RATE_HZ, n, [BAND_HZ[1], 1.2 * BAND_HZ[1]]);
    let magnitude: Vec<f64> = all.iter().zip(&low).map(|(a, l)| (a - l).abs()).collect();
    let half = (SMOOTH_S * RATE_HZ) as usize;
    let smooth: Vec<f64> = (0..n / 2).map(|k| crate::signal::mean_around(&magnitude, 2 * k, half)).collect();
    let limit = 1.5 * crate::signal::quantile(&smooth, 0.9);
    smooth.iter().map(|v| v.min(limit)).collect()
}
