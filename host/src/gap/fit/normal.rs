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

    /// How much the cost falls by a step that is not damped, if the derivatives hold, nats.
    pub(super) fn promised(&self, straight: &Step) -> f64 {
        let own: f64 = self.own.iter().map(|o| o.value.powi(2) / o.precision).sum();
        0.5 * (dot(&straight.joint, &self.vector) + own)
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A cost that is quadratic in two unknowns and the own shift of one passage falls by what is promised, to its minimum.
    #[test]
    fn analytic_a_quadratic_cost_falls_by_what_is_promised() {
        let column = |values: [f64; 2]| Mat::from_fn(2, 1, |i, _| values[i]);
        let (curvature, coupling, right) = ([2.0, 3.0], column([1.0, 0.5]), column([1.0, 2.0]));
        let (precision, value) = (4.0, 2.0);
        let hessian = Mat::from_fn(2, 2, |i, j| {
            f64::from(u8::from(i == j)) * curvature[i] - coupling[(i, 0)] * coupling[(j, 0)] / precision
        });
        let vector = &right - &coupling * faer::Scale(value / precision);
        let own = vec![OwnShift { precision, coupling: coupling.clone(), value }];
        let normal = Normal { path: 1, hessian, vector, own };
        let step = normal.step([0.0; 2]).unwrap();
        let cost = |scale: f64| {
            let (x, own_m) = (&step.joint * faer::Scale(scale), scale * step.own_m[0]);
            let along = |i: usize| 0.5 * curvature[i] * x[(i, 0)].powi(2);
            along(0) + along(1) + own_m * dot(&coupling, &x) + 0.5 * precision * own_m.powi(2)
                - dot(&right, &x)
                - value * own_m
        };
        assert!(
            (cost(1.0) + normal.promised(&step)).abs() < 1e-9,
            "{} {}",
            cost(1.0),
            normal.promised(&step)
        );
        assert!(cost(0.99) > cost(1.0) && cost(1.01) > cost(1.0));
    }
}
