//! `crossing.toml`: what the operator knows of a crossing panel (nominal values, SI units).

use std::fmt;

use serde::{Deserialize, Serialize};

/// The whole file. Coordinates: x along the track, 0 at the nose tip, growing from the wing rail towards the nose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Crossing {
    /// Site name.
    pub name: String,
    /// `UIC60` (stiff pads) or `60E` (soft pads).
    pub design: Design,
    /// Direction in which trains run.
    pub traffic_direction: TrafficDirection,
    /// Sleepers along the track.
    pub track: TrackLayout,
    /// Rails.
    pub rail: Rail,
    /// Rail pads.
    pub pad: Pad,
    /// Sleepers.
    pub sleeper: Sleeper,
    /// Ballast, nominal.
    pub ballast: Ballast,
    /// Train.
    pub vehicle: Vehicle,
    /// Accelerometer.
    pub sensor: Sensor,
}

impl Crossing {
    /// Place x of a sleeper, metres.
    pub fn sleeper_x_m(&self, index: usize) -> f64 {
        let t = &self.track;
        let first = t.crossing_sleeper_x_m - t.crossing_sleeper_index as f64 * t.sleeper_spacing_m;
        first + index as f64 * t.sleeper_spacing_m
    }

    /// Place x of the sensor's sleeper, metres.
    pub fn sensor_x_m(&self) -> f64 {
        self.sleeper_x_m(self.sensor.sleeper_index)
    }

    /// The same with this many sleepers on either side of the crossing sleeper, or as many as there are; the sensor on the crossing sleeper.
    pub fn shortened(mut self, each_side: usize) -> Self {
        let track = &mut self.track;
        let (index, n) = (track.crossing_sleeper_index, track.n_sleepers);
        let (before, after) = (index.min(each_side), (n - 1 - index).min(each_side));
        (track.n_sleepers, track.crossing_sleeper_index) = (before + 1 + after, before);
        self.sensor.sleeper_index = before;
        self
    }
}

/// Crossing panel design.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Design {
    /// Direct, very stiff fastening of the crossing rail.
    #[serde(rename = "UIC60")]
    Uic60,
    /// Resilient rail fastening.
    #[serde(rename = "60E")]
    E60,
}

/// Direction of traffic.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TrafficDirection {
    /// Trains run towards +x.
    Facing,
    /// Trains run towards -x.
    Trailing,
}

impl TrafficDirection {
    /// +1 for facing, -1 for trailing.
    pub fn sign(self) -> f64 {
        match self {
            TrafficDirection::Facing => 1.0,
            TrafficDirection::Trailing => -1.0,
        }
    }

    /// The other one.
    pub fn reversed(self) -> Self {
        match self {
            TrafficDirection::Facing => TrafficDirection::Trailing,
            TrafficDirection::Trailing => TrafficDirection::Facing,
        }
    }
}

impl fmt::Display for TrafficDirection {
    /// As in crossing.toml.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            TrafficDirection::Facing => "facing",
            TrafficDirection::Trailing => "trailing",
        })
    }
}

/// `[track]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct TrackLayout {
    pub n_sleepers: usize,
    pub sleeper_spacing_m: f64,
    /// Index of the instrumented sleeper, counted with growing x.
    pub crossing_sleeper_index: usize,
    pub crossing_sleeper_x_m: f64,
    /// Share of the static load that cant or twist moves from the stock rail to the crossing rail, of half an axle's: what a diagnosis
    /// found, no part of the file.
    #[serde(skip)]
    pub load_transfer: f64,
}

impl TrackLayout {
    /// Static force on the crossing and on the stock rail, of half an axle's.
    pub fn load_factor(&self) -> [f64; 2] {
        [1.0 + self.load_transfer, 1.0 - self.load_transfer]
    }
}

/// `[rail]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct Rail {
    pub profile: String,
    pub youngs_modulus_pa: f64,
    pub second_moment_m4: f64,
    pub area_m2: f64,
    pub mass_per_metre_kg: f64,
    /// kappa of G kappa A.
    pub shear_coefficient: f64,
    pub poisson: f64,
    /// The crossing-side rail is stiffer and heavier between these positions.
    pub crossing_part_x0_m: f64,
    pub crossing_part_x1_m: f64,
    pub crossing_part_stiffness_factor: f64,
    pub crossing_part_mass_factor: f64,
    /// C = value × K.
    pub damping_stiffness_proportional_s: f64,
}

/// `[pad]`, per rail seat, Kelvin model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct Pad {
    pub stiffness_n_m: f64,
    pub damping_ns_m: f64,
}

/// `[sleeper]`, rectangular section; y = 0 at the end beyond the stock rail.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct Sleeper {
    pub length_m: f64,
    pub width_m: f64,
    pub height_m: f64,
    pub youngs_modulus_pa: f64,
    pub poisson: f64,
    pub density_kg_m3: f64,
    pub shear_coefficient: f64,
    pub seat_stock_y_m: f64,
    pub seat_crossing_y_m: f64,
    pub damping_stiffness_proportional_s: f64,
}

/// `[ballast]`, Kelvin, per metre of sleeper, uniform along a sleeper.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct Ballast {
    pub stiffness_n_m2: f64,
    pub damping_ns_m2: f64,
    /// Factor on the stiffness of single sleepers, counted from the crossing sleeper: what a diagnosis found, no part of the
    /// file.
    #[serde(skip)]
    pub support_factor: Vec<(i64, f64)>,
}

/// `[vehicle]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct Vehicle {
    #[serde(rename = "type")]
    pub kind: String,
    pub cars: usize,
    pub car_length_m: f64,
    pub bogie_centres_m: f64,
    pub axle_spacing_m: f64,
    pub wheelset_mass_kg: f64,
    pub wheelset_roll_inertia_kg_m2: f64,
    pub wheel_radius_m: f64,
    /// Mass on an axle; static wheel force = axle load × g / 2.
    pub axle_load_kg: f64,
    pub gravity_m_s2: f64,
    pub contact_half_distance_m: f64,
    pub bogie_frame_mass_kg: f64,
    pub bogie_frame_pitch_inertia_kg_m2: f64,
    pub bogie_frame_roll_inertia_kg_m2: f64,
    pub primary_stiffness_per_axle_box_n_m: f64,
    pub primary_damping_per_axle_box_ns_m: f64,
    pub axle_box_half_distance_m: f64,
    /// F = C d^1.5, no tension.
    pub hertz_constant_n_m15: f64,
}

impl Vehicle {
    /// Distance from the first to the last axle of the train, metres.
    pub fn axle_base_m(&self) -> f64 {
        (self.cars.max(1) - 1) as f64 * self.car_length_m + self.bogie_centres_m + self.axle_spacing_m
    }
}

/// Least sampling rate, Hz: at 1600 Hz behind a low-pass of order 4 at 640 Hz, peaks of simulated recordings are as good as at
/// 4000 Hz but for a factor of two; at 1000 Hz behind 400 Hz, one in ten is 42 % wrong, as impacts fold into the band of the forces.
pub const LEAST_RATE_HZ: f64 = 1600.0;

/// `[sensor]`, on the crossing sleeper.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct Sensor {
    pub sleeper_index: usize,
    pub y_m: f64,
    pub sample_rate_hz: f64,
    pub range_m_s2: f64,
    pub bits: u32,
    pub antialias_order: usize,
    pub antialias_hz: f64,
    pub noise_rms_m_s2: f64,
    pub bias_max_m_s2: f64,
}
