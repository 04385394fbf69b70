//! Rail deflection under a moving force (GKFM-MR, eq. 13): impulse responses between rail nodes, interpolated to the
//! path of the wheel.

use faer::c64;

use crate::signal::{irfft, rfft_frequencies_hz, taper};
use crate::track::{Side, Track};

/// Impulse responses between the rail nodes around the crossing.
pub struct RailGreens {
    /// Rate of the time axis, Hz.
    pub rate_hz: f64,
    len: usize,
    first_x_m: f64,
    step_m: f64,
    n_nodes: usize,
    /// `[lag + LEAD][loaded][read]`, m/(N s).
    response: Vec<f64>,
}

/// Band of the responses, Hz: the force holds nothing above 250 Hz.
const BAND_HZ: [f64; 2] = [300.0, 400.0];
/// Length of the time axis, samples; half a second at 1 kHz.
const LEN: usize = 512;
/// Responses are dropped after this many samples: the deflection has decayed.
const MEMORY: usize = 150;
/// Samples kept before the impulse: the band limit spreads the sharp rise of the deflection under the load over a few
/// milliseconds to both sides, and without the part before it the static deflection comes out 1-4 % too small.
const LEAD: usize = 30;

impl RailGreens {
    /// Responses of one rail within `half_m` of x = 0.
    pub fn new(track: &Track, ballast_n_m2: &[f64], side: Side, half_m: f64, rate_hz: f64) -> Self {
        let nodes: Vec<usize> =
            (0..track.node_x_m.len()).filter(|i| track.node_x_m[*i].abs() <= half_m + track.step_m).collect();
        let frequencies: Vec<f64> =
            rfft_frequencies_hz(LEN, rate_hz).into_iter().filter(|f| *f < BAND_HZ[1]).collect();
        let receptance = track.rail_receptance(&frequencies, ballast_n_m2, side, &nodes, &nodes);
        let n = nodes.len();
        let kept = LEAD + MEMORY;
        let mut response = vec![0.0; kept * n * n];
        let mut spectrum = vec![c64::new(0.0, 0.0); LEN / 2 + 1];
        for loaded in 0..n {
            for read in 0..=loaded {
                for (k, f) in frequencies.iter().enumerate() {
                    spectrum[k] = receptance[k][loaded][read] * (taper(*f, BAND_HZ[0], BAND_HZ[1]) * rate_hz);
                }
                let periodic = irfft(&spectrum, LEN);
                for lag in 0..kept {
                    let value = periodic[(lag + LEN - LEAD) % LEN];
                    response[(lag * n + loaded) * n + read] = value;
                    response[(lag * n + read) * n + loaded] = value;
                }
            }
        }
        let first_x_m = nodes.first().map_or(0.0, |i| track.node_x_m[*i]);
        Self { rate_hz, len: kept, first_x_m, step_m: track.step_m, n_nodes: n, response }
    }

    /// Deflection at the wheel, metres, for a force (N) at its positions x, one per time step.
    pub fn moving_deflection(&self, position_m: &[f64], force_n: &[f64]) -> Vec<f64> {
        let weights: Vec<Option<(usize, [f64; 4])>> = position_m.iter().map(|x| self.weights(*x)).collect();
        let n = self.n_nodes;
        let dt = 1.0 / self.rate_hz;
        (0..position_m.len())
            .map(|k| {
                let Some((read, wr)) = &weights[k] else { return 0.0 };
                let mut sum = 0.0;
                let last = (k + LEAD).min(position_m.len() - 1);
                for j in (k + LEAD + 1).saturating_sub(self.len)..=last {
                    let Some((loaded, wl)) = &weights[j] else { continue };
                    let lag = k + LEAD - j;
                    let at_lag = &self.response[lag * n * n..(lag + 1) * n * n];
                    let mut g = 0.0;
                    for (a, l) in wl.iter().enumerate() {
                        let row = &at_lag[(loaded + a) * n + read..];
                        g += l * (wr[0] * row[0] + wr[1] * row[1] + wr[2] * row[2] + wr[3] * row[3]);
                    }
                    sum += g * force_n[j];
                }
                sum * dt
            })
            .collect()
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
