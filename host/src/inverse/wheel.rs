//! One wheel passing at a speed, on its own clock: where its force is unknown, how it varies, and what the common
//! profile makes of it. All axles of a train share this.

use faer::Mat;

use super::prior::Prior;
use super::profile::CommonProfile;
use crate::greens::GreensFunctions;
use crate::greens::moving::own_positions;
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
    /// Mean deviations under the common profile, newtons.
    pub(super) mean_n: Means,
}

/// Force deviations at a wheel's own samples, newtons: `[leading, trailing][crossing, stock]`.
pub(super) type Means = [[Vec<f64>; 2]; 2];

/// Force deviation per entry of the common profile.
pub(super) enum Basis {
    /// Splines on the grid of each rail: the profile is the deviation, part by part.
    Splines([Mat<f64>; 2]),
    /// All entries, `[leading, trailing][crossing, stock]`: wheel and track make forces of the profile.
    Full(Contacts),
}

pub(super) const SIDES: [Side; 2] = [Side::Crossing, Side::Stock];

impl Wheel {
    /// With its mean deviations under each of the tracks of `moved`, which are close to that of `model`. `None` if a covariance
    /// is not finite.
    pub(super) fn new(
        model: &TrackModel,
        moved: &[TrackModel],
        running: &Running,
        prior: &Prior,
        common: &CommonProfile,
    ) -> Option<(Self, Vec<Means>)> {
        let rate = model.greens.sampling.rate_hz;
        let (first_sample, position_m) =
            own_positions(running.direction, running.speed_m_s, prior.half_m, rate);
        let profile = common.values_at(&position_m, running.speed_m_s);
        let splines = SIDES.map(|s| common.grids.grid(s).basis(&position_m));
        let (root_n, basis, mean_n, moved_n) = match model.excitation {
            Excitation::Force => {
                let step = 1.0 / (rate * prior.correlation_s);
                let root = |side: Side| {
                    let sd_n: Vec<f64> = position_m.iter().map(|x| prior.own_sd(side, *x)).collect();
                    prior.covariance_factor(&position_m, &sd_n, step)
                };
                let roots = [root(Side::Crossing)?, root(Side::Stock)?];
                let mean_n = columns(&profile);
                let moved_n = vec![mean_n.clone(); moved.len()];
                ([roots.clone(), roots], Basis::Splines(splines), mean_n, moved_n)
            }
            Excitation::Irregularity(interaction) => {
                let motion = running.on(interaction, &position_m);
                let step = running.speed_m_s / (rate * prior.own_correlation_m);
                let path = |side: Side| prior.path_factor(&position_m, side, step);
                let root_n = motion.solve_alone(&[path(Side::Crossing)?, path(Side::Stock)?]);
                let basis = Basis::Full(motion.solve_shared(&splines));
                let mean = mean_of(&motion, &profile);
                let moved_n = moved
                    .iter()
                    .map(|m| match m.excitation {
                        Excitation::Irregularity(other) => columns(&motion.nearby(other, &mean)),
                        Excitation::Force => columns(&profile),
                    })
                    .collect();
                (root_n, basis, columns(&mean), moved_n)
            }
        };
        Some((Self { first_sample, position_m, root_n, basis, mean_n }, moved_n))
    }
}

impl Running {
    fn on<'a>(&self, interaction: &'a Interaction, position_m: &'a [f64]) -> Motion<'a> {
        interaction.moving(position_m, self.direction, self.speed_m_s, self.static_force_n)
    }
}

/// Force deviations that an irregularity and the varying deflection make, one column per contact.
fn mean_of(motion: &Motion, irregularity_m: &Contacts) -> Contacts {
    let deflection = motion.load_deflection_m();
    motion.solve(&[0, 1].map(|a: usize| [0, 1].map(|r: usize| &irregularity_m[a][r] + &deflection[a][r])))
}

fn columns(contacts: &Contacts) -> Means {
    contacts.each_ref().map(|axle| axle.each_ref().map(|m| m.col_as_slice(0).to_vec()))
}
