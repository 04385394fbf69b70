//! What is known of the recorder before any search, and goes into the base model first: where its transducer clips, and how far
//! its clock is off.

use super::search::PROBABILITY_SCALE;
use super::{LEAST_GAIN, MOST_SURE, Named, Ranked, Session};
use crate::gap::effect::{Stage, Stated, Witness};
use crate::gap::fit::Frame;
use crate::gap::world::SensorModel;

/// Operator's speeds are within 1 % (uniform).
const OPERATOR_SD: f64 = 0.0058;
/// A clock counts as wrong when the mean of the operator's speeds says so by this many of its standard deviations.
const CLOCK_SPREAD: f64 = 4.0;
/// Half the width of a 90 % interval in standard deviations.
const NINETY: f64 = 1.645;

/// See [`crate::gap::effects::saturation`].
pub(super) const SATURATION: &str = "saturation";
const CLOCK_ERROR: &str = "clock-error";

/// What is known of the recorder, of the effects that are in the catalogue.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Recorder {
    /// Range of a transducer that clips, and how far it may be off, m/s².
    range_m_s2: Option<(f64, f64)>,
    /// Error of the clock by the operator's speeds, which may be nought, with its standard deviation; relative.
    clock: Option<(f64, f64)>,
}

impl Recorder {
    /// Of recordings with or without flat tops, and of the operator's speeds, which need no model.
    pub fn of(flat_top_m_s2: Option<(f64, f64)>, frame: &Frame, exclude: &[String]) -> Self {
        let left_in = |name: &str| !exclude.iter().any(|e| e == name);
        Self {
            range_m_s2: flat_top_m_s2.filter(|_| left_in(SATURATION)),
            clock: clock_by_operator(frame).filter(|_| left_in(CLOCK_ERROR)),
        }
    }

    /// The recorder as the base model takes it.
    pub fn sensor(&self) -> SensorModel {
        SensorModel {
            range_m_s2: self.range_m_s2.map(|(range, _)| range),
            clock_error: self.clock.filter(shows).map_or(0.0, |(mean, _)| mean),
            ..SensorModel::default()
        }
    }
}

/// Whether the operator's speeds show a wrong clock beyond chance.
pub(super) fn shows((mean, sd): &(f64, f64)) -> bool {
    mean.abs() > CLOCK_SPREAD * sd
}

/// Error of the recorder's clock by the operator's speeds, relative, with its standard deviation; `None` without speeds.
pub(super) fn clock_by_operator(frame: &Frame) -> Option<(f64, f64)> {
    let stated = frame.observed.iter().filter_map(|o| o.operator_m_s.map(|v| v / o.speed_m_s - 1.0));
    let errors: Vec<f64> = stated.collect();
    let (n, mean) = (errors.len() as f64, crate::signal::mean(&errors));
    let spread = (errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0)).sqrt();
    // Speeds that are worse than they should be say less.
    (!errors.is_empty()).then(|| (mean, spread.max(OPERATOR_SD) / n.sqrt()))
}

/// Nearer than this to the range values are counted as clipped, relative: the recorder's low-pass and the band of the comparison round
/// the tops.
const AT_RANGE: f64 = 0.9;
/// Part of the bogies' windows from which on what has been clipped off is most of what there was: the simulated sites that clip most
/// have 0.05, recordings cut off at a twentieth of their peaks 0.09.
const MOST_CLIPPED: f64 = 0.07;

impl Session<'_> {
    /// Whether so much is clipped that no effect could mend the model, whatever it were.
    pub(super) fn clips_most(&self) -> bool {
        let Some(range) = self.clips_at_m_s2 else { return false };
        let shares = self.base.frame.observed.iter().map(|o| o.share_above(AT_RANGE * range));
        crate::signal::mean(&shares.collect::<Vec<_>>()) > MOST_CLIPPED
    }

    /// Names what is known of the recorder and is in the base model already; what the operator's speeds tell is not searched for.
    pub(super) fn take(&mut self, recorder: &Recorder) {
        if let Some((range, within)) = recorder.range_m_s2 {
            self.known(SATURATION, Stage::Sensor, ("range_m_s2", range, range - within, range + within));
        }
        let Some((mean, sd)) = recorder.clock else { return };
        self.common.retain(|e| e.witness() != Witness::OperatorSpeeds);
        if shows(&(mean, sd)) {
            let half = NINETY * sd;
            self.known(CLOCK_ERROR, Stage::Timing, ("relative", mean, mean - half, mean + half));
        } else {
            let gain = 0.5 * (mean / sd).powi(2);
            self.rank_alone(
                CLOCK_ERROR,
                Stage::Timing,
                (((gain - LEAST_GAIN) / PROBABILITY_SCALE).exp(), gain),
            );
        }
    }

    fn known(&mut self, name: &'static str, stage: Stage, parameter: Stated) {
        let named = self.newly_named(name, stage);
        self.named.push(Named { probability: MOST_SURE, parameters: vec![parameter], ..named });
        self.rank_alone(name, stage, (MOST_SURE, f64::INFINITY));
    }

    fn rank_alone(&mut self, name: &'static str, stage: Stage, (probability, gain): (f64, f64)) {
        self.ranking.push(Ranked { name, stage, probability, gain, gap_after: f64::NAN });
    }
}
