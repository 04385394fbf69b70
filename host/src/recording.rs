//! Site directories: `crossing.toml`, recordings (Parquet or CSV), optional laser scan.

mod check;
mod crossing;
mod crossing_file;
mod csv;
mod error;
pub(crate) mod files;
mod guard;
mod mat;
mod mseed;
mod number;
mod parquet;
mod samples;
mod scan;
pub mod table;
pub mod truth;

use std::path::Path;

pub use check::{MAX_PASSAGES, MAX_SAMPLES, TEMPERATURE_C, check_passage};
pub use crossing::*;
pub use crossing_file::check_crossing;
pub use error::{PassageFault, RecordingError};
pub use guard::silence_guarded_panics;
pub use scan::POSITION_M;

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

impl Site {
    /// The same site with other passages, such as a part of its own.
    pub fn with_passages(&self, passages: Vec<Passage>) -> Self {
        let (crossing, scan, skipped) = (self.crossing.clone(), self.scan.clone(), self.skipped.clone());
        Self { crossing, passages, scan, skipped }
    }
}

/// One recorded train passage.
#[derive(Clone, Debug, PartialEq)]
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

#[cfg(test)]
impl Passage {
    /// A function of time, in seconds, recorded for `duration_s`, of a train of which nothing is stated.
    pub(crate) fn of_function(sample_rate_hz: f64, duration_s: f64, value_m_s2: impl Fn(f64) -> f64) -> Self {
        let sample = |k: usize| value_m_s2(k as f64 / sample_rate_hz) as f32;
        Self {
            passage_id: 1,
            train_type: String::new(),
            axle_load_kg: 16e3,
            speed_m_s: None,
            temperature_c: 20.0,
            sample_rate_hz,
            acceleration_m_s2: (0..(duration_s * sample_rate_hz) as usize).map(sample).collect(),
        }
    }
}

/// Vertical path of a nominal wheel over the crossing, relative to the undeformed running plane.
#[derive(Clone, Debug, PartialEq)]
pub struct Scan {
    /// x, metres, ascending.
    pub position_m: Vec<f64>,
    /// Positive down, metres.
    pub irregularity_m: Vec<f64>,
}

/// A passage that was left out. Serialised as it stands in the results.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
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
    if !dir.is_dir() {
        return Err(match dir.exists() {
            true => RecordingError::SiteIsAFile { path: dir.into() },
            false => RecordingError::NoDirectory { path: dir.into() },
        });
    }
    let crossing_file = dir.join("crossing.toml");
    if !crossing_file.is_file() {
        return Err(not_a_site("crossing.toml"));
    }
    let crossing = crossing_file::read_crossing(&crossing_file)?;
    let (recordings, index) = (dir.join("passages.parquet"), dir.join("passages.csv"));
    let (recordings, (passages, skipped)) = match (recordings.is_file(), index.is_file()) {
        (true, false) => (recordings.clone(), parquet::read_passages(&recordings, &crossing)?),
        (false, true) => (index, csv::read_passages(dir, &crossing)?),
        (true, true) => return Err(RecordingError::TwoRecordings { path: dir.into() }),
        (false, false) => return Err(not_a_site("passages.parquet")),
    };
    if passages.is_empty() {
        let first = skipped.first().map_or_else(String::new, |s| s.reason.clone());
        return Err(RecordingError::NoUsablePassages { file: recordings, rows: skipped.len(), first });
    }
    let scan_file = dir.join("irregularity.csv");
    let scan = scan_file.is_file().then(|| scan::read_scan(&scan_file)).transpose()?;
    Ok(Site { crossing, passages, scan, skipped })
}

/// Reads and checks the description in a file that may hold more than that.
pub(crate) fn read_crossing_file(file: &Path) -> Result<Crossing, RecordingError> {
    crossing_file::read_crossing(file)
}

/// Reads and checks a laser scan.
pub(crate) fn read_scan_file(file: &Path) -> Result<Scan, RecordingError> {
    scan::read_scan(file)
}

/// How the recordings of a site are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// `passages.parquet`.
    Parquet,
    /// `passages.csv` and `passages/NNN.csv`.
    Csv,
}

/// How the recordings in a site directory are stored, judged by the files that are there.
pub fn format_of(dir: &Path) -> Format {
    if dir.join("passages.csv").is_file() { Format::Csv } else { Format::Parquet }
}

/// What a site directory holds. Others would be replaced, or taken for a part of a site that is written beside them.
const SITE: [&str; 5] = ["passages.parquet", "passages.csv", "passages", "crossing.toml", "irregularity.csv"];

/// Refuses a directory that holds a site already, or a part of one; recordings cannot be made again.
pub fn check_unoccupied(dir: &Path) -> Result<(), RecordingError> {
    match SITE.into_iter().find(|name| dir.join(name).exists()) {
        Some(name) => Err(RecordingError::Occupied { dir: dir.into(), name }),
        None => Ok(()),
    }
}

/// Writes a site directory. A new one appears under its name when it is complete, each file in one that is there when that is.
pub fn write_site(dir: &Path, site: &Site, format: Format) -> Result<(), RecordingError> {
    match dir.symlink_metadata() {
        Err(_) => files::create_dir_with(dir, |new| write_files(new, site, format)),
        Ok(_) => write_files(dir, site, format),
    }
}

fn write_files(dir: &Path, site: &Site, format: Format) -> Result<(), RecordingError> {
    files::create_dir(dir)?;
    crossing_file::write_crossing(&dir.join("crossing.toml"), &site.crossing)?;
    if let Some(scan) = &site.scan {
        scan::write_scan(&dir.join("irregularity.csv"), scan)?;
    }
    match format {
        Format::Parquet => parquet::write_passages(&dir.join("passages.parquet"), &site.passages),
        Format::Csv => csv::write_passages(dir, &site.passages),
    }
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

    #[test]
    fn regress_site_survives_both_formats() {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field/reference-3");
        let mut site = read_site(&dir).unwrap();
        site.passages.truncate(3);
        for format in [Format::Parquet, Format::Csv] {
            let out = tempfile::tempdir().unwrap();
            write_site(out.path(), &site, format).unwrap();
            assert_eq!(format_of(out.path()), format);
            let again = read_site(out.path()).unwrap();
            assert_eq!(again.crossing, site.crossing);
            assert_eq!(again.passages, site.passages);
            assert_eq!(again.scan, site.scan);
        }
    }
}
