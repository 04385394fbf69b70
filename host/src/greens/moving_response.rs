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
    /// `[loaded][read][lag + LEAD]`, m/(N s).
    response: Vec<f64>,
}

/// Impulse responses of every pair of nodes i ≤ j, read at i and loaded at j.
type PairSeries = Vec<Vec<f64>>;

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
        let nodes = Nodes::within(track, half_m);
        let receptance = nodes.receptance(track, ballast_n_m2, sampling);
        let series = [0, 1].map(|read: usize| {
            [0, 1].map(|loaded: usize| pair_series(&receptance, [read, loaded], nodes.len(), sampling))
        });
        // By reciprocity with the rails exchanged, read at j and loaded at i.
        [0, 1].map(|read: usize| {
            [0, 1].map(|loaded: usize| {
                nodes.greens(track, sampling, &series[read][loaded], &series[loaded][read])
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
        let nodes = Nodes::within(track, half_m);
        let receptance = nodes.receptance(track, ballast_n_m2, sampling);
        let series = pair_series(&receptance, [0, 0], nodes.len(), sampling);
        nodes.greens(track, sampling, &series, &series)
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
struct Nodes {
    first: usize,
    last: usize,
}

impl Nodes {
    fn within(track: &Track, half_m: f64) -> Self {
        let within = |x: f64| x.abs() <= half_m + 1.01 * track.step_m;
        let first = track.node_x_m.iter().position(|x| within(*x)).unwrap_or(0);
        let last = track.node_x_m.iter().rposition(|x| within(*x));
        Self { first, last: last.unwrap_or(track.node_x_m.len() - 1) }
    }

    fn len(&self) -> usize {
        self.last - self.first + 1
    }

    fn receptance(
        &self,
        track: &Track,
        ballast_n_m2: &[f64],
        sampling: GreensSampling,
    ) -> Vec<Vec<Vec<[[c64; 2]; 2]>>> {
        track.rail_receptances(&sampling.frequencies_hz(), ballast_n_m2, self.first, self.last)
    }

    /// From the responses of all pairs, and those with the places of load and reading exchanged.
    fn greens(
        &self,
        track: &Track,
        sampling: GreensSampling,
        there: &PairSeries,
        back: &PairSeries,
    ) -> RailGreens {
        let n = self.len();
        let lags = there.first().map_or(0, Vec::len);
        let mut response = vec![0.0; lags * n * n];
        for ((i, j), (there, back)) in pairs(n).zip(there.iter().zip(back)) {
            let mut put = |loaded: usize, read: usize, series: &[f64]| {
                let start = (loaded * n + read) * lags;
                response[start..start + lags].copy_from_slice(series);
            };
            put(i, j, back);
            put(j, i, there);
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

/// From the upper triangles of the receptances of every frequency, from lag −[`LEAD`] on.
fn pair_series(
    receptance: &[Vec<Vec<[[c64; 2]; 2]>>],
    [read, loaded]: [usize; 2],
    n: usize,
    sampling: GreensSampling,
) -> PairSeries {
    let lags = LEAD + (MEMORY_S * sampling.rate_hz) as usize;
    let [pass, stop] = sampling.band_hz;
    let gain: Vec<f64> =
        sampling.frequencies_hz().iter().map(|f| taper(*f, pass, stop) * sampling.rate_hz).collect();
    let series = |(i, j): &(usize, usize)| {
        let mut spectrum = vec![c64::new(0.0, 0.0); sampling.len / 2 + 1];
        for ((value, rows), g) in spectrum.iter_mut().zip(receptance).zip(&gain) {
            *value = rows[*i][j - i][read][loaded] * *g;
        }
        let full = irfft(&spectrum, sampling.len);
        (0..lags).map(|k| full[(k + sampling.len - LEAD) % sampling.len]).collect()
    };
    pairs(n).collect::<Vec<_>>().par_iter().map(series).collect()
}
