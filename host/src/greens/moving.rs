//! Kernels of a moving force: response at the fixed sensor to the force history under a wheel (eq. 8).

use faer::Mat;

use super::GreensFunctions;
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
    let mut response = vec![0.0; greens.sampling.len];
    for c in 0..columns {
        let j = first + c as i64;
        greens.at(side, path.x_m(j as f64 / rate), &mut response);
        add_shifted(matrix.col_as_slice_mut(c), &response, j, 1.0 / rate);
    }
    matrix
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
    let mut response = vec![0.0; greens.sampling.len];
    for j in path.samples_within(FADE_M[1], rate) {
        let x = path.x_m(j as f64 / rate);
        let weight = ((FADE_M[1] - x.abs()) / (FADE_M[1] - FADE_M[0])).clamp(0.0, 1.0);
        greens.at(side, x, &mut response);
        add_shifted(&mut sum, &response, j, weight / rate);
    }
    sum
}

/// Where the constant force begins to fade and where it is gone, metres from the origin.
const FADE_M: [f64; 2] = [10.0, 14.0];

/// Adds `scale` × the periodic `response`, starting at window sample `start`, to `target`.
fn add_shifted(target: &mut [f64], response: &[f64], start: i64, scale: f64) {
    let len = response.len() as i64;
    let from = (start - LEAD).max(0);
    let to = (start + len - LEAD).min(target.len() as i64);
    for k in from..to {
        let lag = (k - start).rem_euclid(len) as usize;
        target[k as usize] += scale * response[lag];
    }
}
