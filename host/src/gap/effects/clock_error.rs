//! A recorder clock that is fast or slow by a constant part.
//!
//! Everything in time is stretched: the speed comes out wrong by as much, so positions stay right, but frequencies of track
//! and wheel do not. Where the operator states speeds (1 % each, unbiased), they alone tell it (`diagnosis/recorder.rs`): ballast
//! and path take over most of what it does to the recordings. Range: a broken crystal or a wrong divider.

use crate::gap::effect::{Advice, Effect, Parameter, Scale, Stage, Witness};
use crate::gap::included::{How, Inclusion};
use crate::gap::world::World;
use crate::recording::Passage;
use crate::signal::resample;

/// See the module.
pub struct ClockError;

const PARAMETERS: [Parameter; 1] = [Parameter {
    name: "relative",
    scale: Scale::Linear,
    unit_size: 0.01,
    prior: (0.0, 1.5),
    range: [-8.0, 8.0],
    step: 0.2,
    least: 0.0,
    model_error: 0.15,
    nuisance: false,
}];

impl Effect for ClockError {
    fn name(&self) -> &'static str {
        "clock-error"
    }

    fn stage(&self) -> Stage {
        Stage::Timing
    }

    fn advice(&self) -> Advice {
        Advice {
            what: "the recorder's clock is fast or slow",
            action: "Set or replace the recorder's clock.",
        }
    }

    fn inclusion(&self) -> Inclusion {
        let how = How::Recorded(|site, effect| {
            let relative = effect.value("relative", [-0.1, 0.1])?;
            site.passages.iter_mut().for_each(|p| to_true_time(p, relative));
            Ok(())
        });
        Inclusion {
            does: Some("Forces: `analyse --with-effects` takes the error out of the recordings."),
            how,
        }
    }

    fn parameters(&self) -> &'static [Parameter] {
        &PARAMETERS
    }

    fn nought(&self) -> Option<Vec<f64>> {
        Some(vec![0.0])
    }

    fn witness(&self) -> Witness {
        Witness::OperatorSpeeds
    }

    fn apply(&self, world: &mut World, values: &[f64]) {
        world.sensor.clock_error = values[0];
    }
}

/// Samples were taken (1 + relative) times as fast as stated; the same recording at the stated rate.
fn to_true_time(passage: &mut Passage, relative: f64) {
    let samples: Vec<f64> = passage.acceleration_m_s2.iter().map(|a| f64::from(*a)).collect();
    let len = (samples.len() as f64 / (1.0 + relative)).round().max(1.0) as usize;
    passage.acceleration_m_s2 = resample(&samples, len).iter().map(|a| *a as f32).collect();
}
