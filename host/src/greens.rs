//! Green's functions of the track seen by the sensor, and the moving-load kernels built from them
//! (paper, section 4.1, eq. 4-8; GKFM-FR).

mod check;
pub mod moving;
pub mod moving_response;

pub use check::{GreensError, try_kernel};

use faer::c64;

use crate::beam;
use crate::signal::{AntiAlias, irfft, rfft_frequencies_hz, taper};
use crate::track::{SensorReceptance, Side, Track};

/// What the Green's functions describe at the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Metres per newton second.
    Displacement,
    /// m/s² per newton second.
    Acceleration,
}

/// Sampling of the Green's functions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GreensSampling {
    /// Rate of the time axis, Hz.
    pub rate_hz: f64,
    /// Length in samples; `len / rate_hz` must exceed the decay time of the track, because the inverse transform is
    /// periodic.
    pub len: usize,
    /// Raised-cosine band limit: gain 1 up to the first, 0 from the second frequency, Hz.
    pub band_hz: [f64; 2],
}

impl GreensSampling {
    /// Force estimate: 800 Hz, its full band with room for the transition.
    pub fn wide() -> Self {
        Self { rate_hz: 800.0, len: 512, band_hz: [260.0, 330.0] }
    }

    /// Calibration by evidence: 375 Hz. On recordings of another program as accurate as 400 Hz, for a sixth less work; 350 Hz, near twice
    /// the end of the band, put wheels 5 instead of 4 mm off.
    pub fn low() -> Self {
        Self { rate_hz: 375.0, len: 240, band_hz: [110.0, 160.0] }
    }

    /// Frequencies at which the receptance is needed, Hz: those where the band limit is not zero.
    pub fn frequencies_hz(&self) -> Vec<f64> {
        let all = rfft_frequencies_hz(self.len, self.rate_hz);
        all.into_iter().filter(|f| *f < self.band_hz[1]).collect()
    }
}

/// Linear-phase or zero-phase digital filter that the data have passed and the model must therefore pass too.
#[derive(Clone, Debug)]
pub enum Chain {
    /// Data are already corrected for the recorder; only the band limit of the sampling applies.
    Corrected,
    /// Analog anti-alias filter followed by a symmetric FIR (delay removed), as on the node.
    Node {
        /// Recorder's filter.
        antialias: AntiAlias,
        /// FIR taps at the raw rate.
        taps: Vec<f64>,
        /// Raw rate, Hz.
        raw_rate_hz: f64,
    },
}

impl Chain {
    fn gain(&self, f_hz: f64) -> c64 {
        match self {
            Chain::Corrected => c64::new(1.0, 0.0),
            Chain::Node { antialias, taps, raw_rate_hz } => {
                let middle = (taps.len() as f64 - 1.0) / 2.0;
                let w = std::f64::consts::TAU * f_hz / raw_rate_hz;
                let fir: f64 =
                    taps.iter().enumerate().map(|(k, t)| t * (w * (k as f64 - middle)).cos()).sum();
                antialias.response(f_hz) * fir
            }
        }
    }
}

/// Unit impulse responses from every rail node (deflection and rotation) to the sensor.
#[derive(Clone, Debug)]
pub struct GreensFunctions {
    /// Sampling of the time axis.
    pub sampling: GreensSampling,
    first_node_x_m: f64,
    step_m: f64,
    n_nodes: usize,
    shear_ratio: [Vec<f64>; 2],
    /// `[side][(node * 2 + dof) * len + lag]`, periodic in lag.
    response: [Vec<f64>; 2],
    /// `[side][(node * 2 + dof) * lines + line]`: transform of the responses, up to the end of the band.
    spectrum: [Vec<c64>; 2],
    /// Static force of wheels on the crossing and on the stock rail, of half an axle's.
    pub(crate) load_factor: [f64; 2],
}

impl GreensFunctions {
    /// Inverse Fourier transform of the receptance (eq. 4), band-limited.
    pub fn new(
        track: &Track,
        ballast_n_m2: &[f64],
        sampling: GreensSampling,
        quantity: Quantity,
        chain: &Chain,
    ) -> Self {
        let receptance = track.sensor_receptance(&sampling.frequencies_hz(), ballast_n_m2);
        Self::of_receptance(track, &receptance, sampling, quantity, chain)
    }

    /// Of a receptance at the frequencies of `sampling`.
    pub(crate) fn of_receptance(
        track: &Track,
        receptance: &SensorReceptance,
        sampling: GreensSampling,
        quantity: Quantity,
        chain: &Chain,
    ) -> Self {
        let elements = track.node_x_m.len() - 1;
        let phi = |side| (0..elements).map(|e| track.shear_ratio(side, e)).collect();
        let gain: Vec<c64> = receptance
            .frequency_hz
            .iter()
            .map(|f| {
                let w = std::f64::consts::TAU * f;
                let order = if quantity == Quantity::Acceleration { -w * w } else { 1.0 };
                chain.gain(*f) * (order * taper(*f, sampling.band_hz[0], sampling.band_hz[1]))
            })
            .collect();
        let crossing = spectra(&receptance.crossing, &gain, sampling);
        let stock = spectra(&receptance.stock, &gain, sampling);
        Self {
            sampling,
            first_node_x_m: track.node_x_m[0],
            step_m: track.step_m,
            n_nodes: track.node_x_m.len(),
            shear_ratio: [phi(Side::Crossing), phi(Side::Stock)],
            response: [
                time_series(&crossing, gain.len(), sampling, 0.0),
                time_series(&stock, gain.len(), sampling, 0.0),
            ],
            spectrum: [crossing, stock],
            load_factor: track.load_factor,
        }
    }

    /// The same for forces within `half_m` of x = 0 only, all responses later by `delay_samples`.
    pub fn delayed(&self, delay_samples: f64, half_m: f64) -> Self {
        let node =
            |x_m: f64| ((x_m - self.first_node_x_m) / self.step_m).clamp(0.0, self.n_nodes as f64 - 1.0);
        let first = node(-half_m).floor() as usize;
        let last = (node(half_m).ceil() as usize).clamp((first + 1).min(self.n_nodes - 1), self.n_nodes - 1);
        let lines = self.spectrum[0].len() / (2 * self.n_nodes);
        let spectrum = [0, 1].map(|s| self.spectrum[s][2 * first * lines..2 * (last + 1) * lines].to_vec());
        let response = [0, 1].map(|s: usize| time_series(&spectrum[s], lines, self.sampling, delay_samples));
        Self {
            sampling: self.sampling,
            first_node_x_m: self.first_node_x_m + first as f64 * self.step_m,
            step_m: self.step_m,
            n_nodes: last - first + 1,
            shear_ratio: [0, 1].map(|s| self.shear_ratio[s][first..last].to_vec()),
            response,
            spectrum,
            load_factor: self.load_factor,
        }
    }

    /// Response of one degree of freedom of a node, over all lags.
    fn node_response(&self, side: usize, node: usize, dof: usize) -> &[f64] {
        let len = self.sampling.len;
        let start = (node * 2 + dof) * len;
        &self.response[side][start..start + len]
    }

    /// Writes the response at the sensor to a unit impulse at `x_m` on one rail into `out`, all lags (periodic).
    /// The force inside an element acts on its nodes by the element's shape functions. Zero outside the track.
    pub fn at(&self, side: Side, x_m: f64, out: &mut [f64]) {
        let Some((weights, series)) = self.nodes_at(side, x_m) else {
            out.fill(0.0);
            return;
        };
        let [a, b, c, d] = series;
        for (k, o) in out.iter_mut().enumerate().take(self.sampling.len) {
            *o = weights[0] * a[k] + weights[1] * b[k] + weights[2] * c[k] + weights[3] * d[k];
        }
    }

    /// Adds `scale` × the response to an impulse at `x_m` and at sample `start` of `target`, as far as it lies within;
    /// the last `lead` lags of the period count as acausal.
    pub(crate) fn add_at(&self, side: Side, x_m: f64, start: i64, lead: i64, scale: f64, target: &mut [f64]) {
        let Some((weights, series)) = self.nodes_at(side, x_m) else { return };
        let len = self.sampling.len as i64;
        let w = weights.map(|w| w * scale);
        let arch = pulp::Arch::new();
        let mut add = |first_lag: i64, end_lag: i64, offset: i64| {
            let from = (start + first_lag).max(0);
            let to = (start + end_lag).min(target.len() as i64);
            if from >= to {
                return;
            }
            let lags = (from - start + offset) as usize..(to - start + offset) as usize;
            let series = series.map(|s| &s[lags.clone()]);
            arch.dispatch(AddWeighted { weights: w, series, out: &mut target[from as usize..to as usize] });
        };
        add(-lead, 0, len);
        add(0, len - lead, 0);
    }

    /// Weights and responses of the four degrees of freedom on which a force at `x_m` acts; `None` outside the track.
    fn nodes_at(&self, side: Side, x_m: f64) -> Option<([f64; 4], [&[f64]; 4])> {
        let position = (x_m - self.first_node_x_m) / self.step_m;
        if !(position >= 0.0 && position <= (self.n_nodes - 1) as f64) {
            return None;
        }
        let element = (position as usize).min(self.n_nodes - 2);
        let side = if side == Side::Crossing { 0 } else { 1 };
        let weights = beam::shape(self.shear_ratio[side][element], self.step_m, position - element as f64);
        Some((weights, [0, 1, 2, 3].map(|i| self.node_response(side, element + i / 2, i % 2))))
    }
}

/// Adds the weighted sum of the series, as long as `out`, to it.
struct AddWeighted<'a> {
    weights: [f64; 4],
    series: [&'a [f64]; 4],
    out: &'a mut [f64],
}

impl pulp::WithSimd for AddWeighted<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        let ([a, b, c, d], w) = (self.series.map(S::as_simd_f64s), self.weights);
        let (out, out_rest) = S::as_mut_simd_f64s(self.out);
        let ws = w.map(|w| simd.splat_f64s(w));
        for ((((o, a), b), c), d) in out.iter_mut().zip(a.0).zip(b.0).zip(c.0).zip(d.0) {
            let pair = simd.mul_add_f64s(ws[0], *a, simd.mul_f64s(ws[1], *b));
            let other = simd.mul_add_f64s(ws[2], *c, simd.mul_f64s(ws[3], *d));
            *o = simd.add_f64s(*o, simd.add_f64s(pair, other));
        }
        for ((((o, a), b), c), d) in out_rest.iter_mut().zip(a.1).zip(b.1).zip(c.1).zip(d.1) {
            let pair = w[0].mul_add(*a, w[1] * b);
            *o += pair + w[2].mul_add(*c, w[3] * d);
        }
    }
}

/// Transforms of the nodes' impulse responses, one row of lines per degree of freedom.
fn spectra(receptance: &[Vec<[c64; 2]>], gain: &[c64], sampling: GreensSampling) -> Vec<c64> {
    let n_nodes = receptance.first().map_or(0, Vec::len);
    let mut out = Vec::with_capacity(2 * n_nodes * receptance.len());
    for node in 0..n_nodes {
        for dof in 0..2 {
            out.extend(receptance.iter().zip(gain).map(|(row, g)| row[node][dof] * g * sampling.rate_hz));
        }
    }
    out
}

/// Time series of the rows of `spectra`, later by `delay_samples`.
fn time_series(spectra: &[c64], lines: usize, sampling: GreensSampling, delay_samples: f64) -> Vec<f64> {
    let turn = -std::f64::consts::TAU * delay_samples / sampling.len as f64;
    let delay: Vec<c64> = (0..lines).map(|k| c64::new(0.0, turn * k as f64).exp()).collect();
    let mut out = Vec::with_capacity(spectra.len() / lines.max(1) * sampling.len);
    let mut spectrum = vec![c64::new(0.0, 0.0); sampling.len / 2 + 1];
    for row in spectra.chunks_exact(lines.max(1)) {
        for ((s, v), d) in spectrum.iter_mut().zip(row).zip(&delay) {
            *s = v * d;
        }
        out.extend(irfft(&spectrum, sampling.len));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::rfft;
    use crate::track::Mesh;
    use crate::verification::reference::{SPEED_M_S, STIFF, WHEEL_N, ballast, panel};

    const SAMPLING: GreensSampling = GreensSampling { rate_hz: 1000.0, len: 512, band_hz: [300.0, 400.0] };

    #[test]
    fn property_spectrum_of_the_response_is_the_receptance() {
        let track = panel(STIFF, Mesh::default());
        let greens = GreensFunctions::new(
            &track,
            &ballast(&track),
            SAMPLING,
            Quantity::Acceleration,
            &Chain::Corrected,
        );
        let (node, f) = (40, 64.0 * SAMPLING.rate_hz / SAMPLING.len as f64);
        let mut response = vec![0.0; SAMPLING.len];
        greens.at(Side::Crossing, track.node_x_m[node], &mut response);
        let found = rfft(&response)[64] / SAMPLING.rate_hz;
        let direct = track.sensor_receptance(&[f], &ballast(&track)).crossing[0][node][0];
        let expected = direct * -(std::f64::consts::TAU * f).powi(2);
        assert!((found - expected).norm() < 1e-10 * expected.norm());
        greens.at(Side::Crossing, 10.9, &mut response);
        assert!(response.iter().all(|v| *v == 0.0), "nothing beyond the rails");
    }

    /// At 1 m/s the inertia of everything is negligible: the response follows the static influence line.
    #[test]
    fn analytic_slow_force_gives_the_influence_line() {
        let track = panel(STIFF, Mesh::default());
        let sampling = GreensSampling { rate_hz: 100.0, len: 128, band_hz: [30.0, 45.0] };
        let greens = GreensFunctions::new(
            &track,
            &ballast(&track),
            sampling,
            Quantity::Displacement,
            &Chain::Corrected,
        );
        let path = moving::WheelPath { direction: 1.0, speed_m_s: 1.0, time_at_origin_s: 6.0 };
        let matrix = moving::kernel(&greens, Side::Crossing, &path, 5.0, 1200);
        let statics = track.sensor_receptance(&[0.0], &ballast(&track));
        for node in [30, 33, 36, 39] {
            let x = track.node_x_m[node];
            let row = ((path.time_at_origin_s + x / path.speed_m_s) * sampling.rate_hz).round() as usize;
            let found: f64 = matrix.row(row).iter().sum::<f64>() * WHEEL_N;
            let expected = statics.crossing[0][node][0].re * WHEEL_N;
            assert!((found - expected).abs() < 0.01 * statics.crossing[0][36][0].re * WHEEL_N, "{x}");
        }
    }

    #[test]
    fn property_constant_force_is_the_sum_of_the_kernel() {
        let track = panel(STIFF, Mesh::default());
        let greens = GreensFunctions::new(
            &track,
            &ballast(&track),
            SAMPLING,
            Quantity::Displacement,
            &Chain::Corrected,
        );
        let path = moving::WheelPath { direction: -1.0, speed_m_s: SPEED_M_S, time_at_origin_s: 0.25 };
        let constant = moving::constant_force_response(&greens, Side::Stock, &path, 500);
        let matrix = moving::kernel(&greens, Side::Stock, &path, 10.0, 500);
        let peak = constant.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        // Near the sensor, what happens beyond 10 m has died away.
        for (k, expected) in constant.iter().enumerate().take(300).skip(200) {
            let sum: f64 = matrix.row(k).iter().sum();
            assert!((sum - expected).abs() < 1e-3 * peak);
        }
    }
}
