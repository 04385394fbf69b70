//! Calibration by evidence: ballast, common irregularity and axle positions from the whole acceleration below 160 Hz,
//! the forces integrated out.
//!
//! The quasi-static fit is biased, because the dynamic force of the crossing leaks below v/2.3 m. Here that force is
//! an unknown with a prior, so nothing has to be filtered away. The model is linearised in the ballast (Gauss-Newton on
//! the marginal likelihood), so that ballast, irregularity and positions come out of one linear-Gaussian posterior.

use std::sync::Arc;

use faer::Mat;
use rayon::prelude::*;

use super::damping::{Damping, MODEL_DAMPING_SD};
use super::low_track::{LowModel, LowTrack};
use super::{BallastParameters, UNKNOWNS};
use crate::inverse::hierarchy::{Moved, SiteModel, SitePassage, SitePosterior};
use crate::inverse::hyper::{IRREGULARITY, refine};
use crate::inverse::{CommonProfile, InverseError, Prior, ProfileGrids};
use crate::vehicle::AxlePattern;

/// Everything of a site that stays fixed while the ballast is varied.
pub struct EvidenceProblem<'a> {
    /// Track on any ballast.
    pub track: &'a LowTrack,
    /// +1 facing, -1 trailing.
    pub direction: f64,
    /// Axle pattern of the trains.
    pub pattern: &'a AxlePattern,
    /// Divisor of the evidence on ballast and position ([`temperature`]).
    pub temperature: f64,
}

/// Divisor of the evidence on ballast and position. All wheels of a train meet the same rail at the same speed, so what
/// the model lacks repeats in every one of them: a train of twelve wheelsets is one independent look, not twelve.
pub fn temperature(pattern: &AxlePattern) -> f64 {
    pattern.offset_m.len() as f64
}

/// The same for likelihoods that are compared with thresholds: those of trains of three cars, with which the thresholds were set.
pub const USUAL_TEMPERATURE: f64 = 12.0;
/// Prior standard deviations of the position errors after the quasi-static alignment, metres: common to all passages,
/// and of each passage; and of the relative speed.
const SHIFT_SD_M: (f64, f64) = (0.5, 0.3);
const SPEED_SD: f64 = 3e-4;
/// Spacing of the common irregularity on the two rails, metres, where descriptions of one train are compared.
const PROFILE_STEP_M: (f64, f64) = (0.1, 0.2);
/// The same where a site is calibrated: four knots to the shortest wave that trains of this speed feel, 160 Hz. With [`PROFILE_STEP_M`] the
/// cusp of a transition between two knots could not be told, and trains were moved to where it could: 20 to 60 mm at 28 to 32 m/s.
const FINE_STEP_M: (f64, f64) = (0.07, 0.2);
const FINE_AT_M_S: f64 = 45.0;
/// No finer than this part of it.
const FINEST: f64 = 0.4;
/// Steps of the difference quotients in the entries of [`BallastParameters::to_vector`].
pub const DIFFERENCE: [f64; UNKNOWNS] = [0.02, 0.02, 0.02, 0.05];
/// Largest change of these in one linearisation.
const TRUST: [f64; UNKNOWNS] = [0.3, 0.4, 0.2, 0.3];
/// Limits of the factor on it: over next to no support the fit begins a factor of ten from where it ends, and goes to and fro at its
/// end.
const TRUST_FACTOR: [f64; 2] = [0.1, 2.0];

/// When linearising ends.
#[derive(Clone, Copy, Debug)]
pub struct Until {
    /// No entry of [`BallastParameters::to_vector`] moves by more than this.
    pub change: f64,
    /// No passage moves by more than this, metres.
    pub shift_m: f64,
    /// Linearisations at most.
    pub rounds: usize,
}

/// State of the calibration: what is known of a site so far.
#[derive(Clone, Debug)]
pub struct Calibration {
    /// Ballast.
    pub ballast: BallastParameters,
    /// Common irregularity.
    pub irregularity: CommonProfile,
    /// Prior of forces and noise at the low sampling.
    pub prior: Prior,
    /// What of the ballast is unknown.
    pub unknown: Unknown,
}

/// What of the ballast a calibration finds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unknown {
    /// The damping is as crossing.toml has it.
    Stiffness,
    /// Both.
    StiffnessAndDamping,
}

impl Unknown {
    /// How many entries of [`BallastParameters::to_vector`], which has the damping last.
    pub fn count(self) -> usize {
        match self {
            Self::Stiffness => UNKNOWNS - 1,
            Self::StiffnessAndDamping => UNKNOWNS,
        }
    }
}

/// Result of the calibration by evidence.
#[derive(Clone, Debug)]
pub struct EvidenceFit {
    /// Most probable parameters.
    pub parameters: BallastParameters,
    /// Posterior covariance of the entries of [`BallastParameters::to_vector`] that were unknown: all, or all but the damping.
    pub covariance: Mat<f64>,
    /// Standard deviation of the position error that all passages share, metres.
    pub shift_sd_m: f64,
    /// Log evidence there, priors of the parameters included.
    pub log_evidence: f64,
    /// Linearisations.
    pub evaluations: usize,
}

impl Calibration {
    /// Nothing known of the irregularity.
    pub fn starting(ballast: BallastParameters, direction: f64) -> Self {
        let prior = Prior::starting(direction);
        let irregularity = level(prior.half_m, PROFILE_STEP_M);
        Self { ballast, irregularity, prior, unknown: Unknown::Stiffness }
    }

    /// The same with an irregularity as fine as trains of this speed feel it: the slower, the shorter are their waves.
    pub fn felt_at(self, speed_m_s: f64) -> Self {
        let finer = (speed_m_s / FINE_AT_M_S).clamp(FINEST, 1.0);
        let irregularity = level(self.prior.half_m, (finer * FINE_STEP_M.0, finer * FINE_STEP_M.1));
        Self { irregularity, ..self }
    }
}

/// No irregularity yet, with this spacing on the two rails.
fn level(half_m: f64, (crossing_m, stock_m): (f64, f64)) -> CommonProfile {
    CommonProfile::zero(ProfileGrids::irregularity(half_m, crossing_m, stock_m))
}

impl EvidenceProblem<'_> {
    /// Linearises until ballast and axle times stay; moves the axle times of the passages.
    pub fn converge(
        &self,
        state: &mut Calibration,
        passages: &mut [SitePassage],
        until: Until,
    ) -> Result<EvidenceFit, InverseError> {
        let mut trust = Trust::new();
        let mut evaluations = 0;
        loop {
            let posterior = self.posterior(state, passages)?;
            evaluations += 1;
            state.advance(&posterior, &mut trust);
            realign(passages, &posterior);
            if until.reached(&posterior) || evaluations >= until.rounds {
                let mut covariance = of_ballast(&posterior, state.unknown);
                if state.unknown == Unknown::StiffnessAndDamping {
                    let last = state.unknown.count() - 1;
                    covariance[(last, last)] += MODEL_DAMPING_SD.powi(2);
                }
                return Ok(EvidenceFit {
                    parameters: state.ballast,
                    covariance,
                    shift_sd_m: posterior.mean_shift_sd_m,
                    log_evidence: posterior.log_evidence,
                    evaluations,
                });
            }
        }
    }

    /// Moves the axle times and speeds of passages to where the model of `state`, its irregularity included, sees them, each by itself.
    pub fn follow(&self, state: &Calibration, passages: &mut [SitePassage]) -> Result<(), InverseError> {
        let model = self.low_model(state);
        let site = self.site_model(&model, Vec::new(), &state.prior, &state.irregularity);
        let followed = site.follow(passages)?;
        realign(passages, &followed);
        Ok(())
    }

    /// Posterior of a site with the ballast of `state` held: a quarter of the work of [`posterior`](Self::posterior).
    pub fn posterior_held(
        &self,
        state: &Calibration,
        passages: &[SitePassage],
    ) -> Result<SitePosterior, InverseError> {
        let model = self.low_model(state);
        self.site_model(&model, Vec::new(), &state.prior, &state.irregularity).posterior(passages)
    }

    /// The track on the ballast of `state`.
    pub fn low_model(&self, state: &Calibration) -> Arc<LowModel> {
        self.track.model(&state.ballast, state.prior.half_m)
    }

    /// Posterior of a site, linearised about `state`, at the low sampling.
    pub fn posterior(
        &self,
        state: &Calibration,
        passages: &[SitePassage],
    ) -> Result<SitePosterior, InverseError> {
        let (model, nearby) = self.models(state);
        self.linearised(&model, &nearby, state).posterior(passages)
    }

    /// The track on the ballast of `state`, and with each unknown entry of that moved by a step.
    fn models(&self, state: &Calibration) -> (Arc<LowModel>, Vec<LowModel>) {
        let half_m = state.prior.half_m;
        let beside = |k: usize| self.track.passing_model(&state.ballast.moved(k, DIFFERENCE[k]), half_m);
        rayon::join(
            || self.low_model(state),
            || (0..state.unknown.count()).into_par_iter().map(beside).collect(),
        )
    }

    fn linearised<'m>(
        &'m self,
        model: &'m LowModel,
        nearby: &'m [LowModel],
        state: &'m Calibration,
    ) -> SiteModel<'m> {
        let z = state.ballast.to_vector();
        let moved = nearby.iter().enumerate().map(|(k, model)| {
            let (mean, sd) = BallastParameters::PRIOR[k];
            Moved { model: model.track_model(), step: DIFFERENCE[k], prior: (mean - z[k], sd) }
        });
        self.site_model(model, moved.collect(), &state.prior, &state.irregularity)
    }

    /// What recordings say of the damping, where `state` was found with the one described: to first order, which is too little where it is
    /// far off.
    pub fn damping(&self, state: &Calibration, passages: &[SitePassage]) -> Result<Damping, InverseError> {
        let unknown = Unknown::StiffnessAndDamping;
        let posterior = self.posterior(&Calibration { unknown, ..state.clone() }, passages)?;
        let k = unknown.count() - 1;
        Ok(Damping::new(posterior.parameters[k], of_ballast(&posterior, unknown)[(k, k)].max(0.0).sqrt()))
    }

    /// Log evidence of `state` under the better of some priors: of two calibrations each has found its own, by factors of two, and what differs
    /// by that is no evidence.
    pub fn evidence_under(
        &self,
        priors: &[&Prior],
        state: &Calibration,
        passages: &[SitePassage],
    ) -> Result<f64, InverseError> {
        let (model, nearby) = self.models(state);
        let site = self.linearised(&model, &nearby, state);
        let prepared = site.prepared(passages)?;
        priors.iter().try_fold(f64::NEG_INFINITY, |best: f64, prior| {
            Ok(best.max(SiteModel { prior, ..site.clone() }.log_evidence(&prepared)?))
        })
    }

    /// Prior whose hyper-parameters the evidence prefers, all else as in `state`.
    pub fn refined(&self, state: &Calibration, passages: &[SitePassage]) -> Result<Prior, InverseError> {
        let model = self.low_model(state);
        let site = self.site_model(&model, Vec::new(), &state.prior, &state.irregularity);
        let prepared = site.prepared(passages)?;
        let evidence = |prior: &Prior| SiteModel { prior, ..site.clone() }.log_evidence(&prepared);
        refine(&state.prior, &IRREGULARITY, &evidence)
    }

    fn site_model<'m>(
        &'m self,
        model: &'m LowModel,
        moved: Vec<Moved<'m>>,
        prior: &'m Prior,
        profile: &'m CommonProfile,
    ) -> SiteModel<'m> {
        SiteModel {
            model: model.track_model(),
            moved,
            direction: self.direction,
            pattern: self.pattern,
            prior,
            profile,
            common_shift_sd_m: SHIFT_SD_M.0,
            passage_shift_sd_m: SHIFT_SD_M.1,
            speed_sd: SPEED_SD,
            temperature: self.temperature,
        }
    }
}

impl Until {
    fn reached(&self, posterior: &SitePosterior) -> bool {
        let largest = |values: &[f64]| values.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        largest(&posterior.parameters) < self.change && largest(&posterior.shift_m) < self.shift_m
    }
}

/// How far a linearisation is trusted, relative to [`TRUST`]: further while the ballast keeps its direction, less where it turns.
struct Trust {
    factor: f64,
    last: [f64; UNKNOWNS],
}

impl Trust {
    fn new() -> Self {
        Self { factor: 1.0, last: [0.0; UNKNOWNS] }
    }

    /// Part of a change that is gone; what is known stays.
    fn step(&mut self, change: &[f64]) -> [f64; UNKNOWNS] {
        let change: [f64; UNKNOWNS] = std::array::from_fn(|k| change.get(k).copied().unwrap_or(0.0));
        let limited =
            |factor: f64| (0..UNKNOWNS).map(|k| change[k].abs() / (factor * TRUST[k])).fold(1.0, f64::max);
        let along: f64 = (0..UNKNOWNS).map(|k| change[k] * self.last[k] / TRUST[k].powi(2)).sum();
        if along < 0.0 {
            self.factor = (0.5 * self.factor).max(TRUST_FACTOR[0]);
        } else if along > 0.0 && limited(self.factor) > 1.0 {
            self.factor = (2.0 * self.factor).min(TRUST_FACTOR[1]);
        }
        let excess = limited(self.factor);
        self.last = std::array::from_fn(|k| change[k] / excess);
        self.last
    }
}

impl Calibration {
    /// Moves towards the posterior mean, as far as it is trusted.
    fn advance(&mut self, posterior: &SitePosterior, trust: &mut Trust) {
        let (z, step) = (self.ballast.to_vector(), trust.step(&posterior.parameters));
        self.ballast = BallastParameters::from_vector(&std::array::from_fn(|k| z[k] + step[k]));
        self.irregularity = posterior.profile.clone();
    }
}

/// Moves the axle times and speeds of all passages to their posterior mean.
pub fn realign(passages: &mut [SitePassage], posterior: &SitePosterior) {
    for (i, passage) in passages.iter_mut().enumerate() {
        let timing = &mut passage.timing;
        timing.first_axle_s += posterior.shift_m[i] / timing.speed_m_s;
        timing.speed_m_s /= 1.0 + posterior.stretch[i];
    }
}

/// Covariance of the ballast, which a posterior has last.
fn of_ballast(posterior: &SitePosterior, unknown: Unknown) -> Mat<f64> {
    let (all, n) = (&posterior.covariance, unknown.count());
    let first = all.nrows() - n;
    all.submatrix(first, first, n, n).to_owned()
}
