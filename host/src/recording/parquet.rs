//! Parquet files of a site: opening with limits, `passages.parquet` in and out.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use arrow_array::builder::{Float32Builder, ListBuilder};
use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Float64Type};
use arrow_array::{Array, ArrayRef, Float64Array, Int32Array, RecordBatch, StringArray};
use arrow_schema::DataType;
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_reader::{ParquetRecordBatchReader, ParquetRecordBatchReaderBuilder};
use parquet::basic::{Compression, ZstdLevel};
use parquet::file::metadata::ParquetMetaData;
use parquet::file::properties::WriterProperties;

use super::check::{Gate, MAX_PASSAGES, MAX_SAMPLES};
use super::files::write_atomic_with;
use super::guard::guarded;
use super::table::{Cells, Kind, check_schema};
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

/// Rows decoded at a time: bounds the memory that one batch of long lists takes.
const BATCH_ROWS: usize = 16;
/// Largest decoded size of a file, bytes. A damaged or hostile footer may promise far more than the disk holds.
const MAX_DECODED_BYTES: i64 = 8 << 30;

/// Reads `passages.parquet`: the usable passages, and the others each with its reason.
pub(super) fn read_passages(
    file: &Path,
    crossing: &Crossing,
) -> Result<(Vec<Passage>, Vec<Skipped>), RecordingError> {
    let mut gate = Gate::new(crossing, "passages.parquet");
    let mut row = 0;
    for_each_batch(file, &COLUMNS, |batch| {
        let cells = Cells(batch);
        for i in 0..batch.num_rows() {
            let id = cells.integer("passage_id", i).and_then(|id| i32::try_from(id).ok());
            gate.admit(row, id, passage(&cells, i));
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
        train_type: cells.text("train_type", i).ok_or(null("train_type"))?,
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
    if let Some(sample) = (0..items.len()).find(|&k| items.is_null(k)) {
        return Err(PassageFault::SampleNull { sample });
    }
    Ok(match items.data_type() {
        DataType::Float32 => items.as_primitive::<Float32Type>().values().to_vec(),
        _ => items.as_primitive::<Float64Type>().values().iter().map(|&a| a as f32).collect(),
    })
}

/// Opens a Parquet file, checks its schema and hands over one batch after the other.
pub(crate) fn for_each_batch(
    file: &Path,
    columns: &[(&'static str, Kind)],
    mut use_batch: impl FnMut(&RecordBatch) -> Result<(), RecordingError>,
) -> Result<(), RecordingError> {
    let damaged = |reason: String| RecordingError::Damaged { file: file.into(), reason };
    let mut reader = guarded(|| open(file, columns)).map_err(damaged)??;
    let mut rows = 0;
    while let Some(batch) = guarded(|| reader.next()).map_err(damaged)? {
        let batch = batch.map_err(|error| damaged(error.to_string()))?;
        rows += batch.num_rows();
        if rows > MAX_PASSAGES {
            return Err(damaged(format!("more than {MAX_PASSAGES} rows")));
        }
        use_batch(&batch)?;
    }
    if rows == 0 { Err(RecordingError::NoRows { file: file.into() }) } else { Ok(()) }
}

fn open(file: &Path, columns: &[(&'static str, Kind)]) -> Result<ParquetRecordBatchReader, RecordingError> {
    let damaged = |reason: String| RecordingError::Damaged { file: file.into(), reason };
    let handle =
        File::open(file).map_err(|source| RecordingError::Io { doing: "open", path: file.into(), source })?;
    let builder = ParquetRecordBatchReaderBuilder::try_new(handle).map_err(|e| damaged(e.to_string()))?;
    check_schema(file, builder.schema(), columns)?;
    check_size(builder.metadata()).map_err(damaged)?;
    builder.with_batch_size(BATCH_ROWS).build().map_err(|e| damaged(e.to_string()))
}

/// Refuses a footer that promises more than a site can hold, before anything is allocated for it.
fn check_size(metadata: &ParquetMetaData) -> Result<(), String> {
    let rows = metadata.file_metadata().num_rows();
    if rows < 0 || rows > MAX_PASSAGES as i64 {
        return Err(format!("it announces {rows} rows"));
    }
    let mut bytes: i64 = 0;
    for column in metadata.row_groups().iter().flat_map(|group| group.columns()) {
        let (size, values) = (column.uncompressed_size(), column.num_values());
        if size < 0 || !(0..=MAX_DECODED_BYTES / 4).contains(&values) {
            return Err(format!("it announces {values} values in {size} bytes in one column"));
        }
        if column.data_page_offset() < 0 || column.compressed_size() < 0 {
            return Err("it announces a column before its beginning".into());
        }
        bytes = bytes.saturating_add(size);
    }
    if bytes > MAX_DECODED_BYTES { Err(format!("it announces {bytes} bytes of data")) } else { Ok(()) }
}

/// Writes `passages.parquet` with the column types of the format.
pub(super) fn write_passages(file: &Path, passages: &[Passage]) -> Result<(), RecordingError> {
    let mut lists = ListBuilder::new(Float32Builder::new());
    for p in passages {
        lists.values().append_slice(&p.acceleration_m_s2);
        lists.append(true);
    }
    let float = |value: fn(&Passage) -> f64| -> ArrayRef {
        Arc::new(passages.iter().map(|p| Some(value(p))).collect::<Float64Array>())
    };
    let columns: [(&str, ArrayRef); 7] = [
        ("passage_id", Arc::new(passages.iter().map(|p| Some(p.passage_id)).collect::<Int32Array>())),
        ("train_type", Arc::new(passages.iter().map(|p| Some(&p.train_type)).collect::<StringArray>())),
        ("axle_load_kg", float(|p| p.axle_load_kg)),
        ("speed_m_s", Arc::new(passages.iter().map(|p| p.speed_m_s).collect::<Float64Array>())),
        ("temperature_c", float(|p| p.temperature_c)),
        ("sample_rate_hz", float(|p| p.sample_rate_hz)),
        ("acceleration_m_s2", Arc::new(lists.finish())),
    ];
    write_columns(file, columns)
}

/// Writes one table, compressed with zstd, under its name only when it is complete.
pub(crate) fn write_columns<const N: usize>(
    file: &Path,
    columns: [(&str, ArrayRef); N],
) -> Result<(), RecordingError> {
    write_atomic_with(file, |out| {
        let batch = RecordBatch::try_from_iter(columns).map_err(std::io::Error::other)?;
        let compression = Compression::ZSTD(ZstdLevel::default());
        let properties = WriterProperties::builder().set_compression(compression).build();
        let mut writer = ArrowWriter::try_new(out, batch.schema(), Some(properties))?;
        writer.write(&batch)?;
        writer.close()?;
        Ok(())
    })
}
