//! A dip in the stock rail opposite the crossing, (1 + cos)/2: a bad weld or a squat. The sensor sits on the other side, so
//! it shows through the sleeper and the rolling of the wheelset.

use crate::gap::effect::{Advice, Effect, Hints, MODEL_ERROR, Parameter, Scale, Stage};
use crate::gap::included::Inclusion;
use crate::gap::world::World;

/// See the module.
pub struct StockIrregularity;

const PARAMETERS: [Parameter; 3] = [
    Parameter {
        name: "depth_m",
        scale: Scale::Linear,
        unit_size: 0.3e-3,
        prior: (0.0, 4.0),
        // A weld may stand proud by a millimetre, not by three: that was a fit to the scan of another crossing.
        range: [-4.0, 16.0],
        step: 0.2,
        least: 0.0,
        model_error: MODEL_ERROR,
        nuisance: false,
    },
    Parameter {
        name: "at_x_m",
        scale: Scale::Linear,
        unit_size: 1.0,
        prior: (0.0, 1.2),
        range: [-3.0, 3.0],
        step: 0.02,
        least: 0.0,
        model_error: MODEL_ERROR,
        nuisance: false,
    },
    Parameter {
        name: "length_m",
        scale: Scale::Log,
        unit_size: 0.4,
        prior: (0.0, 0.6),
        range: [-1.7, 1.4],
        step: 0.1,
        least: 0.0,
        model_error: MODEL_ERROR,
        nuisance: true,
    },
];

impl Effect for StockIrregularity {
    fn name(&self) -> &'static str {
        "stock-irregularity"
    }

    fn stage(&self) -> Stage {
        Stage::Geometry
    }

    fn advice(&self) -> Advice {
        Advice {
            what: "the stock rail has a dip opposite the crossing",
            action: "Inspect the stock rail there for a bad weld or a squat; grind or weld it.",
        }
    }

    /// Every wheel's force and both rails' profiles are estimated anyway.
    fn inclusion(&self) -> Inclusion {
        Inclusion::NEEDLESS
    }

    fn parameters(&self) -> &'static [Parameter] {
        &PARAMETERS
    }

    fn starts(&self, _hints: &Hints) -> Vec<Vec<f64>> {
        // Half a dip apart as well, and as deep as some are: the screening doubts what is many times its start.
        (-8..=8).map(|k| vec![1.0, 0.25 * f64::from(k), 0.0]).collect()
    }

    fn far_starts(&self, _hints: &Hints) -> Vec<Vec<f64>> {
        // Off a dip of 2.9 mm wheels jump, so that it agrees with the recordings within 0.05 m of its place only: neither shallow ones
        // nor such a one 0.2 m away lead there.
        let at = |depth: f64| (-18..=18).map(move |k| vec![depth, 0.1 * f64::from(k), 0.0]);
        at(3.0).chain(at(6.0)).chain(at(9.5)).collect()
    }

    fn apply(&self, world: &mut World, values: &[f64]) {
        world.path.stock_dip = Some([values[0], values[1], values[2]]);
    }
}
