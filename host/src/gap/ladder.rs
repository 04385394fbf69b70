//! The substitution ladder: what predicts the held-out passages, one stage after the other put in the place of what is known
//! of it beforehand. The step that takes most off the residual is the stage that mattered.

use super::GapError;
use super::fit::{Frame, simulate};
use super::measure::{Prediction, prediction, residual_ratios};
use super::world::World;
use crate::ballast::BallastParameters;
use crate::passage::Profile;

/// One model and what it leaves of the held-out passages, RMS relative to the signal.
#[derive(Clone, Debug, PartialEq)]
pub struct Rung {
    /// What stands in the place of what.
    pub model: &'static str,
    /// Of the acceleration below 250 Hz.
    pub acceleration: f64,
    /// Of the displacement; `None` where it was not compared.
    pub displacement: Option<f64>,
}

/// From the drawing to the node's arithmetic. `held_out` has the base model's and the corrected model's predictions;
/// `node_gap` is what the node's arithmetic alone makes.
pub fn ladder(
    frame: &Frame,
    test: &[usize],
    held_out: &[Prediction],
    has_scan: bool,
    node_gap: Option<f64>,
) -> Result<Vec<Rung>, GapError> {
    let nominal = World { ballast: BallastParameters::NOMINAL, ..frame.base.clone() };
    let mut level = nominal.clone();
    level.path.scan = Profile::level();
    let mut out = vec![simulated("level rail, nominal ballast", frame, test, &level)?];
    if has_scan {
        out.push(simulated("geometry: the laser scan", frame, test, &nominal)?);
    }
    let [before, after, floor] = residual_ratios(held_out);
    out.push(rung("ballast and path: calibrated (base model)", before));
    out.push(rung("effects: those named (corrected model)", after));
    if let Some(node) = node_gap {
        out.push(Rung {
            model: "arithmetic: the node's codes, f32 and decimation",
            acceleration: after[0].hypot(node),
            displacement: None,
        });
    }
    out.push(rung("what differs from wheel to wheel (noise floor)", floor));
    Ok(out)
}

fn simulated(model: &'static str, frame: &Frame, test: &[usize], world: &World) -> Result<Rung, GapError> {
    let responses = simulate(world, frame, test)?;
    let predicted: Vec<Prediction> =
        test.iter().zip(&responses).map(|(i, r)| prediction(frame, *i, (world, r), &[])).collect();
    let [_, corrected, _] = residual_ratios(&predicted);
    Ok(rung(model, corrected))
}

fn rung(model: &'static str, [acceleration, displacement]: [f64; 2]) -> Rung {
    Rung { model, acceleration, displacement: Some(displacement) }
}
