//! Rail pads that are stiffer or softer than designed: preload, temperature, age.
//!
//! Pads of one design spread by a factor of four between materials (EPDM 85, EVA 304 kN/mm) and lose half their stiffness
//! when hot.

use crate::gap::effect::{Advice, Effect, Parameter, Scale, Stage};
use crate::gap::included::{FACTOR, Inclusion};
use crate::gap::world::World;

/// See the module.
pub struct PadStiffness;

const PARAMETERS: [Parameter; 1] = [Parameter {
    name: "factor",
    scale: Scale::Log,
    unit_size: 1.0,
    prior: (0.0, 0.8),
    range: [-2.0, 2.2],
    step: 0.05,
    // Training trials without it: up to 0.11.
    least: 0.25,
    model_error: 0.1,
    nuisance: false,
}];

impl Effect for PadStiffness {
    fn name(&self) -> &'static str {
        "pad-stiffness"
    }

    fn stage(&self) -> Stage {
        Stage::Track
    }

    fn advice(&self) -> Advice {
        Advice {
            what: "rail pads are stiffer or softer than drawn",
            action: "Compare the pads with the drawing; replace worn or hardened ones.",
        }
    }

    fn inclusion(&self) -> Inclusion {
        Inclusion::corrected("Forces: `--with-effects` uses the stiffness found.", |site, effect| {
            site.crossing.pad.stiffness_n_m *= effect.value("factor", FACTOR)?;
            Ok(())
        })
    }

    fn parameters(&self) -> &'static [Parameter] {
        &PARAMETERS
    }

    fn nought(&self) -> Option<Vec<f64>> {
        Some(vec![0.0])
    }

    fn apply(&self, world: &mut World, values: &[f64]) {
        world.crossing.pad.stiffness_n_m *= values[0];
    }
}
