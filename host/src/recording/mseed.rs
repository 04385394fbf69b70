//! miniSEED sample files.
//!
//! The decoder is the `miniseed-rs` crate. It follows the chain of blockettes of a version 2 record without a
//! guard against loops, so records are cut out and their chains checked here first.

use miniseed_rs::{MseedRecord, NanoTime, Samples, decode};

use super::check::MAX_SAMPLES;
use super::samples::Source;

/// All records of the file in sequence, m/s².
pub(super) fn samples(bytes: &[u8], source: &Source) -> Result<Vec<f32>, String> {
    let mut samples = Vec::new();
    let mut rest = bytes;
    let mut end: Option<(String, f64)> = None;
    while !rest.is_empty() {
        let length = record_length(rest).ok_or("damaged record header, or not miniSEED")?;
        let record = rest.get(..length).ok_or("the last record is cut short; copy the file again")?;
        check_announced(record)?;
        let record = decode(record).map_err(|e| e.to_string())?;
        check_sequence(&record, end.as_ref(), source.sample_rate_hz)?;
        let count = samples.len();
        append(&mut samples, &record.samples, source.m_s2_per_count)?;
        let seconds = (samples.len() - count) as f64 / source.sample_rate_hz;
        end = Some((record.source_id.to_string(), seconds_of_year(record.start_time) + seconds));
        rest = &rest[length..];
    }
    Ok(samples)
}

/// Codes of Steim1 and Steim2 in a version 3 header, and the most samples of a 32-bit word.
const STEIM: ([u8; 2], usize) = ([10, 11], 7);

/// The decoder makes room for as many samples as a version 3 header announces, up to 2³², before it looks at them; version 2 announces
/// up to 2¹⁶. The record is as long as its header says.
fn check_announced(record: &[u8]) -> Result<(), String> {
    let (true, Some(header)) = (record.starts_with(b"MS\x03"), record.get(..40)) else { return Ok(()) };
    let u32_at =
        |k: usize| u32::from_le_bytes([header[k], header[k + 1], header[k + 2], header[k + 3]]) as usize;
    let (samples, payload) = (u32_at(24), u32_at(36));
    if samples > MAX_SAMPLES {
        return Err(format!("a record announces {samples} samples, more than {MAX_SAMPLES}"));
    }
    if STEIM.0.contains(&header[15]) && samples > STEIM.1 * (payload / 4) {
        return Err(format!(
            "a record announces {samples} samples in {payload} bytes, which hold {} at most; copy the file again",
            STEIM.1 * (payload / 4)
        ));
    }
    Ok(())
}

/// One channel, one rate, no gap: a gap would shift every later axle.
fn check_sequence(record: &MseedRecord, end: Option<&(String, f64)>, rate_hz: f64) -> Result<(), String> {
    // Rates of version 2 are kept as a ratio of two 16-bit integers.
    if (record.sample_rate - rate_hz).abs() > 1e-3 * rate_hz.abs() {
        return Err(format!("sampled at {} Hz, but the index says {rate_hz} Hz", record.sample_rate));
    }
    let Some((channel, expected)) = end else { return Ok(()) };
    if *channel != record.source_id.to_string() {
        return Err(format!("holds channels {channel} and {}; extract one", record.source_id));
    }
    let gap = seconds_of_year(record.start_time) - expected;
    // Start times of version 2 are rounded to 0.1 ms.
    if gap.abs() > 0.5 / rate_hz + 1e-4 {
        return Err(format!("a gap of {:.1} ms before {}", 1e3 * gap, record.start_time));
    }
    Ok(())
}

fn seconds_of_year(t: NanoTime) -> f64 {
    let minutes = (f64::from(t.day) * 24.0 + f64::from(t.hour)) * 60.0 + f64::from(t.minute);
    minutes * 60.0 + f64::from(t.second) + f64::from(t.nanosecond) * 1e-9
}

fn append(samples: &mut Vec<f32>, record: &Samples, m_s2_per_count: Option<f64>) -> Result<(), String> {
    match (record, m_s2_per_count) {
        (Samples::Int(counts), Some(scale)) => {
            samples.extend(counts.iter().map(|&c| (f64::from(c) * scale) as f32));
        }
        (Samples::Int(_), None) => {
            return Err("holds integer counts; add the column `m_s2_per_count` to the index".into());
        }
        (Samples::Float(values), _) => samples.extend(values),
        (Samples::Double(values), _) => samples.extend(values.iter().map(|&a| a as f32)),
    }
    if samples.len() > MAX_SAMPLES { Err(format!("more than {MAX_SAMPLES} samples")) } else { Ok(()) }
}

/// Length of the first record, bytes; `None` when its header contradicts itself.
fn record_length(bytes: &[u8]) -> Option<usize> {
    let u16_at = |k: usize| Some(usize::from(u16::from_be_bytes(bytes.get(k..k + 2)?.try_into().ok()?)));
    if bytes.starts_with(b"MS\x03") {
        let identifier = usize::from(*bytes.get(33)?);
        let extra = usize::from(u16::from_le_bytes(bytes.get(34..36)?.try_into().ok()?));
        let payload = u32::from_le_bytes(bytes.get(36..40)?.try_into().ok()?);
        return Some(40 + identifier + extra + usize::try_from(payload).ok()?);
    }
    let mut length = None;
    let mut at = u16_at(46)?;
    loop {
        if u16_at(at)? == 1000 {
            let power = *bytes.get(at + 6)?;
            // The standard allows 256 bytes to 64 KiB or so; anything beyond is damage.
            length = (7..=20).contains(&power).then(|| 1_usize << power);
        }
        let next = u16_at(at + 2)?;
        if next == 0 {
            return length;
        }
        if next <= at {
            return None;
        }
        at = next;
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use miniseed_rs::{EncodingFormat, FormatVersion, encode};
    use proptest::prelude::*;

    use super::*;

    fn source(m_s2_per_count: Option<f64>) -> Source<'static> {
        Source { file: Path::new("x.mseed"), sample_rate_hz: 4000.0, m_s2_per_count }
    }

    fn record(start_nanosecond: u32, samples: Samples, encoding: EncodingFormat) -> Vec<u8> {
        let start = NanoTime { nanosecond: start_nanosecond, ..NanoTime::epoch() };
        let record = MseedRecord::new()
            .with_nslc("XX", "XING", "00", "BNZ")
            .with_start_time(start)
            .with_sample_rate(4000.0)
            .with_encoding(encoding)
            .with_samples(samples);
        encode(&record).unwrap()
    }

    #[test]
    fn analytic_counts_times_scale() {
        let first = record(0, Samples::Int((0..8).collect()), EncodingFormat::Steim2);
        let second = record(2_000_000, Samples::Int(vec![-100]), EncodingFormat::Steim2);
        let both = [first, second].concat();
        let read = samples(&both, &source(Some(0.5))).unwrap();
        assert_eq!(read, [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, -50.0]);
        assert!(samples(&both, &source(None)).unwrap_err().contains("m_s2_per_count"));
    }

    #[test]
    fn regress_gap_and_cut_are_refused() {
        let first = record(0, Samples::Float(vec![1.0; 8]), EncodingFormat::Float32);
        let late = record(3_000_000, Samples::Float(vec![1.0; 8]), EncodingFormat::Float32);
        assert!(
            samples(&[first.clone(), late].concat(), &source(None)).unwrap_err().contains("gap of 1.0 ms")
        );
        assert!(samples(&first[..first.len() - 1], &source(None)).unwrap_err().contains("cut short"));
    }

    /// The header of a record of a few bytes had 16 GB set aside.
    #[test]
    fn regress_more_samples_than_a_record_holds_are_refused_before_decoding() {
        let v3 = |encoding: EncodingFormat, announced: u32| {
            let record = MseedRecord::new()
                .with_nslc("XX", "XING", "00", "BNZ")
                .with_start_time(NanoTime::epoch())
                .with_sample_rate(4000.0)
                .with_encoding(encoding)
                .with_samples(Samples::Int((0..8).collect()));
            let record = MseedRecord { format_version: FormatVersion::V3, ..record };
            let mut bytes = encode(&record).unwrap();
            bytes[24..28].copy_from_slice(&announced.to_le_bytes());
            samples(&bytes, &source(Some(1.0)))
        };
        assert_eq!(v3(EncodingFormat::Steim2, 8).unwrap().len(), 8);
        for encoding in [EncodingFormat::Steim1, EncodingFormat::Steim2, EncodingFormat::Int32] {
            let error = v3(encoding, u32::MAX).unwrap_err();
            assert!(error.contains("announces 4294967295 samples"), "{error}");
        }
        let error = v3(EncodingFormat::Steim2, 3_999_999).unwrap_err();
        assert!(error.contains("3999999 samples in 64 bytes, which hold 112"), "{error}");
    }

    #[test]
    fn regress_looping_blockettes_are_refused() {
        let mut bytes = record(0, Samples::Int(vec![1]), EncodingFormat::Int32);
        let first = usize::from(bytes[47]);
        bytes[first] = 0;
        bytes[first + 3] = first as u8;
        assert!(samples(&bytes, &source(Some(1.0))).is_err());
    }

    proptest! {
        #[test]
        fn property_bit_flips_never_hang(at in 0_usize..4096, bit in 0_u8..8) {
            let mut bytes = record(0, Samples::Int((0..40).collect()), EncodingFormat::Steim2);
            let at = at % bytes.len();
            bytes[at] ^= 1 << bit;
            let _ = crate::recording::guard::guarded(|| samples(&bytes, &source(Some(1.0))));
        }
    }
}
