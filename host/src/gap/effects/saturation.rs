//! A transducer whose range is smaller than stated: it clips before the recorder's low-pass.
//!
//! The recordings show it themselves: most of them end at the same value, with flat tops there ([`flat_top_m_s2`]). Only
//! where few clip does the search find it, from the largest value on.

use crate::gap::effect::{Effect, Hints, MODEL_ERROR, Parameter, Scale, Stage};
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
    least: 0.0,
    model_error: MODEL_ERROR,
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

/// Samples this near the largest count as flat top, relative.
const NEAR: f64 = 0.03;
/// Samples at the top in a recording that clips; without, one or two are there by chance.
const LEAST_SAMPLES: usize = 12;

/// Range of a transducer that clips: most recordings end at the same value and stay there. Needs no model.
pub fn flat_top_m_s2(site: &crate::recording::Site) -> Option<f64> {
    let largest =
        |p: &crate::recording::Passage| p.acceleration_m_s2.iter().fold(0.0_f32, |m, a| m.max(a.abs()));
    let top = site.passages.iter().map(largest).fold(0.0_f32, f32::max);
    let flat = |p: &&crate::recording::Passage| {
        let near = |a: &&f32| f64::from(a.abs()) > (1.0 - NEAR) * f64::from(top);
        p.acceleration_m_s2.iter().filter(near).count() >= LEAST_SAMPLES
    };
    let clipped = site.passages.iter().filter(flat).count();
    (2 * clipped > site.passages.len()).then_some(f64::from(top))
}
