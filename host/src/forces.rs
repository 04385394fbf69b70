//! Contact force of every wheelset, with intervals that hold what is not known of forces, noise, ballast and positions.

use faer::Mat;
use faer::linalg::solvers::Solve as _;
use rayon::prelude::*;

use crate::identify::IdentifiedSite;
use crate::inverse::hierarchy::{GroupKind, kinds};
use crate::inverse::{
    Estimator, Excitation, GroupGeometry, InverseError, Running, TrackModel, expected_window,
};
use crate::irregularity::on_grid;
use crate::signal::mean;

/// Forces are low-passed here, Hz (paper, section 4.2): the displacement holds hardly any energy above.
pub const LOW_PASS_HZ: f64 = 250.0;

/// Crossing-side force of one wheelset along the track.
#[derive(Clone, Debug)]
pub struct WheelForce {
    /// Index of the axle in the train.
    pub wheelset: usize,
    /// x, metres, in the order of passing, equidistant in time.
    pub position_m: Vec<f64>,
    /// Low-passed at [`LOW_PASS_HZ`], newtons.
    pub force_n: Vec<f64>,
    /// Standard deviation, newtons.
    pub sd_n: Vec<f64>,
}

/// Forces of the wheelsets of all passages, in order, over the whole stretch in which they are estimated, at the sampling
/// rate of the Green's functions.
pub fn all_wheel_forces(
    site: &IdentifiedSite,
    done: &(dyn Fn() + Sync),
) -> Result<Vec<Vec<WheelForce>>, InverseError> {
    let spread = Spread::new(site)?;
    (0..site.recordings.len())
        .into_par_iter()
        .map(|i| {
            let forces = wheel_forces(site, i, &spread);
            done();
            forces
        })
        .collect()
}

fn model<'s>(site: &'s IdentifiedSite) -> TrackModel<'s> {
    TrackModel { greens: &site.greens, excitation: Excitation::Force }
}

fn geometry<'k>(site: &IdentifiedSite, kind: &'k GroupKind, index: usize) -> GroupGeometry<'k> {
    GroupGeometry {
        running: Running {
            direction: site.direction,
            speed_m_s: site.timings[index].speed_m_s,
            static_force_n: site.static_force_n[index],
        },
        axle_offset_m: &kind.offsets.own,
        train_offset_m: &kind.offsets.train,
    }
}

/// Positions of a wheel at the sampling rate while its force is unknown, in the order of passing.
fn positions_m(site: &IdentifiedSite, index: usize) -> Vec<f64> {
    let speed = site.timings[index].speed_m_s;
    let rate = site.greens.sampling.rate_hz;
    crate::greens::moving::own_positions(site.direction, speed, site.prior.half_m, rate).1
}

fn wheel_forces(
    site: &IdentifiedSite,
    index: usize,
    spread: &Spread,
) -> Result<Vec<WheelForce>, InverseError> {
    let position_m = positions_m(site, index);
    let mut forces = Vec::new();
    for (k, kind) in kinds(&site.pattern).iter().enumerate() {
        let estimator = Estimator::new(&model(site), &geometry(site, kind, index), &site.prior, &site.profile)?;
        for group in &kind.groups {
            let window = site.window(index, &estimator, group.first);
            for (axle, force_n) in
                estimator.forces_n(&window, &position_m, LOW_PASS_HZ).into_iter().enumerate()
            {
                let wheelset = group.first + axle;
                let sd_n = spread.sd_n(k, axle, &position_m);
                forces.push(WheelForce { wheelset, position_m: position_m.clone(), force_n, sd_n });
            }
        }
    }
    forces.sort_by_key(|f| f.wheelset);
    Ok(forces)
}

/// Standard deviation of the force along the track for every kind of axle group and axle, taken at the passage of the
/// most usual speed: it hardly depends on the speed.
pub struct Spread {
    position_m: Vec<f64>,
    /// `[kind][axle]`, newtons.
    sd_n: Vec<Vec<Vec<f64>>>,
}

impl Spread {
    /// At the passage whose speed is nearest the mean.
    pub fn new(site: &IdentifiedSite) -> Result<Self, InverseError> {
        let speeds: Vec<f64> = site.timings.iter().map(|t| t.speed_m_s).collect();
        let usual = mean(&speeds);
        let index = (0..speeds.len())
            .min_by(|a, b| (speeds[*a] - usual).abs().total_cmp(&(speeds[*b] - usual).abs()))
            .unwrap_or(0);
        let position_m = positions_m(site, index);
        let covariance = shared_covariance(site);
        let sd_n = kinds(&site.pattern)
            .iter()
            .map(|kind| sds_of(site, kind, index, &position_m, &covariance))
            .collect::<Result<_, _>>()?;
        Ok(Self { position_m, sd_n })
    }

    /// Of an axle of a kind of group, at positions.
    pub fn sd_n(&self, kind: usize, axle: usize, position_m: &[f64]) -> Vec<f64> {
        on_grid(&self.position_m, &self.sd_n[kind][axle], position_m).iter().map(|s| s.max(0.0)).collect()
    }
}

/// Covariance of (profile, position, ballast): position and ballast as the calibration knows them, the profile as it
/// follows from them at the full band.
fn shared_covariance(site: &IdentifiedSite) -> Mat<f64> {
    let wide = &site.posterior.covariance;
    let q = site.ballast.with_position.len();
    let p = wide.nrows() - q;
    let across = wide.submatrix(0, p, p + q, q);
    let Ok(factor) = wide.submatrix(p, p, q, q).to_owned().llt(faer::Side::Lower) else {
        return wide.clone();
    };
    let regression = factor.solve(across.transpose()).transpose().to_owned();
    let known = Mat::from_fn(q, q, |i, j| site.ballast.with_position[i][j]);
    let change = known - wide.submatrix(p, p, q, q);
    wide + &regression * change * regression.transpose()
}

/// Of the axles of one kind: own deviation, load and noise from the estimator; profile and ballast, which all wheels
/// share, from the site's posterior; the position that all passages share from the calibration.
fn sds_of(
    site: &IdentifiedSite,
    kind: &GroupKind,
    index: usize,
    position_m: &[f64],
    covariance: &Mat<f64>,
) -> Result<Vec<Vec<f64>>, InverseError> {
    let geometry = geometry(site, kind, index);
    let estimator = Estimator::new(&model(site), &geometry, &site.prior, &site.profile)?;
    let expected = |greens| {
        let model = TrackModel { greens, excitation: Excitation::Force };
        expected_window(&model, &geometry, &site.prior, &site.profile)
    };
    let n = estimator.len();
    let mut columns: Mat<f64> = Mat::zeros(n, 4);
    for (k, (greens, step)) in site.nearby_greens.iter().enumerate() {
        let moved = expected(greens);
        for i in 0..n {
            columns[(i, 1 + k)] = (moved[i] - estimator.expected_m_s2[i]) / step;
        }
    }
    for i in 0..n {
        // A wheel that comes later by X moves the window by −X ȧ/v.
        columns[(i, 0)] = -estimator.expected_slope_m_s3[i] / geometry.running.speed_m_s;
    }
    let (p, m) = (site.profile.value.len(), site.posterior.covariance.nrows());
    let gains = estimator.gains(position_m, LOW_PASS_HZ, &site.profile);
    Ok(gains
        .iter()
        .map(|axle| {
            let others = -(&axle.gain * &columns);
            let g = position_m.len();
            let mut sensitivity = Mat::zeros(g, m);
            sensitivity.submatrix_mut(0, 0, g, p).copy_from(&axle.profile);
            sensitivity.submatrix_mut(0, p, g, m - p).copy_from(others.subcols(0, m - p));
            let spread = &sensitivity * covariance;
            (0..g)
                .map(|i| {
                    let shared: f64 = (0..m).map(|j| spread[(i, j)] * sensitivity[(i, j)]).sum();
                    (axle.sd_n[i].powi(2) + shared.max(0.0)).sqrt()
                })
                .collect()
        })
        .collect())
}
