//! `forces.parquet`, out and (for tests and comparisons) in.

use std::path::Path;
use std::sync::Arc;

use arrow_array::builder::{Float64Builder, ListBuilder, StringBuilder};
use arrow_array::cast::AsArray;
use arrow_array::{ArrayRef, Float64Array, Int32Array};

use super::ResultsError;
use crate::analysis::{Analysis, PassageResult, WheelsetResult};
use crate::recording::RecordingError;
use crate::recording::parquet::{for_each_batch, write_columns};
use crate::recording::table::{Cells, Kind};

/// Writes one row per passage and wheelset.
pub(super) fn write_forces(file: &Path, analysis: &Analysis) -> Result<(), ResultsError> {
    let rows: Vec<(&PassageResult, &WheelsetResult)> =
        analysis.passages.iter().flat_map(|p| p.wheelsets.iter().map(move |w| (p, w))).collect();
    for (p, w) in &rows {
        check_lengths(p.passage_id, w)?;
    }
    let float = |value: fn(&PassageResult, &WheelsetResult) -> f64| -> ArrayRef {
        Arc::new(rows.iter().map(|(p, w)| Some(value(p, w))).collect::<Float64Array>())
    };
    let list = |value: fn(&WheelsetResult) -> &[f64]| lists(rows.iter().map(|(_, w)| value(w)));
    let passage_ids = rows.iter().map(|(p, _)| Some(p.passage_id)).collect::<Int32Array>();
    let wheelsets = rows.iter().map(|(_, w)| Some(w.wheelset as i32)).collect::<Int32Array>();
    let columns: [(&str, ArrayRef); 14] = [
        ("passage_id", Arc::new(passage_ids)),
        ("wheelset", Arc::new(wheelsets)),
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
        ("flags", text_lists(rows.iter().map(|(_, w)| w.flags.as_slice()))),
    ];
    Ok(write_columns(file, columns)?)
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

fn lists<'a>(rows: impl Iterator<Item = &'a [f64]>) -> ArrayRef {
    let mut builder = ListBuilder::new(Float64Builder::new());
    for values in rows {
        builder.values().append_slice(values);
        builder.append(true);
    }
    Arc::new(builder.finish())
}

fn text_lists<'a>(rows: impl Iterator<Item = &'a [String]>) -> ArrayRef {
    let mut builder = ListBuilder::new(StringBuilder::new());
    for texts in rows {
        texts.iter().for_each(|text| builder.values().append_value(text));
        builder.append(true);
    }
    Arc::new(builder.finish())
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
    for_each_batch(file, &COLUMNS, |batch| {
        let cells = Cells(batch);
        for i in 0..batch.num_rows() {
            let row = rows.len();
            rows.push(force_row(&cells, i).map_err(|column| RecordingError::Cell {
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
    let flags = cells.list("flags", i).ok_or("flags")?;
    let flags = flags.as_string_opt::<i32>().ok_or("flags")?;
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
        flags: flags.iter().flatten().map(str::to_string).collect(),
    })
}
