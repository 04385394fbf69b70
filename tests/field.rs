//! Reads the field recordings of tests/data/field for tests of the node. Small on purpose: the real reader, with
//! its checks, is the host's.

use std::path::PathBuf;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Float64Type, Int32Type};
use arrow_array::{Array, RecordBatch};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;

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
    let mut speeds = true_speeds(site);
    let mut out = Vec::new();
    for batch in batches(site, "passages.parquet") {
        let operator = column(&batch, "speed_m_s").as_primitive::<Float64Type>();
        let acceleration = column(&batch, "acceleration_m_s2").as_list::<i32>();
        for row in 0..batch.num_rows() {
            let truth = if speeds.is_empty() { None } else { Some(speeds.remove(0)) };
            out.push(Recording {
                acceleration_m_s2: acceleration.value(row).as_primitive::<Float32Type>().values().to_vec(),
                speed_m_s: truth.or(operator.is_valid(row).then(|| operator.value(row))),
                speed_is_true: truth.is_some(),
            });
        }
    }
    out
}

fn true_speeds(site: &str) -> Vec<f64> {
    let mut speeds = Vec::new();
    if !path(site, "truth.parquet").exists() {
        return speeds;
    }
    for batch in batches(site, "truth.parquet") {
        let wheelset = column(&batch, "wheelset").as_primitive::<Int32Type>();
        let speed = column(&batch, "true_speed_m_s").as_primitive::<Float64Type>();
        let side = column(&batch, "side").as_string::<i32>();
        let first = |&row: &usize| wheelset.value(row) == 0 && side.value(row) == "crossing";
        speeds.extend((0..batch.num_rows()).filter(first).map(|row| speed.value(row)));
    }
    speeds
}

fn path(site: &str, file: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("data/field").join(site).join(file)
}

fn batches(site: &str, file: &str) -> Vec<RecordBatch> {
    let file = std::fs::File::open(path(site, file)).expect("field recording is part of the repository");
    let reader = ParquetRecordBatchReaderBuilder::try_new(file).and_then(|b| b.build()).expect("Parquet");
    reader.map(|batch| batch.expect("whole file")).collect()
}

fn column<'a>(batch: &'a RecordBatch, name: &str) -> &'a dyn Array {
    batch.column_by_name(name).expect("column of FIELD.md")
}
