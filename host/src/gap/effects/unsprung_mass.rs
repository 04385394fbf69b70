//! Wheelsets heavier or lighter than in the description: other wheels, axle-mounted drives (a driven wheelset weighs up to
//! twice a trailing one).

use crate::gap::effect::{Advice, Effect, MODEL_ERROR, Parameter, Scale, Stage};
use crate::gap::included::{FACTOR, Inclusion};
use crate::gap::world::World;

/// See the module.
pub struct UnsprungMass;

const PARAMETERS: [Parameter; 1] = [Parameter {
    name: "factor",
    scale: Scale::Log,
    unit_size: 1.0,
    prior: (0.0, 0.3),
    range: [-1.0, 1.0],
    step: 0.04,
    least: 0.06,
    model_error: MODEL_ERROR,
    nuisance: false,
}];

impl Effect for UnsprungMass {
    fn name(&self) -> &'static str {
        "unsprung-mass"
    }

    fn stage(&self) -> Stage {
        Stage::Vehicle
    }

    fn advice(&self) -> Advice {
        Advice {
            what: "wheelsets are heavier or lighter than described",
            action: "Nothing to repair. Compare wheelset_mass_kg with the vehicle's data: driven wheelsets weigh up to twice as much.",
        }
    }

    fn inclusion(&self) -> Inclusion {
        Inclusion::corrected("Forces: `--with-effects` uses the mass found.", |site, effect| {
            let (factor, vehicle) = (effect.value("factor", FACTOR)?, &mut site.crossing.vehicle);
            vehicle.wheelset_mass_kg *= factor;
            vehicle.wheelset_roll_inertia_kg_m2 *= factor;
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
        world.wheels.unsprung *= values[0];
    }
}
