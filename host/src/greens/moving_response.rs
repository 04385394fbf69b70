//! Rail deflection under a moving force (GKFM-MR, eq. 13): impulse responses between rail nodes, interpolated to the
//! path of the wheel.

use faer::{Mat, c64};
use rayon::prelude::*;

use super::GreensSampling;
use crate::signal::{irfft, taper};
use crate::track::Track;

/// Impulse responses between the nodes of one rail around the crossing.
#[derive(Clone, Debug)]
pub struct RailGreens {
    /// Sampling of the time axis.
    pub sampling: GreensSampling,
    first_x_m: f64,
    step_m: f64,
    n_nodes: usize,
    /// `[lag + LEAD][loaded][read]`, m/(N s).
    response: Vec<f64>,
}

/// Acausal samples kept: a zero-phase band limit rings before the impulse.
const LEAD: usize = 16;
/// Responses are dropped after this time, seconds: the deflection has decayed.
const MEMORY_S: f64 = 0.15;

impl RailGreens {
    /// Responses within `half_m` of x = 0, `[read][loaded]` for the crossing and the stock rail.
    pub fn of_both_rails(
        track: &Track,
        ballast_n_m2: &[f64],
        half_m: f64,
        sampling: GreensSampling,
    ) -> [[Self; 2]; 2] {
        let last_node = track.node_x_m.len() - 1;
        let within = |x: f64| x.abs() <= half_m + 1.01 * track.step_m;
        let first = track.node_x_m.iter().position(|x| within(*x)).unwrap_or(0);
        let last = track.node_x_m.iter().rposition(|x| within(*x)).unwrap_or(last_node);
        let receptance = track.rail_receptances(&sampling.frequencies_hz(), ballast_n_m2, first, last);
        let n_nodes = last - first + 1;
        [0, 1].map(|read: usize| {
            [0, 1].map(|loaded: usize| Self {
                sampling,
                first_x_m: track.node_x_m[first],
                step_m: track.step_m,
                n_nodes,
                response: impulse_responses(&receptance, [read, loaded], n_nodes, sampling),
            })
        })
    }

    /// Responses of the crossing rail to forces on it.
    pub fn of_crossing_rail(
        track: &Track,
        ballast_n_m2: &[f64],
        half_m: f64,
        sampling: GreensSampling,
    ) -> Self {
        let [[crossing, _], _] = Self::of_both_rails(track, ballast_n_m2, half_m, sampling);
        crossing
    }

    /// Kernel of the moving response: deflection at the wheel (m) per force (N) at the same positions x, one per time
    /// step.
    pub fn kernel(&self, position_m: &[f64]) -> Mat<f64> {
        let weights: Vec<Option<(usize, [f64; 4])>> = position_m.iter().map(|x| self.weights(*x)).collect();
        let n = self.n_nodes;
        let lags = self.response.len() / (n * n);
        let dt = 1.0 / self.sampling.rate_hz;
        Mat::from_fn(position_m.len(), position_m.len(), |k, j| {
            let lag = k + LEAD;
            if lag < j || lag - j >= lags {
                return 0.0;
            }
            let (Some((read, wr)), Some((loaded, wl))) = (&weights[k], &weights[j]) else { return 0.0 };
            let at_lag = &self.response[(lag - j) * n * n..(lag - j + 1) * n * n];
            let sum: f64 = wl
                .iter()
                .enumerate()
                .map(|(a, l)| {
                    let row = &at_lag[(loaded + a) * n + read..];
                    l * (wr[0] * row[0] + wr[1] * row[1] + wr[2] * row[2] + wr[3] * row[3])
                })
                .sum();
            sum * dt
        })
    }

    /// Cubic Lagrange weights of the four nodes around `x_m`; `None` outside the nodes.
    fn weights(&self, x_m: f64) -> Option<(usize, [f64; 4])> {
        let p = (x_m - self.first_x_m) / self.step_m;
        if !(p >= 0.0 && p <= (self.n_nodes as f64 - 1.0)) || self.n_nodes < 4 {
            return None;
        }
        let i = (p.floor() as usize).clamp(1, self.n_nodes - 3);
        let t = p - i as f64;
        let w = [
            -t * (t - 1.0) * (t - 2.0) / 6.0,
            (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0,
            -(t + 1.0) * t * (t - 2.0) / 2.0,
            (t + 1.0) * t * (t - 1.0) / 6.0,
        ];
        Some((i - 1, w))
    }
}

/// `[lag + LEAD][loaded][read]` from the upper triangles of the receptances of every frequency.
fn impulse_responses(
    receptance: &[Vec<Vec<[[c64; 2]; 2]>>],
    [read, loaded]: [usize; 2],
    n: usize,
    sampling: GreensSampling,
) -> Vec<f64> {
    let lags = LEAD + (MEMORY_S * sampling.rate_hz) as usize;
    let [pass, stop] = sampling.band_hz;
    let gain: Vec<f64> =
        sampling.frequencies_hz().iter().map(|f| taper(*f, pass, stop) * sampling.rate_hz).collect();
    let series = |i: usize, j: usize, [read, loaded]: [usize; 2]| {
        let mut spectrum = vec![c64::new(0.0, 0.0); sampling.len / 2 + 1];
        for ((value, rows), g) in spectrum.iter_mut().zip(receptance).zip(&gain) {
            *value = rows[i][j - i][read][loaded] * *g;
        }
        let full = irfft(&spectrum, sampling.len);
        (0..lags).map(|k| full[(k + sampling.len - LEAD) % sampling.len]).collect::<Vec<f64>>()
    };
    let pairs: Vec<(usize, usize)> = (0..n).flat_map(|i| (i..n).map(move |j| (i, j))).collect();
    // Read at i and loaded at j; and, by reciprocity with the rails exchanged, read at j and loaded at i.
    let both: Vec<[Vec<f64>; 2]> = pairs
        .par_iter()
        .map(|(i, j)| {
            let there = series(*i, *j, [read, loaded]);
            let back = if read == loaded { there.clone() } else { series(*i, *j, [loaded, read]) };
            [there, back]
        })
        .collect();
    let mut response = vec![0.0; lags * n * n];
    for ((i, j), [there, back]) in pairs.iter().zip(both) {
        for lag in 0..lags {
            response[(lag * n + i) * n + j] = back[lag];
            response[(lag * n + j) * n + i] = there[lag];
        }
    }
    response
}
