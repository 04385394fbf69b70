//! A transducer whose range is smaller than stated: it clips before the recorder's low-pass.
//!
//! The recordings show it themselves: values pile up at the range in most of them
//! ([`flat_top_m_s2`](crate::reconstruct::flat_top_m_s2)). Only where few clip does the search find it, from the largest value on.

use crate::gap::effect::{Advice, Effect, Hints, MODEL_ERROR, Parameter, Scale, Stage};
use crate::gap::included::Inclusion;
use crate::gap::world::World;
use crate::recording::{Passage, Site, Skipped};

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

    fn advice(&self) -> Advice {
        Advice {
            what: "the sensor clips below its stated range",
            action: "Fit a sensor with a larger range: force peaks are cut off.",
        }
    }

    fn inclusion(&self) -> Inclusion {
        Inclusion::corrected(
            "`--with-effects` leaves clipped recordings out while enough others stay.",
            |site, effect| {
                leave_out_clipped(site, effect.value("range_m_s2", [1.0, 1e4])?);
                Ok(())
            },
        )
    }

    fn parameters(&self) -> &'static [Parameter] {
        &PARAMETERS
    }

    fn starts(&self, hints: &Hints) -> Vec<Vec<f64>> {
        vec![vec![(hints.largest_m_s2.max(1.0) / 100.0).ln()]]
    }

    fn possible(&self, values: &[f64], hints: &Hints) -> bool {
        hints.largest_m_s2 < OVERSHOOT * values[0] + ON_TOP * hints.on_top_m_s2
    }

    fn apply(&self, world: &mut World, values: &[f64]) {
        world.sensor.range_m_s2 = Some(values[0]);
    }
}

/// Nothing this many times the range is recorded by what clips there: its low-pass overshoots by 6 %. Waves of wheels passed for
/// clipping at a quarter of the largest value, a void for clipping at four fifths of it.
const OVERSHOOT: f64 = 1.1;
/// How far beyond that interference and steps of the baseline are allowed for, times what is seen of them.
const ON_TOP: f64 = 2.0;

/// Passages that must stay for an identification.
const LEAST_PASSAGES: usize = 3;
/// Clipped samples that a recording may have: the corner of one wheel.
const FEW_SAMPLES: usize = 4;

/// Clipping cannot be undone: clipped recordings are left out while enough others stay, and marked otherwise.
fn leave_out_clipped(site: &mut Site, range_m_s2: f64) {
    let clipped = |p: &Passage| {
        let at_end = |a: &&f32| f64::from(a.abs()) >= 0.97 * range_m_s2;
        p.acceleration_m_s2.iter().filter(at_end).count() > FEW_SAMPLES
    };
    let sound = site.passages.iter().filter(|p| !clipped(p)).count();
    site.crossing.sensor.range_m_s2 = site.crossing.sensor.range_m_s2.min(range_m_s2);
    if sound >= LEAST_PASSAGES {
        let left_out = site.passages.iter().enumerate().filter(|(_, p)| clipped(p));
        site.skipped.extend(left_out.map(|(row, p)| Skipped {
            passage_id: Some(p.passage_id),
            row,
            reason: format!(
                "clipped at {range_m_s2:.1} m/s² (saturation is included); the others have the lower peaks"
            ),
        }));
        site.passages.retain(|p| !clipped(p));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Waves of 0.2 mm under the wheels passed for a range of 23.5 m/s² in recordings of up to 88, a void of 1 mm for one of 20.3 in
    /// recordings of up to 25.
    #[test]
    fn regress_a_range_below_what_is_recorded_is_none() {
        let hints = |largest_m_s2| Hints { largest_m_s2, on_top_m_s2: 0.1 };
        assert!(!Saturation.possible(&[23.5], &hints(88.0)));
        assert!(!Saturation.possible(&[20.3], &hints(25.0)));
        assert!(Saturation.possible(&[79.0], &hints(80.9)));
    }

    /// They were gone without a word.
    #[test]
    fn regress_clipped_recordings_that_are_left_out_are_listed() {
        let dir = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field/reference-1");
        let mut site = crate::recording::read_site(&dir).unwrap();
        let all = site.passages.len();
        leave_out_clipped(&mut site, 183.0);
        assert!(site.passages.len() < all && site.passages.len() >= LEAST_PASSAGES);
        assert_eq!(site.passages.len() + site.skipped.len(), all);
        assert!(site.skipped.iter().all(|s| s.reason.contains("clipped at 183.0")), "{:?}", site.skipped);
    }

    /// Steps of the baseline and interference come behind the transducer.
    #[test]
    fn property_what_the_recorder_adds_is_no_reason_against_a_range() {
        let hints = Hints { largest_m_s2: 95.0, on_top_m_s2: 8.0 };
        assert!(Saturation.possible(&[79.0], &hints));
    }
}
