//! Rail deflection under a moving force (GKFM-MR, eq. 13): impulse responses between rail nodes, interpolated to the
//! path of the wheel.

use faer::{Mat, c64};
use rayon::prelude::*;

use super::GreensSampling;
use crate::signal::{irfft, taper};
use crate::track::{RailReceptances, Track};

/// Impulse responses between the nodes of one rail around the crossing.
#[derive(Clone, Debug)]
pub struct RailGreens {
    /// Sampling of the time axis.
    pub sampling: GreensSampling,
    first_x_m: f64,
    step_m: f64,
    n_nodes: usize,
    /// `[loaded][read][lag + LEAD]`, m/(N s).
    response: Vec<f64>,
}

/// Impulse responses of every pair of nodes i ≤ j, read at i and loaded at j: `[read][loaded]` for the two rails.
type PairSeries<const R: usize> = Vec<[[Vec<f64>; R]; R]>;

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
        let nodes = RailNodes::within(track, half_m);
        let receptance = nodes.receptance(track, ballast_n_m2, sampling);
        Self::of_receptances(track, &nodes, &receptance, sampling)
    }

    /// The same of receptances between `nodes` at the frequencies of `sampling`.
    pub(crate) fn of_receptances(
        track: &Track,
        nodes: &RailNodes,
        receptance: &RailReceptances,
        sampling: GreensSampling,
    ) -> [[Self; 2]; 2] {
        let series: PairSeries<2> = pair_series(receptance, nodes.len(), sampling);
        [0, 1].map(|read: usize| {
            [0, 1].map(|loaded: usize| nodes.greens(track, sampling, &series, [read, loaded]))
        })
    }

    /// Responses of the crossing rail to forces on it.
    pub fn of_crossing_rail(
        track: &Track,
        ballast_n_m2: &[f64],
        half_m: f64,
        sampling: GreensSampling,
    ) -> Self {
        let nodes = RailNodes::within(track, half_m);
        let receptance = nodes.receptance(track, ballast_n_m2, sampling);
        let series: PairSeries<1> = pair_series(&receptance, nodes.len(), sampling);
        nodes.greens(track, sampling, &series, [0, 0])
    }

    /// Kernel of the moving response: deflection at the wheel (m) per force (N) at the same positions x, one per time
    /// step.
    pub fn kernel(&self, position_m: &[f64]) -> Mat<f64> {
        let weights: Vec<Option<(usize, [f64; 4])>> = position_m.iter().map(|x| self.weights(*x)).collect();
        let n = self.n_nodes;
        let lags = self.response.len() / (n * n);
        let dt = 1.0 / self.sampling.rate_hz;
        let mut out = Mat::zeros(position_m.len(), position_m.len());
        for (j, at_load) in weights.iter().enumerate() {
            let Some((loaded, wl)) = at_load else { continue };
            let first = j.saturating_sub(LEAD);
            let column = out.col_as_slice_mut(j).iter_mut().zip(&weights).enumerate().skip(first);
            for (k, (value, at_read)) in column.take(j + lags - LEAD - first) {
                let Some((read, wr)) = at_read else { continue };
                let mut sum = 0.0;
                for (a, l) in wl.iter().enumerate() {
                    let series = &self.response[((loaded + a) * n + read) * lags..];
                    let at = |b: usize| series[b * lags + k + LEAD - j];
                    sum += l * (wr[0] * at(0) + wr[1] * at(1) + wr[2] * at(2) + wr[3] * at(3));
                }
                *value = sum * dt;
            }
        }
        out
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

/// Neighbouring rail nodes around the crossing.
pub(crate) struct RailNodes {
    first: usize,
    last: usize,
}

impl RailNodes {
    pub(crate) fn within(track: &Track, half_m: f64) -> Self {
        let within = |x: f64| x.abs() <= half_m + 1.01 * track.step_m;
        let first = track.node_x_m.iter().position(|x| within(*x)).unwrap_or(0);
        let last = track.node_x_m.iter().rposition(|x| within(*x));
        Self { first, last: last.unwrap_or(track.node_x_m.len() - 1) }
    }

    fn len(&self) -> usize {
        self.last - self.first + 1
    }

    fn receptance(&self, track: &Track, ballast_n_m2: &[f64], sampling: GreensSampling) -> RailReceptances {
        track.rail_receptances(&sampling.frequencies_hz(), ballast_n_m2, self.range())
    }

    /// First and last.
    pub(crate) fn range(&self) -> [usize; 2] {
        [self.first, self.last]
    }

    /// Responses read on one rail and loaded on another.
    fn greens<const R: usize>(
        &self,
        track: &Track,
        sampling: GreensSampling,
        series: &PairSeries<R>,
        [read, loaded]: [usize; 2],
    ) -> RailGreens {
        let n = self.len();
        let lags = kept_lags(sampling);
        let mut response = vec![0.0; lags * n * n];
        for ((i, j), pair) in pairs(n).zip(series) {
            let mut put = |at_load: usize, at_read: usize, series: &[f64]| {
                let start = (at_load * n + at_read) * lags;
                response[start..start + lags].copy_from_slice(series);
            };
            // By reciprocity with the rails exchanged, read at j and loaded at i.
            put(i, j, &pair[loaded][read]);
            put(j, i, &pair[read][loaded]);
        }
        RailGreens {
            sampling,
            first_x_m: track.node_x_m[self.first],
            step_m: track.step_m,
            n_nodes: n,
            response,
        }
    }
}

fn pairs(n: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..n).flat_map(move |i| (i..n).map(move |j| (i, j)))
}

/// Lags of a response, from −[`LEAD`] on.
fn kept_lags(sampling: GreensSampling) -> usize {
    LEAD + (MEMORY_S * sampling.rate_hz) as usize
}

/// From lag −[`LEAD`] on; for one rail, the first, or for both.
fn pair_series<const R: usize>(
    receptance: &RailReceptances,
    n: usize,
    sampling: GreensSampling,
) -> PairSeries<R> {
    let [pass, stop] = sampling.band_hz;
    let gain: Vec<f64> =
        sampling.frequencies_hz().iter().map(|f| taper(*f, pass, stop) * sampling.rate_hz).collect();
    let kept = |spectrum: &Vec<c64>| -> Vec<f64> {
        let full = irfft(spectrum, sampling.len);
        (0..kept_lags(sampling)).map(|k| full[(k + sampling.len - LEAD) % sampling.len]).collect()
    };
    let series = |pair: usize| {
        let mut spectra: [[Vec<c64>; R]; R] =
            std::array::from_fn(|_| std::array::from_fn(|_| Vec::with_capacity(receptance.len())));
        for (pairs, g) in receptance.iter().zip(&gain) {
            for (spectra, values) in spectra.iter_mut().zip(&pairs[pair]) {
                for (spectrum, value) in spectra.iter_mut().zip(values) {
                    spectrum.push(*value * *g);
                }
            }
        }
        spectra.each_ref().map(|row| row.each_ref().map(kept))
    };
    (0..pairs(n).count()).into_par_iter().map(series).collect()
}
