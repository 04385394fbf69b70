//! Bending stiffness and mass of the crossing rail: factors on the nominal three times plain rail (paper, Table 1).

use crate::gap::effect::{Advice, Effect, MODEL_ERROR, Parameter, Scale, Stage};
use crate::gap::included::{FACTOR, Inclusion};
use crate::gap::world::World;

/// See the module.
pub struct CrossingRail;

const PARAMETERS: [Parameter; 2] = [
    Parameter {
        name: "stiffness_factor",
        scale: Scale::Log,
        unit_size: 1.0,
        prior: (0.0, 0.5),
        range: [-1.5, 1.5],
        step: 0.05,
        // reference-3 without it: 0.23.
        least: 0.25,
        model_error: MODEL_ERROR,
        nuisance: false,
    },
    Parameter {
        name: "mass_factor",
        scale: Scale::Log,
        unit_size: 1.0,
        prior: (0.0, 0.5),
        range: [-1.5, 1.5],
        step: 0.05,
        least: 0.0,
        model_error: MODEL_ERROR,
        nuisance: false,
    },
];

impl Effect for CrossingRail {
    fn name(&self) -> &'static str {
        "crossing-rail"
    }

    fn stage(&self) -> Stage {
        Stage::Track
    }

    fn advice(&self) -> Advice {
        Advice {
            what: "the crossing rail is stiffer or softer than drawn",
            action: "Compare the crossing with its drawing; where it is softer, look for cracks and loose fastenings.",
        }
    }

    fn inclusion(&self) -> Inclusion {
        Inclusion::corrected("Forces: `--with-effects` uses the rail found.", |site, effect| {
            let rail = &mut site.crossing.rail;
            rail.crossing_part_stiffness_factor *= effect.value("stiffness_factor", FACTOR)?;
            rail.crossing_part_mass_factor *= effect.value("mass_factor", FACTOR)?;
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

    /// Another section is stiffer and heavier at once. What had the drawing's stiffness and 0.41 to 4.3 times its mass stood for clipping,
    /// for voids and for chance (trials 18, 90, 97 and 117 of seed 44).
    fn telling(&self) -> usize {
        1
    }

    fn apply(&self, world: &mut World, values: &[f64]) {
        world.crossing.rail.crossing_part_stiffness_factor *= values[0];
        world.crossing.rail.crossing_part_mass_factor *= values[1];
    }
}
