//! Reads the field recordings of tests/data/field for tests of the node. Small on purpose: the real reader, with
//! its checks, is the host's.

use std::path::PathBuf;

use cpcm_tests::rows::{self, Row};

/// One recording.
pub struct Recording {
    /// Acceleration at 4 kHz, m/s².
    pub acceleration_m_s2: Vec<f32>,
    /// True speed where it is known, else the operator's, m/s.
    pub speed_m_s: Option<f64>,
    /// Whether the speed is the true one.
    pub speed_is_true: bool,
}

/// Axles of the train of all sites, m behind the first: three X2-like cars.
pub fn axle_offsets_m() -> Vec<f32> {
    train(3, 24.95, 17.7, 2.9)
}

/// Axles of a train of equal cars with two bogies each.
pub fn train(cars: u32, car_m: f32, bogies_m: f32, axles_m: f32) -> Vec<f32> {
    let car = [0.0, axles_m, bogies_m, bogies_m + axles_m];
    (0..cars).flat_map(|i| car.map(|x| i as f32 * car_m + x)).collect()
}

/// All recordings of a site.
pub fn recordings(site: &str) -> Vec<Recording> {
    let mut speeds = true_speeds(site).into_iter();
    let recording = |row: Row| {
        let truth = speeds.next();
        Recording {
            acceleration_m_s2: row.numbers("acceleration_m_s2").iter().map(|&a| a as f32).collect(),
            speed_m_s: truth.or_else(|| row.optional("speed_m_s")),
            speed_is_true: truth.is_some(),
        }
    };
    rows::read(&path(site, "passages.parquet")).into_iter().map(recording).collect()
}

fn true_speeds(site: &str) -> Vec<f64> {
    let file = path(site, "truth.parquet");
    if !file.exists() {
        return Vec::new();
    }
    let first = |row: &Row| row.number("wheelset") == 0.0 && row.text("side") == "crossing";
    rows::read(&file).iter().filter(|row| first(row)).map(|row| row.number("true_speed_m_s")).collect()
}

fn path(site: &str, file: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("data/field").join(site).join(file)
}
