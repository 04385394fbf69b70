//! Site directories: `crossing.toml`, recordings (Parquet or CSV), optional laser scan.

mod crossing;

pub use crossing::*;

/// One crossing panel recorded over a number of train passages.
#[derive(Clone, Debug)]
pub struct Site {
    /// What the operator knows.
    pub crossing: Crossing,
    /// Usable recordings, in file order.
    pub passages: Vec<Passage>,
    /// Laser scan of the crossing, where there is one.
    pub scan: Option<Scan>,
    /// Passages that were left out, each with its reason.
    pub skipped: Vec<Skipped>,
}

/// One recorded train passage.
#[derive(Clone, Debug)]
pub struct Passage {
    /// Identifier in the file.
    pub passage_id: i32,
    /// Train type as classified by the operator.
    pub train_type: String,
    /// Axle load assumed by the operator, kg.
    pub axle_load_kg: f64,
    /// Operator's speed, m/s, within about 1 %; absent at some sites.
    pub speed_m_s: Option<f64>,
    /// Temperature at the sensor, °C.
    pub temperature_c: f64,
    /// Nominal sampling rate, Hz.
    pub sample_rate_hz: f64,
    /// Sleeper acceleration, m/s², positive downwards.
    pub acceleration_m_s2: Vec<f32>,
}

/// Vertical path of a nominal wheel over the crossing, relative to the undeformed running plane.
#[derive(Clone, Debug, PartialEq)]
pub struct Scan {
    /// x, metres, ascending.
    pub position_m: Vec<f64>,
    /// Positive down, metres.
    pub irregularity_m: Vec<f64>,
}

/// A passage that was left out.
#[derive(Clone, Debug, PartialEq)]
pub struct Skipped {
    /// Identifier in the file, where it could be read.
    pub passage_id: Option<i32>,
    /// Row in the file, counted from 0.
    pub row: usize,
    /// What is wrong and what to do about it.
    pub reason: String,
}
