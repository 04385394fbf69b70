//! Refuses a track that no physics can have, before anything is computed with it.

use super::{Mesh, Track};
use crate::recording::Crossing;

/// Why a track cannot be modelled.
#[derive(Clone, Copy, Debug, thiserror::Error, PartialEq)]
pub enum TrackError {
    /// A stiffness, mass or length that must be above zero is not.
    #[error("{what} must be positive, got {value}")]
    NotPositive {
        /// Which, with unit.
        what: &'static str,
        /// Value.
        value: f64,
    },
    /// Damping below zero would create energy.
    #[error("{what} must not be negative, got {value}")]
    Negative {
        /// Which, with unit.
        what: &'static str,
        /// Value.
        value: f64,
    },
    /// Rails need a sleeper at both ends.
    #[error("a track needs at least 2 sleepers, got {0}")]
    Sleepers(usize),
    /// The sensor is on no sleeper.
    #[error("sensor on sleeper {index}, but the track has {sleepers}")]
    Sensor {
        /// Sleeper of the sensor.
        index: usize,
        /// Number of sleepers.
        sleepers: usize,
    },
}

impl Track {
    /// [`Track::of_crossing`], refused where a number is impossible.
    pub fn try_of_crossing(crossing: &Crossing, mesh: Mesh) -> Result<Self, TrackError> {
        let layout = &crossing.track;
        if layout.n_sleepers < 2 {
            return Err(TrackError::Sleepers(layout.n_sleepers));
        }
        let (index, sleepers) = (crossing.sensor.sleeper_index, layout.n_sleepers);
        if index >= sleepers {
            return Err(TrackError::Sensor { index, sleepers });
        }
        for (what, value) in [
            ("rail element length (m)", mesh.rail_step_m),
            ("sleeper element length (m)", mesh.sleeper_step_m),
            ("sleeper spacing (m)", layout.sleeper_spacing_m),
            ("sleeper length (m)", crossing.sleeper.length_m),
        ] {
            positive(what, value)?;
        }
        let track = Self::of_crossing(crossing, mesh);
        track.check()?;
        Ok(track)
    }

    fn check(&self) -> Result<(), TrackError> {
        for section in [&self.plain, &self.crossing_rail] {
            positive("bending stiffness of the rail (N m²)", section.bending_n_m2)?;
            positive("shear stiffness of the rail (N)", section.shear_n)?;
            positive("mass of the rail (kg/m)", section.mass_kg_m)?;
            positive("rotary inertia of the rail (kg m)", section.rotary_kg_m)?;
        }
        positive("pad stiffness (N/m)", self.pad.stiffness)?;
        not_negative("pad damping (Ns/m)", self.pad.damping)?;
        not_negative("ballast damping (Ns/m²)", self.ballast_damping_ns_m2)?;
        not_negative("rail damping (s)", self.rail_damping_s)
    }
}

fn positive(what: &'static str, value: f64) -> Result<(), TrackError> {
    if value > 0.0 && value.is_finite() { Ok(()) } else { Err(TrackError::NotPositive { what, value }) }
}

fn not_negative(what: &'static str, value: f64) -> Result<(), TrackError> {
    if value >= 0.0 && value.is_finite() { Ok(()) } else { Err(TrackError::Negative { what, value }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn property_impossible_tracks_are_refused_with_their_numbers() {
        let sound: Crossing =
            toml::from_str(include_str!("../../../tests/data/field/reference-1/crossing.toml")).unwrap();
        assert!(Track::try_of_crossing(&sound, Mesh::default()).is_ok());
        let refused = |change: fn(&mut Crossing), words: &str| {
            let mut crossing = sound.clone();
            change(&mut crossing);
            let error = Track::try_of_crossing(&crossing, Mesh::default()).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        };
        refused(|c| c.pad.stiffness_n_m = 0.0, "pad stiffness (N/m) must be positive, got 0");
        refused(|c| c.pad.damping_ns_m = -3.0, "pad damping (Ns/m) must not be negative, got -3");
        refused(|c| c.rail.mass_per_metre_kg = f64::NAN, "got NaN");
        refused(|c| c.rail.crossing_part_stiffness_factor = -1.0, "bending stiffness");
        refused(|c| c.track.n_sleepers = 1, "got 1");
        refused(|c| c.sensor.sleeper_index = 61, "sleeper 61, but the track has 61");
        let mesh = Mesh { rail_step_m: 0.0, ..Mesh::default() };
        assert!(Track::try_of_crossing(&sound, mesh).is_err());
    }
}
