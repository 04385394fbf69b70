//! One wheel passing at a speed, on its own clock: where its force is unknown, how it varies, and what the common
//! profile makes of it. All axles of a train share this.

use faer::Mat;

use super::prior::Prior;
use super::profile::{CommonProfile, WheelClass};
use crate::greens::GreensFunctions;
use crate::greens::moving::{PassingResponse, own_positions};
use crate::interaction::Interaction;
use crate::track::Side;

/// How the common profile makes forces.
#[derive(Clone, Copy, Debug)]
pub enum Excitation<'a> {
    /// It is an irregularity that wheel and track follow.
    Irregularity(&'a Interaction),
    /// It is the force deviation itself.
    Force,
}

/// A calibrated track as the wheels meet it.
#[derive(Clone, Copy, Debug)]
pub struct TrackModel<'a> {
    /// Green's functions of the sensor.
    pub greens: &'a GreensFunctions,
    /// How the common profile makes forces.
    pub excitation: Excitation<'a>,
}

/// Motion and load of the wheels of a train.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Running {
    /// +1 facing, -1 trailing.
    pub direction: f64,
    /// Speed, m/s.
    pub speed_m_s: f64,
    /// Static wheel force, newtons.
    pub static_force_n: f64,
}

/// Wheel on its own clock: it is at x = 0 at sample 0.
pub(super) struct Wheel {
    pub(super) first_sample: i64,
    pub(super) position_m: Vec<f64>,
    pub(super) sides: [WheelSide; 2],
}

/// One rail under the wheel.
pub(super) struct WheelSide {
    /// Factor of the covariance of the wheel's own deviation, N.
    pub(super) root_n: Mat<f64>,
    /// Force deviation per spline coefficient of the common profile.
    pub(super) basis: Mat<f64>,
}

pub(super) const SIDES: [Side; 2] = [Side::Crossing, Side::Stock];

impl Wheel {
    /// `None` if a covariance is not finite.
    pub(super) fn new(
        model: &TrackModel,
        running: &Running,
        prior: &Prior,
        common: &CommonProfile,
    ) -> Option<Self> {
        let rate = model.greens.sampling.rate_hz;
        let (first_sample, position_m) =
            own_positions(running.direction, running.speed_m_s, prior.half_m, rate);
        let step = 1.0 / (rate * prior.correlation_s);
        let side = |side: Side| {
            let sd_n: Vec<f64> = position_m.iter().map(|x| prior.own_sd_n(side, *x)).collect();
            let splines = common.grids.grid(side).basis(&position_m);
            let basis = match model.excitation {
                Excitation::Force => splines,
                Excitation::Irregularity(interaction) => {
                    interaction.follow(side, &position_m, running.static_force_n, &splines)
                }
            };
            Some(WheelSide { root_n: prior.covariance_factor(&position_m, &sd_n, step)?, basis })
        };
        let sides = [side(Side::Crossing)?, side(Side::Stock)?];
        Some(Self { first_sample, position_m, sides })
    }
}

/// Mean force deviation of a wheel under the common profile, at its own samples: [`SIDES`], newtons.
pub(super) fn mean_deviation_n(
    model: &TrackModel,
    running: &Running,
    common: &CommonProfile,
    class: WheelClass,
    position_m: &[f64],
) -> [Vec<f64>; 2] {
    SIDES.map(|side| {
        let splines = common.grids.grid(side).basis(position_m);
        let coefficients = common.coefficients(side, class);
        let mut value = Mat::from_fn(position_m.len(), 1, |j, _| {
            (0..coefficients.len()).map(|i| splines[(j, i)] * coefficients[i]).sum::<f64>()
        });
        if let Excitation::Irregularity(interaction) = model.excitation {
            let deflection = interaction.static_deflection_m(side, position_m, running.static_force_n);
            for (j, d) in deflection.iter().enumerate() {
                value[(j, 0)] += d;
            }
            value = interaction.follow(side, position_m, running.static_force_n, &value);
        }
        value.col_as_slice(0).to_vec()
    })
}

/// Response of the sensor to one wheel on both rails: its static force, and the mean deviation if it has one.
pub(super) fn passing(
    model: &TrackModel,
    running: &Running,
    deviation: Option<&(i64, [Vec<f64>; 2])>,
    window_len: usize,
) -> PassingResponse {
    PassingResponse::new(model.greens, running.direction, running.speed_m_s, window_len, |side, j, _| {
        let mean = deviation.map_or(0.0, |(first, values)| {
            let index = usize::from(side != Side::Crossing);
            usize::try_from(j - first).ok().and_then(|i| values[index].get(i)).copied().unwrap_or(0.0)
        });
        running.static_force_n + mean
    })
}
