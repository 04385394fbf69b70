//! Calibration by evidence: ballast, common force profile and axle positions from the whole acceleration below 160 Hz,
//! the forces integrated out.
//!
//! The quasi-static fit is biased, because the dynamic force of the crossing leaks below v/2.3 m. Here that force is
//! an unknown with a prior, so nothing has to be filtered away.

use argmin::core::{CostFunction, Executor, State};
use argmin::solver::neldermead::NelderMead;
use faer::Mat;

use super::BallastParameters;
use crate::greens::{Chain, GreensFunctions, GreensSampling, Quantity};
use crate::interaction::Interaction;
use crate::inverse::hierarchy::{SiteModel, SitePassage, SitePosterior};
use crate::inverse::hyper::refine;
use crate::inverse::{InverseError, Prior, ProfileGrids};
use crate::recording::Vehicle;
use crate::track::Track;
use crate::vehicle::AxlePattern;

/// Everything of a site that stays fixed while the ballast is varied.
pub struct EvidenceProblem<'a> {
    /// Track without ballast.
    pub track: &'a Track,
    /// +1 facing, -1 trailing.
    pub direction: f64,
    /// Axle pattern of the trains.
    pub pattern: &'a AxlePattern,
    /// Prior of forces and noise at the identification's sampling.
    pub prior: Prior,
    /// Vehicle.
    pub vehicle: &'a Vehicle,
}

/// Prior of the shape p3: between a smooth minimum under the crossing sleeper (q = s², p3 = 0.25) and a cusp (linear,
/// p3 = 0.5), with room on both sides.
const P3_PRIOR: (f64, f64) = (0.4, 0.1);
/// Divisor of the log evidence. All wheels of a train meet the same rail at the same speed, so what the model lacks
/// repeats in every one of them: a train of twelve wheelsets is one independent look, not twelve.
const TEMPERATURE: f64 = 12.0;
/// Prior of ln p1 and ln p2: within a factor of about three around 30 MN/m² (nominal ballast, paper Table 1).
const STIFFNESS_PRIOR: (f64, f64) = (17.2, 1.0);
/// Prior standard deviations of the position errors after the quasi-static alignment, metres: common to all passages,
/// and of each passage.
const SHIFT_SD_M: (f64, f64) = (0.05, 0.02);
/// Spacing of the common profile on the two rails at the low sampling, metres.
const PROFILE_STEP_M: (f64, f64) = (0.1, 0.2);

/// Result of the calibration by evidence.
#[derive(Clone, Debug)]
pub struct EvidenceFit {
    /// Most probable parameters.
    pub parameters: BallastParameters,
    /// Posterior covariance of (ln p1, ln p2, p3).
    pub covariance: [[f64; 3]; 3],
    /// Log evidence there, priors of the parameters included.
    pub log_evidence: f64,
    /// Models evaluated.
    pub evaluations: usize,
}

impl EvidenceProblem<'_> {
    /// Posterior of a site for given ballast at the low sampling.
    pub fn posterior(
        &self,
        ballast: &BallastParameters,
        passages: &[SitePassage],
    ) -> Result<SitePosterior, InverseError> {
        let distribution = ballast.distribution(self.track.sleeper_x_m.len(), self.track.sensor_sleeper);
        LowModel::new(self, &distribution).posterior(self, &self.prior, passages)
    }

    /// Prior whose hyper-parameters the evidence prefers at given ballast.
    pub fn refined(
        &self,
        ballast: &BallastParameters,
        passages: &[SitePassage],
    ) -> Result<Prior, InverseError> {
        let distribution = ballast.distribution(self.track.sleeper_x_m.len(), self.track.sensor_sleeper);
        let model = LowModel::new(self, &distribution);
        Ok(refine(&self.prior, &|prior| Ok(model.posterior(self, prior, passages)?.log_evidence))?.0)
    }

    /// Searches from several starts, because p2 and p3 trade against each other and local optima exist.
    pub fn fit(
        &self,
        starts: &[BallastParameters],
        passages: &[SitePassage],
    ) -> Result<EvidenceFit, InverseError> {
        let mut evaluations = 0;
        let mut best: Option<(Vec<f64>, f64)> = None;
        for start in starts {
            let cost = Cost { problem: self, passages };
            let solver = NelderMead::new(simplex(start)).with_sd_tolerance(0.05).map_err(|_| failed())?;
            let run =
                Executor::new(cost, solver).configure(|s| s.max_iters(60)).run().map_err(|_| failed())?;
            evaluations += run.state().get_func_counts().values().sum::<u64>() as usize;
            let found = run.state().get_best_param().cloned().map(|p| (p, run.state().get_best_cost()));
            if let Some((p, c)) = found
                && best.as_ref().is_none_or(|(_, b)| c < *b)
            {
                best = Some((p, c));
            }
        }
        let (z, cost) = best.ok_or_else(failed)?;
        let covariance = self.curvature(&z, passages, cost)?;
        evaluations += 12;
        Ok(EvidenceFit { parameters: from_vector(&z), covariance, log_evidence: -cost, evaluations })
    }

    /// Negative log evidence with the parameters' priors.
    fn cost(&self, z: &[f64], passages: &[SitePassage]) -> Result<f64, InverseError> {
        let outside = (z[2] - z[2].clamp(0.0, 1.0)).powi(2) * 1e6;
        let prior = [(z[0], STIFFNESS_PRIOR), (z[1], STIFFNESS_PRIOR), (z[2], P3_PRIOR)]
            .iter()
            .map(|(v, (mean, sd))| 0.5 * ((v - mean) / sd).powi(2))
            .sum::<f64>();
        Ok(prior + outside - self.posterior(&from_vector(z), passages)?.log_evidence / TEMPERATURE)
    }

    /// Inverse Hessian of the cost by central differences (Laplace approximation of the posterior).
    fn curvature(
        &self,
        z: &[f64],
        passages: &[SitePassage],
        cost: f64,
    ) -> Result<[[f64; 3]; 3], InverseError> {
        let step = [0.04, 0.06, 0.08];
        let at = |moves: &[(usize, f64)]| {
            let mut p = z.to_vec();
            for (i, s) in moves {
                p[*i] += s * step[*i];
            }
            self.cost(&p, passages)
        };
        let mut hessian = Mat::zeros(3, 3);
        for i in 0..3 {
            hessian[(i, i)] = (at(&[(i, 1.0)])? + at(&[(i, -1.0)])? - 2.0 * cost) / (step[i] * step[i]);
            for j in 0..i {
                let mixed = at(&[(i, 1.0), (j, 1.0)])? + at(&[(i, -1.0), (j, -1.0)])?
                    - at(&[(i, 1.0), (j, -1.0)])?
                    - at(&[(i, -1.0), (j, 1.0)])?;
                hessian[(i, j)] = mixed / (4.0 * step[i] * step[j]);
                hessian[(j, i)] = hessian[(i, j)];
            }
        }
        Ok(positive_inverse(&hessian))
    }
}

/// Track of given ballast at the low sampling.
struct LowModel {
    greens: GreensFunctions,
    interaction: Interaction,
}

impl LowModel {
    fn new(problem: &EvidenceProblem, distribution: &[f64]) -> Self {
        let sampling = GreensSampling::low();
        let (track, half_m) = (problem.track, problem.prior.half_m);
        Self {
            greens: GreensFunctions::new(
                track,
                distribution,
                sampling,
                Quantity::Acceleration,
                &Chain::Corrected,
            ),
            interaction: Interaction::new(track, distribution, problem.vehicle, half_m, sampling),
        }
    }

    fn posterior(
        &self,
        problem: &EvidenceProblem,
        prior: &Prior,
        passages: &[SitePassage],
    ) -> Result<SitePosterior, InverseError> {
        let model = SiteModel {
            greens: &self.greens,
            interaction: &self.interaction,
            direction: problem.direction,
            pattern: problem.pattern,
            prior,
            grids: ProfileGrids::new(prior.half_m, PROFILE_STEP_M.0, PROFILE_STEP_M.1),
            common_shift_sd_m: SHIFT_SD_M.0,
            passage_shift_sd_m: SHIFT_SD_M.1,
        };
        model.posterior(passages)
    }
}

/// Inverse with the eigenvalues limited to those of the prior: a direction in which the numerical curvature vanishes
/// is known no better than before.
fn positive_inverse(hessian: &Mat<f64>) -> [[f64; 3]; 3] {
    let mut out = [[0.0; 3]; 3];
    let Ok(eigen) = hessian.self_adjoint_eigen(faer::Side::Lower) else {
        return [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, P3_PRIOR.1 * P3_PRIOR.1]];
    };
    let (u, s) = (eigen.U(), eigen.S());
    for (i, row) in out.iter_mut().enumerate() {
        for (j, value) in row.iter_mut().enumerate() {
            *value = (0..3).map(|k| u[(i, k)] * u[(j, k)] / s[k].max(1.0)).sum();
        }
    }
    out
}

fn failed() -> InverseError {
    InverseError::Covariance { len: 0, noise_m_s2: f64::NAN }
}

fn from_vector(z: &[f64]) -> BallastParameters {
    BallastParameters {
        p1_n_m2: z[0].clamp(13.0, 20.0).exp(),
        p2_n_m2: z[1].clamp(13.0, 20.0).exp(),
        p3: z[2].clamp(0.0, 1.0),
    }
}

/// Start and one step along each axis.
fn simplex(start: &BallastParameters) -> Vec<Vec<f64>> {
    let z = vec![start.p1_n_m2.ln(), start.p2_n_m2.ln(), start.p3];
    let step = [0.15, 0.3, if start.p3 > 0.5 { -0.2 } else { 0.2 }];
    let moved = |i: usize| {
        let mut p = z.clone();
        p[i] += step[i];
        p
    };
    vec![z.clone(), moved(0), moved(1), moved(2)]
}

struct Cost<'p, 'a> {
    problem: &'p EvidenceProblem<'a>,
    passages: &'p [SitePassage<'p>],
}

impl CostFunction for Cost<'_, '_> {
    type Param = Vec<f64>;
    type Output = f64;

    fn cost(&self, z: &Vec<f64>) -> Result<f64, argmin::core::Error> {
        Ok(self.problem.cost(z, self.passages)?)
    }
}
