//! Front and rear wheelset of a bogie load and excite differently: braking, bogie pitch, steering.
//!
//! Differences are front minus rear over their mean. Breaks the paper's assumption that both have the same force
//! (section 4.2).

use crate::gap::effect::{Advice, Effect, MODEL_ERROR, Parameter, Scale, Stage};
use crate::gap::included::Inclusion;
use crate::gap::world::World;

/// See the module.
pub struct FrontRear;

const PARAMETERS: [Parameter; 2] = [
    Parameter {
        name: "depth_difference",
        scale: Scale::Linear,
        unit_size: 0.1,
        prior: (0.0, 3.0),
        range: [-18.0, 18.0],
        step: 0.2,
        least: 0.3,
        model_error: MODEL_ERROR,
        nuisance: false,
    },
    Parameter {
        name: "load_difference",
        scale: Scale::Linear,
        unit_size: 0.1,
        prior: (0.0, 1.0),
        range: [-9.0, 9.0],
        step: 0.2,
        least: 0.0,
        model_error: MODEL_ERROR,
        nuisance: false,
    },
];

impl Effect for FrontRear {
    fn name(&self) -> &'static str {
        "front-rear"
    }

    fn stage(&self) -> Stage {
        Stage::Vehicle
    }

    fn advice(&self) -> Advice {
        Advice {
            what: "front and rear wheelsets of a bogie load the crossing differently",
            action: "Nothing to repair on the panel. Ask the operator whether trains brake there, and about the vehicles.",
        }
    }

    /// Every wheel's force and both rails' profiles are estimated anyway.
    fn inclusion(&self) -> Inclusion {
        Inclusion::NEEDLESS
    }

    fn parameters(&self) -> &'static [Parameter] {
        &PARAMETERS
    }

    fn nought(&self) -> Option<Vec<f64>> {
        Some(vec![0.0, 0.0])
    }

    fn sizes(&self) -> usize {
        2
    }

    fn apply(&self, world: &mut World, values: &[f64]) {
        for (axle, sign) in [(0, 0.5), (1, -0.5)] {
            world.wheels.depth[axle] *= 1.0 + sign * values[0];
            for load in &mut world.wheels.load[axle] {
                *load *= 1.0 + sign * values[1];
            }
        }
    }
}
