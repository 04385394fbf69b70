//! A recorder clock that is fast or slow by a constant part.
//!
//! Everything in time is stretched: the speed comes out wrong by as much, so positions stay right, but frequencies of track
//! and wheel do not. Where the operator states speeds (1 % each, unbiased), they alone tell it (`diagnosis/recorder.rs`): ballast
//! and path take over most of what it does to the recordings. Range: a broken crystal or a wrong divider.

use crate::gap::effect::{Advice, Effect, Parameter, Scale, Stage, Witness};
use crate::gap::world::World;

/// See the module.
pub struct ClockError;

const PARAMETERS: [Parameter; 1] = [Parameter {
    name: "relative",
    scale: Scale::Linear,
    unit_size: 0.01,
    prior: (0.0, 1.5),
    range: [-8.0, 8.0],
    step: 0.2,
    least: 0.0,
    model_error: 0.15,
    nuisance: false,
}];

impl Effect for ClockError {
    fn name(&self) -> &'static str {
        "clock-error"
    }

    fn stage(&self) -> Stage {
        Stage::Timing
    }

    fn advice(&self) -> Advice {
        Advice {
            what: "the recorder's clock is fast or slow",
            action: "Set or replace the recorder's clock.",
        }
    }

    fn parameters(&self) -> &'static [Parameter] {
        &PARAMETERS
    }

    fn nought(&self) -> Option<Vec<f64>> {
        Some(vec![0.0])
    }

    fn witness(&self) -> Witness {
        Witness::OperatorSpeeds
    }

    fn apply(&self, world: &mut World, values: &[f64]) {
        world.sensor.clock_error = values[0];
    }
}
