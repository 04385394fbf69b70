//! Train speed from the axle pattern: the recordings of all axles, shifted by their distances, add up coherently
//! only at the right speed.

mod stack;

use rayon::prelude::*;

use stack::{LANES, Stack};

use super::Recording;
use crate::vehicle::AxlePattern;

/// Settings of the speed search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedSearch {
    /// Slowest and fastest speed looked for, m/s.
    pub range_m_s: [f64; 2],
    /// Relative step of the first scan.
    pub first_step: f64,
    /// Its band, Hz: low frequencies have no side maxima, but a baseline that shifts has most of its energy there.
    pub first_band_hz: [f64; 2],
    /// What else says of the speed, within 5 %: where it is as good as no other, it chooses among maxima. It need not be right.
    pub about_m_s: Option<f64>,
}

impl Default for SpeedSearch {
    fn default() -> Self {
        Self { range_m_s: [8.0, 90.0], first_step: 1e-3, first_band_hz: [3.0, 60.0], about_m_s: None }
    }
}

/// Successive refinements: half width (relative), band in Hz. Higher bands locate better, but have side maxima
/// outside the range that the step before has already excluded.
const REFINEMENTS: [(f64, [f64; 2]); 2] = [(3e-3, [10.0, 120.0]), (1e-3, [20.0, 200.0])];
const POINTS: usize = 41;
/// How far off a speed is that something else says, relative: operators are within 1 %, recorders' clocks within 4 %.
pub const ABOUT: f64 = 0.05;
/// Part of the highest energy that is enough there. Four axles stack by chance, at 8 m/s and frequencies that turn often from the
/// first to the last, to 1.1 of what they stack to at their own speed; at speeds stated wrongly four axles reach 0.79, twelve 0.65.
const ENOUGH: f64 = 0.85;

/// Speed in m/s at which the stacked energy of all axles is largest; `None` when the recording is silent.
pub fn estimate_speed(recording: &Recording, pattern: &AxlePattern, search: SpeedSearch) -> Option<f64> {
    let [low, high] = search.range_m_s;
    let count = ((high / low).ln() / search.first_step).ceil() as usize;
    let grid: Vec<f64> = (0..=count).map(|i| low * (i as f64 * search.first_step).exp()).collect();
    let (highest, energy) = maximum(recording, pattern, &grid, search.first_band_hz)?;
    let near = search.about_m_s.and_then(|about| highest_near(&grid, &energy, about));
    let mut speed = grid[near.filter(|k| energy[*k] > ENOUGH * energy[highest]).unwrap_or(highest)];
    for (half, band) in REFINEMENTS {
        let step = 2.0 * half / (POINTS - 1) as f64;
        let grid: Vec<f64> = (0..POINTS).map(|i| speed * (1.0 - half + i as f64 * step)).collect();
        let (best, energy) = maximum(recording, pattern, &grid, band)?;
        let i = best.clamp(1, POINTS - 2);
        speed = grid[i] + speed * step * parabola_vertex(energy[i - 1], energy[i], energy[i + 1]);
    }
    Some(speed)
}

/// Place of the highest energy among speeds near one.
fn highest_near(speeds: &[f64], energy: &[f64], about: f64) -> Option<usize> {
    let near = |k: &usize| (speeds[*k] / about - 1.0).abs() < ABOUT;
    (0..speeds.len()).filter(near).max_by(|a, b| energy[*a].total_cmp(&energy[*b]))
}

fn maximum(
    recording: &Recording,
    pattern: &AxlePattern,
    speeds: &[f64],
    band: [f64; 2],
) -> Option<(usize, Vec<f64>)> {
    let lines: Vec<(f64, f64)> = recording
        .spectrum()
        .iter()
        .enumerate()
        .map(|(k, v)| (recording.frequency_hz(k), v.norm_sqr()))
        .filter(|(f, _)| *f > band[0] && *f < band[1])
        .collect();
    let spacing = recording.frequency_hz(1);
    let arch = pulp::Arch::new();
    let energy: Vec<f64> = speeds
        .par_chunks(LANES)
        .flat_map_iter(|some| {
            // A last chunk that is not full repeats its last speed.
            let lanes = std::array::from_fn(|l| some[l.min(some.len() - 1)]);
            let stack = Stack::new(&lines, spacing, pattern, lanes);
            arch.dispatch(stack).into_iter().take(some.len())
        })
        .collect();
    let best = (0..energy.len()).max_by(|a, b| energy[*a].total_cmp(&energy[*b]))?;
    (energy[best] > 0.0).then_some((best, energy))
}

/// Offset of the vertex of a parabola through three equally spaced values, in steps from the middle one, limited to ±1.
pub(super) fn parabola_vertex(left: f64, middle: f64, right: f64) -> f64 {
    let curvature = left - 2.0 * middle + right;
    if curvature < 0.0 { (0.5 * (left - right) / curvature).clamp(-1.0, 1.0) } else { 0.0 }
}
