//! Limits that the method states for itself, as flags on results (paper, section 6.3).
//!
//! | flag | limit |
//! |---|---|
//! | `low-speed` | under 40 km/h the dynamic forces are near the sensor noise |
//! | `clipped` | the sensor saturated, at its range or below it: integration drifts, ballast and forces may be far off |
//! | `unknown-train` | a train type that is not the site's: masses and axle pattern are not known |
//! | `freight` | freight trains: wheelset mass and load are not known, the method is not made for them |
//! | `unlike-load` | axle load more than 10 % off the site's vehicle: forces follow in proportion |
//! | `unlike-speed` | the operator states a speed more than 5 % off the one found: one of them, or the unit, is wrong |
//! | `unlike-model` | the calibrated model does not explain the recording: spikes, gaps, drift, half a train, another train, or the whole site is not as described |
//! | `other-direction` | the train runs in the other direction than crossing.toml has it; left out like one that the model does not explain |
//! | `unlike-description` | the recordings fit another description of the panel far better: trains in the other direction, or the sensor one sleeper along |
//! | `model-gap` | over the whole site the calibrated model leaves more than three times the noise of quiet track: something acts that it does not hold, `cpcm diagnose` may say what |
//! | `large-deflection` | beyond 3 mm ballast is not linear: voids, which no linear track explains |
//!
//! A flag changes no number; it says how far to trust. But indicators are of the passages that are not `unlike-model`, and no crossing is
//! healthy where most passages are `clipped` or have a `model-gap`, or the panel is not as described.

use crate::reconstruct::ABOUT;

/// Speed below which the method is weak, m/s: 40 km/h.
const LOW_SPEED_M_S: f64 = 40.0 / 3.6;
/// Share of the sensor's range that counts as saturated: a transducer clips before the recorder's low-pass, which rounds short tops
/// to 0.92 of the range and more (simulated site at 65 m/s, of whose forces a tenth are 8 % wrong).
const NEAR_RANGE: f64 = 0.9;
/// The same of where values pile up.
const FLAT: f64 = 0.98;
/// Words that freight trains go by in train types.
const FREIGHT: [&str; 5] = ["freight", "goods", "cargo", "güter", "gods"];
/// Axle load of freight wagons and heavy locomotives, kg; passenger cars and multiple units are below.
const FREIGHT_AXLE_KG: f64 = 20_500.0;
/// Relative difference to the site's axle load.
const UNLIKE_LOAD: f64 = 0.1;
/// Noise over that of quiet track. 24 sites without an effect, recorded and simulated, need once the noise or less; one with voids and
/// wheels out of round 16 times, with saturation 4 times, with pads of 2.9 and a gain that drifts with temperature 8 times.
const LARGE_EXCESS: f64 = 3.0;
/// Sleeper displacement, metres: the paper's linear panels reach 1 mm, its voided one 6 mm.
const LARGE_DEFLECTION_M: f64 = 3e-3;

/// Flag of passages on which the sensor saturated.
pub const CLIPPED: &str = "clipped";

/// Flag of passages that site-wide results leave out while others are left.
pub const UNLIKE_MODEL: &str = "unlike-model";

/// Flag of passages in the other direction than crossing.toml has it.
pub const OTHER_DIRECTION: &str = "other-direction";

/// Flag of sites whose crossing.toml the recordings contradict.
pub const UNLIKE_DESCRIPTION: &str = "unlike-description";

/// Flag of sites on which something acts that the model does not hold.
pub const MODEL_GAP: &str = "model-gap";

/// What the flags of one passage depend on.
#[derive(Clone, Debug)]
pub struct PassageLimits<'a> {
    /// m/s.
    pub speed_m_s: f64,
    /// As the operator states it, m/s.
    pub stated_m_s: Option<f64>,
    /// Largest |acceleration| of the raw recording, m/s².
    pub largest_m_s2: f64,
    /// Range of the sensor, m/s².
    pub range_m_s2: f64,
    /// Where the recordings of the site clip by themselves, whatever the range, m/s².
    pub clips_at_m_s2: Option<f64>,
    /// Type of the recorded train.
    pub train_type: &'a str,
    /// Type of the site's vehicle.
    pub vehicle_type: &'a str,
    /// Axle load of the recorded train, kg.
    pub axle_load_kg: f64,
    /// Axle load of the site's vehicle, kg.
    pub vehicle_axle_load_kg: f64,
    /// What the calibrated model leaves of the site's recordings, over the noise of quiet track.
    pub excess_noise: f64,
    /// Whether the calibrated model explains the recording.
    pub explained: bool,
    /// Whether the train runs in the other direction than crossing.toml has it.
    pub other_way: bool,
    /// Whether the panel is as crossing.toml has it.
    pub described: bool,
    /// Reconstructed displacement of the sleeper, metres, positive down.
    pub displacement_m: &'a [f64],
}

impl PassageLimits<'_> {
    /// Flags in a fixed order.
    pub fn flags(&self) -> Vec<String> {
        let train = self.train_type.to_lowercase();
        let freight = FREIGHT.iter().any(|w| train.contains(w)) || self.axle_load_kg > FREIGHT_AXLE_KG;
        let unlike = (self.axle_load_kg / self.vehicle_axle_load_kg - 1.0).abs() > UNLIKE_LOAD;
        let unlike_speed =
            self.stated_m_s.is_some_and(|stated| (self.speed_m_s / stated - 1.0).abs() > ABOUT);
        let deepest = self.displacement_m.iter().copied().fold(0.0, f64::max);
        [
            ("low-speed", self.speed_m_s < LOW_SPEED_M_S),
            (CLIPPED, self.clipped()),
            ("unknown-train", self.train_type != self.vehicle_type),
            ("freight", freight),
            ("unlike-load", unlike),
            ("unlike-speed", unlike_speed),
            (UNLIKE_MODEL, !self.explained),
            (OTHER_DIRECTION, self.other_way),
            (UNLIKE_DESCRIPTION, !self.described),
            (MODEL_GAP, self.excess_noise > LARGE_EXCESS),
            ("large-deflection", deepest > LARGE_DEFLECTION_M),
        ]
        .into_iter()
        .filter(|(_, reached)| *reached)
        .map(|(name, _)| name.to_string())
        .collect()
    }

    fn clipped(&self) -> bool {
        let flat = self.clips_at_m_s2.is_some_and(|top| self.largest_m_s2 >= FLAT * top);
        flat || self.largest_m_s2 >= NEAR_RANGE * self.range_m_s2
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sound() -> PassageLimits<'static> {
        PassageLimits {
            speed_m_s: 44.0,
            stated_m_s: Some(43.6),
            largest_m_s2: 120.0,
            range_m_s2: 490.5,
            clips_at_m_s2: None,
            train_type: "X2",
            vehicle_type: "X2",
            axle_load_kg: 15_500.0,
            vehicle_axle_load_kg: 15_500.0,
            excess_noise: 1.0,
            explained: true,
            other_way: false,
            described: true,
            displacement_m: &[0.0, 0.8e-3, -0.1e-3],
        }
    }

    #[test]
    fn paper_limits_are_flagged_one_by_one() {
        assert!(sound().flags().is_empty());
        let one = |limits: PassageLimits, flag: &str| assert_eq!(limits.flags(), [flag], "{limits:?}");
        one(PassageLimits { speed_m_s: 11.0, stated_m_s: None, ..sound() }, "low-speed");
        one(PassageLimits { largest_m_s2: 490.4, ..sound() }, "clipped");
        one(PassageLimits { largest_m_s2: 450.0, ..sound() }, "clipped");
        one(PassageLimits { clips_at_m_s2: Some(119.0), ..sound() }, "clipped");
        assert!(
            PassageLimits { clips_at_m_s2: Some(140.0), ..sound() }.flags().is_empty(),
            "another passage clips"
        );
        one(PassageLimits { train_type: "X2000", ..sound() }, "unknown-train");
        one(PassageLimits { train_type: "Goods", vehicle_type: "Goods", ..sound() }, "freight");
        let heavy = PassageLimits { axle_load_kg: 22_500.0, vehicle_axle_load_kg: 22_500.0, ..sound() };
        one(heavy, "freight");
        one(PassageLimits { axle_load_kg: 18_000.0, ..sound() }, "unlike-load");
        one(PassageLimits { stated_m_s: Some(158.4), ..sound() }, "unlike-speed");
        one(PassageLimits { explained: false, ..sound() }, "unlike-model");
        one(PassageLimits { other_way: true, ..sound() }, "other-direction");
        one(PassageLimits { described: false, ..sound() }, "unlike-description");
        one(PassageLimits { excess_noise: 4.0, ..sound() }, "model-gap");
        one(PassageLimits { displacement_m: &[6e-3], ..sound() }, "large-deflection");
    }

    #[test]
    fn property_several_limits_keep_their_order() {
        let bad = PassageLimits { speed_m_s: 5.0, train_type: "freight", displacement_m: &[4e-3], ..sound() };
        assert_eq!(
            bad.flags(),
            ["low-speed", "unknown-train", "freight", "unlike-speed", "large-deflection"]
        );
    }
}
