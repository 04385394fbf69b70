//! What can be wrong with a site directory, each with the numbers and what to do.

use std::path::PathBuf;

/// A site directory that cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum RecordingError {
    #[error("cannot {doing} {path}: {source}")]
    Io { doing: &'static str, path: PathBuf, source: std::io::Error },

    #[error("there is no directory {path}; check the path of the site")]
    NoDirectory { path: PathBuf },

    #[error("{path} is a file; name the site directory that holds it")]
    SiteIsAFile { path: PathBuf },

    #[error(
        "{path} is not a site directory: {missing} is missing; a site holds crossing.toml and \
         passages.parquet (or passages.csv with passages/*.csv)"
    )]
    NotASite { path: PathBuf, missing: &'static str },

    #[error(
        "{path} holds both passages.parquet and passages.csv; remove the one that is not meant, so that \
         it is clear which recordings count"
    )]
    TwoRecordings { path: PathBuf },

    #[error("{path} is a file; name a directory for the results")]
    NotADirectory { path: PathBuf },

    #[error("there is no directory {path}; create it, or name another file")]
    NoParent { path: PathBuf },

    #[error("{path} is there and is no file; name another one")]
    NotAFile { path: PathBuf },

    #[error(
        "{dir} already holds {name}, which would be replaced or mixed with what is written; name a new directory"
    )]
    Occupied { dir: PathBuf, name: &'static str },

    #[error("{file} is {bytes} bytes long, more than the {limit} bytes that a site may hold; split the site")]
    TooLarge { file: PathBuf, bytes: u64, limit: u64 },

    #[error("{file}: not valid TOML: {reason}")]
    Toml { file: PathBuf, reason: String },

    #[error("{file}: key `{key}`: {reason}")]
    Key { file: PathBuf, key: String, reason: String },

    #[error("{file}: key `{key}` = {value} is outside {min} … {max} {unit}; {hint}")]
    KeyRange {
        file: PathBuf,
        key: &'static str,
        value: f64,
        min: f64,
        max: f64,
        unit: &'static str,
        hint: &'static str,
    },

    #[error(
        "{file} cannot be read: {reason}; the file is truncated or damaged: copy it again from the source"
    )]
    Damaged { file: PathBuf, reason: String },

    #[error("{file}: column `{column}` is missing (columns present: {present}); add it")]
    MissingColumn { file: PathBuf, column: &'static str, present: String },

    #[error("{file}: column `{column}` has type {found}, expected {expected}; convert the column")]
    ColumnType { file: PathBuf, column: &'static str, found: String, expected: &'static str },

    #[error("{file}: column `{column}`, row {row}: {fault}")]
    Cell { file: PathBuf, column: &'static str, row: usize, fault: String },

    #[error("{file} has no rows; record at least one train passage")]
    NoRows { file: PathBuf },

    #[error("{file}: none of the {rows} passages can be used; the first: {first}")]
    NoUsablePassages { file: PathBuf, rows: usize, first: String },
}

/// Why one passage cannot be used. The passages around it are not affected.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum PassageFault {
    #[error(
        "the row has {found} fields, the header {expected}; put text that holds a comma in quotes, or complete the row"
    )]
    Fields { found: usize, expected: usize },

    #[error("column `{column}` is null; fill in the value or remove the row")]
    Null { column: &'static str },

    #[error("column `{column}` is {value}; only finite numbers can be used")]
    NotFinite { column: &'static str, value: f64 },

    #[error("column `acceleration_m_s2`, sample {sample} is {value}; only finite numbers can be used")]
    SampleNotFinite { sample: usize, value: f32 },

    #[error("column `acceleration_m_s2`, sample {sample} is null; repair the recording or remove the row")]
    SampleNull { sample: usize },

    #[error("column `acceleration_m_s2` is empty; remove the row")]
    EmptyRecording,

    #[error(
        "column `acceleration_m_s2` holds {samples} samples, more than {limit}; one row is one train passage"
    )]
    LongRecording { samples: usize, limit: usize },

    #[error(
        "column `acceleration_m_s2` lasts {seconds:.2} s, but the train takes at least {needed:.2} s; the \
         recording is cut short"
    )]
    ShortRecording { seconds: f64, needed: f64 },

    #[error("column `{column}` = {value} is outside {min} … {max} {unit}; {hint}")]
    OutOfRange {
        column: &'static str,
        value: f64,
        min: f64,
        max: f64,
        unit: &'static str,
        hint: &'static str,
    },

    #[error(
        "column `sample_rate_hz` = {value}, but crossing.toml says {expected} Hz; resample the recording or \
         correct crossing.toml"
    )]
    SampleRate { value: f64, expected: f64 },

    #[error(
        "column `acceleration_m_s2` reaches {peak:.1}, beyond the sensor range of {range:.1} m/s²; is it in \
         mm/s² or in raw counts?"
    )]
    BeyondRange { peak: f64, range: f64 },

    #[error(
        "column `acceleration_m_s2` is quieter ({noise:.4} m/s² rms) than the noise of the sensor \
         ({nominal} m/s² rms); is it in g? Multiply by 9.81"
    )]
    TooQuiet { noise: f64, nominal: f64 },

    #[error(
        "column `acceleration_m_s2` is {value} m/s² for {:.0} ms while the track shakes: the recorder held a value or filled a gap; see \
         to sensor, cable and memory",
        1e3 * seconds
    )]
    Held { value: f64, seconds: f64 },

    #[error(
        "column `acceleration_m_s2`: the recording {end} under the train ({level:.2} m/s² rms there, {quiet:.2} where it is quietest); \
         record 0.3 s before and after it"
    )]
    TrainCut { end: &'static str, level: f64, quiet: f64 },

    #[error(
        "column `acceleration_m_s2` never exceeds {peak:.2} m/s²: no train in the recording, a dead sensor, \
         or the unit is g"
    )]
    NoTrain { peak: f64 },

    #[error(
        "column `passage_id` = {passage_id} is already used by row {first_row}; give each passage its own"
    )]
    DuplicateId { passage_id: i32, first_row: usize },

    #[error("column `passage_id` = {value} does not fit a 32-bit integer; renumber the passages")]
    IdTooLarge { value: i64 },

    #[error("column `{column}` reads `{text}`, which is not a number")]
    NotANumber { column: &'static str, text: String },

    #[error("column `file`: {reason}")]
    SampleFile { reason: String },
}
