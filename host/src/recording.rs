//! Site directories: `crossing.toml`, recordings (Parquet or CSV), optional laser scan.

mod check;
mod crossing;
mod crossing_file;
mod error;
mod files;
mod parquet;
mod scan;
mod table;

use std::path::Path;

pub use check::{MAX_PASSAGES, MAX_SAMPLES, check_passage};
pub use crossing::*;
pub use crossing_file::check_crossing;
pub use error::{PassageFault, RecordingError};

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

/// Reads and checks a site directory.
///
/// A fault of the whole (no crossing.toml, a missing column, a truncated file) is an error. A fault of one passage
/// leaves that passage out and lists it in [`Site::skipped`]; when nothing remains, that is an error too.
/// Files named `truth.*` are never opened here.
pub fn read_site(dir: &Path) -> Result<Site, RecordingError> {
    let not_a_site = |missing| RecordingError::NotASite { path: dir.into(), missing };
    let crossing_file = dir.join("crossing.toml");
    if !crossing_file.is_file() {
        return Err(not_a_site("crossing.toml"));
    }
    let crossing = crossing_file::read_crossing(&crossing_file)?;
    let recordings = dir.join("passages.parquet");
    if !recordings.is_file() {
        return Err(not_a_site("passages.parquet"));
    }
    let (passages, skipped) = parquet::read_passages(&recordings, &crossing)?;
    if passages.is_empty() {
        let first = skipped.first().map_or_else(String::new, |s| s.reason.clone());
        return Err(RecordingError::NoUsablePassages { file: recordings, rows: skipped.len(), first });
    }
    let scan_file = dir.join("irregularity.csv");
    let scan = scan_file.is_file().then(|| scan::read_scan(&scan_file)).transpose()?;
    Ok(Site { crossing, passages, scan, skipped })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reference_site_reads_completely() {
        for name in ["reference-1", "reference-2", "reference-3", "known-saturation", "blind-e", "blind-g"] {
            let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field").join(name);
            let site = read_site(&dir).unwrap();
            assert_eq!(site.passages.len(), 24, "{name}");
            assert!(site.skipped.is_empty(), "{name}: {:?}", site.skipped);
            assert!(site.scan.is_some());
        }
    }
}
