//! Resonance of the sensor's mounting: a second-order system between sleeper and transducer.
//!
//! Glued mounts resonate above 1 kHz, which is no fault; brackets and magnets at some hundred hertz reach into the band.

use crate::gap::effect::{Advice, Effect, Hints, MODEL_ERROR, Parameter, Scale, Stage};
use crate::gap::included::{How, Inclusion};
use crate::gap::world::World;
use crate::recording::Passage;
use crate::signal::filtered;

/// See the module.
pub struct MountResonance;

const PARAMETERS: [Parameter; 2] = [
    Parameter {
        name: "frequency_hz",
        scale: Scale::Log,
        unit_size: 400.0,
        prior: (0.0, 0.6),
        // Up to 800 Hz: at the end of its range it stands for something else, as above a transducer that clips.
        range: [-1.2, 0.69],
        step: 0.03,
        least: 0.0,
        model_error: MODEL_ERROR,
        nuisance: false,
    },
    Parameter {
        name: "damping_ratio",
        scale: Scale::Log,
        unit_size: 0.1,
        prior: (0.0, 0.8),
        range: [-2.5, 1.8],
        step: 0.1,
        least: 0.0,
        model_error: MODEL_ERROR,
        nuisance: false,
    },
];

impl Effect for MountResonance {
    fn name(&self) -> &'static str {
        "mount-resonance"
    }

    fn stage(&self) -> Stage {
        Stage::Sensor
    }

    fn advice(&self) -> Advice {
        Advice {
            what: "the sensor's mount resonates",
            action: "Fasten the sensor anew, glued or bolted to clean concrete without a bracket. Forces above that frequency are wrong until then.",
        }
    }

    /// What it does above its resonance is lost.
    fn inclusion(&self) -> Inclusion {
        let how = How::Recorded(|site, effect| {
            let frequency_hz = effect.value("frequency_hz", [20.0, 5000.0])?;
            let damping = effect.value("damping_ratio", [1e-3, 2.0])?;
            site.passages.iter_mut().for_each(|p| without_mount(p, frequency_hz, damping));
            Ok(())
        });
        Inclusion { does: None, how }
    }

    fn parameters(&self) -> &'static [Parameter] {
        &PARAMETERS
    }

    fn starts(&self, _hints: &Hints) -> Vec<Vec<f64>> {
        vec![vec![0.6, 1.0], vec![0.4, 0.5]]
    }

    fn far_starts(&self, hints: &Hints) -> Vec<Vec<f64>> {
        // From above, a lost model does not lead down to a light mount's resonance: 450, 300 and 230 Hz.
        let within = [vec![0.12, 0.0], vec![-0.29, 0.0], vec![-0.55, 0.0]];
        self.starts(hints).into_iter().chain(within).collect()
    }

    fn apply(&self, world: &mut World, values: &[f64]) {
        world.sensor.mount = Some((values[0], values[1]));
    }
}

/// Takes the amplification by the mounting back; its inverse is bounded, so nothing blows up.
fn without_mount(passage: &mut Passage, frequency_hz: f64, damping: f64) {
    let samples: Vec<f64> = passage.acceleration_m_s2.iter().map(|a| f64::from(*a)).collect();
    let restored = filtered(&samples, passage.sample_rate_hz, |f| {
        // Far above the resonance the mounting isolates; what is there is left as it is.
        let s = (f / frequency_hz).min(3.0);
        let damped = faer::c64::new(0.0, 2.0 * damping * s);
        (damped + (1.0 - s * s)) / (damped + 1.0)
    });
    passage.acceleration_m_s2 = restored.iter().map(|a| *a as f32).collect();
}
