//! Voided sleepers: a gap between sleeper and ballast, F = k max(0, w − gap).
//!
//! The gap closes under every axle; deflection has an intercept at zero load, and its edges are sharp. Sources: paper,
//! section 6.2 (6 mm deflection of Vad 131); a quadratic fall-off to the neighbours as for the stiffness (fig. 7).

use crate::gap::effect::{Advice, Effect, Hints, Parameter, Scale, Stage};
use crate::gap::included::{How, Inclusion, TAKEN_OFF};
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

    fn inclusion(&self) -> Inclusion {
        Inclusion { does: Some(TAKEN_OFF), how: How::Linearised("gap_m", [1e-5, 0.1]) }
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

/// The same over five sleepers, which keep some of their damping. Not in the catalogue: to name voids, the first form does, and the
/// rules on naming are set on it; to take a void off the recordings, its reach matters.
///
/// Gaps fall off as a raised cosine. known-voided-sleepers, its ballast put in, wants 0.72 to 0.84 and 0.25 to 0.28 of the deepest one
/// under the neighbours, which is half a width of three.
pub struct VoidOverFive;

const PARAMETERS_OVER_FIVE: [Parameter; 2] = [
    PARAMETERS[0],
    Parameter {
        name: "half_width_sleepers",
        prior: (3.0, 0.3),
        // In between the outer sleepers hang, and the next ones do not.
        range: [2.5, 3.8],
        ..PARAMETERS[1]
    },
];

/// Part of the bed's damping that stays where a sleeper hangs. Without it sleepers swing between the bogies by twice what they do on
/// known-voided-sleepers (void and ballast put in, 16 % of the displacement are missed between 6 and 20 Hz; 6 % with 0.03, 8 % with
/// 0.05, and 5 % on a reference site, which has no void).
const CRIB_DAMPING: f64 = 0.03;

impl Effect for VoidOverFive {
    fn name(&self) -> &'static str {
        VoidedSleepers.name()
    }

    fn stage(&self) -> Stage {
        VoidedSleepers.stage()
    }

    fn advice(&self) -> Advice {
        VoidedSleepers.advice()
    }

    fn inclusion(&self) -> Inclusion {
        VoidedSleepers.inclusion()
    }

    fn parameters(&self) -> &'static [Parameter] {
        &PARAMETERS_OVER_FIVE
    }

    fn starts(&self, hints: &Hints) -> Vec<Vec<f64>> {
        let width = PARAMETERS_OVER_FIVE[1].prior.0;
        VoidedSleepers.starts(hints).iter().map(|start| vec![start[0], width]).collect()
    }

    fn apply(&self, world: &mut World, values: &[f64]) {
        let (gap_m, half_width) = (values[0], values[1]);
        let share = |offset: i64| 0.5 * (1.0 + (std::f64::consts::PI * offset as f64 / half_width).cos());
        world.bed.gap_m = (-2..=2).map(|offset| (offset, share(offset) * gap_m)).collect();
        world.bed.crib_damping = CRIB_DAMPING;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ballast::BallastParameters;
    use crate::gap::base::nominal_world;
    use crate::recording::read_site;
    use std::path::Path;

    #[test]
    fn analytic_a_raised_cosine_of_half_a_width_of_three() {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field/reference-1");
        let mut world = nominal_world(&read_site(&dir).unwrap(), BallastParameters::NOMINAL).unwrap();
        VoidOverFive.apply(&mut world, &[0.8e-3, 3.0]);
        for ((offset, gap_m), expected) in
            world.bed.gap_m.iter().zip([0.2e-3, 0.6e-3, 0.8e-3, 0.6e-3, 0.2e-3])
        {
            assert!((gap_m - expected).abs() < 1e-12, "{offset}: {gap_m}");
        }
    }
}
