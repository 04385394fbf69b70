//! One wheel passing at a speed, on its own clock: where its force is unknown, how it varies, and what the common
//! profile makes of it. All axles of a train share this.

use faer::Mat;

use super::prior::Prior;
use super::profile::CommonProfile;
use crate::greens::GreensFunctions;
use crate::greens::moving::{PassingResponse, own_positions};
use crate::interaction::{Contacts, Interaction, Motion};
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
    /// Factors of the covariance of the wheel's own deviation, N: `[leading, trailing][crossing, stock]`.
    pub(super) root_n: Contacts,
    pub(super) basis: Basis,
}

/// Force deviation per entry of the common profile.
pub(super) enum Basis {
    /// Splines on the grid of each rail: the profile is the deviation, part by part.
    Splines([Mat<f64>; 2]),
    /// All entries, `[leading, trailing][crossing, stock]`: wheel and track make forces of the profile.
    Full(Contacts),
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
        let (root_n, basis) = match model.excitation {
            Excitation::Force => {
                let step = 1.0 / (rate * prior.correlation_s);
                let root = |side: Side| {
                    let sd_n: Vec<f64> = position_m.iter().map(|x| prior.own_sd(side, *x)).collect();
                    prior.covariance_factor(&position_m, &sd_n, step)
                };
                let roots = [root(Side::Crossing)?, root(Side::Stock)?];
                let splines = SIDES.map(|s| common.grids.grid(s).basis(&position_m));
                ([roots.clone(), roots], Basis::Splines(splines))
            }
            Excitation::Irregularity(interaction) => {
                let motion = running.on(interaction, &position_m);
                let step = running.speed_m_s / (rate * prior.own_correlation_m);
                let path = |side: Side| prior.path_factor(&position_m, side, step);
                let own = motion.solve_alone(&[path(Side::Crossing)?, path(Side::Stock)?]);
                (own, Basis::Full(motion.solve(&common.grids.values_at(&position_m))))
            }
        };
        Some(Self { first_sample, position_m, root_n, basis })
    }
}

impl Running {
    fn on<'a>(&self, interaction: &'a Interaction, position_m: &'a [f64]) -> Motion<'a> {
        interaction.moving(position_m, self.direction, self.speed_m_s, self.static_force_n)
    }
}

/// Mean force deviations under the common profile at a wheel's own samples, newtons:
/// `[leading, trailing][crossing, stock]`.
pub fn mean_deviations_n(
    model: &TrackModel,
    running: &Running,
    common: &CommonProfile,
    position_m: &[f64],
) -> [[Vec<f64>; 2]; 2] {
    let profile = [0, 1].map(|axle: usize| {
        let class = common.grids.class(running.speed_m_s, axle);
        SIDES.map(|side| {
            let splines = common.grids.grid(side).basis(position_m);
            let coefficients = common.coefficients(side, class);
            splines * Mat::from_fn(coefficients.len(), 1, |i, _| coefficients[i])
        })
    });
    let deviation = match model.excitation {
        Excitation::Force => profile,
        Excitation::Irregularity(interaction) => {
            let motion = running.on(interaction, position_m);
            let deflection = motion.load_deflection_m();
            motion.solve(&[0, 1].map(|a: usize| [0, 1].map(|r: usize| &profile[a][r] + &deflection[a][r])))
        }
    };
    deviation.map(|axle| axle.map(|m| m.col_as_slice(0).to_vec()))
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
