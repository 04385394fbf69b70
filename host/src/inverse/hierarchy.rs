//! All passages of a site at once: the force profile that all wheels share, the position of every passage, and the
//! evidence of the track model, with all forces integrated out.
//!
//! Window j of passage i: a = s + A c − (X + x_i) ȧ/v + e, with s the response to the static forces, c the common
//! profile, X and x_i the common and the passage's position error, and e Gaussian with the covariance of the wheels'
//! own deviations, their load and the noise. Everything but the track model is linear and Gaussian, so the posterior
//! of (c, X, x_i) and the evidence are closed forms.

use faer::Mat;
use faer::linalg::matmul::matmul;
use faer::linalg::solvers::Solve as _;
use faer::{Accum, Par};
use rayon::prelude::*;

use super::{CommonProfile, Estimator, GroupGeometry, InverseError, Prior, ProfileGrids};
use crate::greens::GreensFunctions;
use crate::interaction::Interaction;
use crate::reconstruct::{Recording, Timing};
use crate::vehicle::{AxleGroup, AxlePattern};

/// One passage as the identification sees it.
#[derive(Clone, Copy, Debug)]
pub struct SitePassage<'a> {
    /// Corrected recording.
    pub recording: &'a Recording,
    /// Speed and current axle times.
    pub timing: Timing,
    /// Static wheel force, newtons.
    pub static_force_n: f64,
}

/// Model of a site with given ballast.
#[derive(Clone)]
pub struct SiteModel<'a> {
    /// Green's functions of the calibrated track.
    pub greens: &'a GreensFunctions,
    /// Wheel-track interaction of the calibrated track.
    pub interaction: &'a Interaction,
    /// +1 facing, -1 trailing.
    pub direction: f64,
    /// Axle pattern of the trains.
    pub pattern: &'a AxlePattern,
    /// Prior of forces and noise.
    pub prior: &'a Prior,
    /// Grids of the common profile.
    pub grids: ProfileGrids,
    /// Prior standard deviation of the common position error X, metres.
    pub common_shift_sd_m: f64,
    /// Prior standard deviation of each passage's position error, metres.
    pub passage_shift_sd_m: f64,
}

/// What the passages of a site together say.
pub struct SitePosterior {
    /// Log evidence of the model.
    pub log_evidence: f64,
    /// Posterior mean of the common profile.
    pub profile: CommonProfile,
    /// Posterior covariance of the profile, m², and of the common position error in the last row and column (m).
    pub covariance: Mat<f64>,
    /// Common position error X, metres: the wheels are at x = 0 later by X/v than assumed.
    pub common_shift_m: f64,
    /// Position error of every passage, common part included, metres.
    pub shift_m: Vec<f64>,
    /// Standard deviation of the passage's own part, metres.
    pub shift_sd_m: Vec<f64>,
}

/// Linear-Gaussian statistics of one passage, its own position error eliminated.
struct Statistics {
    /// Information matrix of (c, X).
    information: Mat<f64>,
    /// Information vector.
    vector: Mat<f64>,
    log_likelihood: f64,
    /// Own position error: precision, its coupling to (c, X), and its information value.
    own_precision: f64,
    own_coupling: Mat<f64>,
    own_value: f64,
}

impl SiteModel<'_> {
    /// Geometry of a group of axles of a passage.
    pub fn geometry<'g>(&self, offsets: &'g GroupOffsets, passage: &SitePassage) -> GroupGeometry<'g> {
        GroupGeometry {
            direction: self.direction,
            speed_m_s: passage.timing.speed_m_s,
            axle_offset_m: &offsets.own,
            train_offset_m: &offsets.train,
            static_force_n: passage.static_force_n,
            mean_force: None,
        }
    }

    /// Posterior and evidence over `passages`.
    pub fn posterior(&self, passages: &[SitePassage]) -> Result<SitePosterior, InverseError> {
        let statistics: Vec<Statistics> =
            passages.par_iter().map(|p| self.statistics(p)).collect::<Result<_, _>>()?;
        let m = self.grids.len() + 1;
        let mut prior = Mat::zeros(m, m);
        let profile_prior = self.grids.prior_covariance(self.prior);
        prior.submatrix_mut(0, 0, m - 1, m - 1).copy_from(&profile_prior);
        prior[(m - 1, m - 1)] = self.common_shift_sd_m.powi(2);
        let mut information: Mat<f64> = Mat::zeros(m, m);
        let mut vector: Mat<f64> = Mat::zeros(m, 1);
        let mut log_evidence = 0.0;
        for s in &statistics {
            information += &s.information;
            vector += &s.vector;
            log_evidence += s.log_likelihood;
        }
        // Whitened with the prior's Cholesky factor, so that a nearly singular prior does no harm.
        let bad = |_| InverseError::Covariance { len: m, noise_m_s2: self.prior.noise_m_s2 };
        let root = prior.llt(faer::Side::Lower).map_err(bad)?.L().to_owned();
        let inner = root.transpose() * &information * &root + Mat::<f64>::identity(m, m);
        let factor = inner.llt(faer::Side::Lower).map_err(bad)?;
        let whitened = root.transpose() * &vector;
        let solved = factor.solve(&whitened);
        let l = factor.L();
        log_evidence += (0..m).map(|i| 0.5 * whitened[(i, 0)] * solved[(i, 0)] - l[(i, i)].ln()).sum::<f64>();
        let mean = &root * &solved;
        let covariance = &root * factor.solve(root.transpose());
        Ok(self.collect(&statistics, log_evidence, &mean, covariance))
    }

    fn collect(
        &self,
        statistics: &[Statistics],
        log_evidence: f64,
        mean: &Mat<f64>,
        covariance: Mat<f64>,
    ) -> SitePosterior {
        let m = mean.nrows();
        let common_shift_m = mean[(m - 1, 0)];
        let own = |s: &Statistics| {
            let coupled: f64 = (0..m).map(|i| s.own_coupling[(i, 0)] * mean[(i, 0)]).sum();
            (s.own_value - coupled) / s.own_precision
        };
        SitePosterior {
            log_evidence,
            profile: CommonProfile {
                grids: self.grids.clone(),
                irregularity_m: (0..m - 1).map(|i| mean[(i, 0)]).collect(),
            },
            covariance,
            common_shift_m,
            shift_m: statistics.iter().map(|s| common_shift_m + own(s)).collect(),
            shift_sd_m: statistics.iter().map(|s| s.own_precision.sqrt().recip()).collect(),
        }
    }

    /// Windows of one passage, reduced to the information on (c, X) and on its own position error.
    fn statistics(&self, passage: &SitePassage) -> Result<Statistics, InverseError> {
        let m = self.grids.len() + 1;
        let mut information = Mat::zeros(m + 1, m + 1);
        let mut vector = Mat::zeros(m + 1, 1);
        let mut log_likelihood = 0.0;
        let zero = CommonProfile::zero(self.grids.clone());
        for kind in kinds(self.pattern) {
            let estimator = Estimator::new(
                self.greens,
                &self.geometry(&kind.offsets, passage),
                self.prior,
                self.interaction,
                &zero,
            )?;
            for group in &kind.groups {
                let columns = self.columns(&estimator, passage, *group);
                let whitened = estimator.whiten(&columns);
                let products = columns.transpose() * &whitened;
                let last = m + 1;
                for i in 0..=m {
                    vector[(i, 0)] += products[(i, last)];
                    for j in 0..=m {
                        information[(i, j)] += products[(i, j)];
                    }
                }
                let n = estimator.len() as f64;
                log_likelihood -= 0.5 * products[(last, last)]
                    + estimator.log_det_half()
                    + 0.5 * n * std::f64::consts::TAU.ln();
            }
        }
        Ok(self.eliminate_own_shift(&information, &vector, log_likelihood))
    }

    /// [A | −ȧ/v for X | −ȧ/v for x_i | residual]
    fn columns(&self, estimator: &Estimator, passage: &SitePassage, group: AxleGroup) -> Mat<f64> {
        let (n, m) = (estimator.len(), self.grids.len());
        let (rate, band) = (estimator.rate_hz, self.greens.sampling.band_hz);
        let start =
            passage.timing.axle_s(self.pattern.offset_m[group.first]) - estimator.before as f64 / rate;
        let window = passage.recording.window(start, rate, n, band);
        let slope = passage.recording.window_slope(start, rate, n, band);
        let mut columns = Mat::zeros(n, m + 3);
        columns.submatrix_mut(0, 0, n, m).copy_from(estimator.profile_response());
        for k in 0..n {
            let per_metre = -slope[k] / passage.timing.speed_m_s;
            columns[(k, m)] = per_metre;
            columns[(k, m + 1)] = per_metre;
            columns[(k, m + 2)] = window[k] - estimator.expected_m_s2[k];
        }
        columns
    }

    fn eliminate_own_shift(
        &self,
        information: &Mat<f64>,
        vector: &Mat<f64>,
        log_likelihood: f64,
    ) -> Statistics {
        let m = self.grids.len() + 1;
        let precision = information[(m, m)] + self.passage_shift_sd_m.powi(-2);
        let coupling = Mat::from_fn(m, 1, |i, _| information[(i, m)]);
        let value = vector[(m, 0)];
        let mut reduced = information.submatrix(0, 0, m, m).to_owned();
        matmul(&mut reduced, Accum::Add, &coupling, coupling.transpose(), -1.0 / precision, Par::Seq);
        let reduced_vector = Mat::from_fn(m, 1, |i, _| vector[(i, 0)] - coupling[(i, 0)] * value / precision);
        let log_likelihood = log_likelihood + 0.5 * value * value / precision
            - 0.5 * (precision * self.passage_shift_sd_m.powi(2)).ln();
        Statistics {
            information: reduced,
            vector: reduced_vector,
            log_likelihood,
            own_precision: precision,
            own_coupling: coupling,
            own_value: value,
        }
    }
}

/// Offsets of the axles of a group.
#[derive(Clone, Debug, PartialEq)]
pub struct GroupOffsets {
    /// Behind the group's first axle, metres.
    pub own: Vec<f64>,
    /// All axles of the train behind the group's first, metres.
    pub train: Vec<f64>,
}

/// Groups of a train that one estimator serves.
#[derive(Clone, Debug)]
pub struct GroupKind {
    /// Offsets of the first group of this kind; the axles of other groups are too far away to matter.
    pub offsets: GroupOffsets,
    /// All groups of this kind.
    pub groups: Vec<AxleGroup>,
}

/// Groups with the same spacing of axles, in order of first appearance.
pub fn kinds(pattern: &AxlePattern) -> Vec<GroupKind> {
    let mut kinds: Vec<GroupKind> = Vec::new();
    for group in pattern.groups() {
        let first = pattern.offset_m[group.first];
        let own: Vec<f64> =
            pattern.offset_m[group.first..group.first + group.len].iter().map(|o| o - first).collect();
        let same = |k: &&mut GroupKind| {
            k.offsets.own.len() == own.len()
                && k.offsets.own.iter().zip(&own).all(|(a, b)| (a - b).abs() < 1e-6)
        };
        match kinds.iter_mut().find(same) {
            Some(kind) => kind.groups.push(group),
            None => {
                let train = pattern.offset_m.iter().map(|o| o - first).collect();
                kinds.push(GroupKind { offsets: GroupOffsets { own, train }, groups: vec![group] });
            }
        }
    }
    kinds
}
