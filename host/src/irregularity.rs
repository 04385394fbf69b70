//! Crossing irregularity from the identified force: wheel path minus rail deflection (paper, section 5, eq. 13-16).

use faer::Mat;
use rayon::prelude::*;

use crate::forces::{LOW_PASS_HZ, WheelForce};
use crate::greens::moving_response::RailGreens;
use crate::interaction::Wheelset;
use crate::recording::Vehicle;
use crate::signal::{CubicSpline, brick_band, one_at, resample};

/// Longest wavelength kept, metres (paper, section 5): double integration over a few metres drifts beyond it.
pub const LONGEST_WAVELENGTH_M: f64 = 1.0;

/// Effective mass of a rigid wheelset (heave and roll) at one contact, kg: 1 / (1/m + b²/I).
pub fn effective_wheel_mass_kg(vehicle: &Vehicle) -> f64 {
    1.0 / (1.0 / vehicle.wheelset_mass_kg
        + vehicle.contact_half_distance_m.powi(2) / vehicle.wheelset_roll_inertia_kg_m2)
}

/// Band-passed irregularity (1 m … 250 Hz) at `grid_m`, metres, positive down.
///
/// `rail` must hold Green's functions at the time step of the force. The wheel load is constant (eq. 15), so the wheel
/// accelerates by (Q − f)/m; the rail deflects under f − Q; the contact is compressed by Hertz's law.
pub fn irregularity(
    force: &WheelForce,
    speed_m_s: f64,
    static_force_n: f64,
    rail: &RailGreens,
    vehicle: &Vehicle,
    grid_m: &[f64],
) -> Vec<f64> {
    let rate_hz = rail.sampling.rate_hz;
    let dt = 1.0 / rate_hz;
    let mass = effective_wheel_mass_kg(vehicle);
    let deviation: Vec<f64> = force.force_n.iter().map(|f| f - static_force_n).collect();
    let moved = &rail.kernel(&force.position_m) * Mat::from_fn(deviation.len(), 1, |j, _| deviation[j]);
    let deflection: Vec<f64> = moved.col_as_slice(0).to_vec();
    let acceleration: Vec<f64> = deviation.iter().map(|d| -d / mass).collect();
    let raw: Vec<f64> = force
        .force_n
        .iter()
        .zip(twice_integrated(&acceleration, dt))
        .zip(&deflection)
        .map(|((f, path), rail)| path - rail - compression_m(*f, vehicle))
        .collect();
    in_band(&raw, rate_hz, speed_m_s, &force.position_m, grid_m)
}

/// The same without the assumptions that the wheel load is constant, the stock rail unloaded and the rail level under the
/// static load: primary suspension and bogie frame carry on, the stock side's force is what follows from this one, and the
/// static load sinks deeper between sleepers.
pub fn irregularity_of_wheelset(
    force: &WheelForce,
    speed_m_s: f64,
    static_force_n: f64,
    wheelset: &Wheelset,
    vehicle: &Vehicle,
    grid_m: &[f64],
) -> Vec<f64> {
    let leading = force.wheelset.is_multiple_of(2);
    let deviation_n = Mat::from_fn(force.force_n.len(), 1, |j, _| force.force_n[j] - static_force_n);
    let path = wheelset.relative_path_m(leading, &deviation_n);
    let raw: Vec<f64> = (force.force_n.iter().zip(path.col_as_slice(0)))
        .map(|(f, path)| path - compression_m(*f, vehicle))
        .collect();
    in_band(&raw, wheelset.rate_hz, speed_m_s, &force.position_m, grid_m)
}

/// Band-passed path, given at the samples, at `grid_m`.
fn in_band(path_m: &[f64], rate_hz: f64, speed_m_s: f64, position_m: &[f64], grid_m: &[f64]) -> Vec<f64> {
    on_grid(position_m, &banded(path_m, rate_hz, speed_m_s), grid_m)
}

/// Path at the samples without a cubic, in the band of the irregularity.
fn banded(path_m: &[f64], rate_hz: f64, speed_m_s: f64) -> Vec<f64> {
    brick_band(&without_cubic(path_m), rate_hz, speed_m_s / LONGEST_WAVELENGTH_M, LOW_PASS_HZ)
}

/// What becomes of the path at the samples before it goes to a grid, as a matrix: without a cubic, in the band of the irregularity.
pub fn in_band_matrix(samples: usize, rate_hz: f64, speed_m_s: f64) -> Mat<f64> {
    matrix(samples, |one| banded(one, rate_hz, speed_m_s))
}

/// [`on_grid`] as a matrix.
pub fn on_grid_matrix(position_m: &[f64], grid_m: &[f64]) -> Mat<f64> {
    matrix(position_m.len(), |one| on_grid(position_m, one, grid_m))
}

/// A linear map of `samples` values, column by column.
fn matrix(samples: usize, map: impl Fn(&[f64]) -> Vec<f64> + Sync) -> Mat<f64> {
    let column = |j: usize| map(&one_at(j, samples));
    let columns: Vec<Vec<f64>> = (0..samples).into_par_iter().map(column).collect();
    Mat::from_fn(columns.first().map_or(0, Vec::len), samples, |i, j| columns[j][i])
}

/// Change of the contact's compression with its force, m/N.
pub fn compression_slope_m_n(force_n: f64, vehicle: &Vehicle) -> f64 {
    match force_n > 0.0 {
        true => 2.0 / 3.0 * compression_m(force_n, vehicle) / force_n,
        false => 0.0,
    }
}

/// Hertz's law.
fn compression_m(force_n: f64, vehicle: &Vehicle) -> f64 {
    (force_n.max(0.0) / vehicle.hertz_constant_n_m15).powf(2.0 / 3.0)
}

/// Path from acceleration, both at the samples, from rest, by Numerov's rule: without delay, and 1.07 times too large at
/// 250 Hz and 800 samples per second, where Euler's steps would be half a sample early and 1.4 times too large.
fn twice_integrated(acceleration: &[f64], dt_s: f64) -> Vec<f64> {
    let n = acceleration.len();
    let mut path = vec![0.0; n];
    for k in 1..n.saturating_sub(1) {
        let mean = (acceleration[k - 1] + 10.0 * acceleration[k] + acceleration[k + 1]) / 12.0;
        path[k + 1] = 2.0 * path[k] - path[k - 1] + mean * dt_s * dt_s;
    }
    path
}

/// Residual of the least-squares cubic, which holds what the double integration cannot know; Legendre polynomials keep
/// the normal equations diagonal on the equidistant grid up to discretisation, which two sweeps remove.
fn without_cubic(values: &[f64]) -> Vec<f64> {
    let n = values.len();
    let mut out = values.to_vec();
    let u = |i: usize| 2.0 * i as f64 / (n.max(2) - 1) as f64 - 1.0;
    let legendre = |order: usize, x: f64| match order {
        0 => 1.0,
        1 => x,
        2 => 1.5 * x * x - 0.5,
        _ => 2.5 * x * x * x - 1.5 * x,
    };
    for _ in 0..3 {
        for order in 0..4 {
            let norm: f64 = (0..n).map(|i| legendre(order, u(i)).powi(2)).sum();
            let share: f64 = (0..n).map(|i| legendre(order, u(i)) * out[i]).sum::<f64>() / norm.max(1e-300);
            for (i, value) in out.iter_mut().enumerate() {
                *value -= share * legendre(order, u(i));
            }
        }
    }
    out
}

/// Interpolates values given at equidistant positions in the order of passing onto ascending positions, band-limited: at
/// 250 Hz and 800 samples per second a cubic spline alone would lose 5 %.
pub fn on_grid(position_m: &[f64], values: &[f64], grid_m: &[f64]) -> Vec<f64> {
    let n = values.len();
    let (Some(first), Some(last)) = (position_m.first(), position_m.last()) else {
        return vec![0.0; grid_m.len()];
    };
    // The straight line between the ends is taken out, so that the periodic continuation has no step.
    let line = |u: f64| values[0] + (values[n - 1] - values[0]) * u;
    let parts = (n - 1).max(1) as f64;
    let bent: Vec<f64> = values.iter().enumerate().map(|(i, v)| v - line(i as f64 / parts)).collect();
    let fine = resample(&bent, FINER * n);
    let step = (last - first) / parts / FINER as f64;
    let kept = FINER * (n - 1) + 1;
    let mut x: Vec<f64> = (0..kept).map(|i| first + i as f64 * step).collect();
    let mut y: Vec<f64> = (0..kept).map(|i| fine[i] + line(i as f64 / (FINER as f64 * parts))).collect();
    if x.first() > x.last() {
        x.reverse();
        y.reverse();
    }
    match CubicSpline::new(&x, &y) {
        Some(spline) => grid_m.iter().map(|p| spline.at(*p)).collect(),
        None => vec![0.0; grid_m.len()],
    }
}

/// Rate at which values are interpolated by splines, relative to that at which they are given.
const FINER: usize = 4;

#[cfg(test)]
mod tests {
    use super::*;

    /// A bell of acceleration: path and its place in time.
    #[test]
    fn analytic_integration_is_neither_early_nor_late() {
        let (dt, middle, width) = (1.0 / 800.0, 0.25, 0.006);
        let path = |t: f64| (-((t - middle) / width).powi(2)).exp();
        let acceleration = |t: f64| {
            let u = (t - middle) / width;
            path(t) * (4.0 * u * u - 2.0) / width.powi(2)
        };
        let samples: Vec<f64> = (0..400).map(|k| acceleration(k as f64 * dt)).collect();
        let found = twice_integrated(&samples, dt);
        let worst = (0..400).map(|k| (found[k] - path(k as f64 * dt)).abs()).fold(0.0, f64::max);
        assert!(worst < 2e-3, "{worst}");
        assert!(twice_integrated(&[1.0], dt) == [0.0] && twice_integrated(&[], dt).is_empty());
    }

    #[test]
    fn property_matrices_do_what_they_are_the_matrices_of() {
        let (rate_hz, speed_m_s) = (800.0, 42.0);
        let x: Vec<f64> = (-60..=60).map(|i| -f64::from(i) * speed_m_s / rate_hz).collect();
        let values: Vec<f64> =
            x.iter().map(|x| 1e-3 * (-(x / 0.3).powi(2)).exp() + 1e-4 * (7.0 * x).sin()).collect();
        let grid: Vec<f64> = (-90..=150).map(|i| f64::from(i) * 0.01).collect();
        let by_matrix = on_grid_matrix(&x, &grid)
            * in_band_matrix(x.len(), rate_hz, speed_m_s)
            * Mat::from_fn(x.len(), 1, |i, _| values[i]);
        for (i, expected) in in_band(&values, rate_hz, speed_m_s, &x, &grid).into_iter().enumerate() {
            assert!(
                (by_matrix[(i, 0)] - expected).abs() < 1e-12,
                "{i}: {} instead of {expected}",
                by_matrix[(i, 0)]
            );
        }
    }

    #[test]
    fn analytic_compression_grows_with_the_force_as_its_slope_says() {
        let vehicle = crate::verification::reference::vehicle();
        for force_n in [10e3, 76e3, 200e3] {
            let step = compression_m(force_n + 1.0, &vehicle) - compression_m(force_n - 1.0, &vehicle);
            assert!((0.5 * step / compression_slope_m_n(force_n, &vehicle) - 1.0).abs() < 1e-6);
        }
        assert_eq!(compression_slope_m_n(-1.0, &vehicle), 0.0);
    }

    #[test]
    fn analytic_a_wave_of_250_hz_survives_the_grid() {
        // 800 samples per second at 40 m/s, a wave of 250 Hz under a smooth hump.
        let x: Vec<f64> = (-80..=80).map(|i| f64::from(i) * 0.05).collect();
        let wave = |x: f64| (-0.5 * x * x).exp() * (std::f64::consts::TAU * 250.0 / 40.0 * x).cos() + 0.3 * x;
        let values: Vec<f64> = x.iter().map(|x| wave(*x)).collect();
        let grid: Vec<f64> = (-150..=150).map(|i| f64::from(i) * 0.01).collect();
        for (found, x) in on_grid(&x, &values, &grid).iter().zip(&grid) {
            assert!((found - wave(*x)).abs() < 0.002, "at {x} m: {found} instead of {}", wave(*x));
        }
    }
}
