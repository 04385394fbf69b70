//! Speed and time of a train from the envelope of its recording: where the wheels hit the crossing.
//!
//! Coherent stacking ([`estimate_speed`](super::estimate_speed)) is far more accurate, but a transducer that clips shifts its
//! baseline, and the low frequencies then find another speed, as they may for a short train. The envelope stands that, and only
//! has to tell neighbouring maxima of the stack apart.

use super::Recording;
use crate::vehicle::AxlePattern;

/// Rate of the envelope, Hz.
const RATE_HZ: f64 = 500.0;
/// Band of the hits: above the deflection, below the contact resonance.
const BAND_HZ: [f64; 2] = [40.0, 250.0];
/// The envelope is smoothed over this long, s: 0.4 m of track at 40 m/s.
const SMOOTH_S: f64 = 0.01;
/// Speeds of trains, m/s.
pub const SPEEDS_M_S: [f64; 2] = [10.0, 80.0];
/// Wheels hit the crossing within this from x = 0, metres, half a bogie's axle spacing apart from the next choice.
pub const FARTHEST_HIT_M: f64 = 1.45;
/// Relative step of the speed: half a smoothing length over a train of 75 m.
const STEP: f64 = 2e-3;
/// The envelope is flat under the wheels: sums this close to the highest, relative, are the top, and its middle the place. Its beginning,
/// which was taken before, is a slower speed by 0.6 to 1 %.
const FLAT: f64 = 0.03;

/// Speed (m/s) and time (s) at which the first wheel hits the crossing, such that most of the envelope lies under the axles, among
/// speeds from `low` to `high`.
/// `None` for a silent recording, or one shorter than any train.
pub fn comb(recording: &Recording, pattern: &AxlePattern, [low, high]: [f64; 2]) -> Option<(f64, f64)> {
    let (envelope, _) = envelope(recording);
    let total: f64 = envelope.iter().sum();
    if total <= 0.0 {
        return None;
    }
    let count = ((high / low).ln() / STEP) as usize;
    let length_m = pattern.offset_m.last().copied().unwrap_or(0.0);
    let speed_m_s = |i: usize| low * (i as f64 * STEP).exp();
    let sums = |i: usize| -> Vec<f64> {
        let last = envelope.len() as f64 - 1.0 - length_m / speed_m_s(i) * RATE_HZ;
        let under = |axle_m: &f64| (axle_m / speed_m_s(i) * RATE_HZ).round() as usize;
        let at: Vec<usize> = pattern.offset_m.iter().map(under).collect();
        let sum = |start: usize| at.iter().filter_map(|k| envelope.get(start + k)).sum();
        (0..last.max(0.0) as usize).map(sum).collect()
    };
    let highest: Vec<f64> = (0..count).map(|i| sums(i).into_iter().fold(0.0, f64::max)).collect();
    let best = middle_of_top(&highest)?;
    let start = middle_of_top(&sums(best))?;
    Some((speed_m_s(best), start as f64 / RATE_HZ))
}

/// Middle of the stretch around the highest value in which values are nearly as high.
fn middle_of_top(values: &[f64]) -> Option<usize> {
    let best = (0..values.len()).max_by(|a, b| values[*a].total_cmp(&values[*b]))?;
    let least = (1.0 - FLAT) * values[best];
    let first = values[..best].iter().rposition(|v| *v < least).map_or(0, |i| i + 1);
    let last = values[best..].iter().position(|v| *v < least).map_or(values.len(), |k| best + k) - 1;
    Some((first + last) / 2)
}

/// Smoothed magnitude, m/s², held below a few times its mean under the train so that one hard wheel does not decide alone; and its rate, Hz.
pub fn envelope(recording: &Recording) -> (Vec<f64>, f64) {
    let n = (recording.duration_s() * 2.0 * RATE_HZ) as usize;
    let low = recording.window(0.0, 2.0 * RATE_HZ, n, [BAND_HZ[0], 1.2 * BAND_HZ[0]]);
    let all = recording.window(0.0, 2.0 * RATE_HZ, n, [BAND_HZ[1], 1.2 * BAND_HZ[1]]);
    let magnitude: Vec<f64> = all.iter().zip(&low).map(|(a, l)| (a - l).abs()).collect();
    let half = (SMOOTH_S * RATE_HZ) as usize;
    let smooth: Vec<f64> = (0..n / 2).map(|k| crate::signal::mean_around(&magnitude, 2 * k, half)).collect();
    let limit = 1.5 * crate::signal::quantile(&smooth, 0.9);
    (smooth.iter().map(|v| v.min(limit)).collect(), RATE_HZ)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::reconstruct::{SpeedSearch, estimate_speed};
    use crate::recording::read_site;

    /// The speeds of coherent stacking are good to 0.05 % there.
    #[test]
    fn property_envelopes_tell_the_speed_to_half_a_percent() {
        for name in ["reference-1", "known-saturation"] {
            let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field");
            let site = read_site(&root.join(name)).unwrap();
            let pattern = AxlePattern::of_vehicle(&site.crossing.vehicle);
            for p in site.passages.iter().take(6) {
                let recording = Recording::new(p, &site.crossing.sensor);
                let (found, _) = comb(&recording, &pattern, SPEEDS_M_S).unwrap();
                let stacked = estimate_speed(&recording, &pattern, SpeedSearch::default()).unwrap();
                assert!((found / stacked - 1.0).abs() < 5e-3, "{name}: {found} of {stacked}");
            }
        }
    }
}
