//! Rail deflection under a moving force (GKFM-MR, eq. 13): impulse responses between rail nodes, interpolated to the
//! path of the wheel.

use faer::{Mat, c64};
use rayon::prelude::*;

use super::GreensSampling;
use crate::signal::{irfft, taper};
use crate::track::{Side, Track};

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
    /// Responses of one rail within `half_m` of x = 0.
    pub fn new(
        track: &Track,
        ballast_n_m2: &[f64],
        side: Side,
        half_m: f64,
        sampling: GreensSampling,
    ) -> Self {
        let nodes: Vec<usize> = (0..track.node_x_m.len())
            .filter(|i| track.node_x_m[*i].abs() <= half_m + 1.01 * track.step_m)
            .collect();
        let frequencies = sampling.frequencies_hz();
        let receptance = track.rail_receptance(&frequencies, ballast_n_m2, side, &nodes, &nodes);
        let n = nodes.len();
        let lags = LEAD + (MEMORY_S * sampling.rate_hz) as usize;
        let pairs: Vec<(usize, usize)> = (0..n).flat_map(|i| (0..=i).map(move |j| (i, j))).collect();
        let [pass, stop] = sampling.band_hz;
        let series: Vec<Vec<f64>> = pairs
            .par_iter()
            .map(|(loaded, read)| {
                let mut spectrum = vec![c64::new(0.0, 0.0); sampling.len / 2 + 1];
                for (k, f) in frequencies.iter().enumerate() {
                    spectrum[k] = receptance[k][*loaded][*read] * (taper(*f, pass, stop) * sampling.rate_hz);
                }
                let full = irfft(&spectrum, sampling.len);
                (0..lags).map(|i| full[(i + sampling.len - LEAD) % sampling.len]).collect()
            })
            .collect();
        let mut response = vec![0.0; lags * n * n];
        for ((loaded, read), values) in pairs.iter().zip(series) {
            for (lag, value) in values.into_iter().enumerate() {
                response[(lag * n + loaded) * n + read] = value;
                response[(lag * n + read) * n + loaded] = value;
            }
        }
        let first_x_m = nodes.first().map_or(0.0, |i| track.node_x_m[*i]);
        Self { sampling, first_x_m, step_m: track.step_m, n_nodes: n, response }
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
