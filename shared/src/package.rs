//! The kernel package: everything the node needs for one crossing, precomputed on the host.
//!
//! Byte layout of the file, and of a kernel bank in the node's flash (all integers little-endian):
//!
//! ```text
//! offset     length  content
//! 0          8       magic "CPCMKERN"
//! 8          4       n = length of the header in bytes
//! 12         n       postcard of `Header`, followed by CRC-32/ISO-HDLC of that postcard (4 bytes, in n)
//! 12 + n     m       payload: f32 blocks, addressed by `Block` relative to the start of the payload
//! ```
//!
//! A `Block` is a row-major matrix of f32, with a CRC-32 of its own, so the node can check what it reads
//! while it streams a matrix out of flash without ever holding it in memory.

pub mod check;

pub use check::{PackageError, header_len};

use heapless::{String, Vec};
use serde::{Deserialize, Serialize};

/// First eight bytes of every package.
pub const MAGIC: [u8; 8] = *b"CPCMKERN";
/// Version of this layout; a node refuses any other.
pub const FORMAT: u16 = 1;
/// Length of magic and header length, in bytes.
pub const PREFIX_LEN: usize = 12;
/// Longest header the node accepts, in bytes.
pub const MAX_HEADER_LEN: usize = 4096;
/// Most axles in a train pattern.
pub const MAX_AXLES: usize = 64;
/// Most axle groups in a train pattern.
pub const MAX_GROUPS: usize = 32;
/// Most axles in one group, that is in one window.
pub const MAX_GROUP_AXLES: usize = 8;
/// Most different operators per speed bin.
pub const MAX_OPERATORS: usize = 4;
/// Most speed bins.
pub const MAX_BINS: usize = 24;
/// Longest window, in decimated samples.
pub const MAX_WINDOW: usize = 1024;
/// Largest rank of an operator.
pub const MAX_RANK: usize = 256;
/// Most points of the force grid along the transition region, per wheelset.
pub const MAX_GRID: usize = 160;

/// First part of the package.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// Layout version, [`FORMAT`].
    pub format: u16,
    /// Where the package comes from.
    pub provenance: Provenance,
    /// The sensor and sampling that the operators were computed for.
    pub sensor: Sensor,
    /// +1: trains run towards +x (facing), -1: towards -x (trailing).
    pub direction: i8,
    /// Axle pattern of the expected train.
    pub train: Train,
    /// Positions x of the force grid, metres: first point and step; wheel positions as in the site's coordinates.
    pub grid_first_m: f32,
    /// Step of the force grid, metres.
    pub grid_step_m: f32,
    /// Points of the force grid per wheelset.
    pub grid_len: u16,
    /// Speed bins, ascending speed. At least two when the node is to interpolate between them.
    pub bins: Vec<Bin, MAX_BINS>,
    /// Length of the payload in bytes.
    pub payload_len: u32,
}

/// Where a package comes from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Site name.
    pub site: String<48>,
    /// Hash of the calibrated model (ballast, hyper-parameters, site description).
    pub model_hash: u64,
    /// Date of calibration, ISO 8601, as given by the operator; empty when unknown.
    pub calibrated_on: String<10>,
    /// Version of the program that wrote the package.
    pub written_by: String<16>,
}

/// Sensor and sampling chain that a package expects.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sensor {
    /// Raw sampling rate, Hz.
    pub sample_rate_hz: f32,
    /// Decimation from the raw to the window rate.
    pub decimation: u8,
    /// Acceleration of one sensor code, m/s².
    pub m_s2_per_code: f32,
    /// Full scale, m/s².
    pub range_m_s2: f32,
}

/// Axle pattern of a train, cut into groups that are evaluated in one window each.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Train {
    /// Name of the type, as the operator calls it.
    pub name: String<16>,
    /// Distance of each axle behind the first, metres, ascending, first = 0.
    pub axle_offset_m: Vec<f32, MAX_AXLES>,
    /// Static wheel force, newtons.
    pub static_force_n: f32,
    /// Groups of neighbouring axles, in order.
    pub groups: Vec<Group, MAX_GROUPS>,
}

/// Neighbouring axles whose responses overlap (a bogie, or the two bogies at a coupling).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Group {
    /// Index of the first axle in the train pattern.
    pub first_axle: u8,
    /// Number of axles.
    pub axles: u8,
    /// Which operator of a bin serves this group.
    pub operator: u8,
}

/// Operators for one speed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bin {
    /// Speed the operators were computed for, m/s.
    pub speed_m_s: f32,
    /// One per kind of group.
    pub operators: Vec<Operator, MAX_OPERATORS>,
}

/// The estimator of one kind of group at one speed:
/// `force = offset + expand · (project · window)`, with
/// `window[k]` the decimated acceleration at `group time + (k - before) / window rate`, the time axis scaled so
/// that the wheels are where they would be at the bin's speed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Operator {
    /// Window samples before the moment when the group's first axle is at x = 0.
    pub before: u16,
    /// Rank × window length.
    pub project: Block,
    /// (axles × grid length) × rank; axle-major rows.
    pub expand: Block,
    /// (axles × grid length) × 1, newtons: the force that the model expects from an all-zero window.
    pub offset_n: Block,
    /// (axles × grid length) × 1, newtons: half width of the 90 % interval.
    pub half_width_n: Block,
    /// 1 × window length, m/s²: the window that the model expects; used to align the axles.
    pub template_m_s2: Block,
}

/// A row-major f32 matrix in the payload.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Block {
    /// Offset from the start of the payload, bytes.
    pub offset: u32,
    /// Rows.
    pub rows: u16,
    /// Columns.
    pub cols: u16,
    /// CRC-32/ISO-HDLC of the bytes.
    pub crc: u32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checksum::crc32;

    /// The layout that a bank and `cpcm kernel` have, worked by hand from postcard's rules.
    #[test]
    fn reference_bytes_of_a_header() {
        let block = |first: u8| Block {
            offset: first.into(),
            rows: u16::from(first) + 1,
            cols: u16::from(first) + 2,
            crc: u32::from(first) + 3,
        };
        let operator = Operator {
            before: 3,
            project: block(0),
            expand: block(4),
            offset_n: block(8),
            half_width_n: block(12),
            template_m_s2: block(16),
        };
        let bin = Bin { speed_m_s: 40.0, operators: Vec::from_slice(&[operator]).unwrap() };
        let header = Header {
            format: FORMAT,
            provenance: Provenance {
                site: "GN".try_into().unwrap(),
                model_hash: 128,
                calibrated_on: String::new(),
                written_by: "x".try_into().unwrap(),
            },
            sensor: Sensor { sample_rate_hz: 4000.0, decimation: 4, m_s2_per_code: 0.5, range_m_s2: 2.0 },
            direction: -1,
            train: Train {
                name: String::new(),
                axle_offset_m: Vec::from_slice(&[0.0, 2.0]).unwrap(),
                static_force_n: 1.0,
                groups: Vec::from_slice(&[Group { first_axle: 0, axles: 2, operator: 0 }]).unwrap(),
            },
            grid_first_m: -2.0,
            grid_step_m: 0.5,
            grid_len: 200,
            bins: Vec::from_slice(&[bin]).unwrap(),
            payload_len: 300,
        };
        let postcard: [u8; 80] = [
            1, 2, b'G', b'N', 0x80, 1, 0, 1, b'x', 0, 0, 0x7A, 0x45, 4, 0, 0, 0, 0x3F, 0, 0, 0, 0x40, 0xFF,
            0, 2, 0, 0, 0, 0, 0, 0, 0, 0x40, 0, 0, 0x80, 0x3F, 1, 0, 2, 0, 0, 0, 0, 0xC0, 0, 0, 0, 0x3F,
            0xC8, 1, 1, 0, 0, 0x20, 0x42, 1, 3, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17,
            18, 19, 0xAC, 2,
        ];
        let mut bytes = [0; 128];
        assert_eq!(header.encode(&mut bytes), Ok(12 + 80 + 4));
        assert_eq!(&bytes[..12], b"CPCMKERN\x54\0\0\0");
        assert_eq!(bytes[12..92], postcard);
        assert_eq!(bytes[92..96], crc32(&postcard).to_le_bytes());
    }
}
