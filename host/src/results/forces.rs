//! `forces.parquet`, out and (for tests and comparisons) in.

use std::path::Path;

use super::ResultsError;
use crate::analysis::{Analysis, PassageResult, WheelsetResult};
use crate::recording::RecordingError;
use crate::recording::table::{Cells, Column, Kind, for_each_batch, write_columns};

/// Writes one row per passage and wheelset.
pub(super) fn write_forces(file: &Path, analysis: &Analysis) -> Result<(), ResultsError> {
    let rows: Vec<(&PassageResult, &WheelsetResult)> =
        analysis.passages.iter().flat_map(|p| p.wheelsets.iter().map(move |w| (p, w))).collect();
    for (p, w) in &rows {
        check_lengths(p.passage_id, w)?;
    }
    let float = |value: fn(&PassageResult, &WheelsetResult) -> f64| {
        Column::Numbers(rows.iter().map(|(p, w)| Some(value(p, w))).collect())
    };
    let list = |value: fn(&WheelsetResult) -> &[f64]| {
        Column::NumberLists(rows.iter().map(|(_, w)| value(w)).collect())
    };
    let flags = rows.iter().map(|(_, w)| w.flags.iter().map(String::as_str).collect()).collect();
    let columns = [
        ("passage_id", Column::Integers(rows.iter().map(|(p, _)| Some(p.passage_id)).collect())),
        ("wheelset", Column::Integers(rows.iter().map(|(_, w)| i32::try_from(w.wheelset).ok()).collect())),
        ("speed_m_s", float(|p, _| p.speed_m_s)),
        ("position_m", list(|w| &w.position_m)),
        ("contact_force_n", list(|w| &w.contact_force_n)),
        ("lower_n", list(|w| &w.lower_n)),
        ("upper_n", list(|w| &w.upper_n)),
        ("peak_force_n", float(|_, w| w.peak_force_n.value)),
        ("peak_position_m", float(|_, w| w.peak_position_m)),
        ("peak_lower_n", float(|_, w| w.peak_force_n.lower)),
        ("peak_upper_n", float(|_, w| w.peak_force_n.upper)),
        ("irregularity_m", list(|w| &w.irregularity_m)),
        ("irregularity_rms_m", float(|_, w| w.irregularity_rms_m)),
        ("flags", Column::TextLists(flags)),
    ];
    Ok(write_columns(file, &columns)?)
}

/// All vectors of a wheelset share one grid; a reader of the file relies on that.
fn check_lengths(passage_id: i32, w: &WheelsetResult) -> Result<(), ResultsError> {
    let expected = w.position_m.len();
    let vectors = [
        ("contact_force_n", w.contact_force_n.len()),
        ("lower_n", w.lower_n.len()),
        ("upper_n", w.upper_n.len()),
        ("irregularity_m", w.irregularity_m.len()),
    ];
    match vectors.into_iter().find(|&(_, found)| found != expected) {
        Some((column, found)) => {
            Err(ResultsError::Ragged { passage_id, wheelset: w.wheelset, column, found, expected })
        }
        None => Ok(()),
    }
}

/// One row of `forces.parquet`; names and units are those of the file.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct ForceRow {
    pub passage_id: i32,
    pub wheelset: usize,
    pub speed_m_s: f64,
    pub position_m: Vec<f64>,
    pub contact_force_n: Vec<f64>,
    pub lower_n: Vec<f64>,
    pub upper_n: Vec<f64>,
    pub peak_force_n: f64,
    pub peak_position_m: f64,
    pub peak_lower_n: f64,
    pub peak_upper_n: f64,
    pub irregularity_m: Vec<f64>,
    pub irregularity_rms_m: f64,
    pub flags: Vec<String>,
}

const COLUMNS: [(&str, Kind); 14] = [
    ("passage_id", Kind::Integer),
    ("wheelset", Kind::Integer),
    ("speed_m_s", Kind::Number),
    ("position_m", Kind::Numbers),
    ("contact_force_n", Kind::Numbers),
    ("lower_n", Kind::Numbers),
    ("upper_n", Kind::Numbers),
    ("peak_force_n", Kind::Number),
    ("peak_position_m", Kind::Number),
    ("peak_lower_n", Kind::Number),
    ("peak_upper_n", Kind::Number),
    ("irregularity_m", Kind::Numbers),
    ("irregularity_rms_m", Kind::Number),
    ("flags", Kind::Texts),
];

/// Reads `forces.parquet`.
pub fn read_forces(file: &Path) -> Result<Vec<ForceRow>, RecordingError> {
    let mut rows = Vec::new();
    for_each_batch(file, &COLUMNS, |cells| {
        for i in 0..cells.rows() {
            let row = rows.len();
            rows.push(force_row(cells, i).map_err(|column| RecordingError::Cell {
                file: file.into(),
                column,
                row,
                fault: "is null or not possible".into(),
            })?);
        }
        Ok(())
    })?;
    Ok(rows)
}

/// One row; on failure the column that is at fault.
fn force_row(cells: &Cells, i: usize) -> Result<ForceRow, &'static str> {
    let integer = |column| cells.integer(column, i).ok_or(column);
    let number = |column| cells.number(column, i).ok_or(column);
    let numbers = |column| cells.numbers(column, i).ok_or(column);
    Ok(ForceRow {
        passage_id: i32::try_from(integer("passage_id")?).map_err(|_| "passage_id")?,
        wheelset: usize::try_from(integer("wheelset")?).map_err(|_| "wheelset")?,
        speed_m_s: number("speed_m_s")?,
        position_m: numbers("position_m")?,
        contact_force_n: numbers("contact_force_n")?,
        lower_n: numbers("lower_n")?,
        upper_n: numbers("upper_n")?,
        peak_force_n: number("peak_force_n")?,
        peak_position_m: number("peak_position_m")?,
        peak_lower_n: number("peak_lower_n")?,
        peak_upper_n: number("peak_upper_n")?,
        irregularity_m: numbers("irregularity_m")?,
        irregularity_rms_m: number("irregularity_rms_m")?,
        flags: cells.texts("flags", i).ok_or("flags")?,
    })
}
