//! Voided sleepers: a gap between sleeper and ballast, F = k max(0, w − gap).
//!
//! The gap closes under every axle; deflection has an intercept at zero load, and its edges are sharp. Sources: paper,
//! section 6.2 (6 mm deflection of Vad 131); a quadratic fall-off to the neighbours as for the stiffness (fig. 7).

use crate::gap::effect::{Advice, Effect, Hints, Parameter, Scale, Stage};
use crate::gap::world::World;

/// See the module.
pub struct VoidedSleepers;

/// Gaps: from what settles within a tamping cycle to the several millimetres seen in practice.
const PARAMETERS: [Parameter; 2] = [
    Parameter {
        name: "gap_m",
        scale: Scale::Log,
        unit_size: 1e-3,
        prior: (0.0, 1.0),
        range: [-2.5, 2.3],
        step: 0.05,
        least: 0.0,
        model_error: 0.3,
        nuisance: false,
    },
    Parameter {
        name: "neighbour_share",
        scale: Scale::Linear,
        unit_size: 1.0,
        prior: (0.5, 0.3),
        range: [0.0, 1.0],
        step: 0.05,
        least: 0.0,
        model_error: 0.3,
        nuisance: true,
    },
];

impl Effect for VoidedSleepers {
    fn name(&self) -> &'static str {
        "voided-sleepers"
    }

    fn stage(&self) -> Stage {
        Stage::Track
    }

    fn advice(&self) -> Advice {
        Advice {
            what: "sleepers hang above their ballast",
            action: "Tamp or stone-blow the crossing sleeper and its neighbours, and measure again when trains have settled them.",
        }
    }

    fn parameters(&self) -> &'static [Parameter] {
        &PARAMETERS
    }

    fn starts(&self, _hints: &Hints) -> Vec<Vec<f64>> {
        [0.15e-3, 0.5e-3, 1.2e-3, 3e-3].map(|gap: f64| vec![(gap / 1e-3).ln(), 0.5]).to_vec()
    }

    fn apply(&self, world: &mut World, values: &[f64]) {
        let (gap, share) = (values[0], values[1]);
        world.bed.gap_m = vec![(-1, share * gap), (0, gap), (1, share * gap)];
    }
}
