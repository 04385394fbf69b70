//! What `analyse` finds out about a site: the structs that the results files and the report are written from.

mod budget;

use std::borrow::Cow;

use crate::identify::Misdescription;
use crate::limits::UNLIKE_MODEL;
use crate::recording::{Crossing, Scan, Skipped};

pub use self::budget::{Budget, Change, Consequence, Drawn, Outcome, Tolerance};

/// Everything known about one site after the analysis.
#[derive(Clone, Debug)]
pub struct Analysis {
    /// Site description.
    pub crossing: Crossing,
    /// Laser scan, where there is one, band-passed like the irregularities (for comparison only; never used in the
    /// identification).
    pub scan: Option<Scan>,
    /// Calibrated ballast.
    pub ballast: BallastEstimate,
    /// One per usable passage.
    pub passages: Vec<PassageResult>,
    /// Condition indicators over all passages.
    pub indicators: Indicators,
    /// What crossing.toml has otherwise than the recordings: then forces and irregularity mean nothing.
    pub misdescription: Option<Misdescription>,
    /// What follows of what crossing.toml may be wrong by, where that was asked for.
    pub budget: Option<Budget>,
    /// Effects of a diagnosis for which description and recordings were corrected before, in words with their sizes.
    pub effects_included: Vec<String>,
    /// Passages left out, each with its reason.
    pub skipped: Vec<Skipped>,
}

impl Analysis {
    /// Passages that the model explains and that are not, those left out before included.
    pub fn used_and_left_out(&self) -> (usize, usize) {
        let used = self.passages.iter().filter(|p| p.explained()).count();
        (used, self.passages.len() - used + self.skipped.len())
    }

    /// Whether its forces mean something: the panel is as described, and the model explains some of the passages.
    pub fn means_something(&self) -> bool {
        self.misdescription.is_none() && self.passages.iter().any(PassageResult::explained)
    }

    /// Wheelsets of the passages that the model explains.
    pub fn wheelsets(&self) -> usize {
        self.passages.iter().filter(|p| p.explained()).map(|p| p.wheelsets.len()).sum()
    }

    /// The same of the passages that the model explains alone; of all where it explains none.
    pub fn of_explained(&self) -> Cow<'_, Self> {
        if explained(&self.passages).len() == self.passages.len() {
            return Cow::Borrowed(self);
        }
        let mut some = self.clone();
        some.passages.retain(PassageResult::explained);
        Cow::Owned(some)
    }
}

/// Passages that the model explains; all where it explains none.
pub fn explained(passages: &[PassageResult]) -> Vec<&PassageResult> {
    let none = !passages.iter().any(PassageResult::explained);
    passages.iter().filter(|p| none || p.explained()).collect()
}

/// A value with its 90 % interval.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[allow(missing_docs)]
pub struct Interval {
    pub value: f64,
    pub lower: f64,
    pub upper: f64,
}

/// Ballast: stiffness per sleeper and its three parameters (paper, section 3.1), and damping.
#[derive(Clone, Debug)]
pub struct BallastEstimate {
    /// Outer stiffness p1, N/m².
    pub p1_n_m2: Interval,
    /// Stiffness of the crossing sleeper p2, N/m².
    pub p2_n_m2: Interval,
    /// Shape p3 in 0 … 1.
    pub p3: Interval,
    /// Damping.
    pub damping: DampingEstimate,
    /// Per sleeper, N/m², index = sleeper number.
    pub stiffness_n_m2: Vec<Interval>,
    /// Residual displacement misfit of the calibrated model over the measured displacement, RMS ratio.
    pub misfit: f64,
}

/// Damping of the ballast per metre of sleeper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DampingEstimate {
    /// That of crossing.toml, Ns/m².
    pub described_ns_m2: f64,
    /// What the recordings speak for, Ns/m².
    pub recorded_ns_m2: Interval,
    /// What everything else was found with, Ns/m²: the described one, or, where the recordings contradict that, the recorded one.
    pub used_ns_m2: f64,
}

impl DampingEstimate {
    /// Whether the recordings contradict crossing.toml.
    pub fn contradicts_description(&self) -> bool {
        self.used_ns_m2 != self.described_ns_m2
    }
}

/// One train passage.
#[derive(Clone, Debug)]
pub struct PassageResult {
    /// Identifier in the recording file.
    pub passage_id: i32,
    /// Train speed, m/s.
    pub speed_m_s: f64,
    /// Temperature at the sensor, °C.
    pub temperature_c: f64,
    /// Time at which each axle is at x = 0, seconds after the first sample.
    pub axle_times_s: Vec<f64>,
    /// Sampling rate of the three traces below, Hz.
    pub trace_rate_hz: f64,
    /// Measured acceleration, low-passed at 250 Hz, m/s².
    pub acceleration_m_s2: Vec<f64>,
    /// Reconstructed sleeper displacement, metres, positive down.
    pub displacement_m: Vec<f64>,
    /// Displacement of the calibrated model under constant wheel forces, metres.
    pub model_displacement_m: Vec<f64>,
    /// One per wheelset, in order of arrival.
    pub wheelsets: Vec<WheelsetResult>,
}

impl PassageResult {
    /// Whether the calibrated model explains the recording; if not, its forces mean nothing.
    pub fn explained(&self) -> bool {
        !self.has_flag(UNLIKE_MODEL)
    }

    /// Whether a wheelset has a flag.
    pub fn has_flag(&self, flag: &str) -> bool {
        self.wheelsets.iter().any(|w| w.flags.iter().any(|f| f == flag))
    }
}

/// Force and irregularity of one wheelset on the crossing side; all vectors on the same 10 mm grid.
#[derive(Clone, Debug)]
#[allow(missing_docs)]
pub struct WheelsetResult {
    pub wheelset: usize,
    /// x, metres, ascending.
    pub position_m: Vec<f64>,
    /// Low-passed at 250 Hz, newtons.
    pub contact_force_n: Vec<f64>,
    /// 90 % interval.
    pub lower_n: Vec<f64>,
    pub upper_n: Vec<f64>,
    pub peak_force_n: Interval,
    pub peak_position_m: f64,
    /// Band-passed 1 m … 250 Hz, metres, positive down.
    pub irregularity_m: Vec<f64>,
    pub irregularity_rms_m: f64,
    /// Limits of the method that this result touches, e.g. `low-speed`, `clipped`.
    pub flags: Vec<String>,
}

/// Condition indicators over the passages of a site (paper, section 7).
#[derive(Clone, Debug)]
pub struct Indicators {
    /// Force peak per wheelset, newtons.
    pub peak_force_n: Spread,
    /// RMS of the band-passed irregularity per wheelset, metres.
    pub irregularity_rms_m: Spread,
    /// First SVD mode of the forces over all wheelsets, newtons, with its grid.
    pub force_mode_n: Vec<f64>,
    /// First SVD mode of the irregularity over all wheelsets, metres.
    pub irregularity_mode_m: Vec<f64>,
    /// Mean irregularity over all wheelsets, metres, with the 90 % interval of the mean; NaN ends where none is stated.
    pub mean_irregularity_m: Vec<Interval>,
    /// Grid of the modes and of the mean irregularity: x, metres.
    pub position_m: Vec<f64>,
    /// Verdict against the thresholds.
    pub condition: Condition,
    /// How soon to act.
    pub urgency: String,
    /// What to do, in words a maintenance planner can use.
    pub recommended_action: String,
}

/// Mean and 80th-percentile range (the middle 80 % of the sample).
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct Spread {
    pub mean: f64,
    /// 90 % interval of the mean, NaN where none is stated.
    pub mean90: [f64; 2],
    pub p10: f64,
    pub p90: f64,
    /// Threshold between healthy and damaged.
    pub threshold: f64,
}

/// Condition against the thresholds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Condition {
    /// Both indicators below their thresholds.
    Healthy,
    /// One indicator above its threshold, or either within 10 % of it.
    Watch,
    /// Both above.
    Damaged,
}

/// Wheels and trains of which tests need only this much.
#[cfg(test)]
pub(crate) mod examples {
    use super::*;

    /// A wheel with a peak, newtons, and the RMS of its irregularity, metres, on a grid of one place.
    pub(crate) fn wheelset(
        wheelset: usize,
        peak_n: f64,
        irregularity_rms_m: f64,
        flags: &[&str],
    ) -> WheelsetResult {
        WheelsetResult {
            wheelset,
            position_m: vec![0.0],
            contact_force_n: vec![peak_n],
            lower_n: vec![peak_n],
            upper_n: vec![peak_n],
            peak_force_n: Interval { value: peak_n, lower: peak_n, upper: peak_n },
            peak_position_m: 0.0,
            irregularity_m: vec![0.0],
            irregularity_rms_m,
            flags: flags.iter().map(|f| (*f).into()).collect(),
        }
    }

    /// A train of these wheels, without traces.
    pub(crate) fn passage(wheelsets: Vec<WheelsetResult>) -> PassageResult {
        PassageResult {
            passage_id: 0,
            speed_m_s: 40.0,
            temperature_c: 10.0,
            axle_times_s: vec![0.5],
            trace_rate_hz: 1000.0,
            acceleration_m_s2: Vec::new(),
            displacement_m: Vec::new(),
            model_displacement_m: Vec::new(),
            wheelsets,
        }
    }
}
