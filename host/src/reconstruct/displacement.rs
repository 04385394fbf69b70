//! Sleeper displacement from acceleration: integration in the frequency domain.

use super::{Recording, Timing};
use crate::signal::{irfft, mean, quantile, rfft, rms};
use crate::vehicle::AxlePattern;

/// Search for the high-pass corner (paper, section 1.1: the corner is optimised to remove the baseline distortion).
///
/// Its source gives no objective; ours is the RMS of the displacement while no train is near, relative to the
/// 5th-to-95th percentile range, plus the uplift beyond what a beam on an elastic foundation shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HighPassSearch {
    /// Lowest and highest corner tried, Hz.
    pub corner_hz: [f64; 2],
    /// Corners tried, geometrically spaced.
    pub steps: usize,
    /// Distance from the nearest axle beyond which the sleeper is at rest, metres.
    pub clear_m: f64,
    /// Uplift up to this share of the largest deflection is physical (a Winkler beam lifts by e^{-π} = 4.3 %).
    pub physical_uplift: f64,
}

impl Default for HighPassSearch {
    fn default() -> Self {
        Self { corner_hz: [0.25, 6.0], steps: 24, clear_m: 6.0, physical_uplift: 0.1 }
    }
}

/// Displacement by high-pass and double integration.
#[derive(Clone, Debug)]
pub struct HighPassed {
    /// Metres, positive down, at the raw rate.
    pub displacement_m: Vec<f64>,
    /// Chosen corner, Hz.
    pub corner_hz: f64,
    /// Width of the range of corners whose objective is within 10 % of the best, Hz: how well the corner is determined.
    pub flat_width_hz: f64,
}

/// The paper's reconstruction: 4th-order zero-phase high-pass whose corner is searched.
pub fn high_pass_displacement(
    recording: &Recording,
    timing: Timing,
    pattern: &AxlePattern,
    search: HighPassSearch,
) -> HighPassed {
    let quiet = quiet_samples(recording, timing, pattern, search.clear_m);
    let ratio = (search.corner_hz[1] / search.corner_hz[0]).powf(1.0 / (search.steps.max(2) - 1) as f64);
    let candidates: Vec<(f64, f64, Vec<f64>)> = (0..search.steps.max(2))
        .map(|i| {
            let corner = search.corner_hz[0] * ratio.powi(i as i32);
            let d = integrate_above(recording, corner);
            let level = mean(&pick(&d, &quiet));
            let d: Vec<f64> = d.iter().map(|v| v - level).collect();
            (objective(&d, &quiet, search.physical_uplift), corner, d)
        })
        .collect();
    let best = candidates.iter().map(|c| c.0).fold(f64::INFINITY, f64::min);
    let flat: Vec<f64> = candidates.iter().filter(|c| c.0 <= 1.1 * best).map(|c| c.1).collect();
    let flat_width_hz = flat.last().unwrap_or(&0.0) - flat.first().unwrap_or(&0.0);
    let chosen = candidates.into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
    let (_, corner_hz, displacement_m) = chosen.unwrap_or((0.0, 0.0, Vec::new()));
    HighPassed { displacement_m, corner_hz, flat_width_hz }
}

/// Measured above `corner_hz`, `model_m` below (one complementary filter pair), level from the quiet ends.
/// Double integration of the sensor noise leaves nothing usable below a few Hz, while the model is best there.
pub fn complementary_displacement(
    recording: &Recording,
    timing: Timing,
    pattern: &AxlePattern,
    model_m: &[f64],
    corner_hz: f64,
) -> Vec<f64> {
    let measured = integrate_above(recording, corner_hz);
    let n = recording.len;
    let padded = 2 * n;
    let mut model = model_m.to_vec();
    model.resize(padded, 0.0);
    let mut spectrum = rfft(&model);
    for (k, value) in spectrum.iter_mut().enumerate() {
        *value *= 1.0 - high_pass_gain(k as f64 * recording.rate_hz / padded as f64, corner_hz);
    }
    let low = irfft(&spectrum, padded);
    let sum: Vec<f64> = measured.iter().zip(&low).map(|(a, b)| a + b).collect();
    let level =
        mean(&pick(&sum, &quiet_samples(recording, timing, pattern, HighPassSearch::default().clear_m)));
    sum.iter().map(|v| v - level).collect()
}

fn high_pass_gain(f_hz: f64, corner_hz: f64) -> f64 {
    if f_hz > 0.0 { 1.0 / (1.0 + (corner_hz / f_hz).powi(8)) } else { 0.0 }
}

fn integrate_above(recording: &Recording, corner_hz: f64) -> Vec<f64> {
    recording.filtered(|f| {
        let w = std::f64::consts::TAU * f;
        if f > 0.0 { -high_pass_gain(f, corner_hz) / (w * w) } else { 0.0 }
    })
}

/// Indices of the samples with all axles further than `clear_m`, before and after the train.
fn quiet_samples(recording: &Recording, timing: Timing, pattern: &AxlePattern, clear_m: f64) -> Vec<usize> {
    let first = timing.first_axle_s - clear_m / timing.speed_m_s;
    let last = timing.axle_s(pattern.length_m()) + clear_m / timing.speed_m_s;
    (0..recording.len)
        .filter(|i| {
            let t = *i as f64 / recording.rate_hz;
            t < first || t > last
        })
        .collect()
}

fn pick(values: &[f64], indices: &[usize]) -> Vec<f64> {
    indices.iter().filter_map(|i| values.get(*i)).copied().collect()
}

fn objective(displacement: &[f64], quiet: &[usize], physical_uplift: f64) -> f64 {
    let range = (quantile(displacement, 0.95) - quantile(displacement, 0.05)).max(f64::MIN_POSITIVE);
    let deepest = displacement.iter().fold(0.0, |m: f64, v| m.max(*v));
    let highest = displacement.iter().fold(0.0, |m: f64, v| m.max(-v));
    let uplift = (highest - physical_uplift * deepest).max(0.0);
    rms(&pick(displacement, quiet)) / range + uplift / range
}
