//! Trains: axle pattern, wheel loads, groups of axles whose responses overlap at the sensor.

use crate::recording::Vehicle;

/// Axle pattern of a train.
#[derive(Clone, Debug, PartialEq)]
pub struct AxlePattern {
    /// Distance behind the first axle, metres, ascending, first = 0.
    pub offset_m: Vec<f64>,
}

/// Consecutive axles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxleGroup {
    /// Index of the first axle.
    pub first: usize,
    /// Number of axles.
    pub len: usize,
}

/// Axles closer than this (metres) share one group: their forces cannot be estimated apart from each other because the
/// sensor still feels one while the next is in the transition region.
const GROUP_GAP_M: f64 = 10.0;

impl AxlePattern {
    /// Pattern of a train of equal cars with two two-axle bogies each.
    pub fn of_vehicle(vehicle: &Vehicle) -> Self {
        let within = [
            0.0,
            vehicle.axle_spacing_m,
            vehicle.bogie_centres_m,
            vehicle.bogie_centres_m + vehicle.axle_spacing_m,
        ];
        let offset_m =
            (0..vehicle.cars).flat_map(|car| within.map(|o| car as f64 * vehicle.car_length_m + o)).collect();
        Self { offset_m }
    }

    /// Distance between first and last axle, metres.
    pub fn length_m(&self) -> f64 {
        self.offset_m.last().copied().unwrap_or(0.0)
    }

    /// Groups of neighbouring axles, front to rear.
    pub fn groups(&self) -> Vec<AxleGroup> {
        let mut groups: Vec<AxleGroup> = Vec::new();
        for i in 0..self.offset_m.len() {
            match groups.last_mut() {
                Some(g) if self.offset_m[i] - self.offset_m[i - 1] < GROUP_GAP_M => g.len += 1,
                _ => groups.push(AxleGroup { first: i, len: 1 }),
            }
        }
        groups
    }
}

/// Static wheel force of an axle load, newtons: half the axle's weight.
pub fn static_wheel_force_n(axle_load_kg: f64, gravity_m_s2: f64) -> f64 {
    axle_load_kg * gravity_m_s2 / 2.0
}
