//! `records.bin` and `records.parquet`.
//!
//! `records.bin` is the journal's records one after another, byte for byte (see `cpcm_shared::record`).

use std::path::Path;

use cpcm_shared::checksum;
use cpcm_shared::message::{Entry, Info};
use cpcm_shared::record::{FORMAT, Record, Wheelset, flag};

use crate::recording::RecordingError;
use crate::recording::table::{Column, write_columns};

/// Bytes that are no records.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RecordsError {
    /// The file ends inside a record, or a record does not decode.
    #[error(
        "record number {index} (counted from 0), at byte {offset}, does not decode: the file is cut or damaged"
    )]
    Undecodable {
        /// Which record.
        index: usize,
        /// Where it begins, bytes.
        offset: usize,
    },
    /// The checksum is wrong.
    #[error(
        "record number {index} (counted from 0), at byte {offset}, fails its checksum: the file is damaged"
    )]
    Checksum {
        /// Which record.
        index: usize,
        /// Where it begins, bytes.
        offset: usize,
    },
    /// Another version of the layout.
    #[error("record number {index} (counted from 0) has layout {found}, this program knows {FORMAT}")]
    Format {
        /// Which record.
        index: usize,
        /// Version in the record.
        found: u8,
    },
}

/// Takes `records.bin` apart. Stops at the first fault, and returns what was good before it with the number of bytes.
pub fn parse_records(bytes: &[u8]) -> (Vec<Record>, usize, Option<RecordsError>) {
    let (mut records, mut offset) = (Vec::new(), 0);
    while offset < bytes.len() {
        match parse_one(&bytes[offset..], records.len(), offset) {
            Ok((record, length)) => {
                records.push(record);
                offset += length;
            }
            Err(error) => return (records, offset, Some(error)),
        }
    }
    (records, offset, None)
}

/// The records at the beginning of `bytes` that are whole.
pub(super) fn whole_records(mut bytes: &[u8]) -> Vec<&[u8]> {
    let mut records = Vec::new();
    while let Ok((_, length)) = parse_one(bytes, records.len(), 0) {
        let (record, rest) = bytes.split_at(length);
        records.push(record);
        bytes = rest;
    }
    records
}

fn parse_one(bytes: &[u8], index: usize, offset: usize) -> Result<(Record, usize), RecordsError> {
    if let Some(&found) = bytes.first()
        && found != FORMAT
    {
        return Err(RecordsError::Format { index, found });
    }
    let undecodable = RecordsError::Undecodable { index, offset };
    let (record, rest) = postcard::take_from_bytes::<Record>(bytes).map_err(|_| undecodable.clone())?;
    let length = bytes.len() - rest.len() + checksum::LEN;
    let whole = bytes.get(..length).ok_or(undecodable)?;
    checksum::verified(whole).ok_or(RecordsError::Checksum { index, offset })?;
    Ok((record, length))
}

/// Whether a record is from after the node's last start-up, from which its samples and its clock count. What a node that could not
/// store its newest records says of the one before them may be wrong, unless its sample count has not got that far yet.
pub fn recorded_since_start(info: &Info, entry: &Entry) -> bool {
    let next = info.records.as_ref().map_or(0, |records| u64::from(records.last) + 1);
    let counters = &info.counters;
    u64::from(entry.sequence) + u64::from(counters.passages) >= next
        && entry.first_axle_sample <= counters.samples
}

/// Flags of a record by name.
pub fn flag_names(flags: u16) -> Vec<&'static str> {
    let names = [
        (flag::CLIPPED, "clipped"),
        (flag::SAMPLES_LOST, "samples-lost"),
        (flag::TRUNCATED, "truncated"),
        (flag::NO_KERNEL, "no-kernel"),
        (flag::UNKNOWN_TRAIN, "unknown-train"),
        (flag::SPEED_OUTSIDE, "speed-outside"),
        (flag::WINDOW_CUT, "window-cut"),
        (flag::KERNEL_READ, "kernel-read"),
        (flag::LOW_SPEED, "low-speed"),
        (flag::NOT_RECORDED, "not-recorded"),
    ];
    names.into_iter().filter(|(bit, _)| flags & bit != 0).map(|(_, name)| name).collect()
}

/// Writes one row per record and wheelset; `passage_id` is the place of the record in `records`. A record without
/// wheelsets has no row: its forces could not be identified.
pub fn write_records_parquet(file: &Path, records: &[Record]) -> Result<(), RecordingError> {
    let rows: Vec<Row> = records
        .iter()
        .enumerate()
        .flat_map(|(id, record)| {
            record.wheelsets.iter().enumerate().map(move |(k, w)| Row { id, record, k, w })
        })
        .collect();
    let integer = |value: fn(&Row) -> usize| {
        Column::Integers(rows.iter().map(|row| i32::try_from(value(row)).ok()).collect())
    };
    let float = |value: fn(&Row) -> f32| {
        Column::Numbers(rows.iter().map(|row| Some(f64::from(value(row)))).collect())
    };
    let columns = [
        ("passage_id", integer(|row| row.id)),
        ("wheelset", integer(|row| row.k)),
        ("speed_m_s", float(|row| row.record.speed_m_s)),
        ("peak_force_n", float(|row| row.w.peak_force_n)),
        ("peak_position_m", float(|row| row.w.peak_position_m)),
        ("peak_lower_n", float(|row| row.w.peak_force_n - row.w.peak_half_width_n)),
        ("peak_upper_n", float(|row| row.w.peak_force_n + row.w.peak_half_width_n)),
        ("flags", Column::TextLists(rows.iter().map(|row| flag_names(row.record.flags)).collect())),
    ];
    write_columns(file, &columns)
}

struct Row<'a> {
    id: usize,
    record: &'a Record,
    k: usize,
    w: &'a Wheelset,
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use cpcm_shared::journal::encode;

    pub(crate) fn encoded(sequence: u32, wheelsets: usize) -> Vec<u8> {
        let wheelset = Wheelset {
            time_s: 0.5,
            peak_force_n: 9.0e4,
            peak_position_m: 0.3,
            peak_half_width_n: 1.0e3,
            match_quality: 0.9,
        };
        let record = Record {
            format: FORMAT,
            sequence,
            first_axle_sample: 1,
            samples: 2,
            kernel_id: 3,
            speed_m_s: 40.0,
            max_acceleration_m_s2: 1.0,
            quiet_rms_m_s2: 0.1,
            flags: flag::CLIPPED | flag::LOW_SPEED,
            wheelsets: std::iter::repeat_n(wheelset, wheelsets).collect(),
        };
        let mut bytes = [0; 2048];
        let length = encode(&record, &mut bytes).unwrap();
        bytes[..length].to_vec()
    }

    #[test]
    fn property_records_round_trip_and_faults_are_named() {
        let (a, b) = (encoded(5, 2), encoded(9, 0));
        let file = [a.clone(), b.clone()].concat();
        let (records, used, error) = parse_records(&file);
        assert_eq!((records.len(), used, error), (2, file.len(), None));
        assert_eq!((records[0].sequence, records[1].sequence), (5, 9));
        for cut in 1..b.len() {
            let (records, used, error) = parse_records(&file[..a.len() + cut]);
            let offset = a.len();
            assert_eq!((records.len(), used), (1, offset));
            assert_eq!(error, Some(RecordsError::Undecodable { index: 1, offset }), "cut {cut}");
        }
        let mut damaged = file.clone();
        damaged[20] ^= 1;
        assert_eq!(parse_records(&damaged).2, Some(RecordsError::Checksum { index: 0, offset: 0 }));
        damaged[0] = 7;
        assert_eq!(parse_records(&damaged).2, Some(RecordsError::Format { index: 0, found: 7 }));
    }

    #[test]
    fn property_every_flag_has_a_name() {
        let all = flag_names(u16::MAX);
        assert_eq!(all.len(), 10);
        assert_eq!(flag_names(flag::CLIPPED | flag::NOT_RECORDED), ["clipped", "not-recorded"]);
        assert_eq!(flag_names(flag::NOT_RECORDED << 1), [""; 0], "a flag without name");
    }

    proptest::proptest! {
        #[test]
        fn property_arbitrary_bytes_never_panic(bytes in proptest::collection::vec(proptest::num::u8::ANY, 0..600)) {
            let (_, good, fault) = parse_records(&bytes);
            assert!(good == bytes.len() || fault.is_some());
        }

        #[test]
        fn property_spoilt_records_are_noticed(at in 0_usize..10_000, with in 1_u8..) {
            let mut bytes = [encoded(0, 12), encoded(1, 12)].concat();
            let at = at % bytes.len();
            bytes[at] ^= with;
            let (records, good, fault) = parse_records(&bytes);
            assert!(good <= at && records.len() < 2 && fault.is_some());
        }
    }
}
