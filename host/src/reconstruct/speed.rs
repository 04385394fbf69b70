//! Train speed from the axle pattern: the recordings of all axles, shifted by their distances, add up coherently
//! only at the right speed.

use rayon::prelude::*;

use super::Recording;
use crate::vehicle::AxlePattern;

/// Settings of the speed search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedSearch {
    /// Slowest and fastest speed looked for, m/s.
    pub range_m_s: [f64; 2],
    /// Relative step of the first scan.
    pub first_step: f64,
}

impl Default for SpeedSearch {
    fn default() -> Self {
        Self { range_m_s: [8.0, 90.0], first_step: 1e-3 }
    }
}

/// Successive refinements: half width (relative), band in Hz. Higher bands locate better, but have side maxima
/// outside the range that the step before has already excluded.
const REFINEMENTS: [(f64, [f64; 2]); 2] = [(3e-3, [10.0, 120.0]), (1e-3, [20.0, 200.0])];
const POINTS: usize = 41;
const FIRST_BAND_HZ: [f64; 2] = [3.0, 60.0];

/// Speed in m/s at which the stacked energy of all axles is largest; `None` when the recording is silent.
pub fn estimate_speed(recording: &Recording, pattern: &AxlePattern, search: SpeedSearch) -> Option<f64> {
    let [low, high] = search.range_m_s;
    let count = ((high / low).ln() / search.first_step).ceil() as usize;
    let grid: Vec<f64> = (0..=count).map(|i| low * (i as f64 * search.first_step).exp()).collect();
    let (best, _) = maximum(recording, pattern, &grid, FIRST_BAND_HZ)?;
    let mut speed = grid[best];
    for (half, band) in REFINEMENTS {
        let step = 2.0 * half / (POINTS - 1) as f64;
        let grid: Vec<f64> = (0..POINTS).map(|i| speed * (1.0 - half + i as f64 * step)).collect();
        let (best, energy) = maximum(recording, pattern, &grid, band)?;
        let i = best.clamp(1, POINTS - 2);
        speed = grid[i] + speed * step * parabola_vertex(energy[i - 1], energy[i], energy[i + 1]);
    }
    Some(speed)
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
    let energy: Vec<f64> = speeds
        .par_chunks(LANES)
        .flat_map_iter(|some| {
            // A last chunk that is not full repeats its last speed.
            let lanes = std::array::from_fn(|l| some[l.min(some.len() - 1)]);
            stacked_energies(&lines, spacing, pattern, lanes).into_iter().take(some.len())
        })
        .collect();
    let best = (0..energy.len()).max_by(|a, b| energy[*a].total_cmp(&energy[*b]))?;
    (energy[best] > 0.0).then_some((best, energy))
}

/// Speeds at a time: the processor's vector registers hold several.
const LANES: usize = 4;

/// Σ |A(f)|² |Σ_w e^{2πi f s_w / v}|²: energy of the sum of the axle-shifted recordings at each of the speeds v, with s_w
/// the axle offsets. `lines` are equally spaced, so the phase of each axle advances by a constant factor.
fn stacked_energies(
    lines: &[(f64, f64)],
    spacing_hz: f64,
    pattern: &AxlePattern,
    speeds: [f64; LANES],
) -> [f64; LANES] {
    let Some((first_hz, _)) = lines.first() else { return [0.0; LANES] };
    let turns = |f: f64| -> Vec<[[f64; LANES]; 2]> {
        let phase = |offset: f64, speed: f64| std::f64::consts::TAU * f * offset / speed;
        let of = |o: &f64| [speeds.map(|v| phase(*o, v).cos()), speeds.map(|v| phase(*o, v).sin())];
        pattern.offset_m.iter().map(of).collect()
    };
    let (mut phasor, advance) = (turns(*first_hz), turns(spacing_hz));
    let mut energy = [0.0; LANES];
    for (_, power) in lines {
        let (mut real, mut imaginary) = ([0.0; LANES], [0.0; LANES]);
        for ([p_re, p_im], [a_re, a_im]) in phasor.iter_mut().zip(&advance) {
            for l in 0..LANES {
                real[l] += p_re[l];
                imaginary[l] += p_im[l];
                let (re, im) = (p_re[l], p_im[l]);
                p_re[l] = re * a_re[l] - im * a_im[l];
                p_im[l] = re * a_im[l] + im * a_re[l];
            }
        }
        for l in 0..LANES {
            energy[l] += power * (real[l] * real[l] + imaginary[l] * imaginary[l]);
        }
    }
    energy
}

/// Offset of the vertex of a parabola through three equally spaced values, in steps from the middle one, limited to ±1.
pub(super) fn parabola_vertex(left: f64, middle: f64, right: f64) -> f64 {
    let curvature = left - 2.0 * middle + right;
    if curvature < 0.0 { (0.5 * (left - right) / curvature).clamp(-1.0, 1.0) } else { 0.0 }
}
