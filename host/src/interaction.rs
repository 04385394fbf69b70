//! Wheel and track joined at the contact: how the irregularity and the varying deflection of the track make the
//! contact force deviate from the static one.
//!
//! With the wheel pressed down by Q and positive displacement down, the deviation d = f − Q moves the wheel by −α_w d,
//! the rail by G d and compresses the contact by C_H d; a wheel in contact follows rail plus irregularity, so
//! (α_w + G + C_H) d = −(z + w_s), with z the irregularity and w_s the variation of the deflection under the static load.
//! The contact is linearised at Q (loss of contact is left to the wheels' own deviations).

use faer::linalg::solvers::Solve as _;
use faer::{Mat, c64};

use crate::greens::GreensSampling;
use crate::greens::moving_response::RailGreens;
use crate::recording::Vehicle;
use crate::signal::{CubicSpline, irfft, taper};
use crate::track::{Side, Track};

/// Interaction of a wheel with the calibrated track on both rails.
#[derive(Clone, Debug)]
pub struct Interaction {
    rails: [RailGreens; 2],
    /// Deflection under the wheel per static force on both wheels, m/N, along x.
    static_compliance: [CubicSpline; 2],
    /// Impulse response of the wheelset at one contact, per lag (periodic), m/(N s).
    wheel: Vec<f64>,
    hertz_constant_n_m15: f64,
}

impl Interaction {
    /// For forces within `half_m` of x = 0.
    pub fn new(
        track: &Track,
        ballast_n_m2: &[f64],
        vehicle: &Vehicle,
        half_m: f64,
        sampling: GreensSampling,
    ) -> Self {
        Self {
            rails: RailGreens::of_both_rails(track, ballast_n_m2, half_m, sampling),
            static_compliance: static_compliance(track, ballast_n_m2, half_m),
            wheel: wheel_response(vehicle, sampling),
            hertz_constant_n_m15: vehicle.hertz_constant_n_m15,
        }
    }

    /// Force deviations at the positions of a wheel, one per time step, for irregularities there: `irregularity_m` has one
    /// column per case; the result likewise, in newtons per unit of the columns.
    pub fn follow(
        &self,
        side: Side,
        position_m: &[f64],
        static_force_n: f64,
        irregularity_m: &Mat<f64>,
    ) -> Mat<f64> {
        let rail = &self.rails[index(side)];
        let mut compliance = rail.kernel(position_m);
        let (n, len) = (position_m.len(), self.wheel.len());
        let dt = 1.0 / rail.sampling.rate_hz;
        let contact = 1.0 / (1.5 * self.hertz_constant_n_m15.powf(2.0 / 3.0) * static_force_n.cbrt());
        for j in 0..n {
            for k in 0..n {
                // The response is periodic; a slow train has more positions than the period.
                compliance[(k, j)] += self.wheel[(k as i64 - j as i64).rem_euclid(len as i64) as usize] * dt;
            }
            compliance[(j, j)] += contact;
        }
        -compliance.partial_piv_lu().solve(irregularity_m)
    }

    /// Variation of the deflection under the static load along the positions, metres, mean removed: a constant
    /// deflection moves the whole vehicle and makes no force.
    pub fn static_deflection_m(&self, side: Side, position_m: &[f64], static_force_n: f64) -> Vec<f64> {
        let spline = &self.static_compliance[index(side)];
        let values: Vec<f64> = position_m.iter().map(|x| static_force_n * spline.at(*x)).collect();
        let mean = crate::signal::mean(&values);
        values.iter().map(|v| v - mean).collect()
    }
}

fn index(side: Side) -> usize {
    match side {
        Side::Crossing => 0,
        Side::Stock => 1,
    }
}

/// Deflection of each rail under unit static forces on both rails at the same x.
fn static_compliance(track: &Track, ballast_n_m2: &[f64], half_m: f64) -> [CubicSpline; 2] {
    let nodes: Vec<usize> = (0..track.node_x_m.len())
        .filter(|i| track.node_x_m[*i].abs() <= half_m + 2.0 * track.step_m)
        .collect();
    let x: Vec<f64> = nodes.iter().map(|i| track.node_x_m[*i]).collect();
    let deflection = track.static_deflection_under_axle(ballast_n_m2, &nodes);
    [0, 1].map(|rail| {
        let y: Vec<f64> = deflection.iter().map(|d| d[rail]).collect();
        CubicSpline::new(&x, &y).unwrap_or_else(CubicSpline::zero)
    })
}

/// Band-limited impulse response of a rigid wheelset on its primary suspension (heave and roll, bogie frame at rest)
/// at one contact.
fn wheel_response(vehicle: &Vehicle, sampling: GreensSampling) -> Vec<f64> {
    let (k, c) =
        (2.0 * vehicle.primary_stiffness_per_axle_box_n_m, 2.0 * vehicle.primary_damping_per_axle_box_ns_m);
    let lever = vehicle.axle_box_half_distance_m.powi(2);
    let contact = vehicle.contact_half_distance_m.powi(2);
    let mut spectrum = vec![c64::new(0.0, 0.0); sampling.len / 2 + 1];
    for (value, f) in spectrum.iter_mut().zip(sampling.frequencies_hz()) {
        let w = std::f64::consts::TAU * f;
        let suspension = c64::new(k, w * c);
        let heave = c64::new(1.0, 0.0) / (suspension - w * w * vehicle.wheelset_mass_kg);
        let roll =
            c64::new(contact, 0.0) / (suspension * lever - w * w * vehicle.wheelset_roll_inertia_kg_m2);
        *value = (heave + roll) * (taper(f, sampling.band_hz[0], sampling.band_hz[1]) * sampling.rate_hz);
    }
    irfft(&spectrum, sampling.len)
}
