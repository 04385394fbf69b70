//! Linear screening: what effects would add to a fit, from one simulation of each.

use faer::Mat;
use faer::linalg::solvers::Solve as _;
use rayon::prelude::*;

use super::nearby::Nearby;
use super::normal::normal_equations;
use super::{Evaluation, Frame, Linearised, Shape, State, derivatives, mean_windows, values, whiten};
use crate::gap::GapError;
use crate::gap::effect::{Effect, Hints};
use crate::gap::forward::Detail;

/// Direction in which an effect, or the difference that a start value makes, moves the passages.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Direction {
    /// Which of the effects.
    pub effect: usize,
    /// Which parameter, for effects that begin smoothly at nought.
    pub parameter: Option<usize>,
    /// Which start otherwise.
    pub start: usize,
}

/// Information on the directions of a list of effects, the base model's own unknowns eliminated.
pub struct Screening {
    /// Order of rows and columns.
    pub directions: Vec<Direction>,
    /// Information matrix without the directions' priors.
    pub information: Mat<f64>,
    /// Information vector.
    pub vector: Mat<f64>,
    /// Prior standard deviation of each direction's coefficient.
    pub prior_sd: Vec<f64>,
}

/// Linear screening of `candidates` around a fit with `accepted` effects.
pub fn screen(
    frame: &Frame,
    (accepted, state): (&[&dyn Effect], &State),
    candidates: &[&dyn Effect],
    hints: &Hints,
    subset: &[usize],
) -> Result<Screening, GapError> {
    let here = Evaluation::new(frame, accepted, state, (subset, Detail::Full))?;
    let base = derivatives(frame, accepted, state, subset, &here)?;
    let mut directions = Vec::new();
    let mut variants: Vec<(Vec<f64>, f64)> = Vec::new();
    let mut prior_sd = Vec::new();
    for (e, effect) in candidates.iter().enumerate() {
        match effect.nought() {
            Some(nought) => {
                for (k, p) in effect.parameters().iter().enumerate() {
                    let mut moved = nought.clone();
                    moved[k] += p.step;
                    directions.push(Direction { effect: e, parameter: Some(k), start: 0 });
                    variants.push((moved, p.step));
                    prior_sd.push(p.prior.1);
                }
            }
            None => {
                for (start, coordinates) in effect.starts(hints).into_iter().enumerate() {
                    directions.push(Direction { effect: e, parameter: None, start });
                    variants.push((coordinates, 1.0));
                    prior_sd.push(1.0);
                }
            }
        }
    }
    let nearby = Nearby::of(frame, subset, here.detail);
    let columns: Vec<Vec<Vec<f64>>> = directions
        .par_iter()
        .zip(&variants)
        .map(|(d, (coordinates, step))| {
            let mut world = state.world(frame, accepted);
            let effect = candidates[d.effect];
            effect.apply(&mut world, &values(effect, coordinates));
            let shifts = (&state.shift_m[..], 0.0);
            let predicted = match effect.simulated() {
                true => {
                    let responses = nearby.responses(&world, &here.responses)?;
                    mean_windows(frame, &world, &responses, subset, shifts)
                }
                false => mean_windows(frame, &world, &here.responses, subset, shifts),
            };
            Ok(predicted
                .iter()
                .zip(&here.predicted)
                .map(|(a, b)| a.iter().zip(b).map(|(a, b)| (a - b) / step).collect())
                .collect())
        })
        .collect::<Result<_, GapError>>()?;
    let both: Vec<Mat<f64>> = (0..subset.len())
        .map(|p| {
            let b = &base[p];
            Mat::from_fn(b.nrows(), b.ncols() + columns.len(), |k, c| {
                if c < b.ncols() { b[(k, c)] } else { columns[c - b.ncols()][p][k] }
            })
        })
        .collect();
    let linear = whiten(frame, subset, &both, &here);
    let (information, vector) = reduced(frame, accepted, state, subset, &linear, columns.len())?;
    Ok(Screening { directions, information, vector, prior_sd })
}

/// Information on the last `extra` columns with everything before them eliminated.
fn reduced(
    frame: &Frame,
    accepted: &[&dyn Effect],
    state: &State,
    subset: &[usize],
    linear: &Linearised,
    extra: usize,
) -> Result<(Mat<f64>, Mat<f64>), GapError> {
    let own_effects: usize = accepted.iter().map(|e| e.parameters().len()).sum();
    let shape = Shape::of(frame, own_effects + extra);
    let normal = normal_equations(frame, accepted, state, &shape, linear, subset);
    let (n, m) = (shape.len(), shape.len() - extra);
    let h = &normal.hessian;
    let block = |r: std::ops::Range<usize>, c: std::ops::Range<usize>| {
        Mat::from_fn(r.len(), c.len(), |i, j| h[(r.start + i, c.start + j)])
    };
    let (bb, be, ee) = (block(0..m, 0..m), block(0..m, m..n), block(m..n, m..n));
    let factor = bb
        .llt(faer::Side::Lower)
        .map_err(|_| GapError::Singular { what: "the base model around its fit" })?;
    let information = &ee - be.transpose() * factor.solve(&be);
    let right = Mat::from_fn(m, 1, |i, _| normal.vector[(i, 0)]);
    let own = Mat::from_fn(extra, 1, |i, _| normal.vector[(m + i, 0)]);
    let vector = &own - be.transpose() * factor.solve(&right);
    Ok((information, vector))
}
