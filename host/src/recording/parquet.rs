//! `passages.parquet`, in and out.

use std::borrow::Cow;
use std::path::Path;

use super::check::{Gate, MAX_SAMPLES};
use super::table::{Cells, Column, Kind, for_each_batch, write_columns};
use super::{Crossing, Passage, PassageFault, RecordingError, Skipped};

/// Columns of `passages.parquet`.
const COLUMNS: [(&str, Kind); 7] = [
    ("passage_id", Kind::Integer),
    ("train_type", Kind::Text),
    ("axle_load_kg", Kind::Number),
    ("speed_m_s", Kind::Number),
    ("temperature_c", Kind::Number),
    ("sample_rate_hz", Kind::Number),
    ("acceleration_m_s2", Kind::Numbers),
];

/// Reads `passages.parquet`: the usable passages, and the others each with its reason.
pub(super) fn read_passages(
    file: &Path,
    crossing: &Crossing,
) -> Result<(Vec<Passage>, Vec<Skipped>), RecordingError> {
    let mut gate = Gate::new(crossing, "passages.parquet");
    let mut row = 0;
    for_each_batch(file, &COLUMNS, |cells| {
        for i in 0..cells.rows() {
            let id = cells.integer("passage_id", i).and_then(|id| i32::try_from(id).ok());
            gate.admit(row, id, passage(cells, i));
            row += 1;
        }
        Ok(())
    })?;
    Ok((gate.passages, gate.skipped))
}

fn passage(cells: &Cells, i: usize) -> Result<Passage, PassageFault> {
    let null = |column| PassageFault::Null { column };
    let id = cells.integer("passage_id", i).ok_or(null("passage_id"))?;
    let number = |column| cells.number(column, i).ok_or(null(column));
    Ok(Passage {
        passage_id: i32::try_from(id).map_err(|_| PassageFault::IdTooLarge { value: id })?,
        train_type: cells.text("train_type", i).ok_or(null("train_type"))?.to_string(),
        axle_load_kg: number("axle_load_kg")?,
        speed_m_s: cells.number("speed_m_s", i),
        temperature_c: number("temperature_c")?,
        sample_rate_hz: number("sample_rate_hz")?,
        acceleration_m_s2: samples(cells, i)?,
    })
}

fn samples(cells: &Cells, i: usize) -> Result<Vec<f32>, PassageFault> {
    let column = "acceleration_m_s2";
    let items = cells.list(column, i).ok_or(PassageFault::Null { column })?;
    if items.len() > MAX_SAMPLES {
        return Err(PassageFault::LongRecording { samples: items.len(), limit: MAX_SAMPLES });
    }
    let sample = |(sample, item): (usize, &Option<f64>)| match item {
        Some(value) => Ok(*value as f32),
        None => Err(PassageFault::SampleNull { sample }),
    };
    items.iter().enumerate().map(sample).collect()
}

/// Writes `passages.parquet` with the column types of the format.
pub(super) fn write_passages(file: &Path, passages: &[Passage]) -> Result<(), RecordingError> {
    let number = |value: fn(&Passage) -> Option<f64>| Column::Numbers(passages.iter().map(value).collect());
    let samples = passages.iter().map(|p| Some(Cow::Borrowed(p.acceleration_m_s2.as_slice()))).collect();
    let columns = [
        ("passage_id", Column::Integers(passages.iter().map(|p| Some(p.passage_id)).collect())),
        ("train_type", Column::Texts(passages.iter().map(|p| p.train_type.as_str()).collect())),
        ("axle_load_kg", number(|p| Some(p.axle_load_kg))),
        ("speed_m_s", number(|p| p.speed_m_s)),
        ("temperature_c", number(|p| Some(p.temperature_c))),
        ("sample_rate_hz", number(|p| Some(p.sample_rate_hz))),
        ("acceleration_m_s2", Column::SingleLists(samples)),
    ];
    write_columns(file, &columns)
}
