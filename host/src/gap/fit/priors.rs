//! What is assumed of a fit's unknowns before the recordings.

use faer::Mat;

use super::{Frame, Shape, State, lower_solve};
use crate::ballast::BallastParameters;
use crate::gap::effect::Effect;
use crate::track::Side;

/// Common and own position errors, metres.
pub(super) const SHIFT_SD_M: (f64, f64) = (0.05, 0.02);

/// Means and standard deviations of what is unknown of the ballast.
pub(super) fn ballast_priors(frame: &Frame) -> impl Iterator<Item = (f64, f64)> {
    BallastParameters::PRIOR.into_iter().take(frame.unknown.count())
}

/// Squares of the path's deviation per knot in units of its prior, crossing and stock side: about 1 or less when the path is
/// what the prior says.
pub(super) fn path_strain(frame: &Frame, state: &State) -> [f64; 2] {
    let white = whitened_deviation(frame, state);
    let knots = frame.base.path.deviation.knots();
    [Side::Crossing, Side::Stock].map(|side| {
        let squares = (0..knots.len()).filter(|k| knots[*k].0 == side).map(|k| white[(k, 0)].powi(2));
        let count = squares.clone().count();
        squares.sum::<f64>() / count.max(1) as f64
    })
}

/// The path's deviation in units of its prior, one column.
fn whitened_deviation(frame: &Frame, state: &State) -> Mat<f64> {
    let deviation = Mat::from_fn(state.deviation_m.len(), 1, |i, _| state.deviation_m[i]);
    lower_solve(&frame.deviation_root, &deviation)
}

pub(super) fn prior_cost(frame: &Frame, effects: &[&dyn Effect], state: &State, subset: &[usize]) -> f64 {
    let square = |v: f64, (mean, sd): (f64, f64)| 0.5 * ((v - mean) / sd).powi(2);
    let white = whitened_deviation(frame, state);
    let path: f64 = 0.5 * white.col_as_slice(0).iter().map(|v| v * v).sum::<f64>();
    let ballast: f64 = state.ballast.iter().zip(ballast_priors(frame)).map(|(v, p)| square(*v, p)).sum();
    let common = common_shift(state, subset);
    let shift: f64 = square(common, (0.0, SHIFT_SD_M.0))
        + subset.iter().map(|i| square(state.shift_m[*i] - common, (0.0, SHIFT_SD_M.1))).sum::<f64>();
    let parameters: f64 = effects
        .iter()
        .zip(&state.effects)
        .flat_map(|(e, c)| e.parameters().iter().zip(c))
        .map(|(p, c)| square(*c, p.prior))
        .sum();
    path + ballast + shift + parameters
}

pub(super) fn common_shift(state: &State, subset: &[usize]) -> f64 {
    let (common, own) = (SHIFT_SD_M.0.powi(-2), SHIFT_SD_M.1.powi(-2));
    let sum: f64 = subset.iter().map(|i| state.shift_m[*i]).sum();
    sum * own / (common + own * subset.len() as f64)
}

pub(super) fn add_prior(
    frame: &Frame,
    effects: &[&dyn Effect],
    state: &State,
    shape: &Shape,
    common: f64,
    information: &mut Mat<f64>,
    vector: &mut Mat<f64>,
) {
    let m = shape.path;
    let inverse_root = lower_solve(&frame.deviation_root, &Mat::identity(m, m));
    let precision = inverse_root.transpose() * &inverse_root;
    let deviation = Mat::from_fn(m, 1, |i, _| state.deviation_m[i]);
    let pull = &precision * &deviation;
    for j in 0..m {
        for i in 0..m {
            information[(i, j)] += precision[(i, j)];
        }
        vector[(j, 0)] -= pull[(j, 0)];
    }
    let mut add = |at: usize, value: f64, (mean, sd): (f64, f64)| {
        information[(at, at)] += sd.powi(-2);
        vector[(at, 0)] += (mean - value) * sd.powi(-2);
    };
    for (k, prior) in ballast_priors(frame).enumerate() {
        add(m + k, state.ballast[k], prior);
    }
    add(shape.common_shift(), common, (0.0, SHIFT_SD_M.0));
    let mut at = shape.first_effect();
    for (e, effect) in effects.iter().enumerate() {
        for (k, p) in effect.parameters().iter().enumerate() {
            add(at, state.effects[e][k], p.prior);
            at += 1;
        }
    }
}
