//! Contact force of every wheelset, with intervals that hold what is not known of forces, noise, ballast and positions.

use std::sync::Arc;

use faer::Mat;
use rayon::prelude::*;

use crate::identify::{ForceClass, IdentifiedSite};
use crate::inverse::hierarchy::{GroupKind, GroupOffsets, kinds};
use crate::inverse::train::Train;
use crate::inverse::{AxleGain, Estimator, Excitation, GroupGeometry, InverseError, Running, TrackModel};
use crate::irregularity::on_grid;
use crate::signal::mean;

/// Forces are low-passed here, Hz (paper, section 4.2): the displacement holds hardly any energy above.
pub const LOW_PASS_HZ: f64 = 250.0;

/// Time by which the modelled track may come early or late, s. The ballast's damping, taken as nominal, makes the sleeper lag
/// by several milliseconds, and the posterior, which states 31 to 45 µs, does not hold that. On recordings of
/// another program forces come 87 to 113 µs early or late (`cpcm verify --site`).
const LAG_SD_S: f64 = 100e-6;

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
    /// The same with the shared position known: a shift moves a peak and leaves its height.
    pub unshifted_sd_n: Vec<f64>,
}

impl WheelForce {
    /// A force that is given, not identified: nothing of it is uncertain.
    pub fn given(wheelset: usize, position_m: Vec<f64>, force_n: Vec<f64>) -> Self {
        let sd_n = vec![0.0; position_m.len()];
        Self { wheelset, position_m, force_n, unshifted_sd_n: sd_n.clone(), sd_n }
    }
}

/// Forces of the wheelsets of all passages, in order, over the whole stretch in which they are estimated, at the sampling
/// rate of the Green's functions; `spreads` of all classes.
pub fn all_wheel_forces(
    site: &IdentifiedSite,
    spreads: &[Spread],
    done: &(dyn Fn() + Sync),
) -> Result<Vec<Vec<WheelForce>>, InverseError> {
    (0..site.recordings.len())
        .into_par_iter()
        .map(|i| {
            let forces = wheel_forces(site, i, &spreads[site.class_of_passage(i)]);
            done();
            forces
        })
        .collect()
}

fn model<'s>(site: &'s IdentifiedSite) -> TrackModel<'s> {
    TrackModel { greens: &site.greens, excitation: Excitation::Force }
}

fn running(site: &IdentifiedSite, index: usize) -> Running {
    Running {
        direction: site.direction,
        speed_m_s: site.timings[index].speed_m_s,
        static_force_n: site.static_force_n[index],
    }
}

fn geometry<'k>(site: &IdentifiedSite, kind: &'k GroupKind, index: usize) -> GroupGeometry<'k> {
    GroupGeometry {
        running: running(site, index),
        axle_offset_m: &kind.offsets.own,
        train_offset_m: &kind.offsets.train,
    }
}

/// Positions of a wheel at the sampling rate while its force is unknown, in the order of passing.
fn positions_m(site: &IdentifiedSite, index: usize) -> Vec<f64> {
    let speed = site.timings[index].speed_m_s;
    let rate = site.greens.sampling.rate_hz;
    crate::greens::moving::own_positions(site.direction, speed, site.half_m(), rate).1
}

/// Forces of the wheelsets of passage `index`.
pub fn wheel_forces(
    site: &IdentifiedSite,
    index: usize,
    spread: &Spread,
) -> Result<Vec<WheelForce>, InverseError> {
    let position_m = positions_m(site, index);
    let mut forces = Vec::new();
    let kinds = kinds(&site.pattern);
    let offsets: Vec<&GroupOffsets> = kinds.iter().map(|k| &k.offsets).collect();
    let class = &site.classes[site.class_of_passage(index)];
    let train = Train::new(&model(site), &[], running(site, index), &offsets, &class.prior, class.profile())?;
    let estimators = Arc::new(train).estimators(&class.prior)?;
    for (k, (kind, estimator)) in kinds.iter().zip(&estimators).enumerate() {
        for group in &kind.groups {
            let window = site.window(index, estimator, group.first);
            for (axle, force_n) in
                estimator.forces_n(&window, &position_m, LOW_PASS_HZ).into_iter().enumerate()
            {
                let wheelset = group.first + axle;
                let [unshifted_sd_n, sd_n] = spread.sd_n(k, axle, &position_m);
                let position_m = position_m.clone();
                forces.push(WheelForce { wheelset, position_m, force_n, sd_n, unshifted_sd_n });
            }
        }
    }
    forces.sort_by_key(|f| f.wheelset);
    Ok(forces)
}

/// Standard deviation of the force along the track for every kind of axle group and axle, taken at the passage of the
/// most usual speed: it hardly depends on the speed.
pub struct Spread {
    /// That passage, by its place in the site.
    pub passage: usize,
    /// Positions of its wheels, one per sample in the order of passing, metres.
    pub position_m: Vec<f64>,
    /// `[kind][axle]`.
    causes: Vec<Vec<Causes>>,
    /// `[kind][axle]`.
    shared: Vec<Vec<SharedCauses>>,
}

/// How the force of an axle, at the positions of [`Spread::position_m`], follows what all wheels share and is not known exactly.
pub struct SharedCauses {
    /// Force of the common profile alone, newtons.
    pub base_n: Vec<f64>,
    /// Per entry of the common profile of the class: positions × entries.
    pub profile: Mat<f64>,
    /// Per (ln p1, ln p2, p3), newtons: positions × 3.
    pub ballast_n: Mat<f64>,
}

/// What a force is not known by: standard deviations along the track, newtons.
#[derive(Clone, Debug)]
pub struct Causes {
    /// Noise of the recording, what a wheel has of its own, its load.
    pub own_n: Vec<f64>,
    /// What all wheels share: a force on the stock rail looks like one on the crossing rail.
    pub profile_n: Vec<f64>,
    /// Ballast.
    pub ballast_n: Vec<f64>,
    /// All of these together.
    pub unshifted_n: Vec<f64>,
    /// And the position that all passages share.
    pub all_n: Vec<f64>,
}

impl Causes {
    /// What does not differ from wheel to wheel, the position aside, which moves a peak and leaves its height.
    pub fn shared_n(&self) -> Vec<f64> {
        self.profile_n
            .iter()
            .zip(&self.ballast_n)
            .map(|(profile_n, ballast_n)| profile_n.hypot(*ballast_n))
            .collect()
    }
}

impl Spread {
    /// Of every class of a site.
    pub fn of_classes(site: &IdentifiedSite) -> Result<Vec<Self>, InverseError> {
        (0..site.classes.len()).map(|class| Self::new(site, class)).collect()
    }

    /// Of a class of speeds, by its number, at the passage whose speed is nearest their mean.
    pub fn new(site: &IdentifiedSite, class: usize) -> Result<Self, InverseError> {
        let speeds: Vec<f64> = site.timings.iter().map(|t| t.speed_m_s).collect();
        let members: Vec<usize> = (0..speeds.len()).filter(|i| site.class_of_passage(*i) == class).collect();
        let usual = mean(&members.iter().map(|i| speeds[*i]).collect::<Vec<_>>());
        let index = members
            .into_iter()
            .min_by(|a, b| (speeds[*a] - usual).abs().total_cmp(&(speeds[*b] - usual).abs()))
            .unwrap_or(0);
        let position_m = positions_m(site, index);
        let of_kinds: Vec<Vec<(Causes, SharedCauses)>> = kinds(&site.pattern)
            .par_iter()
            .map(|kind| causes_of(site, &site.classes[class], kind, index, &position_m))
            .collect::<Result<_, _>>()?;
        let (causes, shared) = of_kinds.into_iter().map(|axles| axles.into_iter().unzip()).unzip();
        Ok(Self { passage: index, position_m, causes, shared })
    }

    /// What the axles of all kinds of groups share with other wheels, `[kind][axle]`.
    pub fn shared(&self) -> &[Vec<SharedCauses>] {
        &self.shared
    }

    /// Of an axle of a kind of group, at positions: with the shared position known, and in all.
    pub fn sd_n(&self, kind: usize, axle: usize, position_m: &[f64]) -> [Vec<f64>; 2] {
        let c = &self.causes[kind][axle];
        [&c.unshifted_n, &c.all_n].map(|sd_n| self.on(sd_n, position_m))
    }

    /// The same cause by cause.
    pub fn causes(&self, kind: usize, axle: usize, position_m: &[f64]) -> Causes {
        let c = &self.causes[kind][axle];
        let on = |sd_n: &[f64]| self.on(sd_n, position_m);
        Causes {
            own_n: on(&c.own_n),
            profile_n: on(&c.profile_n),
            ballast_n: on(&c.ballast_n),
            unshifted_n: on(&c.unshifted_n),
            all_n: on(&c.all_n),
        }
    }

    fn on(&self, sd_n: &[f64], position_m: &[f64]) -> Vec<f64> {
        on_grid(&self.position_m, sd_n, position_m).iter().map(|s| s.max(0.0)).collect()
    }
}

/// Of the axles of one kind: own deviation, load and noise; what is left unknown of the common profile; ballast and the
/// position that all passages share, from the calibration.
fn causes_of(
    site: &IdentifiedSite,
    class: &ForceClass,
    kind: &GroupKind,
    index: usize,
    position_m: &[f64],
) -> Result<Vec<(Causes, SharedCauses)>, InverseError> {
    let geometry = geometry(site, kind, index);
    let estimator = Estimator::new(&model(site), &geometry, &class.prior, class.profile())?;
    let gains = estimator.gains(position_m, LOW_PASS_HZ, class.profile());
    let ballast = ballast_sensitivity(site, class, &geometry, position_m)?;
    let profile_covariance = class.profile_covariance();
    let known = &site.ballast.covariance;
    let position_sd_m = position_sd_m(site, index);
    let causes = gains.into_iter().zip(ballast).map(|(axle, ballast_n)| {
        let slope = slope_per_m(position_m, &axle.base_n);
        let AxleGain { base_n, sd_n: own_n, profile, .. } = axle;
        let profile_n = deviations(&profile, &(&profile * profile_covariance));
        let of_ballast_n = deviations(&ballast_n, &(&ballast_n * known));
        let parts = [&own_n, &profile_n, &of_ballast_n];
        let unshifted = |i: usize| parts.iter().map(|p| p[i].powi(2)).sum::<f64>().sqrt();
        let unshifted_n: Vec<f64> = (0..position_m.len()).map(unshifted).collect();
        let all_n = unshifted_n.iter().zip(&slope).map(|(n, s)| n.hypot(s * position_sd_m)).collect();
        let causes = Causes { own_n, profile_n, ballast_n: of_ballast_n, unshifted_n, all_n };
        (causes, SharedCauses { base_n, profile, ballast_n })
    });
    Ok(causes.collect())
}

/// Standard deviation of the position that the forces of all wheels share, at the speed of a passage, metres.
pub fn position_sd_m(site: &IdentifiedSite, index: usize) -> f64 {
    site.ballast.shift_sd_m.hypot(LAG_SD_S * site.timings[index].speed_m_s)
}

/// Change of the forces of every axle per entry of the ballast's vector, newtons, if every wheel stood for itself: what a wrong ballast
/// puts into all wheels alike, the common profile takes over as well.
fn ballast_sensitivity(
    site: &IdentifiedSite,
    class: &ForceClass,
    geometry: &GroupGeometry,
    position_m: &[f64],
) -> Result<Vec<Mat<f64>>, InverseError> {
    let prior = class.prior.with_common_as_own();
    let nearby = site.nearby_greens.iter();
    let moved: Vec<TrackModel> =
        nearby.map(|(greens, _)| TrackModel { greens, excitation: Excitation::Force }).collect();
    let (estimator, expected) =
        Estimator::with_moved(&model(site), &moved, geometry, &prior, class.profile())?;
    let mut columns: Mat<f64> = Mat::zeros(estimator.len(), moved.len());
    for (k, (window, (_, step))) in expected.iter().zip(&site.nearby_greens).enumerate() {
        for (i, value) in window.iter().enumerate() {
            columns[(i, k)] = (value - estimator.expected_m_s2[i]) / step;
        }
    }
    let gains = estimator.gains(position_m, LOW_PASS_HZ, class.profile());
    Ok(gains.iter().map(|axle| -(&axle.gain * &columns)).collect())
}

/// Square roots of the diagonal of a · bᵀ.
pub fn deviations(a: &Mat<f64>, b: &Mat<f64>) -> Vec<f64> {
    let product = |i: usize| (0..a.ncols()).map(|j| a[(i, j)] * b[(i, j)]).sum::<f64>();
    (0..a.nrows()).map(|i| product(i).max(0.0).sqrt()).collect()
}

/// Slope of a force or a path along equidistant positions by central differences, per metre.
pub fn slope_per_m(position_m: &[f64], force_n: &[f64]) -> Vec<f64> {
    let last = position_m.len().saturating_sub(1);
    (0..position_m.len())
        .map(|i| {
            let (a, b) = (i.saturating_sub(1), (i + 1).min(last));
            (force_n[b] - force_n[a]) / (position_m[b] - position_m[a])
        })
        .collect()
}
