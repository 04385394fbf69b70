//! Sample files of one passage: CSV, MAT v5, miniSEED.
//!
//! | ending | content |
//! |---|---|
//! | `.csv` | column `acceleration_m_s2`, m/s², one sample per row; other columns are ignored |
//! | `.mat` | MAT v5 (`save -v7` or `-v6`), numeric array `acceleration_m_s2`, m/s² |
//! | `.mseed`, `.miniseed` | version 2 or 3, one channel without gaps; floats are m/s², integers need `m_s2_per_count` |

use std::path::Path;

use super::check::MAX_SAMPLES;
use super::files::{quoted, read_bytes};
use super::guard::guarded;
use super::{PassageFault, mat, mseed};

/// What the index says about a sample file.
pub(super) struct Source<'a> {
    pub(super) file: &'a Path,
    pub(super) sample_rate_hz: f64,
    pub(super) m_s2_per_count: Option<f64>,
}

pub(super) const COLUMN: &str = "acceleration_m_s2";

/// Reads the samples, m/s².
pub(super) fn read(source: &Source) -> Result<Vec<f32>, PassageFault> {
    let refuse = |reason| PassageFault::SampleFile { reason };
    let name = source.file.display();
    let bytes = read_bytes(source.file).map_err(|e| refuse(e.to_string()))?;
    let ending = source.file.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    match ending.as_deref() {
        Some("csv") => from_csv(&bytes),
        Some("mat") => mat::samples(&bytes).map_err(|reason| refuse(format!("{name}: {reason}"))),
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
        samples.push(text.parse().map_err(|_| {
            refuse(format!("sample {} reads `{}`, not a number", samples.len(), quoted(&text)))
        })?);
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

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Programs quote headers, and some all cells; a quotation mark too many makes one cell of the rest of the file.
    #[test]
    fn property_quoted_cells_are_read_and_damaged_ones_are_cut_in_messages() {
        let text = "\"time, s\",\"acceleration_m_s2\"\n\"0\",\"1.5\"\n0.1,-2\n";
        assert_eq!(from_csv(text.as_bytes()).unwrap(), [1.5, -2.0]);
        let spoilt = format!("{COLUMN}\n1\n\"2\n{}", "3\n".repeat(10_000));
        let refused = from_csv(spoilt.as_bytes()).unwrap_err().to_string();
        assert!(refused.contains("sample 1 ") && refused.len() < 200, "{refused}");
    }

    proptest! {
        #[test]
        fn property_arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..600)) {
            let _ = from_csv(&bytes);
        }

        #[test]
        fn property_csv_round_trip_is_exact(samples in proptest::collection::vec(-500.0_f32..500.0, 1..200)) {
            prop_assert_eq!(from_csv(to_csv(&samples).as_bytes()).unwrap(), samples);
        }
    }
}
