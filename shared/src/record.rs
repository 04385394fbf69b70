//! What the node keeps of a passage.
//!
//! In the journal and on the wire a record is its postcard encoding followed by CRC-32/ISO-HDLC (4 bytes,
//! little-endian): self-delimiting, so `records.bin` is just records one after another. Nothing in it depends
//! on wall time: the same samples give the same bytes in host simulation, in QEMU and after a download.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::package::MAX_AXLES;

/// Version of the record layout.
pub const FORMAT: u8 = 1;
/// Upper bound of an encoded record, bytes.
pub const MAX_ENCODED_LEN: usize = 2048;

/// One passage as the node saw it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Layout version, [`FORMAT`].
    pub format: u8,
    /// Advances by one for every detected passage, also for those that could not be evaluated or stored.
    pub sequence: u32,
    /// Raw sample count since start-up at which the first axle was at x = 0 (rounded down).
    pub first_axle_sample: u64,
    /// Raw samples the recording of this passage spans.
    pub samples: u32,
    /// Header CRC of the kernel package in force, 0 when there was none.
    pub kernel_id: u32,
    /// Train speed, m/s; 0 when it could not be found.
    pub speed_m_s: f32,
    /// Largest |acceleration| of the raw samples, m/s², from the quiet level (gravity is taken off).
    pub max_acceleration_m_s2: f32,
    /// RMS of the decimated signal before the train, m/s².
    pub quiet_rms_m_s2: f32,
    /// See [`flag`].
    pub flags: u16,
    /// One per wheelset, in order of arrival; empty when the forces could not be identified.
    pub wheelsets: Vec<Wheelset, MAX_AXLES>,
}

/// Force peak of one wheelset on the crossing side.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Wheelset {
    /// Time at x = 0 after the first axle, seconds.
    pub time_s: f32,
    /// Largest contact force in the transition region, low-passed at 250 Hz, newtons.
    pub peak_force_n: f32,
    /// Position x of the peak, metres.
    pub peak_position_m: f32,
    /// Half width of the 90 % interval of the peak, newtons.
    pub peak_half_width_n: f32,
    /// How well the alignment template matched, 0 … 1 (normalised correlation).
    pub match_quality: f32,
}

/// Flags of a record.
pub mod flag {
    /// The sensor clipped.
    pub const CLIPPED: u16 = 1 << 0;
    /// Samples were lost during the passage (FIFO overrun).
    pub const SAMPLES_LOST: u16 = 1 << 1;
    /// The passage was longer than the buffer.
    pub const TRUNCATED: u16 = 1 << 2;
    /// No kernel package in force.
    pub const NO_KERNEL: u16 = 1 << 3;
    /// The axle pattern does not match the train of the package.
    pub const UNKNOWN_TRAIN: u16 = 1 << 4;
    /// The speed is outside the bins of the package.
    pub const SPEED_OUTSIDE: u16 = 1 << 5;
    /// A window reaches beyond the recording.
    pub const WINDOW_CUT: u16 = 1 << 6;
    /// Reading the kernel from flash failed or its CRC did not match.
    pub const KERNEL_READ: u16 = 1 << 7;
    /// Speed below 40 km/h: the method is weak there (paper, section 6.3).
    pub const LOW_SPEED: u16 = 1 << 8;
    /// The passage began while the previous one was being evaluated; nothing of it was recorded.
    pub const NOT_RECORDED: u16 = 1 << 9;
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The layout that `records.bin` and the journal have, worked by hand from postcard's rules.
    #[test]
    fn reference_bytes_of_a_record() {
        let wheelset = Wheelset {
            time_s: 0.0,
            peak_force_n: 2.0,
            peak_position_m: -2.0,
            peak_half_width_n: 0.5,
            match_quality: 1.0,
        };
        let record = Record {
            format: FORMAT,
            sequence: 300,
            first_axle_sample: 128,
            samples: 200,
            kernel_id: 7,
            speed_m_s: 40.0,
            max_acceleration_m_s2: 1.0,
            quiet_rms_m_s2: 0.5,
            flags: flag::LOW_SPEED,
            wheelsets: Vec::from_slice(&[wheelset]).unwrap(),
        };
        let expected: [u8; 43] = [
            1, 0xAC, 2, 0x80, 1, 0xC8, 1, 7, 0, 0, 0x20, 0x42, 0, 0, 0x80, 0x3F, 0, 0, 0, 0x3F, 0x80, 2, 1,
            0, 0, 0, 0, 0, 0, 0, 0x40, 0, 0, 0, 0xC0, 0, 0, 0, 0x3F, 0, 0, 0x80, 0x3F,
        ];
        let mut bytes = [0; 64];
        assert_eq!(postcard::to_slice(&record, &mut bytes).unwrap(), &expected);
    }
}
