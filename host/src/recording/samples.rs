//! Sample files of one passage: CSV, MAT v5, miniSEED.
//!
//! | ending | content |
//! |---|---|
//! | `.csv` | column `acceleration_m_s2`, m/s², one sample per row; other columns are ignored |
//! | `.mat` | MAT v5 (`save -v7` or `-v6`), numeric array `acceleration_m_s2`, m/s² |
//! | `.mseed`, `.miniseed` | version 2 or 3, one channel without gaps; floats are m/s², integers need `m_s2_per_count` |

use std::path::Path;

use matfile::{MatFile, NumericData};

use super::check::MAX_SAMPLES;
use super::files::read_bytes;
use super::guard::guarded;
use super::{PassageFault, mseed};

/// What the index says about a sample file.
pub(super) struct Source<'a> {
    pub(super) file: &'a Path,
    pub(super) sample_rate_hz: f64,
    pub(super) m_s2_per_count: Option<f64>,
}

const COLUMN: &str = "acceleration_m_s2";

/// Reads the samples, m/s².
pub(super) fn read(source: &Source) -> Result<Vec<f32>, PassageFault> {
    let refuse = |reason| PassageFault::SampleFile { reason };
    let name = source.file.display();
    let bytes = read_bytes(source.file).map_err(|e| refuse(e.to_string()))?;
    let ending = source.file.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    match ending.as_deref() {
        Some("csv") => from_csv(&bytes),
        Some("mat") => from_mat(bytes).map_err(|reason| refuse(format!("{name}: {reason}"))),
        Some("mseed" | "miniseed") => guarded(|| mseed::samples(&bytes, source))
            .and_then(|samples| samples)
            .map_err(|reason| refuse(format!("{name}: {reason}"))),
        _ => Err(refuse(format!("{name} has an unknown ending; use .csv, .mat or .mseed"))),
    }
}

fn from_csv(bytes: &[u8]) -> Result<Vec<f32>, PassageFault> {
    let refuse = |reason| PassageFault::SampleFile { reason };
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(bytes);
    let headers = reader.byte_headers().map_err(|e| refuse(e.to_string()))?;
    let place = headers
        .iter()
        .position(|h| h == COLUMN.as_bytes())
        .ok_or_else(|| refuse(format!("column `{COLUMN}` is missing in the sample file; add the header")))?;
    let mut samples = Vec::new();
    for record in reader.byte_records() {
        let record = record.map_err(|e| refuse(e.to_string()))?;
        let text = String::from_utf8_lossy(record.get(place).unwrap_or_default());
        if samples.len() == MAX_SAMPLES {
            return Err(PassageFault::LongRecording { samples: MAX_SAMPLES + 1, limit: MAX_SAMPLES });
        }
        if text.is_empty() {
            return Err(PassageFault::SampleNull { sample: samples.len() });
        }
        samples.push(
            text.parse()
                .map_err(|_| refuse(format!("sample {} reads `{text}`, not a number", samples.len())))?,
        );
    }
    Ok(samples)
}

/// The samples as a sample file. The shortest text that gives the same f32 again.
pub(super) fn to_csv(samples: &[f32]) -> String {
    let mut text = format!("{COLUMN}\n");
    for a in samples {
        text.push_str(&a.to_string());
        text.push('\n');
    }
    text
}

/// The `matfile` crate calls itself alpha; a damaged file that trips it must not end the program.
fn from_mat(bytes: Vec<u8>) -> Result<Vec<f32>, String> {
    let mat = guarded(|| MatFile::parse(bytes.as_slice()))?.map_err(|e| e.to_string())?;
    let array = mat
        .find_by_name(COLUMN)
        .ok_or_else(|| format!("no numeric array `{COLUMN}`; save it with `save -v7`"))?;
    match array.data() {
        NumericData::Double { real, imag: None } => Ok(real.iter().map(|&a| a as f32).collect()),
        NumericData::Single { real, imag: None } => Ok(real.clone()),
        _ => Err(format!("array `{COLUMN}` is not real floating point, m/s²; convert it before saving")),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// MAT v5 by its published layout: 128-byte header, then one matrix element of four sub-elements.
    fn mat_v5(name: &str, values: &[f64]) -> Vec<u8> {
        let element = |kind: u32, data: &[u8]| {
            let mut bytes = [kind.to_le_bytes(), (data.len() as u32).to_le_bytes()].concat();
            bytes.extend(data);
            bytes.resize(bytes.len().next_multiple_of(8), 0);
            bytes
        };
        let (double, uint32, int32, int8) = (9, 6, 5, 1);
        let flags = element(uint32, &[6, 0, 0, 0, 0, 0, 0, 0]);
        let size = element(int32, &[1_i32.to_le_bytes(), (values.len() as i32).to_le_bytes()].concat());
        let data: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let matrix = [flags, size, element(int8, name.as_bytes()), element(double, &data)].concat();
        let mut bytes = format!("{:<124}", "MATLAB 5.0 MAT-file").into_bytes();
        bytes.extend([0x00, 0x01, b'I', b'M']);
        bytes.extend(element(14, &matrix));
        bytes
    }

    #[test]
    fn reference_mat_v5_layout() {
        let values = [0.5, -1.25, 100.0];
        assert_eq!(from_mat(mat_v5(COLUMN, &values)).unwrap(), [0.5, -1.25, 100.0]);
        assert!(from_mat(mat_v5("other", &values)).unwrap_err().contains(COLUMN));
    }

    proptest! {
        #[test]
        fn property_spoilt_mat_never_panics(at in 0_usize..300, with in any::<u8>()) {
            let mut bytes = mat_v5(COLUMN, &[1.0; 12]);
            let at = at % bytes.len();
            bytes[at] = with;
            let _ = from_mat(bytes);
        }

        #[test]
        fn property_arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..600)) {
            let _ = from_csv(&bytes);
            let _ = from_mat(bytes);
        }

        #[test]
        fn property_csv_round_trip_is_exact(samples in proptest::collection::vec(-500.0_f32..500.0, 1..200)) {
            prop_assert_eq!(from_csv(to_csv(&samples).as_bytes()).unwrap(), samples);
        }
    }
}
