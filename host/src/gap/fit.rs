//! Joint fit of the base model and a set of effects: Gauss-Newton steps on the simulated passages, everything else
//! linear and Gaussian.
//!
//! Unknown are the deviation of the path from the scan (both rails), the ballast's stiffness and damping, a common and one own
//! position error per passage, and the parameters of the effects. The simulation is exact in all of them; its derivatives
//! are differences, except those for the path, which come from the linear model once per site.

mod damping;
mod descent;
mod nearby;
mod normal;
mod priors;
mod recall;
mod screening;
mod settled;

pub use damping::damping;
pub use recall::{Recall, simulate};
pub use screening::{Direction, Screening, screen};
pub use settled::{cost_in_place, replaced, settled};

use faer::linalg::solvers::{Llt, Solve as _};
use faer::{Mat, MatRef};
use rayon::prelude::*;

use self::descent::Descent;
use self::nearby::Nearby;
use self::normal::{Step, normal_equations};
use self::priors::{SHIFT_SD_M, ballast_priors, prior_cost};
use self::recall::simulate_in;
use super::GapError;
use super::data::Observed;
use super::effect::Effect;
use super::forward::{Detail, Response};
use super::linear::BogieResponses;
use super::world::{SensorModel, World};
use crate::ballast::evidence::Unknown;
use crate::ballast::{BallastParameters, UNKNOWNS};
use crate::signal::sum_in_order;

/// Everything that stays fixed during the fits of one site.
pub struct Frame {
    /// World with the start values.
    pub base: World,
    /// All passages.
    pub observed: Vec<Observed>,
    /// Linear responses of a well mounted sensor, per passage.
    pub responses: Vec<BogieResponses>,
    /// Factor of the covariance of a passage's mean window.
    pub factors: Vec<Llt<f64>>,
    /// Factor of the prior covariance of the path's deviation.
    pub deviation_root: Mat<f64>,
    /// What of the ballast is unknown.
    pub unknown: Unknown,
    /// What was simulated lately.
    pub recall: Recall,
}

/// Values of everything unknown.
#[derive(Clone, Debug)]
pub struct State {
    /// Deviation of the path, spline coefficients, metres.
    pub deviation_m: Vec<f64>,
    /// [`BallastParameters::to_vector`].
    pub ballast: [f64; UNKNOWNS],
    /// Position error of every passage, metres: the train is later by this.
    pub shift_m: Vec<f64>,
    /// Coordinates of the effects' parameters, one list per effect.
    pub effects: Vec<Vec<f64>>,
}

/// Outcome of a fit.
#[derive(Clone)]
pub struct Fit {
    /// Most probable values.
    pub state: State,
    /// Log posterior density there, up to constants of the data.
    pub log_posterior: f64,
    /// Log evidence (Laplace).
    pub log_evidence: f64,
    /// Posterior covariance of the ballast parameters, then the effects' coordinates.
    pub covariance: Mat<f64>,
    /// Whitened residuals and columns of every passage used, for leave-one-out prediction and identifiability.
    pub passages: Vec<Whitened>,
}

impl Fit {
    /// Squared misfit per value, at least 1: how far the model is from explaining the mean windows.
    pub fn inflation(&self) -> f64 {
        let (sum, n) = self
            .passages
            .iter()
            .fold((0.0, 0.0), |(s, n), p| (s + p.squares(), n + p.residual.nrows() as f64));
        (sum / n).max(1.0)
    }

    /// Whether the model is so far off that its derivatives say little of what would mend it.
    pub fn lost(&self) -> bool {
        self.inflation() > LOST
    }
}

/// Squared misfit per value above which the model is lost, and its derivatives with it: strong effects of training trials
/// leave 2.4 to 7.5, sites without any 1.
const LOST: f64 = 2.0;

/// One passage, whitened: columns for the ballast, the common shift, the effects; path columns apart.
#[derive(Clone)]
pub struct Whitened {
    /// Index among the observed passages.
    pub index: usize,
    /// Path, ballast, common shift, effects.
    pub columns: Mat<f64>,
    /// Residual.
    pub residual: Mat<f64>,
}

impl Whitened {
    /// Of the residual.
    pub fn squares(&self) -> f64 {
        self.residual.col_as_slice(0).iter().map(|v| v * v).sum()
    }
}

/// Steps of the numerical derivatives.
const BALLAST_STEP: [f64; UNKNOWNS] = [0.04, 0.04, 0.04, 0.1];
/// Longest step of a fit: a factor of two in stiffness, a fifth of the range of the shape, a factor of 1.6 in damping.
const BALLAST_STRIDE: [f64; UNKNOWNS] = [0.7, 0.7, 0.2, 0.5];
/// Step for the derivative by position, metres.
const SHIFT_STEP_M: f64 = 2e-4;

impl State {
    /// Start without effects.
    pub fn start(frame: &Frame, ballast: &BallastParameters) -> Self {
        Self {
            deviation_m: vec![0.0; frame.deviation_root.nrows()],
            ballast: ballast.to_vector(),
            shift_m: vec![0.0; frame.observed.len()],
            effects: Vec::new(),
        }
    }

    /// The same with the parameters of further effects.
    pub fn with(&self, coordinates: impl IntoIterator<Item = Vec<f64>>) -> Self {
        let mut more = self.clone();
        more.effects.extend(coordinates);
        more
    }

    /// Ballast parameters, kept within what a simulation bears.
    pub fn ballast(&self) -> BallastParameters {
        BallastParameters::from_vector(&self.ballast)
    }

    /// World in this state.
    pub fn world(&self, frame: &Frame, effects: &[&dyn Effect]) -> World {
        let mut world = frame.base.clone();
        world.ballast = self.ballast();
        world.path.deviation.coefficient_m.copy_from_slice(&self.deviation_m);
        for (effect, coordinates) in effects.iter().zip(&self.effects) {
            let values = values(*effect, coordinates);
            effect.apply(&mut world, &values);
        }
        world
    }
}

/// Mean windows that the recorder would show of given responses; every train later by `late_m`.
fn mean_windows(
    frame: &Frame,
    world: &World,
    responses: &[Response],
    subset: &[usize],
    (shift_m, late_m): (&[f64], f64),
) -> Vec<Vec<f64>> {
    subset
        .par_iter()
        .zip(responses)
        .map(|(i, r)| {
            let o = &frame.observed[*i];
            let late_s = (shift_m[*i] + late_m) / o.speed_m_s;
            o.predicted_mean(r, world.sensor.gain_at(o.temperature_c), late_s)
        })
        .collect()
}

/// Simulation of the passages in a state.
struct Evaluation {
    detail: Detail,
    sensor: SensorModel,
    /// Whether sleepers stay on a bed that is linear.
    linear_bed: bool,
    responses: Vec<Response>,
    predicted: Vec<Vec<f64>>,
    residuals: Vec<Vec<f64>>,
    cost: f64,
}

impl Evaluation {
    fn new(
        frame: &Frame,
        effects: &[&dyn Effect],
        state: &State,
        (subset, detail): (&[usize], Detail),
    ) -> Result<Self, GapError> {
        let world = state.world(frame, effects);
        let responses = simulate_in(detail, &world, frame, subset)?;
        let predicted = mean_windows(frame, &world, &responses, subset, (&state.shift_m, 0.0));
        let residuals: Vec<Vec<f64>> = subset
            .iter()
            .zip(&predicted)
            .map(|(i, p)| frame.observed[*i].mean.iter().zip(p).map(|(m, p)| m - p).collect())
            .collect();
        let cost = cost(frame, effects, state, subset, &residuals);
        Ok(Self {
            detail,
            sensor: world.sensor,
            linear_bed: world.bed.is_linear(),
            responses,
            predicted,
            residuals,
            cost,
        })
    }
}

/// Numbers of unknowns: path, then ballast, common shift, effects.
struct Shape {
    path: usize,
    ballast: usize,
    effects: usize,
}

impl Shape {
    fn len(&self) -> usize {
        self.first_effect() + self.effects
    }

    fn of(frame: &Frame, effects: usize) -> Self {
        Self { path: frame.deviation_root.nrows(), ballast: frame.unknown.count(), effects }
    }

    fn common_shift(&self) -> usize {
        self.path + self.ballast
    }

    fn first_effect(&self) -> usize {
        self.common_shift() + 1
    }
}

/// Options of a fit.
#[derive(Clone, Copy, Debug)]
pub struct FitOptions {
    /// Most Gauss-Newton steps.
    pub steps: usize,
    /// Number of steps before which derivatives are renewed.
    pub renew: usize,
    /// Ends when the log posterior grows by less.
    pub tolerance: f64,
    /// Tries damped steps where straight ones are misled.
    pub damped: bool,
    /// Of the simulations.
    pub detail: Detail,
}

impl FitOptions {
    /// From a start that may be far from the optimum, or for a model that everything else is measured against.
    pub const THOROUGH: Self =
        Self { steps: 16, renew: 14, tolerance: 0.5, damped: true, detail: Detail::Full };
}

impl Default for FitOptions {
    fn default() -> Self {
        Self { steps: 8, renew: 6, tolerance: 0.5, damped: true, detail: Detail::Full }
    }
}

/// Linearisation of the passages at a state.
struct Linearised {
    /// Per passage: whitened [path | ballast | common shift | effects | own shift | residual].
    passages: Vec<Whitened>,
    own: Vec<Mat<f64>>,
}

/// Fits base model and effects to the passages of `subset`.
pub fn fit(
    frame: &Frame,
    effects: &[&dyn Effect],
    start: State,
    subset: &[usize],
    options: FitOptions,
) -> Result<Fit, GapError> {
    let shape = Shape::of(frame, effects.iter().map(|e| e.parameters().len()).sum());
    let mut state = start;
    let mut here = Evaluation::new(frame, effects, &state, (subset, options.detail))?;
    let mut columns = derivatives(frame, effects, &state, subset, &here)?;
    let mut descent = Descent { frame, effects, subset, options, damped: None };
    let mut fresh = true;
    for step in 0..options.steps {
        let linear = whiten(frame, subset, &columns, &here);
        let normal = normal_equations(frame, effects, &state, &shape, &linear, subset);
        let stride = descent.stride((&state, &here), &normal)?;
        let converged = fresh && stride.converged;
        let gained = stride.next.as_ref().map_or(0.0, |(_, e)| here.cost - e.cost);
        if let Some((s, e)) = stride.next {
            (state, here) = (s, e);
            fresh = false;
        }
        // Old derivatives may be what stops the descent.
        let halted = gained <= descent.tolerance(here.cost) && (fresh || step >= options.renew);
        if converged || halted {
            break;
        }
        if step < options.renew {
            columns = derivatives(frame, effects, &state, subset, &here)?;
            fresh = true;
        }
    }
    let linear = whiten(frame, subset, &columns, &here);
    finish(frame, effects, state, &shape, linear, here.cost, subset)
}

/// Negative log posterior.
fn cost(
    frame: &Frame,
    effects: &[&dyn Effect],
    state: &State,
    subset: &[usize],
    residuals: &[Vec<f64>],
) -> f64 {
    let misfit = subset.par_iter().zip(residuals).map(|(i, r)| {
        let column = Mat::from_fn(r.len(), 1, |k, _| r[k]);
        let white = whitened(&frame.factors[*i], &column);
        0.5 * white.col_as_slice(0).iter().map(|v| v * v).sum::<f64>()
    });
    sum_in_order(misfit) + prior_cost(frame, effects, state, subset)
}

/// Columns [ballast | common shift | effects] per passage by differences.
fn derivatives(
    frame: &Frame,
    effects: &[&dyn Effect],
    state: &State,
    subset: &[usize],
    here: &Evaluation,
) -> Result<Vec<Mat<f64>>, GapError> {
    let mut variants: Vec<(State, f64, bool)> = Vec::new();
    for k in 0..frame.unknown.count() {
        let mut moved = state.clone();
        moved.ballast[k] += BALLAST_STEP[k];
        variants.push((moved, BALLAST_STEP[k], true));
    }
    let mut late = state.clone();
    late.shift_m.iter_mut().for_each(|s| *s += SHIFT_STEP_M);
    variants.push((late, SHIFT_STEP_M, false));
    for (e, effect) in effects.iter().enumerate() {
        for (k, p) in effect.parameters().iter().enumerate() {
            let mut moved = state.clone();
            let up = moved.effects[e][k] + p.step <= p.range[1];
            let step = if up { p.step } else { -p.step };
            moved.effects[e][k] += step;
            variants.push((moved, step, effect.simulated()));
        }
    }
    let nearby = Nearby::of(frame, subset, here.detail);
    let there: Vec<Vec<Vec<f64>>> = variants
        .par_iter()
        .map(|(s, _, simulated)| {
            let world = s.world(frame, effects);
            let shifts = (&s.shift_m[..], 0.0);
            match simulated {
                true => {
                    let responses = nearby.responses(&world, &here.responses)?;
                    Ok(mean_windows(frame, &world, &responses, subset, shifts))
                }
                false => Ok(mean_windows(frame, &world, &here.responses, subset, shifts)),
            }
        })
        .collect::<Result<_, GapError>>()?;
    Ok((0..subset.len())
        .map(|p| {
            Mat::from_fn(here.predicted[p].len(), variants.len(), |k, v| {
                (there[v][p][k] - here.predicted[p][k]) / variants[v].1
            })
        })
        .collect())
}

/// L⁻¹ · columns.
pub fn whitened(factor: &Llt<f64>, columns: &Mat<f64>) -> Mat<f64> {
    forward_solved(factor.L(), columns)
}

fn lower_solve(root: &Mat<f64>, columns: &Mat<f64>) -> Mat<f64> {
    forward_solved(root.as_ref(), columns)
}

fn forward_solved(lower: MatRef<'_, f64>, columns: &Mat<f64>) -> Mat<f64> {
    let mut out = columns.clone();
    faer::linalg::triangular_solve::solve_lower_triangular_in_place(lower, out.as_mut(), faer::Par::Seq);
    out
}

/// The responses to the path are those of a well mounted sensor; what it is mounted on stands between them and the recording.
fn whiten(frame: &Frame, subset: &[usize], columns: &[Mat<f64>], here: &Evaluation) -> Linearised {
    let (passages, own) = subset
        .par_iter()
        .zip(columns)
        .zip(&here.residuals)
        .map(|((i, columns), residual)| {
            let path = here.sensor.through_mount(&frame.responses[*i].both);
            let (n, m, q) = (residual.len(), path.ncols(), columns.ncols());
            let all = Mat::from_fn(n, m + q, |k, c| if c < m { path[(k, c)] } else { columns[(k, c - m)] });
            let factor = &frame.factors[*i];
            let white = whitened(factor, &all);
            let own = Mat::from_fn(n, 1, |k, _| white[(k, m + frame.unknown.count())]);
            let residual = whitened(factor, &Mat::from_fn(n, 1, |k, _| residual[k]));
            (Whitened { index: *i, columns: white, residual }, own)
        })
        .unzip();
    Linearised { passages, own }
}

fn moved(
    frame: &Frame,
    effects: &[&dyn Effect],
    state: &State,
    by: &Step,
    scale: f64,
    subset: &[usize],
) -> State {
    let mut next = state.clone();
    let shape = Shape::of(frame, 0);
    let m = shape.path;
    let step = |i: usize| scale * by.joint[(i, 0)];
    for (i, d) in next.deviation_m.iter_mut().enumerate() {
        *d += step(i);
    }
    for (k, b) in next.ballast.iter_mut().take(shape.ballast).enumerate() {
        let most = BALLAST_STRIDE[k];
        *b += step(m + k).clamp(-most, most);
    }
    for (i, own) in subset.iter().zip(&by.own_m) {
        next.shift_m[*i] += step(shape.common_shift()) + scale * own;
    }
    let mut at = shape.first_effect();
    for (e, effect) in effects.iter().enumerate() {
        for (k, p) in effect.parameters().iter().enumerate() {
            let most = 2.0 * p.prior.1;
            let value = next.effects[e][k] + step(at).clamp(-most, most);
            next.effects[e][k] = value.clamp(p.range[0], p.range[1]);
            at += 1;
        }
    }
    next
}

fn finish(
    frame: &Frame,
    effects: &[&dyn Effect],
    state: State,
    shape: &Shape,
    linear: Linearised,
    cost: f64,
    subset: &[usize],
) -> Result<Fit, GapError> {
    let normal = normal_equations(frame, effects, &state, shape, &linear, subset);
    let factor = normal
        .hessian
        .llt(faer::Side::Lower)
        .map_err(|_| GapError::Singular { what: "the curvature at the best fit" })?;
    let (n, m) = (shape.len(), shape.path);
    let l = factor.L();
    let log_det: f64 = (0..n).map(|i| l[(i, i)].ln()).sum();
    let prior_log_det: f64 = (0..m).map(|i| frame.deviation_root[(i, i)].ln()).sum::<f64>()
        + ballast_priors(frame).map(|p| p.1.ln()).sum::<f64>()
        + SHIFT_SD_M.0.ln()
        + effects.iter().flat_map(|e| e.parameters()).map(|p| p.prior.1.ln()).sum::<f64>();
    let wanted: Vec<usize> = (m..shape.common_shift()).chain(shape.first_effect()..n).collect();
    let picked = Mat::from_fn(n, wanted.len(), |i, j| f64::from(u8::from(i == wanted[j])));
    let covariance = picked.transpose() * factor.solve(&picked);
    Ok(Fit {
        state,
        log_posterior: -cost,
        log_evidence: -cost - log_det - prior_log_det,
        covariance,
        passages: linear.passages,
    })
}

/// Values at coordinates, inside their ranges.
pub fn values(effect: &dyn Effect, coordinates: &[f64]) -> Vec<f64> {
    let inside = |(p, c): (&super::effect::Parameter, &f64)| p.value(c.clamp(p.range[0], p.range[1]));
    effect.parameters().iter().zip(coordinates).map(inside).collect()
}
