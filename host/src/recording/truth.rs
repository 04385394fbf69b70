//! `truth.parquet` and `truth.toml`: what really happened, for scoring only.
//!
//! Only the scoring of `demo`, `verify` and the tests use this module; `analyse`, `kernel` and `diagnose` never do.

use std::borrow::Cow;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::RecordingError;
use super::files::{create_dir, read_text, write_atomic};
use super::table::{Cells, Column, Kind, for_each_batch, write_columns};

/// Everything known about a simulated site.
#[derive(Clone, Debug)]
pub struct Truth {
    /// One per passage and wheel, in file order.
    pub wheels: Vec<WheelTruth>,
    /// `truth.toml`.
    pub site: SiteTruth,
}

/// Which rail a wheel runs on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The rail with the crossing.
    Crossing,
    /// The other rail.
    Stock,
}

/// One wheel in one passage.
#[derive(Clone, Debug, PartialEq)]
pub struct WheelTruth {
    /// As in `passages.parquet`.
    pub passage_id: i32,
    /// 0 is the first axle of the train.
    pub wheelset: usize,
    /// Rail.
    pub side: Side,
    /// x, metres, on a 10 mm grid.
    pub position_m: Vec<f64>,
    /// Unfiltered contact force at these positions, newtons.
    pub contact_force_n: Vec<f64>,
    /// Speed of the first axle at the instrumented sleeper, m/s.
    pub true_speed_m_s: f64,
    /// Displacement of the sleeper at the sensor, metres, one per sample of the recording; only in the row of
    /// wheelset 0 on the crossing side.
    pub sleeper_displacement_m: Option<Vec<f64>>,
}

/// `truth.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SiteTruth {
    /// Deviations from the nominal description; free-form.
    #[serde(default = "no_effects")]
    pub effects: toml::Value,
    /// Ballast.
    pub ballast: BallastTruth,
    /// Shape of the crossing; free-form.
    #[serde(default = "empty_table")]
    pub geometry: toml::Value,
}

fn no_effects() -> toml::Value {
    toml::Value::Array(Vec::new())
}

fn empty_table() -> toml::Value {
    toml::Value::Table(toml::Table::new())
}

/// True ballast stiffness.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BallastTruth {
    /// Sleeper number minus crossing sleeper number of the first entry.
    pub first_sleeper_offset: i64,
    /// Per sleeper, N/m².
    pub stiffness_n_m2: Vec<f64>,
    /// p1 (N/m²), p2 (N/m²), p3, where the stiffness follows that shape.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p1_p2_p3: Option<[f64; 3]>,
}

const COLUMNS: [(&str, Kind); 7] = [
    ("passage_id", Kind::Integer),
    ("wheelset", Kind::Integer),
    ("side", Kind::Text),
    ("position_m", Kind::Numbers),
    ("contact_force_n", Kind::Numbers),
    ("true_speed_m_s", Kind::Number),
    ("sleeper_displacement_m", Kind::Numbers),
];

/// Whether the site has the forces that [`read_truth`] needs.
pub fn has_truth(dir: &Path) -> bool {
    dir.join("truth.parquet").is_file() && dir.join("truth.toml").is_file()
}

/// Reads both truth files.
pub fn read_truth(dir: &Path) -> Result<Truth, RecordingError> {
    let file = dir.join("truth.parquet");
    let mut wheels = Vec::new();
    for_each_batch(&file, &COLUMNS, |cells| {
        for i in 0..cells.rows() {
            let row = wheels.len();
            wheels.push(wheel(cells, i).map_err(|column| RecordingError::Cell {
                file: file.clone(),
                column,
                row,
                fault: "is null or not possible".into(),
            })?);
        }
        Ok(())
    })?;
    Ok(Truth { wheels, site: read_site_truth(dir)? })
}

/// Reads `truth.toml` alone.
pub fn read_site_truth(dir: &Path) -> Result<SiteTruth, RecordingError> {
    let file = dir.join("truth.toml");
    toml::from_str(&read_text(&file)?)
        .map_err(|e| RecordingError::Toml { file: file.clone(), reason: e.to_string() })
}

/// One row; on failure the column that is at fault.
fn wheel(cells: &Cells, i: usize) -> Result<WheelTruth, &'static str> {
    let side = match cells.text("side", i) {
        Some("crossing") => Side::Crossing,
        Some("stock") => Side::Stock,
        _ => return Err("side"),
    };
    let position_m = cells.numbers("position_m", i).ok_or("position_m")?;
    let contact_force_n = cells.numbers("contact_force_n", i).ok_or("contact_force_n")?;
    if position_m.len() != contact_force_n.len() {
        return Err("contact_force_n");
    }
    let finite = |values: &[f64]| values.iter().all(|v| v.is_finite());
    if !finite(&position_m) || !finite(&contact_force_n) {
        return Err(if finite(&position_m) { "contact_force_n" } else { "position_m" });
    }
    let integer = |column| cells.integer(column, i).ok_or(column);
    Ok(WheelTruth {
        passage_id: i32::try_from(integer("passage_id")?).map_err(|_| "passage_id")?,
        wheelset: usize::try_from(integer("wheelset")?).map_err(|_| "wheelset")?,
        side,
        position_m,
        contact_force_n,
        true_speed_m_s: cells.number("true_speed_m_s", i).ok_or("true_speed_m_s")?,
        sleeper_displacement_m: cells.numbers("sleeper_displacement_m", i),
    })
}

/// Writes both truth files.
pub fn write_truth(dir: &Path, truth: &Truth) -> Result<(), RecordingError> {
    create_dir(dir)?;
    let file = dir.join("truth.toml");
    let text = toml::to_string(&truth.site)
        .map_err(|e| RecordingError::Toml { file: file.clone(), reason: e.to_string() })?;
    write_atomic(&file, text.as_bytes())?;
    let w = &truth.wheels;
    let side = |side| if side == Side::Crossing { "crossing" } else { "stock" };
    let columns = [
        ("passage_id", Column::Integers(w.iter().map(|w| Some(w.passage_id)).collect())),
        ("wheelset", Column::Integers(w.iter().map(|w| i32::try_from(w.wheelset).ok()).collect())),
        ("side", Column::Texts(w.iter().map(|w| side(w.side)).collect())),
        ("position_m", lists(w, |w| Some(&w.position_m))),
        ("contact_force_n", lists(w, |w| Some(&w.contact_force_n))),
        ("true_speed_m_s", Column::Numbers(w.iter().map(|w| Some(w.true_speed_m_s)).collect())),
        ("sleeper_displacement_m", lists(w, |w| w.sleeper_displacement_m.as_deref())),
    ];
    write_columns(&dir.join("truth.parquet"), &columns)
}

/// The format keeps these lists in float32.
fn lists<'a>(wheels: &'a [WheelTruth], list: impl Fn(&'a WheelTruth) -> Option<&'a [f64]>) -> Column<'a> {
    let narrow = |values: &[f64]| Cow::Owned(values.iter().map(|&v| v as f32).collect());
    Column::SingleLists(wheels.iter().map(|wheel| list(wheel).map(narrow)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regress_truth_survives_writing() {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field/reference-1");
        let mut truth = read_truth(&dir).unwrap();
        // 24 passages, 12 wheelsets, 2 sides.
        assert_eq!(truth.wheels.len(), 24 * 12 * 2);
        assert_eq!(truth.site.ballast.p1_p2_p3, Some([30e6, 18e6, 0.35]));
        truth.wheels.truncate(5);
        let out = tempfile::tempdir().unwrap();
        write_truth(out.path(), &truth).unwrap();
        let again = read_truth(out.path()).unwrap();
        assert_eq!(again.wheels, truth.wheels);
        assert_eq!(again.site, truth.site);
    }
}
