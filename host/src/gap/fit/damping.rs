//! Whether the damping of the ballast is as described, by the first step of a fit that has it unknown.

use super::normal::normal_equations;
use super::{Evaluation, Frame, Shape, State, derivatives, finish, whiten};
use crate::ballast::damping::Damping;
use crate::gap::GapError;
use crate::gap::forward::Detail;

/// What recordings say of the damping, around a state without effects; `frame` has it unknown.
pub fn damping(frame: &Frame, state: &State, subset: &[usize]) -> Result<Damping, GapError> {
    let here = Evaluation::new(frame, &[], state, (subset, Detail::Full))?;
    let linear = whiten(frame, subset, &derivatives(frame, &[], state, subset, &here)?, &here);
    let shape = Shape::of(frame, 0);
    let normal = normal_equations(frame, &[], state, &shape, &linear, subset);
    let change = normal.step([0.0; 2])?.joint;
    let fit = finish(frame, &[], state.clone(), &shape, linear, here.cost, subset)?;
    let k = shape.ballast - 1;
    let sd = (fit.inflation() * fit.covariance[(k, k)]).max(0.0).sqrt();
    Ok(Damping::new(change[(shape.path + k, 0)], sd))
}
