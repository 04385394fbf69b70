//! Deviations of a site from its nominal description, as plain values; absent means nominal. Names are those of the
//! diagnosis.

use serde::{Deserialize, Serialize};

/// `[simulation.effects]`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
#[allow(missing_docs)]
pub struct Effects {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub voided_sleepers: Option<VoidedSleepers>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ballast_stiffening: Option<BallastStiffening>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ballast_mass: Option<BallastMass>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub support_loss: Option<SupportLoss>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pad_stiffness: Option<PadStiffness>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub crossing_rail: Option<CrossingRail>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axle_load: Option<Factor>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unsprung_mass: Option<Factor>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub load_transfer: Option<LoadTransfer>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub front_rear: Option<FrontRear>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wheel_out_of_roundness: Option<WheelOutOfRoundness>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wheel_flat: Option<WheelFlats>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hollow_wheels: Option<HollowWheels>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stock_irregularity: Option<StockIrregularity>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gain_temperature: Option<GainTemperature>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub saturation: Option<Saturation>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bias_step: Option<BiasSteps>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clock_error: Option<ClockError>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mount_resonance: Option<Mount>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tonal: Option<Tonal>,
}

impl Effects {
    /// Names of the effects that act.
    pub fn names(&self) -> Vec<String> {
        match toml::Value::try_from(self) {
            Ok(toml::Value::Table(table)) => table.keys().cloned().collect(),
            _ => Vec::new(),
        }
    }
}

/// Gap under some sleepers: F = k max(0, w − gap).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VoidedSleepers {
    /// m.
    pub gap_m: f64,
    /// Sleepers, counted from the crossing sleeper, and the share of the gap under each.
    #[serde(default = "middle")]
    pub sleepers: Vec<(i64, f64)>,
    /// Part of the bed's damping that they keep while they hang, as they rub along the crib.
    #[serde(default)]
    pub crib_damping: f64,
}

impl VoidedSleepers {
    /// A gap of `gap_m` under the crossing sleeper and half of it under its neighbours, m.
    pub fn in_the_middle(gap_m: f64) -> Self {
        Self { gap_m, sleepers: middle(), crib_damping: 0.0 }
    }
}

fn middle() -> Vec<(i64, f64)> {
    vec![(-1, 0.5), (0, 1.0), (1, 0.5)]
}

/// All sleepers on ballast that stiffens: F = k w (1 + w/doubling).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BallastStiffening {
    /// Displacement at which the secant stiffness has doubled, m.
    pub doubling_m: f64,
    /// Second over first stiffness of a bilinear law that begins at `doubling_m`, instead of the quadratic one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bilinear_factor: Option<f64>,
}

/// Ballast that moves with every sleeper.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BallastMass {
    /// kg per metre of sleeper.
    pub mass_kg_m: f64,
}

/// Low stiffness somewhere.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SupportLoss {
    /// Factor on the stiffness.
    pub factor: f64,
    /// Sleepers, counted from the crossing sleeper.
    pub sleepers: Vec<i64>,
}

/// Pads that are not as designed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PadStiffness {
    /// On the stiffness.
    pub factor: f64,
    /// On the damping.
    #[serde(default = "one")]
    pub damping_factor: f64,
}

fn one() -> f64 {
    1.0
}

/// Crossing rail: factors on the nominal factors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CrossingRail {
    /// On bending and shear stiffness.
    pub stiffness_factor: f64,
    /// On mass and rotary inertia.
    pub mass_factor: f64,
}

/// A factor on a nominal value.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Factor {
    /// 1 is nominal.
    pub factor: f64,
}

/// Static load that is not equally shared; positive loads the crossing side, the front wheelset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LoadTransfer {
    /// Crossing wheel carries (1 + this) times the mean of its wheelset.
    pub to_crossing_side: f64,
    /// Front wheelset carries (1 + this) times the mean of its bogie.
    pub to_front: f64,
}

/// Front and rear wheelset excite differently: depth (1 ± difference/2) times nominal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrontRear {
    /// Relative difference of path depth, front minus rear.
    pub depth_difference: f64,
}

/// Polygonal wheels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WheelOutOfRoundness {
    /// Waves around the wheel.
    pub order: u32,
    /// m.
    pub amplitude_m: f64,
    /// Share of wheelsets that have it.
    pub share: f64,
}

/// Flat wheels: a flat of this length, rounded; depth = length²/8R.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WheelFlats {
    /// m.
    pub length_m: f64,
    /// Share of wheelsets that have it.
    pub share: f64,
}

/// Hollow-worn wheels, which meet another path.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HollowWheels {
    /// On the depth of the path.
    pub depth_factor: f64,
    /// m.
    pub shift_m: f64,
    /// Share of wheelsets that have it.
    pub share: f64,
}

/// Dip (1 − cos)/2 in the stock rail.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct StockIrregularity {
    pub depth_m: f64,
    pub at_x_m: f64,
    pub length_m: f64,
}

/// Sensitivity depends on temperature.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GainTemperature {
    /// Relative, per kelvin.
    pub per_kelvin: f64,
    /// °C at which the sensitivity is right.
    pub reference_c: f64,
}

/// Transducer with a smaller range than stated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Saturation {
    /// ±, m/s².
    pub range_m_s2: f64,
}

/// Baseline shift at every bogie, of random sign.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct BiasSteps {
    pub step_m_s2: f64,
    pub decay_s: f64,
}

/// Sampling rate that is not as stated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClockError {
    /// The clock runs faster by this part.
    pub relative: f64,
}

/// Resonance of the mounting.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct Mount {
    pub frequency_hz: f64,
    pub damping_ratio: f64,
}

/// Electrical interference.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct Tonal {
    pub frequency_hz: f64,
    pub amplitude_m_s2: f64,
}
