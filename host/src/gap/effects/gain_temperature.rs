//! Sensitivity of the sensor that depends on its temperature: a (1 + s (T − T₀)).
//!
//! Acts on all frequencies alike and follows the temperature from passage to passage. T₀ is unknown, so a constant gain goes
//! with it. Data sheets give up to 0.04 %/K; a failing bridge or a loose mount reaches ten times that.

use crate::gap::effect::{Advice, Effect, MODEL_ERROR, Parameter, Scale, Stage, Witness};
use crate::gap::included::Inclusion;
use crate::gap::world::{REFERENCE_C, World};

/// See the module.
pub struct GainTemperature;

const PARAMETERS: [Parameter; 2] = [
    Parameter {
        name: "per_kelvin",
        scale: Scale::Linear,
        unit_size: 1e-3,
        prior: (0.0, 3.0),
        range: [-20.0, 20.0],
        step: 1.0,
        least: 0.0,
        model_error: MODEL_ERROR,
        nuisance: false,
    },
    Parameter {
        name: "gain_at_20_c",
        scale: Scale::Linear,
        unit_size: 0.01,
        prior: (100.0, 3.0),
        range: [50.0, 200.0],
        step: 1.0,
        least: 0.0,
        model_error: MODEL_ERROR,
        nuisance: true,
    },
];

impl Effect for GainTemperature {
    fn name(&self) -> &'static str {
        "gain-temperature"
    }

    fn stage(&self) -> Stage {
        Stage::Sensor
    }

    fn advice(&self) -> Advice {
        Advice {
            what: "the sensor's sensitivity follows its temperature",
            action: "Calibrate or replace the sensor.",
        }
    }

    fn inclusion(&self) -> Inclusion {
        Inclusion::corrected(
            "Until then `--with-effects` takes the change out of the recordings.",
            |site, effect| {
                let per_kelvin = effect.value("per_kelvin", [-0.02, 0.02])?;
                for p in &mut site.passages {
                    let gain = 1.0 + per_kelvin * (p.temperature_c - REFERENCE_C);
                    p.acceleration_m_s2.iter_mut().for_each(|a| *a = (f64::from(*a) / gain) as f32);
                }
                Ok(())
            },
        )
    }

    fn parameters(&self) -> &'static [Parameter] {
        &PARAMETERS
    }

    fn nought(&self) -> Option<Vec<f64>> {
        Some(vec![0.0, 100.0])
    }

    fn simulated(&self) -> bool {
        false
    }

    fn witness(&self) -> Witness {
        Witness::Temperatures
    }

    fn apply(&self, world: &mut World, values: &[f64]) {
        world.sensor.gain_per_kelvin = values[0];
        world.sensor.gain = values[1];
    }
}
