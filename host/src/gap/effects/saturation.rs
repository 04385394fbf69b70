//! A transducer whose range is smaller than stated: it clips before the recorder's low-pass.
//!
//! The range can only be near the largest value recorded, which is where the search starts.

use crate::gap::effect::{Effect, Hints, Parameter, Scale, Stage};
use crate::gap::world::World;

/// See the module.
pub struct Saturation;

const PARAMETERS: [Parameter; 1] = [Parameter {
    name: "range_m_s2",
    scale: Scale::Log,
    unit_size: 100.0,
    prior: (0.0, 1.0),
    range: [-3.0, 2.0],
    step: 0.05,
    nuisance: false,
}];

impl Effect for Saturation {
    fn name(&self) -> &'static str {
        "saturation"
    }

    fn stage(&self) -> Stage {
        Stage::Sensor
    }

    fn parameters(&self) -> &'static [Parameter] {
        &PARAMETERS
    }

    fn starts(&self, hints: &Hints) -> Vec<Vec<f64>> {
        vec![vec![(hints.largest_m_s2.max(1.0) / 100.0).ln()]]
    }

    fn apply(&self, world: &mut World, values: &[f64]) {
        world.sensor.range_m_s2 = Some(values[0]);
    }
}
