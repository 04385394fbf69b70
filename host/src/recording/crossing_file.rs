//! `crossing.toml` in and out: every key present, every value possible.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::files::{read_text, toml_table, write_atomic};
use super::{Crossing, LEAST_RATE_HZ, RecordingError};

/// Version of the format that this program reads and writes.
const FORMAT_VERSION: i64 = 1;

/// Keys that describe the file rather than the crossing.
#[derive(Serialize, Deserialize)]
struct Header {
    format_version: Option<i64>,
    sign_convention: Option<String>,
}

/// Reads and checks `crossing.toml`.
pub(super) fn read_crossing(file: &Path) -> Result<Crossing, RecordingError> {
    let crossing = parse_crossing(file, &read_text(file)?)?;
    check_crossing(file, &crossing)?;
    Ok(crossing)
}

fn parse_crossing(file: &Path, text: &str) -> Result<Crossing, RecordingError> {
    let table = toml_table(file, text)?;
    let key = |key: String, reason: String| RecordingError::Key { file: file.into(), key, reason };
    let header =
        Header::deserialize(table.clone()).map_err(|e| key("format_version".into(), e.to_string()))?;
    check_header(&header).map_err(|(name, reason)| key(name.into(), reason))?;
    serde_path_to_error::deserialize(table).map_err(|e| {
        let path = e.path().to_string();
        let place = if path == "." { "(top level)".into() } else { path };
        key(place, e.into_inner().to_string().trim_end().into())
    })
}

fn check_header(header: &Header) -> Result<(), (&'static str, String)> {
    match header.format_version {
        Some(version) if version != FORMAT_VERSION => Err((
            "format_version",
            format!("version {version} is not known; this program reads version {FORMAT_VERSION}"),
        )),
        _ => match header.sign_convention.as_deref() {
            Some(sign) if sign != "positive downwards" => Err((
                "sign_convention",
                format!("`{sign}` is not known; turn the recordings to `positive downwards`"),
            )),
            _ => Ok(()),
        },
    }
}

/// One checked value: key, value, smallest, largest, unit, hint.
type Limit = (&'static str, f64, f64, f64, &'static str, &'static str);

/// Refuses values that no crossing panel can have; most often a wrong unit.
pub fn check_crossing(file: &Path, c: &Crossing) -> Result<(), RecordingError> {
    let limits = [track(c), rail(c), pad_and_ballast(c), sleeper(c), train(c), bogie(c), sensor(c)];
    for &(key, value, min, max, unit, hint) in limits.iter().flatten() {
        if !(value >= min && value <= max) {
            return Err(RecordingError::KeyRange { file: file.into(), key, value, min, max, unit, hint });
        }
    }
    check_relations(c).map_err(|(key, reason)| RecordingError::Key {
        file: file.into(),
        key: key.into(),
        reason,
    })
}

fn track(c: &Crossing) -> Vec<Limit> {
    let t = &c.track;
    vec![
        (
            "track.n_sleepers",
            t.n_sleepers as f64,
            9.0,
            401.0,
            "sleepers",
            "the model needs a few on both sides",
        ),
        ("track.sleeper_spacing_m", t.sleeper_spacing_m, 0.3, 1.2, "m", "is it in mm?"),
        ("track.crossing_sleeper_x_m", t.crossing_sleeper_x_m, -5.0, 5.0, "m", "x = 0 is the nose tip"),
    ]
}

fn rail(c: &Crossing) -> Vec<Limit> {
    let r = &c.rail;
    vec![
        ("rail.youngs_modulus_pa", r.youngs_modulus_pa, 1.5e11, 2.5e11, "Pa", "steel has 2.1e11 Pa"),
        ("rail.second_moment_m4", r.second_moment_m4, 5e-6, 1e-4, "m4", "60E1 has 3.038e-5 m4"),
        ("rail.area_m2", r.area_m2, 2e-3, 3e-2, "m2", "60E1 has 7.67e-3 m2"),
        ("rail.mass_per_metre_kg", r.mass_per_metre_kg, 20.0, 250.0, "kg", "60E1 has 60 kg"),
        ("rail.shear_coefficient", r.shear_coefficient, 0.1, 1.0, "", "60E1 has 0.4"),
        ("rail.poisson", r.poisson, 0.0, 0.5, "", "steel has 0.3"),
        ("rail.crossing_part_x0_m", r.crossing_part_x0_m, -30.0, 30.0, "m", "is it in mm?"),
        ("rail.crossing_part_x1_m", r.crossing_part_x1_m, -30.0, 30.0, "m", "is it in mm?"),
        (
            "rail.crossing_part_stiffness_factor",
            r.crossing_part_stiffness_factor,
            0.2,
            20.0,
            "",
            "1 is plain rail",
        ),
        ("rail.crossing_part_mass_factor", r.crossing_part_mass_factor, 0.2, 20.0, "", "1 is plain rail"),
        (
            "rail.damping_stiffness_proportional_s",
            r.damping_stiffness_proportional_s,
            0.0,
            1e-3,
            "s",
            "C = value x K",
        ),
    ]
}

fn pad_and_ballast(c: &Crossing) -> Vec<Limit> {
    vec![
        ("pad.stiffness_n_m", c.pad.stiffness_n_m, 5e6, 2e10, "N/m", "is it in kN/mm or MN/m?"),
        ("pad.damping_ns_m", c.pad.damping_ns_m, 0.0, 1e7, "Ns/m", "is it in kNs/m?"),
        ("ballast.stiffness_n_m2", c.ballast.stiffness_n_m2, 1e6, 1e9, "N/m2", "is it in MN/m2?"),
        ("ballast.damping_ns_m2", c.ballast.damping_ns_m2, 0.0, 1e7, "Ns/m2", "per metre of sleeper"),
    ]
}

fn sleeper(c: &Crossing) -> Vec<Limit> {
    let s = &c.sleeper;
    vec![
        ("sleeper.length_m", s.length_m, 1.8, 8.0, "m", "is it in mm?"),
        ("sleeper.width_m", s.width_m, 0.1, 0.6, "m", "is it in mm?"),
        ("sleeper.height_m", s.height_m, 0.08, 0.5, "m", "is it in mm?"),
        ("sleeper.youngs_modulus_pa", s.youngs_modulus_pa, 5e8, 2.5e11, "Pa", "concrete has 3e10 Pa"),
        ("sleeper.poisson", s.poisson, 0.0, 0.5, "", "concrete has 0.2"),
        ("sleeper.density_kg_m3", s.density_kg_m3, 300.0, 9000.0, "kg/m3", "concrete has 2400 kg/m3"),
        ("sleeper.shear_coefficient", s.shear_coefficient, 0.1, 1.0, "", "a rectangle has 5/6"),
        ("sleeper.seat_stock_y_m", s.seat_stock_y_m, 0.0, 8.0, "m", "y = 0 is the end beyond the stock rail"),
        ("sleeper.seat_crossing_y_m", s.seat_crossing_y_m, 0.0, 8.0, "m", "y grows from the stock rail"),
        (
            "sleeper.damping_stiffness_proportional_s",
            s.damping_stiffness_proportional_s,
            0.0,
            1e-2,
            "s",
            "C = value x K",
        ),
    ]
}

fn train(c: &Crossing) -> Vec<Limit> {
    let v = &c.vehicle;
    let tonnes = "is it in tonnes?";
    vec![
        ("vehicle.cars", v.cars as f64, 1.0, 200.0, "cars", "a train has at least one"),
        ("vehicle.car_length_m", v.car_length_m, 5.0, 60.0, "m", "first axle to first axle of the next car"),
        ("vehicle.bogie_centres_m", v.bogie_centres_m, 3.0, 50.0, "m", "is it in mm?"),
        ("vehicle.axle_spacing_m", v.axle_spacing_m, 1.0, 5.0, "m", "is it in mm?"),
        ("vehicle.wheelset_mass_kg", v.wheelset_mass_kg, 300.0, 5000.0, "kg", tonnes),
        ("vehicle.wheelset_roll_inertia_kg_m2", v.wheelset_roll_inertia_kg_m2, 50.0, 5000.0, "kg m2", ""),
        ("vehicle.wheel_radius_m", v.wheel_radius_m, 0.2, 1.2, "m", "radius, not diameter, in metres"),
        ("vehicle.axle_load_kg", v.axle_load_kg, 4e3, 45e3, "kg", "is it in tonnes or newtons?"),
        ("vehicle.gravity_m_s2", v.gravity_m_s2, 9.7, 9.9, "m/s2", "write 9.81"),
        ("vehicle.contact_half_distance_m", v.contact_half_distance_m, 0.3, 1.0, "m", "half the distance"),
        (
            "vehicle.hertz_constant_n_m15",
            v.hertz_constant_n_m15,
            1e9,
            1e12,
            "N/m^1.5",
            "steel has about 1e11",
        ),
    ]
}

fn bogie(c: &Crossing) -> Vec<Limit> {
    let v = &c.vehicle;
    let primary_k = v.primary_stiffness_per_axle_box_n_m;
    let primary_c = v.primary_damping_per_axle_box_ns_m;
    vec![
        ("vehicle.bogie_frame_mass_kg", v.bogie_frame_mass_kg, 300.0, 3e4, "kg", "is it in tonnes?"),
        (
            "vehicle.bogie_frame_pitch_inertia_kg_m2",
            v.bogie_frame_pitch_inertia_kg_m2,
            50.0,
            1e5,
            "kg m2",
            "",
        ),
        ("vehicle.bogie_frame_roll_inertia_kg_m2", v.bogie_frame_roll_inertia_kg_m2, 50.0, 1e5, "kg m2", ""),
        ("vehicle.primary_stiffness_per_axle_box_n_m", primary_k, 1e5, 1e8, "N/m", "is it in kN/mm?"),
        ("vehicle.primary_damping_per_axle_box_ns_m", primary_c, 0.0, 1e6, "Ns/m", "is it in kNs/m?"),
        ("vehicle.axle_box_half_distance_m", v.axle_box_half_distance_m, 0.3, 1.5, "m", "half the distance"),
    ]
}

fn sensor(c: &Crossing) -> Vec<Limit> {
    let s = &c.sensor;
    vec![
        (
            "sensor.sample_rate_hz",
            s.sample_rate_hz,
            LEAST_RATE_HZ,
            200e3,
            "Hz",
            "is it in kHz? slower recorders fold impacts into the band of the forces",
        ),
        ("sensor.y_m", s.y_m, 0.0, 8.0, "m", "on the sleeper, y = 0 at its end beyond the stock rail"),
        ("sensor.range_m_s2", s.range_m_s2, 20.0, 50e3, "m/s2", "is it in g?"),
        ("sensor.bits", f64::from(s.bits), 8.0, 32.0, "bits", ""),
        ("sensor.antialias_order", s.antialias_order as f64, 1.0, 12.0, "", ""),
        ("sensor.antialias_hz", s.antialias_hz, 250.0, 100e3, "Hz", "forces are found up to 250 Hz"),
        ("sensor.noise_rms_m_s2", s.noise_rms_m_s2, 0.0, 20.0, "m/s2", "rms over the sampled band"),
        ("sensor.bias_max_m_s2", s.bias_max_m_s2, 0.0, 20.0, "m/s2", ""),
    ]
}

/// Track on either side of the crossing sleeper that the model needs, metres: with 25 sleepers (7.2 m) the response is 0.6 % off, with
/// 19 (5.4 m) 2 %, with 13 (3.6 m) 9 % (`docs/validation.md`).
const LEAST_TRACK_M: f64 = 7.0;

/// Values that are possible one by one but not together.
fn check_relations(c: &Crossing) -> Result<(), (&'static str, String)> {
    let (n, s) = (c.track.n_sleepers, &c.sleeper);
    let index = c.track.crossing_sleeper_index;
    // The ballast varies over ±2 sleepers, and the rails end at the outermost ones.
    if index < 4 || index + 4 >= n {
        return Err((
            "track.crossing_sleeper_index",
            format!("{index} must lie at least 4 sleepers inside 0 … {}", n.saturating_sub(1)),
        ));
    }
    let ends_m = [index, n - 1 - index].map(|sleepers| sleepers as f64 * c.track.sleeper_spacing_m);
    if ends_m.iter().any(|end_m| *end_m < LEAST_TRACK_M) {
        return Err((
            "track.n_sleepers",
            format!(
                "{n} sleepers, the crossing sleeper being number {index} from 0, reach {:.2} m to one side of it and {:.2} m to the other; the \
                 model needs {LEAST_TRACK_M} m on both sides, plain line included",
                ends_m[0], ends_m[1]
            ),
        ));
    }
    if c.sensor.sleeper_index != index {
        return Err((
            "sensor.sleeper_index",
            format!(
                "{} differs from track.crossing_sleeper_index = {index}; the sensor belongs there",
                c.sensor.sleeper_index
            ),
        ));
    }
    if !(s.seat_stock_y_m < s.seat_crossing_y_m && s.seat_crossing_y_m <= s.length_m) {
        return Err((
            "sleeper.seat_crossing_y_m",
            format!(
                "{} m must lie between the stock seat at {} m and the sleeper end at {} m",
                s.seat_crossing_y_m, s.seat_stock_y_m, s.length_m
            ),
        ));
    }
    if c.sensor.y_m > s.length_m {
        return Err((
            "sensor.y_m",
            format!("{} m is beyond the sleeper end at {} m", c.sensor.y_m, s.length_m),
        ));
    }
    check_lengths(c)
}

fn check_lengths(c: &Crossing) -> Result<(), (&'static str, String)> {
    let (r, v) = (&c.rail, &c.vehicle);
    if r.crossing_part_x0_m >= r.crossing_part_x1_m {
        return Err((
            "rail.crossing_part_x1_m",
            format!("{} m must be larger than crossing_part_x0_m", r.crossing_part_x1_m),
        ));
    }
    if v.axle_spacing_m >= v.bogie_centres_m {
        return Err((
            "vehicle.axle_spacing_m",
            format!(
                "{} m, between the axles of a bogie, must be smaller than bogie_centres_m = {} m; bogies would overlap: are they swapped?",
                v.axle_spacing_m, v.bogie_centres_m
            ),
        ));
    }
    if v.bogie_centres_m + v.axle_spacing_m >= v.car_length_m && v.cars > 1 {
        return Err((
            "vehicle.car_length_m",
            format!(
                "{} m is shorter than bogie centres plus axle spacing; cars would overlap",
                v.car_length_m
            ),
        ));
    }
    if c.sensor.antialias_hz > c.sensor.sample_rate_hz {
        return Err((
            "sensor.antialias_hz",
            format!("{} Hz lies above the sampling rate", c.sensor.antialias_hz),
        ));
    }
    Ok(())
}

/// The file as written: header, then the crossing.
#[derive(Serialize)]
struct Written<'a> {
    #[serde(flatten)]
    header: Header,
    #[serde(flatten)]
    crossing: &'a Crossing,
}

/// Writes `crossing.toml`.
pub(super) fn write_crossing(file: &Path, crossing: &Crossing) -> Result<(), RecordingError> {
    let header =
        Header { format_version: Some(FORMAT_VERSION), sign_convention: Some("positive downwards".into()) };
    let text = toml::to_string(&Written { header, crossing })
        .map_err(|e| RecordingError::Toml { file: file.into(), reason: e.to_string() })?;
    write_atomic(file, text.as_bytes())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const SOUND: &str = include_str!("../../../tests/data/field/reference-1/crossing.toml");

    fn read(text: &str) -> Result<Crossing, RecordingError> {
        let file = Path::new("crossing.toml");
        let crossing = parse_crossing(file, text)?;
        check_crossing(file, &crossing)?;
        Ok(crossing)
    }

    proptest! {
        #[test]
        fn property_arbitrary_text_never_panics(text in "\\PC{0,300}") {
            let _ = read(&text);
        }

        #[test]
        fn property_spoilt_file_never_panics(at in 0..SOUND.len(), with in "[-\\[\\]=0-9a-z\"#.\n]{0,4}") {
            let mut text = SOUND.to_string();
            text.replace_range(at..at + 1, &with);
            let _ = read(&text);
        }
    }

    /// Such a train was analysed, and its crossing called healthy.
    #[test]
    fn regress_bogies_that_overlap_are_refused() {
        for (centres, spacing) in [("3.0", "4.0"), ("3.0", "3.0")] {
            let text = SOUND.replace("bogie_centres_m = 17.7", &format!("bogie_centres_m = {centres}"));
            let text = text.replace("axle_spacing_m = 2.9", &format!("axle_spacing_m = {spacing}"));
            let error = read(&text).unwrap_err().to_string();
            assert!(error.contains("axle_spacing_m") && error.contains("overlap"), "{error}");
        }
    }

    #[test]
    fn property_every_key_is_needed() {
        for (k, line) in SOUND.lines().enumerate().filter(|(_, l)| l.contains(" = ")) {
            let rest: Vec<&str> =
                SOUND.lines().enumerate().filter(|(i, _)| *i != k).map(|(_, l)| l).collect();
            let name = line.split(' ').next().unwrap();
            // These describe the file or repeat the documentation.
            let optional = ["format_version", "sign_convention", "quantity", "antialias"];
            let optional = optional.contains(&name) || ["x_origin", "x_positive", "y_origin"].contains(&name);
            match read(&rest.join("\n")) {
                Ok(_) => assert!(optional, "{name} can be left out"),
                Err(error) => assert!(error.to_string().contains(name), "{error} does not name {name}"),
            }
        }
    }
}
