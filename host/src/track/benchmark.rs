//! Track of the published receptance benchmarks: rigid half sleepers, so that each rail is a track of its own.

use super::{Kelvin, Mesh, Sleeper, Track};
use crate::section::BeamSection;

/// Benchmark `T1`: 101 half sleepers.
const SLEEPERS: usize = 101;
/// Sleeper spacing, m.
const SPACING_M: f64 = 0.6;
/// Half sleeper, kg.
const HALF_SLEEPER_KG: f64 = 150.0;
/// Supported length of a half sleeper, m.
const HALF_LENGTH_M: f64 = 1.25;
/// Ballast damping, Ns/m per metre of sleeper: 156.25 kNs/m per half sleeper.
const BALLAST_DAMPING_NS_M2: f64 = 125e3;

impl Track {
    /// Benchmark `T1`: undamped rails 60E1 from x = 0 to 60 m on 101 rigid half sleepers of 150 kg, 0.6 m apart, with
    /// ballast of 30 (MN/m)/m and 125 (kNs/m)/m over 1.25 m. The two rails do not feel each other; the sensor is on
    /// sleeper 50 at x = 30 m.
    pub fn benchmark_t1(pad: Kelvin, mesh: Mesh) -> Self {
        let nodes_per_bay = (SPACING_M / mesh.rail_step_m).round().max(1.0) as usize;
        let step_m = SPACING_M / nodes_per_bay as f64;
        let rail = BeamSection::rail_60e1_benchmark();
        Self {
            node_x_m: (0..(SLEEPERS - 1) * nodes_per_bay + 1).map(|i| i as f64 * step_m).collect(),
            sleeper_x_m: (0..SLEEPERS).map(|i| i as f64 * SPACING_M).collect(),
            step_m,
            plain: rail,
            crossing_rail: rail,
            crossing_part_m: [0.0, 0.0],
            rail_damping_s: 0.0,
            pad,
            sleeper: Sleeper::RigidHalves { mass_kg: HALF_SLEEPER_KG, length_m: HALF_LENGTH_M },
            ballast_damping_ns_m2: BALLAST_DAMPING_NS_M2,
            sensor_sleeper: SLEEPERS / 2,
            support_factor: Vec::new(),
            load_factor: [1.0; 2],
            rail_halvings: 0,
            nodes_per_bay,
        }
    }
}
