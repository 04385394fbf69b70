//! All passages of a site at once: what all wheels share, the ballast, the position of every passage, and the evidence
//! of the model, with all forces integrated out.
//!
//! Window j of passage i, linearised about the current ballast θ₀ and axle times:
//! a = s + A c + D (θ − θ₀) − (X + x_i) ȧ/v + e, with s the response to static forces and mean deflection, c the common
//! profile, D the derivative of the expected window with respect to the ballast, X and x_i the common and the passage's
//! position error, and e Gaussian with the covariance of the wheels' own deviations, their load and the noise. The
//! posterior of (c, X, θ, x_i) and the evidence are closed forms; a few linearisations reach the optimum (Gauss-Newton).

use std::sync::Arc;

use faer::linalg::matmul::triangular;
use faer::linalg::solvers::{DenseSolveCore as _, Llt, Solve as _};
use faer::{Accum, Mat, Par};
use rayon::prelude::*;

use super::prior_root::PriorRoot;
use super::profile::Shapes;
use super::train::{Group, Train};
use super::wheel::{Running, TrackModel};
use super::{CommonProfile, InverseError, Prior};
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

/// A parameter of the track: the model with it moved by a small step.
#[derive(Clone, Copy)]
pub struct Moved<'a> {
    /// Track with the parameter moved.
    pub model: TrackModel<'a>,
    /// How far, in the parameter's unit.
    pub step: f64,
    /// Prior mean relative to the current value, and standard deviation.
    pub prior: (f64, f64),
}

/// Model of a site at the current values of its parameters.
#[derive(Clone)]
pub struct SiteModel<'a> {
    /// Track.
    pub model: TrackModel<'a>,
    /// The same with each unknown parameter moved.
    pub moved: Vec<Moved<'a>>,
    /// +1 facing, -1 trailing.
    pub direction: f64,
    /// Axle pattern of the trains.
    pub pattern: &'a AxlePattern,
    /// Prior of forces and noise.
    pub prior: &'a Prior,
    /// Common profile about which is linearised.
    pub profile: &'a CommonProfile,
    /// Prior standard deviation of the common position error X, metres.
    pub common_shift_sd_m: f64,
    /// Prior standard deviation of each passage's position error, metres.
    pub passage_shift_sd_m: f64,
    /// Prior standard deviation of each passage's speed, relative.
    pub speed_sd: f64,
    /// Divisor of the evidence on X and θ: in how many windows the errors of the model repeat themselves.
    pub temperature: f64,
}

/// What the passages of a site together say.
pub struct SitePosterior {
    /// Log evidence of the model.
    pub log_evidence: f64,
    /// Posterior mean of the common profile.
    pub profile: CommonProfile,
    /// Posterior covariance of (c, X, θ), tempered.
    pub covariance: Mat<f64>,
    /// Standard deviation of the position error averaged over the passages, metres.
    pub mean_shift_sd_m: f64,
    /// Change of the track parameters θ − θ₀.
    pub parameters: Vec<f64>,
    /// Position error of every passage, common part included, metres: its wheels are at x = 0 later by that much than
    /// assumed.
    pub shift_m: Vec<f64>,
    /// Relative error of every passage's duration: the train takes longer by this share than assumed.
    pub stretch: Vec<f64>,
    /// What the model leaves of every passage, squared, per value of its windows and in units of what it expects to leave: below 1
    /// where the model holds.
    pub misfit: Vec<f64>,
}

/// Unknowns that each passage has for itself: position and stretch.
const OWN: usize = 2;

/// Linear-Gaussian statistics of one passage, its own unknowns eliminated.
struct Statistics {
    /// What the train can tell apart of the profile.
    shapes: Shapes,
    /// Information matrix of the shapes' amplitudes and (X, θ).
    information: Mat<f64>,
    /// Information vector of (c, X, θ).
    vector: Mat<f64>,
    log_likelihood: f64,
    /// Squared residual with the profile zero, and how many values it has.
    squared: f64,
    values: usize,
    /// Covariance of the own unknowns, their coupling to (c, X, θ), and their information values.
    /// The coupling is that of the entries of the joint vector.
    own_covariance: [[f64; 2]; 2],
    own_coupling: Mat<f64>,
    own_value: [f64; 2],
}

/// A passage with all of its model that does not depend on hyper-parameters.
pub struct Prepared {
    train: Arc<Train>,
    /// Per kind of groups: [A | D | own columns of every group], and the number of groups.
    columns: Vec<(Mat<f64>, usize)>,
}

impl SiteModel<'_> {
    /// Unknowns that all passages share: profile, position, parameters.
    fn shared(&self) -> usize {
        self.profile.grids.len() + 1 + self.moved.len()
    }

    /// Posterior and evidence over `passages`.
    pub fn posterior(&self, passages: &[SitePassage]) -> Result<SitePosterior, InverseError> {
        let statistics = self.of_every(passages)?;
        let joint = self.joint(&statistics)?;
        let mean = joint.mean();
        let covariance = self.tempered(joint.root.coloured(&joint.factor.inverse()));
        let mean_shift_sd_m = self.mean_shift_sd_m(&statistics, &covariance);
        let means = self.means(&statistics, &mean);
        Ok(SitePosterior { log_evidence: joint.log_evidence, covariance, mean_shift_sd_m, ..means })
    }

    /// What passages say of their own unknowns, with what is shared known to be as in the model.
    pub fn follow(&self, passages: &[SitePassage]) -> Result<SitePosterior, InverseError> {
        let known = &self.profile.value;
        let shared = Mat::from_fn(self.shared(), 1, |i, _| known.get(i).copied().unwrap_or(0.0));
        Ok(self.means(&self.of_every(passages)?, &shared))
    }

    /// Posterior mean of the common profile alone, under the model's prior.
    pub fn posterior_profile(&self, passages: &[Prepared]) -> Result<CommonProfile, InverseError> {
        let statistics = self.of_prepared(passages)?;
        Ok(self.means(&statistics, &self.joint(&statistics)?.mean()).profile)
    }

    /// Evidence over passages under the model's prior.
    pub fn log_evidence(&self, passages: &[Prepared]) -> Result<f64, InverseError> {
        Ok(self.joint(&self.of_prepared(passages)?)?.log_evidence)
    }

    /// What of the passages does not depend on hyper-parameters: priors that are asked of it may differ in standard deviations
    /// and correlations.
    pub fn prepared(&self, passages: &[SitePassage]) -> Result<Vec<Prepared>, InverseError> {
        let kinds = kinds(self.pattern);
        passages.par_iter().map(|p| self.prepare(&kinds, p)).collect()
    }

    fn of_prepared(&self, passages: &[Prepared]) -> Result<Vec<Statistics>, InverseError> {
        passages.par_iter().map(|p| self.statistics(p)).collect()
    }

    fn of_every(&self, passages: &[SitePassage]) -> Result<Vec<Statistics>, InverseError> {
        let kinds = kinds(self.pattern);
        passages.par_iter().map(|p| self.statistics(&self.prepare(&kinds, p)?)).collect()
    }

    fn prepare(&self, kinds: &[GroupKind], passage: &SitePassage) -> Result<Prepared, InverseError> {
        let running = Running {
            direction: self.direction,
            speed_m_s: passage.timing.speed_m_s,
            static_force_n: passage.static_force_n,
        };
        let moved: Vec<TrackModel> = self.moved.iter().map(|m| m.model).collect();
        let offsets: Vec<&GroupOffsets> = kinds.iter().map(|k| &k.offsets).collect();
        let train = Train::new(&self.model, &moved, running, &offsets, self.prior, self.profile)?;
        let amplitudes = train.shapes.amplitudes(&self.profile.value);
        let columns = kinds
            .iter()
            .enumerate()
            .map(|(k, kind)| (self.columns(&train, k, kind, passage, &amplitudes), kind.groups.len()))
            .collect();
        Ok(Prepared { train: Arc::new(train), columns })
    }

    /// Information of all passages and the prior on what is shared.
    fn joint(&self, statistics: &[Statistics]) -> Result<Joint, InverseError> {
        let (m, p) = (self.shared(), self.profile.grids.len());
        let bad = || InverseError::Covariance { len: m, noise_m_s2: self.prior.noise_m_s2 };
        let covariances = self.profile.grids.prior_covariances(self.prior);
        let mut root = PriorRoot::of_covariances(&covariances).ok_or_else(bad)?;
        let mut centre = Mat::zeros(m, 1);
        root.push_scalar(self.common_shift_sd_m / self.temperature.sqrt());
        for (k, moved) in self.moved.iter().enumerate() {
            root.push_scalar(moved.prior.1 / self.temperature.sqrt());
            centre[(p + 1 + k, 0)] = moved.prior.0;
        }
        let mut information: Mat<f64> = Mat::zeros(m, m);
        let mut vector: Mat<f64> = Mat::zeros(m, 1);
        let mut log_evidence = 0.0;
        for s in statistics {
            s.shapes.add_expanded(&mut information, &s.information);
            vector += &s.vector;
            log_evidence += s.log_likelihood;
        }
        // About the prior mean, and whitened with the prior's Cholesky factor, so that a nearly singular prior does no
        // harm.
        let at_centre = &information * &centre;
        log_evidence +=
            (0..m).map(|i| centre[(i, 0)] * (vector[(i, 0)] - 0.5 * at_centre[(i, 0)])).sum::<f64>();
        let vector = root.transposed_times((&vector - &at_centre).as_ref());
        let factor = root.whitened(&information).llt(faer::Side::Lower).map_err(|_| bad())?;
        let solved = factor.solve(&vector);
        let l = factor.L();
        log_evidence += (0..m).map(|i| 0.5 * vector[(i, 0)] * solved[(i, 0)] - l[(i, i)].ln()).sum::<f64>();
        Ok(Joint { root, centre, factor, vector, log_evidence })
    }

    /// A passage's own position follows what is shared: X + x_i moves with (c, X, θ) by a row h, and the mean row gives the
    /// uncertainty that averaging over passages does not remove.
    fn mean_shift_sd_m(&self, statistics: &[Statistics], covariance: &Mat<f64>) -> f64 {
        let m = covariance.nrows();
        let count = statistics.len().max(1) as f64;
        let mut row = Mat::zeros(1, m);
        row[(0, self.profile.grids.len())] = 1.0;
        for s in statistics {
            for i in 0..m {
                let follows: f64 = (0..OWN).map(|k| s.own_covariance[0][k] * s.own_coupling[(i, k)]).sum();
                row[(0, i)] -= follows / count;
            }
        }
        let variance = (&row * covariance * row.transpose())[(0, 0)];
        variance.max(0.0).sqrt()
    }

    /// Widens the covariance of (X, θ) by the temperature; the profile follows by its regression on them.
    fn tempered(&self, mut covariance: Mat<f64>) -> Mat<f64> {
        let (p, q) = (self.profile.grids.len(), 1 + self.moved.len());
        let block = covariance.submatrix(p, p, q, q).to_owned();
        let Ok(factor) = block.llt(faer::Side::Lower) else { return covariance };
        let across = covariance.submatrix(0, p, p + q, q).to_owned();
        let solved = factor.solve(across.transpose());
        covariance += faer::Scale(self.temperature - 1.0) * (&across * &solved);
        covariance
    }

    fn means(&self, statistics: &[Statistics], mean: &Mat<f64>) -> SitePosterior {
        let p = self.profile.grids.len();
        let common_shift_m = mean[(p, 0)];
        let own: Vec<[f64; OWN]> = statistics.iter().map(|s| s.own_mean(mean)).collect();
        SitePosterior {
            log_evidence: 0.0,
            profile: CommonProfile {
                grids: self.profile.grids.clone(),
                value: (0..p).map(|i| mean[(i, 0)]).collect(),
            },
            covariance: Mat::zeros(0, 0),
            mean_shift_sd_m: 0.0,
            parameters: (p + 1..mean.nrows()).map(|i| mean[(i, 0)]).collect(),
            shift_m: own.iter().map(|o| common_shift_m + o[0]).collect(),
            stretch: own.iter().map(|o| o[1]).collect(),
            misfit: statistics.iter().map(|s| s.misfit(mean)).collect(),
        }
    }

    /// [A | D | own columns of every group]: response to the shapes of the profile, derivatives by the track parameters,
    /// and what each group of a kind shows.
    fn columns(
        &self,
        train: &Train,
        k: usize,
        kind: &GroupKind,
        passage: &SitePassage,
        amplitudes: &Mat<f64>,
    ) -> Mat<f64> {
        let (response, group) = (train.response(k), &train.groups[k]);
        let (n, q) = (response.nrows(), response.ncols());
        let fixed = q + self.moved.len();
        let mut columns = Mat::zeros(n, fixed + kind.groups.len() * (OWN + 1));
        columns.subcols_mut(0, q).copy_from(response);
        for (j, (moved, expected)) in self.moved.iter().zip(&group.moved_m_s2).enumerate() {
            for i in 0..n {
                columns[(i, q + j)] = (expected[i] - group.expected_m_s2[i]) / moved.step;
            }
        }
        // A window as it would be with the profile zero.
        let known = response * amplitudes;
        let zero: Vec<f64> = (0..n).map(|i| group.expected_m_s2[i] - known[(i, 0)]).collect();
        for (g, axles) in kind.groups.iter().enumerate() {
            let own = self.own_columns(train, group, passage, *axles, &zero);
            columns.subcols_mut(fixed + g * (OWN + 1), OWN + 1).copy_from(&own);
        }
        columns
    }

    /// [−ȧ/v | −ȧ τ | residual], with τ the time since the first axle, for a window that is `zero_m_s2` with the profile zero.
    fn own_columns(
        &self,
        train: &Train,
        group: &Group,
        passage: &SitePassage,
        axles: AxleGroup,
        zero_m_s2: &[f64],
    ) -> Mat<f64> {
        let (n, rate, band) = (group.window.len, train.rate_hz, self.model.greens.sampling.band_hz);
        let timing = passage.timing;
        let start = timing.axle_s(self.pattern.offset_m[axles.first]) - group.window.before as f64 / rate;
        let window = passage.recording.window(start, rate, n, band);
        // The slope of the model's mean, not of the recording: what the wheels have of their own says nothing on where
        // they are, but would damp every step.
        let slope = &group.expected_slope_m_s3;
        Mat::from_fn(n, OWN + 1, |k, c| match c {
            0 => -slope[k] / timing.speed_m_s,
            1 => -slope[k] * (start + k as f64 / rate - timing.first_axle_s),
            _ => window[k] - zero_m_s2[k],
        })
    }

    /// Windows of one passage, reduced to the information on what is shared and on its own unknowns.
    fn statistics(&self, passage: &Prepared) -> Result<Statistics, InverseError> {
        let shapes = &passage.train.shapes;
        let fixed = shapes.len() + self.moved.len();
        let width = fixed + 1 + OWN + 1;
        let estimators = passage.train.estimators(self.prior)?;
        let of_kinds: Vec<Mat<f64>> = estimators
            .par_iter()
            .zip(&passage.columns)
            .map(|(estimator, (columns, groups))| {
                let mut columns = columns.clone();
                estimator.whiten(&mut columns);
                let mut products = Mat::zeros(width, width);
                add_products(&mut products, &columns, shapes.len(), fixed, *groups);
                products
            })
            .collect();
        let mut products: Mat<f64> = Mat::zeros(width, width);
        let (mut log_likelihood, mut values) = (0.0, 0);
        for ((of_kind, estimator), (_, groups)) in of_kinds.iter().zip(&estimators).zip(&passage.columns) {
            products += of_kind;
            values += groups * estimator.len();
            log_likelihood -= *groups as f64
                * (estimator.log_det_half() + 0.5 * estimator.len() as f64 * std::f64::consts::TAU.ln());
        }
        log_likelihood -= 0.5 * products[(width - 1, width - 1)];
        Ok(Statistics { values, ..self.eliminate_own(shapes, &products, log_likelihood) })
    }

    fn eliminate_own(&self, shapes: &Shapes, products: &Mat<f64>, log_likelihood: f64) -> Statistics {
        let m = shapes.len() + 1 + self.moved.len();
        let value = [products[(m + OWN, m)], products[(m + OWN, m + 1)]];
        let precision = [
            [products[(m, m)] + self.passage_shift_sd_m.powi(-2), products[(m + 1, m)]],
            [products[(m + 1, m)], products[(m + 1, m + 1)] + self.speed_sd.powi(-2)],
        ];
        let determinant = precision[0][0] * precision[1][1] - precision[0][1] * precision[1][0];
        let covariance = [
            [precision[1][1] / determinant, -precision[0][1] / determinant],
            [-precision[1][0] / determinant, precision[0][0] / determinant],
        ];
        let coupling = products.submatrix(m, 0, OWN, m).transpose().to_owned();
        let weights = Mat::from_fn(OWN, OWN, |i, j| covariance[i][j]);
        let weighted = &coupling * &weights;
        let mut information = products.submatrix(0, 0, m, m).to_owned();
        triangular::matmul(
            &mut information,
            triangular::BlockStructure::TriangularLower,
            Accum::Add,
            &weighted,
            triangular::BlockStructure::Rectangular,
            coupling.transpose(),
            triangular::BlockStructure::Rectangular,
            -1.0,
            Par::Seq,
        );
        symmetrise(&mut information);
        let vector = Mat::from_fn(1, m, |_, i| {
            products[(m + OWN, i)] - weighted[(i, 0)] * value[0] - weighted[(i, 1)] * value[1]
        });
        let quadratic: f64 =
            (0..OWN).map(|i| (0..OWN).map(|j| value[i] * covariance[i][j] * value[j]).sum::<f64>()).sum();
        let prior_ln = self.passage_shift_sd_m.powi(-2).ln() + self.speed_sd.powi(-2).ln();
        Statistics {
            shapes: shapes.clone(),
            information,
            vector: shapes.expanded_columns(vector.as_ref()).transpose().to_owned(),
            log_likelihood: log_likelihood + 0.5 * quadratic - 0.5 * (determinant.ln() - prior_ln),
            squared: products[(m + OWN, m + OWN)] - quadratic,
            values: 0,
            own_covariance: covariance,
            own_coupling: shapes.expanded_columns(coupling.transpose()).transpose().to_owned(),
            own_value: value,
        }
    }
}

/// Prior and data on what is shared, whitened by the prior: information `factor` = 1 + rootᵀ information root.
struct Joint {
    root: PriorRoot,
    /// Prior mean.
    centre: Mat<f64>,
    factor: Llt<f64>,
    vector: Mat<f64>,
    log_evidence: f64,
}

impl Joint {
    fn mean(&self) -> Mat<f64> {
        &self.centre + self.root.times(self.factor.solve(&self.vector).as_ref())
    }
}

impl Statistics {
    /// Squared residual per value, the own unknowns at their best.
    fn misfit(&self, shared: &Mat<f64>) -> f64 {
        let (entries, q) = (shared.nrows(), self.shapes.len());
        let more = self.information.nrows() - q;
        let profile: Vec<f64> = (0..entries - more).map(|i| shared[(i, 0)]).collect();
        let amplitudes = self.shapes.amplitudes(&profile);
        let known = Mat::from_fn(q + more, 1, |i, _| {
            if i < q { amplitudes[(i, 0)] } else { shared[(entries - more + i - q, 0)] }
        });
        let of_vector: f64 = (0..entries).map(|i| self.vector[(i, 0)] * shared[(i, 0)]).sum();
        let expected = (known.transpose() * &self.information * &known)[(0, 0)];
        (self.squared - 2.0 * of_vector + expected) / self.values.max(1) as f64
    }

    fn own_mean(&self, shared: &Mat<f64>) -> [f64; OWN] {
        let left: Vec<f64> = (0..OWN)
            .map(|k| {
                let coupled: f64 =
                    (0..shared.nrows()).map(|i| self.own_coupling[(i, k)] * shared[(i, 0)]).sum();
                self.own_value[k] - coupled
            })
            .collect();
        [0, 1].map(|i| (0..OWN).map(|k| self.own_covariance[i][k] * left[k]).sum())
    }
}

/// Adds columnsᵀ columns of all groups of a kind, lower triangle in the order (c, X, θ, x_i, stretch, residual),
/// with c the amplitudes of the profile's shapes.
///
/// `columns` holds (A, D) once, then (−ȧ/v, stretch, residual) of every group; −ȧ/v serves X and x_i.
fn add_products(products: &mut Mat<f64>, columns: &Mat<f64>, profile: usize, fixed: usize, groups: usize) {
    let place = |i: usize| if i < profile { i } else { i + 1 };
    let own = fixed + 1;
    let targets = [(profile, 0), (own, 0), (own + 1, 1), (own + 2, 2)];
    let fixed_columns = columns.subcols(0, fixed);
    let mut square: Mat<f64> = Mat::zeros(fixed, fixed);
    triangular::matmul(
        &mut square,
        triangular::BlockStructure::TriangularLower,
        Accum::Replace,
        fixed_columns.transpose(),
        triangular::BlockStructure::Rectangular,
        fixed_columns,
        triangular::BlockStructure::Rectangular,
        groups as f64,
        Par::Seq,
    );
    for j in 0..fixed {
        for i in j..fixed {
            products[(place(i), place(j))] += square[(i, j)];
        }
    }
    // The groups share the fixed columns: their sum meets these once.
    let mut sum: Mat<f64> = Mat::zeros(columns.nrows(), OWN + 1);
    let mut within: Mat<f64> = Mat::zeros(OWN + 1, OWN + 1);
    for g in 0..groups {
        let group = columns.subcols(fixed + g * (OWN + 1), OWN + 1);
        sum += group;
        within += group.transpose() * group;
    }
    let across = fixed_columns.transpose() * &sum;
    for (a, k) in targets {
        for i in 0..fixed {
            let (row, column) = (a.max(place(i)), a.min(place(i)));
            products[(row, column)] += across[(i, k)];
        }
        for (b, l) in targets.into_iter().filter(|(b, _)| *b <= a) {
            products[(a, b)] += within[(k, l)];
        }
    }
}

fn symmetrise(lower: &mut Mat<f64>) {
    for j in 0..lower.ncols() {
        for i in 0..j {
            lower[(i, j)] = lower[(j, i)];
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
