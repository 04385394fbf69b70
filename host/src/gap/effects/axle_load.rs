//! All axles heavier or lighter than the operator says.
//!
//! Everything scales, the excitation by the crossing apart; passenger load changes a coach by up to a sixth.

use crate::gap::effect::{Advice, Effect, MODEL_ERROR, Parameter, Scale, Stage};
use crate::gap::included::{FACTOR, Inclusion};
use crate::gap::world::World;

/// See the module.
pub struct AxleLoad;

const PARAMETERS: [Parameter; 1] = [Parameter {
    name: "factor",
    scale: Scale::Log,
    unit_size: 1.0,
    prior: (0.0, 0.12),
    range: [-0.6, 0.6],
    step: 0.02,
    least: 0.04,
    model_error: MODEL_ERROR,
    nuisance: false,
}];

impl Effect for AxleLoad {
    fn name(&self) -> &'static str {
        "axle-load"
    }

    fn stage(&self) -> Stage {
        Stage::Vehicle
    }

    fn advice(&self) -> Advice {
        Advice {
            what: "trains are heavier or lighter than stated",
            action: "Nothing to repair. Compare axle_load_kg with the operator's data or a weighbridge.",
        }
    }

    fn inclusion(&self) -> Inclusion {
        Inclusion::corrected("Forces: `--with-effects` uses the load found.", |site, effect| {
            let factor = effect.value("factor", FACTOR)?;
            site.crossing.vehicle.axle_load_kg *= factor;
            site.passages.iter_mut().for_each(|p| p.axle_load_kg *= factor);
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
        for load in world.wheels.load.iter_mut().flatten() {
            *load *= values[0];
        }
    }
}
