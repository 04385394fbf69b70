//! Normal equations of a fit's Gauss-Newton step, the passages' own shifts eliminated.

use faer::Mat;
use faer::linalg::solvers::Solve as _;
use rayon::prelude::*;

use super::priors::{SHIFT_SD_M, add_prior, common_shift};
use super::{Frame, Linearised, Shape, State};
use crate::gap::GapError;
use crate::gap::effect::Effect;

/// Normal equations of a Gauss-Newton step in path, ballast, common shift and effects.
pub(super) struct Normal {
    /// Number of the path's unknowns, which come first.
    pub(super) path: usize,
    pub(super) hessian: Mat<f64>,
    pub(super) vector: Mat<f64>,
    pub(super) own: Vec<OwnShift>,
}

/// Own shift of one passage, eliminated from the equations: its precision, what couples it to the others, its right side.
pub(super) struct OwnShift {
    precision: f64,
    coupling: Mat<f64>,
    value: f64,
}

/// Changes of path, ballast, common shift, effects, and the own shifts, metres.
pub(super) struct Step {
    pub(super) joint: Mat<f64>,
    pub(super) own_m: Vec<f64>,
}

impl Normal {
    /// Step with the curvature along the path's unknowns, and along the others, larger by the parts `damping`.
    pub(super) fn step(&self, damping: [f64; 2]) -> Result<Step, GapError> {
        let n = self.hessian.nrows();
        let on_diagonal = |i: usize| 1.0 + damping[usize::from(i >= self.path)].max(1e-10);
        let ridge =
            Mat::from_fn(n, n, |i, j| self.hessian[(i, j)] * if i == j { on_diagonal(i) } else { 1.0 });
        let factor = ridge
            .llt(faer::Side::Lower)
            .map_err(|_| GapError::Singular { what: "the joint fit of path, ballast and effects" })?;
        let joint = factor.solve(&self.vector);
        let own_m = self.own.iter().map(|o| (o.value - dot(&o.coupling, &joint)) / o.precision).collect();
        Ok(Step { joint, own_m })
    }
}

pub(super) fn normal_equations(
    frame: &Frame,
    effects: &[&dyn Effect],
    state: &State,
    shape: &Shape,
    linear: &Linearised,
    subset: &[usize],
) -> Normal {
    let n = shape.len();
    let mut hessian: Mat<f64> = Mat::zeros(n, n);
    let mut vector: Mat<f64> = Mat::zeros(n, 1);
    let common = common_shift(state, subset);
    let precision_own = SHIFT_SD_M.1.powi(-2);
    let parts: Vec<(Mat<f64>, Mat<f64>, OwnShift)> = linear
        .passages
        .par_iter()
        .zip(&linear.own)
        .map(|(p, own)| {
            let mut gram = p.columns.transpose() * &p.columns;
            let mut right = p.columns.transpose() * &p.residual;
            let coupling = p.columns.transpose() * own;
            let precision = squared(own) + precision_own;
            let value = dot(own, &p.residual) - precision_own * (state.shift_m[p.index] - common);
            gram -= &coupling * coupling.transpose() * faer::Scale(1.0 / precision);
            right -= &coupling * faer::Scale(value / precision);
            (gram, right, OwnShift { precision, coupling, value })
        })
        .collect();
    for (gram, right, _) in &parts {
        hessian += gram;
        vector += right;
    }
    add_prior(frame, effects, state, shape, common, &mut hessian, &mut vector);
    Normal { path: shape.path, hessian, vector, own: parts.into_iter().map(|(.., own)| own).collect() }
}

pub(super) fn dot(a: &Mat<f64>, b: &Mat<f64>) -> f64 {
    crate::signal::dot(a.col_as_slice(0), b.col_as_slice(0))
}

fn squared(a: &Mat<f64>) -> f64 {
    dot(a, a)
}
