//! Static load shared unequally between the two rails: cant, curve, skew load. Positive loads the crossing side.

use crate::gap::effect::{Advice, Effect, MODEL_ERROR, Parameter, Scale, Stage};
use crate::gap::included::Inclusion;
use crate::gap::world::World;

/// A share of the load moved to the other rail; wheels stay on both.
const TRANSFER: [f64; 2] = [-0.9, 0.9];

/// See the module.
pub struct LoadTransfer;

const PARAMETERS: [Parameter; 1] = [Parameter {
    name: "fraction",
    scale: Scale::Linear,
    unit_size: 0.1,
    prior: (0.0, 1.0),
    range: [-5.0, 5.0],
    step: 0.2,
    least: 0.2,
    model_error: MODEL_ERROR,
    nuisance: false,
}];

impl Effect for LoadTransfer {
    fn name(&self) -> &'static str {
        "load-transfer"
    }

    fn stage(&self) -> Stage {
        Stage::Vehicle
    }

    fn advice(&self) -> Advice {
        Advice {
            what: "the two rails carry unequal loads",
            action: "Measure cant and twist at the crossing; lift and tamp where they are out of tolerance.",
        }
    }

    fn inclusion(&self) -> Inclusion {
        Inclusion::corrected("Forces: `--with-effects` uses the transfer found.", |site, effect| {
            site.crossing.track.load_transfer = effect.value("fraction", TRANSFER)?;
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
        for axle in &mut world.wheels.load {
            axle[0] *= 1.0 + values[0];
            axle[1] *= 1.0 - values[0];
        }
    }
}
