//! Kernels of a moving force: response at the fixed sensor to the force history under a wheel (eq. 8).

use faer::{Mat, c64};

use super::GreensFunctions;
use crate::signal::{irfft, rfft};
use crate::track::Side;

/// Motion of one wheel over the time axis of a window; the time axis has the rate of the Green's functions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WheelPath {
    /// +1 facing, -1 trailing.
    pub direction: f64,
    /// Speed, m/s.
    pub speed_m_s: f64,
    /// Window time at which the wheel is at x = 0, seconds.
    pub time_at_origin_s: f64,
}

impl WheelPath {
    /// Position at window time `t_s`.
    pub fn x_m(&self, t_s: f64) -> f64 {
        self.direction * self.speed_m_s * (t_s - self.time_at_origin_s)
    }

    /// Samples (index range, may be negative) during which |x| ≤ `half_m`.
    pub fn samples_within(&self, half_m: f64, rate_hz: f64) -> std::ops::RangeInclusive<i64> {
        let reach_s = half_m / self.speed_m_s;
        let first = ((self.time_at_origin_s - reach_s) * rate_hz).ceil() as i64;
        let last = ((self.time_at_origin_s + reach_s) * rate_hz).floor() as i64;
        first..=last
    }
}

/// Acausal part kept of the band-limited responses, samples: a zero-phase band limit rings before the impulse.
const LEAD: i64 = 60;

/// Kernel matrix, window samples × force samples, in response units per newton: `response = kernel · force`.
/// Forces are taken at the samples during which the wheel is within `half_m` of x = 0.
pub fn kernel(
    greens: &GreensFunctions,
    side: Side,
    path: &WheelPath,
    half_m: f64,
    window_len: usize,
) -> Mat<f64> {
    let rate = greens.sampling.rate_hz;
    let range = path.samples_within(half_m, rate);
    let first = *range.start();
    let columns = (range.end() - first + 1).max(0) as usize;
    let mut matrix = Mat::zeros(window_len, columns);
    for c in 0..columns {
        let j = first + c as i64;
        let x_m = path.x_m(j as f64 / rate);
        greens.add_at(side, x_m, j, LEAD, 1.0 / rate, matrix.col_as_slice_mut(c));
    }
    matrix
}

/// Samples on a wheel's own clock, on which it is at x = 0 at sample 0, while it is within `half_m`: positions, metres,
/// in the order of passing. Returns the first sample too.
pub fn own_positions(direction: f64, speed_m_s: f64, half_m: f64, rate_hz: f64) -> (i64, Vec<f64>) {
    let reach = (half_m / speed_m_s * rate_hz).floor() as i64;
    (-reach, (-reach..=reach).map(|j| direction * speed_m_s * j as f64 / rate_hz).collect())
}

/// Kernel like [`kernel`] with forces on the wheel's own clock ([`own_positions`]): the wheel is at x = 0 at a window
/// time that need not be a sample, and `greens` are delayed by its fraction.
pub fn own_clock_kernel(
    greens: &GreensFunctions,
    side: Side,
    position_m: &[f64],
    first_sample: i64,
    window_len: usize,
) -> Mat<f64> {
    let rate = greens.sampling.rate_hz;
    let mut matrix = Mat::zeros(window_len, position_m.len());
    for (c, x_m) in position_m.iter().enumerate() {
        let column = matrix.col_as_slice_mut(c);
        greens.add_at(side, *x_m, first_sample + c as i64, LEAD, 1.0 / rate, column);
    }
    matrix
}

/// Response of the sensor to one passing wheel on both rails, to be placed at any time: kept as a spectrum, so that a
/// shift by a fraction of a sample is exact.
#[derive(Clone, Debug)]
pub struct PassingResponse {
    rate_hz: f64,
    /// Sample at which the wheel is at x = 0.
    origin: f64,
    /// Samples that are not zero.
    support: usize,
    padded: usize,
    series: Vec<f64>,
    spectrum: Vec<c64>,
}

impl PassingResponse {
    /// Of the constant forces of an axle on both rails, `force_n` their mean, faded out towards the rail ends like
    /// [`constant_force_response`]; to be placed in windows of up to `window_len` samples.
    pub fn of_constant(
        greens: &GreensFunctions,
        direction: f64,
        speed_m_s: f64,
        window_len: usize,
        force_n: f64,
    ) -> Self {
        let rate_hz = greens.sampling.rate_hz;
        let (first, positions) = own_positions(direction, speed_m_s, FADE_M[1], rate_hz);
        let support = positions.len() + greens.sampling.len;
        let padded = (support + window_len).next_power_of_two();
        let origin = (LEAD - first) as f64;
        let silent =
            Self { rate_hz, origin, support, padded, series: vec![0.0; padded], spectrum: Vec::new() };
        let [crossing, stock] = greens.load_factor.map(|factor| vec![factor * force_n; positions.len()]);
        silent.with(greens, first, &positions, [&crossing, &stock])
    }

    /// With forces added on the crossing and the stock rail at positions of the wheel's own clock, from sample `first` on.
    pub fn with(
        &self,
        greens: &GreensFunctions,
        first: i64,
        position_m: &[f64],
        force_n: [&[f64]; 2],
    ) -> Self {
        let mut series = self.series.clone();
        let start = self.origin as i64 + first;
        for (side, force_n) in [Side::Crossing, Side::Stock].into_iter().zip(force_n) {
            for ((c, x_m), force_n) in position_m.iter().enumerate().zip(force_n) {
                let scale = fade(*x_m) * force_n / self.rate_hz;
                greens.add_at(side, *x_m, start + c as i64, LEAD, scale, &mut series);
            }
        }
        let spectrum = rfft(&series);
        Self { series, spectrum, ..*self }
    }

    /// Sum over wheels that are at x = 0 at the given window times.
    pub fn window(&self, time_at_origin_s: &[f64], len: usize) -> Vec<f64> {
        self.placed(time_at_origin_s, len, |_| c64::new(1.0, 0.0))
    }

    /// Time derivative of [`Self::window`], per second.
    pub fn slope(&self, time_at_origin_s: &[f64], len: usize) -> Vec<f64> {
        let step = std::f64::consts::TAU * self.rate_hz / self.padded as f64;
        self.placed(time_at_origin_s, len, |k| c64::new(0.0, step * k as f64))
    }

    fn placed(&self, time_at_origin_s: &[f64], len: usize, gain: impl Fn(usize) -> c64) -> Vec<f64> {
        let mut sum = vec![c64::new(0.0, 0.0); self.spectrum.len()];
        let mut any = false;
        for time in time_at_origin_s {
            let shift = time * self.rate_hz - self.origin;
            if shift + self.support as f64 <= 0.0 || shift >= len as f64 {
                continue;
            }
            any = true;
            let turn = c64::new(0.0, -std::f64::consts::TAU * shift / self.padded as f64).exp();
            let mut phasor = c64::new(1.0, 0.0);
            for (s, v) in sum.iter_mut().zip(&self.spectrum) {
                *s += v * phasor;
                phasor *= turn;
            }
        }
        if !any {
            return vec![0.0; len];
        }
        for (k, s) in sum.iter_mut().enumerate() {
            *s *= gain(k);
        }
        let mut out = irfft(&sum, self.padded);
        out.resize(len, 0.0);
        out
    }
}

/// Response of the window to a constant unit force on one rail, all the way along the track, faded out towards the
/// rail ends (10 … 14 m from the origin) so that no step enters there.
pub fn constant_force_response(
    greens: &GreensFunctions,
    side: Side,
    path: &WheelPath,
    window_len: usize,
) -> Vec<f64> {
    let rate = greens.sampling.rate_hz;
    let mut sum = vec![0.0; window_len];
    for j in path.samples_within(FADE_M[1], rate) {
        let x_m = path.x_m(j as f64 / rate);
        greens.add_at(side, x_m, j, LEAD, fade(x_m) / rate, &mut sum);
    }
    sum
}

fn fade(x_m: f64) -> f64 {
    ((FADE_M[1] - x_m.abs()) / (FADE_M[1] - FADE_M[0])).clamp(0.0, 1.0)
}

/// Where the constant force begins to fade and where it is gone, metres from the origin.
const FADE_M: [f64; 2] = [10.0, 14.0];
