//! Ballast that moves with the sleepers.
//!
//! A cone of ballast below a sleeper weighs as much as the sleeper itself (130 to 350 kg/m); the prior is of that
//! size.

use crate::gap::effect::{Advice, Effect, Hints, Parameter, Scale, Stage};
use crate::gap::included::Inclusion;
use crate::gap::world::World;

/// See the module.
pub struct BallastMass;

const PARAMETERS: [Parameter; 1] = [Parameter {
    name: "mass_kg_m",
    scale: Scale::Linear,
    unit_size: 50.0,
    prior: (0.0, 3.0),
    range: [0.0, 20.0],
    step: 0.2,
    least: 1.0,
    // Of 46 kg/m 38 are found.
    model_error: 0.2,
    nuisance: false,
}];

impl Effect for BallastMass {
    fn name(&self) -> &'static str {
        "ballast-mass"
    }

    fn stage(&self) -> Stage {
        Stage::Track
    }

    fn advice(&self) -> Advice {
        Advice { what: "ballast moves with the sleepers", action: "Nothing to repair." }
    }

    fn inclusion(&self) -> Inclusion {
        Inclusion::corrected("Forces: `--with-effects` includes the mass.", |site, effect| {
            // It moves with the sleeper and adds nothing to its stiffness.
            let s = &mut site.crossing.sleeper;
            s.density_kg_m3 += effect.value("mass_kg_m", [0.0, 2000.0])? / (s.width_m * s.height_m);
            Ok(())
        })
    }

    fn parameters(&self) -> &'static [Parameter] {
        &PARAMETERS
    }

    fn starts(&self, _hints: &Hints) -> Vec<Vec<f64>> {
        // A sleeper with much ballast on it has another resonance, which no small mass leads to.
        vec![vec![0.0], vec![4.0], vec![12.0]]
    }

    fn far_starts(&self, hints: &Hints) -> Vec<Vec<f64>> {
        self.starts(hints).into_iter().chain([vec![8.0], vec![18.0]]).collect()
    }

    fn nought(&self) -> Option<Vec<f64>> {
        Some(vec![0.0])
    }

    fn apply(&self, world: &mut World, values: &[f64]) {
        world.bed.mass_kg_m = values[0];
    }
}
