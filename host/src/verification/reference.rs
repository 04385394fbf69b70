//! Tracks of the reference cases and the curves that other programs computed for them (`tests/data/reference`).

use super::VerifyError;
use crate::recording::{
    Ballast, Crossing, Design, Pad, Rail, Sensor, Sleeper as SleeperSite, TrackLayout, TrafficDirection,
    Vehicle,
};
use crate::section::BeamSection;
use crate::track::{Kelvin, Mesh, Sleeper, Track};

/// Rail pads of a reference case.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PadCase {
    /// For tables.
    pub name: &'static str,
    /// Per seat, N/m and Ns/m.
    pub pad: Kelvin,
}

/// 60E design of the paper (table 1).
pub const SOFT: PadCase = PadCase { name: "soft pads", pad: Kelvin { stiffness: 60e6, damping: 6e3 } };
/// Between the two.
pub const MID: PadCase = PadCase { name: "medium pads", pad: Kelvin { stiffness: 200e6, damping: 28e3 } };
/// UIC60 design of the paper (table 1).
pub const STIFF: PadCase = PadCase { name: "stiff pads", pad: Kelvin { stiffness: 1200e6, damping: 25e3 } };

/// Ballast of all reference cases, N/m².
pub const BALLAST_N_M2: f64 = 30e6;
/// Static wheel force: axle load 15.5 t.
pub const WHEEL_N: f64 = 15_500.0 * 9.81 / 2.0;
/// Speed of the reference passages, m/s.
pub const SPEED_M_S: f64 = 50.0;
/// Axle spacing of the bogie, metres.
pub const BOGIE_M: f64 = 2.9;

/// Two-rail crossing panel: 37 sleepers of 2.5 m, the crossing part ±1.8 m about the instrumented sleeper at x = 0,
/// sensor under the crossing rail. The published script puts the origin 10.8 m further back.
pub fn panel(pads: PadCase, mesh: Mesh) -> Track {
    panel_of_length(pads, mesh, 37)
}

/// The same with another number of sleepers (odd).
pub fn panel_of_length(pads: PadCase, mesh: Mesh, n_sleepers: usize) -> Track {
    let mut site = site(pads);
    site.track.n_sleepers = n_sleepers;
    site.track.crossing_sleeper_index = n_sleepers / 2;
    site.sensor.sleeper_index = n_sleepers / 2;
    Track::of_crossing(&site, mesh)
}

/// Uniform ballast of a track.
pub fn ballast(track: &Track) -> Vec<f64> {
    vec![BALLAST_N_M2; track.sleeper_x_m.len()]
}

/// Benchmark T1: one rail on 101 rigid half sleepers of 150 kg at 0.6 m, ballast per half sleeper 1.25 m × 30 MN/m²
/// and 1.25 m × 125 kNs/m²; x = 0 over the middle sleeper. The second rail rests on its own halves.
pub fn t1(pads: PadCase, rail_step_m: f64) -> Track {
    let mesh = Mesh { rail_step_m, ..Mesh::default() };
    let mut track = panel_of_length(pads, mesh, 101);
    track.plain = BeamSection::rail_60e1_benchmark();
    track.crossing_rail = track.plain;
    track.sleeper = Sleeper::RigidHalves { mass_kg: 150.0, length_m: 1.25 };
    track
}

/// Stiffness of a support that does not give, N/m: 10⁶ times a rail span, 10⁻¹⁰ of what a double can resolve.
const RIGID_N_M: f64 = 1e15;

/// A rail span that rests on two rigid points: simply supported, because rails end free at the last sleepers.
pub fn simple_beam(section: BeamSection, span_m: f64, elements: usize, damping_s: f64) -> Track {
    let mut site = site(SOFT);
    site.track.n_sleepers = 2;
    site.track.crossing_sleeper_index = 0;
    site.track.crossing_sleeper_x_m = -0.5 * span_m;
    site.track.sleeper_spacing_m = span_m;
    site.sensor.sleeper_index = 0;
    let mesh = Mesh { rail_step_m: span_m / elements as f64, ..Mesh::default() };
    let mut track = Track::of_crossing(&site, mesh);
    track.plain = section;
    track.crossing_rail = section;
    track.rail_damping_s = damping_s;
    track.pad = Kelvin { stiffness: RIGID_N_M, damping: 0.0 };
    track.sleeper = Sleeper::RigidHalves { mass_kg: 0.0, length_m: 1.0 };
    track.ballast_damping_ns_m2 = 0.0;
    track
}

/// Ballast that makes the supports of [`simple_beam`] rigid.
pub fn rigid_ballast() -> Vec<f64> {
    vec![RIGID_N_M; 2]
}

/// A rail on so many supports that they act like a continuous one: `spacing_m` apart over 40 m. `per_metre` holds pad,
/// ballast (N/m², Ns/m²) and sleeper mass (kg/m) per metre of rail.
pub fn continuous(section: BeamSection, per_metre: crate::closed_form::TwoLayer, spacing_m: f64) -> Track {
    let mut site = site(SOFT);
    let half = (20.0 / spacing_m).round() as usize;
    site.track.n_sleepers = 2 * half + 1;
    site.track.sleeper_spacing_m = spacing_m;
    site.track.crossing_sleeper_index = half;
    site.sensor.sleeper_index = half;
    let mesh = Mesh { rail_step_m: spacing_m.min(0.3), ..Mesh::default() };
    let mut track = Track::of_crossing(&site, mesh);
    track.plain = section;
    track.crossing_rail = section;
    track.pad =
        Kelvin { stiffness: per_metre.pad_n_m2 * spacing_m, damping: per_metre.pad_ns_m2 * spacing_m };
    track.sleeper = Sleeper::RigidHalves { mass_kg: per_metre.sleeper_kg_m * spacing_m, length_m: spacing_m };
    track.ballast_damping_ns_m2 = per_metre.ballast_ns_m2;
    track
}

/// Description of the two-rail panel, number for number that of the published script; no damping but that of pads
/// and ballast.
pub(crate) fn site(pads: PadCase) -> Crossing {
    Crossing {
        name: "reference panel".into(),
        design: Design::Uic60,
        traffic_direction: TrafficDirection::Facing,
        track: TrackLayout {
            n_sleepers: 37,
            sleeper_spacing_m: 0.6,
            crossing_sleeper_index: 18,
            crossing_sleeper_x_m: 0.0,
            load_transfer: 0.0,
        },
        rail: Rail {
            profile: "60E1".into(),
            youngs_modulus_pa: 210e9,
            second_moment_m4: 3.038e-5,
            area_m2: 76.70e-4,
            mass_per_metre_kg: 60.0,
            shear_coefficient: 0.40,
            poisson: 0.3,
            crossing_part_x0_m: -1.8,
            crossing_part_x1_m: 1.8,
            crossing_part_stiffness_factor: 3.0,
            crossing_part_mass_factor: 3.0,
            damping_stiffness_proportional_s: 0.0,
        },
        pad: Pad { stiffness_n_m: pads.pad.stiffness, damping_ns_m: pads.pad.damping },
        sleeper: SleeperSite {
            length_m: 2.5,
            width_m: 0.25,
            height_m: 0.20,
            youngs_modulus_pa: 30e9,
            poisson: 0.2,
            density_kg_m3: 2400.0,
            shear_coefficient: 5.0 / 6.0,
            seat_stock_y_m: 0.5,
            seat_crossing_y_m: 2.0,
            damping_stiffness_proportional_s: 0.0,
        },
        ballast: Ballast { stiffness_n_m2: BALLAST_N_M2, damping_ns_m2: 125e3, support_factor: Vec::new() },
        vehicle: vehicle(),
        sensor: Sensor {
            sleeper_index: 18,
            y_m: 2.0,
            sample_rate_hz: 5000.0,
            range_m_s2: 500.0,
            bits: 16,
            antialias_order: 0,
            antialias_hz: 2500.0,
            noise_rms_m_s2: 0.0,
            bias_max_m_s2: 0.0,
        },
    }
}

/// One bogie of an X2 car (paper, table 1); what the paper does not give is not used by any check.
pub fn vehicle() -> Vehicle {
    Vehicle {
        kind: "X2".into(),
        cars: 1,
        car_length_m: 24.95,
        bogie_centres_m: 17.7,
        axle_spacing_m: BOGIE_M,
        wheelset_mass_kg: 1340.0,
        wheelset_roll_inertia_kg_m2: 700.0,
        wheel_radius_m: 0.46,
        axle_load_kg: 15_500.0,
        gravity_m_s2: 9.81,
        contact_half_distance_m: 0.75,
        bogie_frame_mass_kg: 2800.0,
        bogie_frame_pitch_inertia_kg_m2: 2200.0,
        bogie_frame_roll_inertia_kg_m2: 1900.0,
        primary_stiffness_per_axle_box_n_m: 1.1e6,
        primary_damping_per_axle_box_ns_m: 12e3,
        axle_box_half_distance_m: 1.0,
        hertz_constant_n_m15: 9.3e10,
    }
}

/// Numbers of a reference file, by column; lines that begin with `#` and the line with the names are left out.
pub fn columns(file: &'static str, text: &str) -> Result<Vec<Vec<f64>>, VerifyError> {
    let mut columns: Vec<Vec<f64>> = Vec::new();
    let lines = text.lines().enumerate().filter(|(_, l)| !l.starts_with('#') && !l.trim().is_empty());
    for (line, row) in lines.skip(1) {
        let bad = || VerifyError::Reference { file, line: line + 1 };
        let values = row
            .split(',')
            .map(|v| v.trim().parse::<f64>())
            .collect::<Result<Vec<_>, _>>()
            .map_err(|_| bad())?;
        columns.resize(values.len().max(columns.len()), Vec::new());
        if columns.len() != values.len() {
            return Err(bad());
        }
        columns.iter_mut().zip(values).for_each(|(c, v)| c.push(v));
    }
    if columns.is_empty() { Err(VerifyError::Reference { file, line: 0 }) } else { Ok(columns) }
}

/// Text of a file in `tests/data/reference`, with its name.
macro_rules! reference {
    ($file:literal) => {
        ($file, include_str!(concat!("../../../tests/data/reference/", $file)))
    };
}
pub(super) use reference;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn property_reference_files_are_read_and_bad_lines_named() {
        let good = columns("x.csv", "# note\na,b\n1,2\n3,4\n").unwrap();
        assert_eq!(good, vec![vec![1.0, 3.0], vec![2.0, 4.0]]);
        let error = columns("x.csv", "a,b\n1,2\n3\n").unwrap_err();
        assert_eq!(error.to_string(), "reference curve x.csv is damaged in line 3");
        assert!(columns("x.csv", "a,b\n").is_err());
    }
}
