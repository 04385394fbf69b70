//! One wheel passing at a speed, on its own clock: where its force is unknown, how it varies, and what the common
//! profile makes of it. All axles of a train share this.

use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::{Accum, Mat, MatRef, Par};

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
    /// Mean static force of the wheels of an axle, newtons.
    pub static_force_n: f64,
}

/// Wheel on its own clock: it is at x = 0 at sample 0. Nothing of it depends on the hyper-parameters, so that a search
/// over them needs it but once.
pub(super) struct Wheel {
    pub(super) first_sample: i64,
    pub(super) position_m: Vec<f64>,
    pub(super) basis: Basis,
    /// Mean deviations under the common profile, newtons.
    pub(super) mean_n: Means,
    /// The same under each of the tracks close by.
    pub(super) moved_n: Vec<Means>,
    own: Own,
    rate_hz: f64,
    speed_m_s: f64,
}

/// What a wheel has of its own.
enum Own {
    /// A force deviation.
    Force,
    /// An irregularity: force deviation per irregularity under that contact alone, N/m.
    Irregularity(Box<Contacts>),
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
    /// Within `half_m` of x = 0, with its mean deviations under each of the tracks of `moved`, which are close to that of
    /// `model`.
    pub(super) fn new(
        model: &TrackModel,
        moved: &[TrackModel],
        running: &Running,
        half_m: f64,
        common: &CommonProfile,
    ) -> Self {
        let rate_hz = model.greens.sampling.rate_hz;
        let (first_sample, position_m) = own_positions(running.direction, running.speed_m_s, half_m, rate_hz);
        let profile = common.values_at(&position_m, running.speed_m_s);
        let splines = SIDES.map(|s| common.grids.grid(s).basis(&position_m));
        let (own, basis, mean_n, moved_n) = match model.excitation {
            Excitation::Force => {
                let mean_n = columns(&profile);
                let moved_n = vec![mean_n.clone(); moved.len()];
                (Own::Force, Basis::Splines(splines), mean_n, moved_n)
            }
            Excitation::Irregularity(interaction) => {
                let motion = running.on(interaction, &position_m);
                let basis = Basis::Full(motion.solve_shared(&splines));
                let mean = mean_of(&motion, &profile);
                let moved_n = moved
                    .iter()
                    .map(|m| match m.excitation {
                        Excitation::Irregularity(other) => columns(&motion.nearby(other, &mean)),
                        Excitation::Force => columns(&profile),
                    })
                    .collect();
                (Own::Irregularity(Box::new(motion.alone())), basis, columns(&mean), moved_n)
            }
        };
        let speed_m_s = running.speed_m_s;
        Self { first_sample, position_m, basis, mean_n, moved_n, own, rate_hz, speed_m_s }
    }

    /// kernel · root, with a factor of [`Self::roots_n`].
    pub(super) fn shaped(&self, kernel: &Mat<f64>, root_n: &Mat<f64>) -> Mat<f64> {
        match self.own {
            Own::Force => times_lower(kernel.as_ref(), root_n),
            Own::Irregularity(_) => kernel * root_n,
        }
    }

    /// Factors of the covariance of the wheel's own deviation on a rail, N: `[leading, trailing]`. `None` if it is not
    /// finite.
    pub(super) fn roots_n(&self, prior: &Prior, rail: usize) -> Option<[Mat<f64>; 2]> {
        match &self.own {
            Own::Force => {
                let step = 1.0 / (self.rate_hz * prior.correlation_s);
                let sd_n: Vec<f64> = self.position_m.iter().map(|x| prior.own_sd(SIDES[rail], *x)).collect();
                let root = prior.covariance_factor(&self.position_m, &sd_n, step)?;
                Some([root.clone(), root])
            }
            Own::Irregularity(alone_n_m) => {
                let step = self.speed_m_s / (self.rate_hz * prior.own_correlation_m);
                let path = prior.path_factor(&self.position_m, SIDES[rail], step)?;
                Some([0, 1].map(|axle: usize| times_lower(alone_n_m[axle][rail].as_ref(), &path)))
            }
        }
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

/// Product with a lower triangular matrix.
fn times_lower(matrix: MatRef<'_, f64>, lower: &Mat<f64>) -> Mat<f64> {
    let mut out = Mat::zeros(matrix.nrows(), lower.ncols());
    triangular::matmul(
        &mut out,
        BlockStructure::Rectangular,
        Accum::Replace,
        matrix,
        BlockStructure::Rectangular,
        lower,
        BlockStructure::TriangularLower,
        1.0,
        Par::Seq,
    );
    out
}

fn columns(contacts: &Contacts) -> Means {
    contacts.each_ref().map(|axle| axle.each_ref().map(|m| m.col_as_slice(0).to_vec()))
}
