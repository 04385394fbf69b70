//! Ballast that stiffens under load, F = k w (1 + w/w₀): all sleepers.
//!
//! w₀ is the displacement at which the secant stiffness has doubled. The search runs over 1/w₀, which is nought without the effect.
//! Range: from where nothing is left of the effect to a tenth of a usual deflection (0.5 mm, paper fig. 12), beyond which a bed is
//! next to a stop. The prior bears a fifth of it: 1/w₀ of 10/mm is 2.5 standard deviations.

use crate::gap::effect::{Advice, Effect, Hints, MODEL_ERROR, Parameter, Scale, Stage};
use crate::gap::included::{How, Inclusion, TAKEN_OFF};
use crate::gap::world::World;

/// See the module.
pub struct BallastStiffening;

const PARAMETERS: [Parameter; 1] = [Parameter {
    name: "doubling_m",
    scale: Scale::Inverse,
    unit_size: 1e-3,
    prior: (0.0, 4.0),
    range: [0.0, 20.0],
    step: 0.05,
    least: 0.0,
    model_error: MODEL_ERROR,
    nuisance: false,
}];

impl Effect for BallastStiffening {
    fn name(&self) -> &'static str {
        "ballast-stiffening"
    }

    fn stage(&self) -> Stage {
        Stage::Track
    }

    fn advice(&self) -> Advice {
        Advice {
            what: "ballast stiffens under load",
            action: "Look for fouled or frozen ballast. Forces of trains of another load than these are less certain than stated.",
        }
    }

    fn inclusion(&self) -> Inclusion {
        Inclusion { does: Some(TAKEN_OFF), how: How::Linearised("doubling_m", [1e-5, 10.0]) }
    }

    fn parameters(&self) -> &'static [Parameter] {
        &PARAMETERS
    }

    fn nought(&self) -> Option<Vec<f64>> {
        Some(vec![0.0])
    }

    fn starts(&self, _hints: &Hints) -> Vec<Vec<f64>> {
        // Fits from a linear bed may stop halfway to one that is several times as stiff under a wheel.
        vec![vec![0.0], vec![5.0]]
    }

    fn apply(&self, world: &mut World, values: &[f64]) {
        // Beyond 10 m the bed is linear, and the simulation cheaper.
        world.bed.doubling_m = (values[0] < 10.0).then_some(values[0]);
    }
}
