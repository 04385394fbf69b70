//! Low stiffness outside the ±2 sleepers that the calibration resolves: sleepers 3 to 6 on either side.
//!
//! A factor on the stiffness on the side of negative and of positive x; 1 is the outer stiffness p1.

use crate::gap::effect::{Advice, Effect, MODEL_ERROR, Parameter, Scale, Stage};
use crate::gap::included::{FACTOR, Inclusion};
use crate::gap::world::World;

/// See the module.
pub struct SupportLoss;

const PARAMETERS: [Parameter; 2] = [
    Parameter {
        name: "factor_negative_x",
        scale: Scale::Log,
        unit_size: 1.0,
        prior: (0.0, 0.8),
        range: [-3.0, 1.0],
        step: 0.1,
        least: 0.0,
        model_error: MODEL_ERROR,
        nuisance: false,
    },
    Parameter {
        name: "factor_positive_x",
        scale: Scale::Log,
        unit_size: 1.0,
        prior: (0.0, 0.8),
        range: [-3.0, 1.0],
        step: 0.1,
        least: 0.0,
        model_error: MODEL_ERROR,
        nuisance: false,
    },
];

impl Effect for SupportLoss {
    fn name(&self) -> &'static str {
        "support-loss"
    }

    fn stage(&self) -> Stage {
        Stage::Track
    }

    fn advice(&self) -> Advice {
        Advice {
            what: "sleepers beside the crossing have lost support",
            action: "Inspect sleepers 3 to 6 on the side with the low factor, and tamp them.",
        }
    }

    fn inclusion(&self) -> Inclusion {
        Inclusion::corrected("Forces: `--with-effects` uses the supports found.", |site, effect| {
            let sides =
                [effect.value("factor_negative_x", FACTOR)?, effect.value("factor_positive_x", FACTOR)?];
            site.crossing.ballast.support_factor = factors(sides);
            Ok(())
        })
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
        world.crossing.ballast.support_factor = factors([values[0], values[1]]);
    }
}

/// Factor of every sleeper concerned, counted from the crossing sleeper, from those on the side of negative and of positive
/// x.
pub fn factors([negative, positive]: [f64; 2]) -> Vec<(i64, f64)> {
    (3..=6).flat_map(|k| [(-k, negative), (k, positive)]).collect()
}
