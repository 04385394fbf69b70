//! Memory image of the simulated board: the file behind the 16 MiB of PSRAM in QEMU.
//!
//! ```text
//! offset       length    content (integers little-endian)
//! 0            12 MiB    NOR flash of the node (see [`crate::storage::Map::node`]); blank is 0xFF
//! 0xC0_0000    8         magic "CPCMSAMP"; anything else: no samples, and the flash is blanked first
//! 0xC0_0008    4         number of samples
//! 0xC0_000C    4         flags: bit 0 = end the simulation when all passages are evaluated
//! 0xC0_0010    3 each    samples: vertical sensor code, 24-bit two's complement
//! ```
//!
//! The first sample is taken 250 µs after the sensor has been started.

use crate::sample::SensorCode;

/// Length of the image, bytes.
pub const LEN: usize = 16 << 20;
/// Where the sample header begins, bytes; the flash is before it.
pub const SAMPLES: usize = crate::storage::FLASH_LEN as usize;
/// First bytes of the sample header.
pub const MAGIC: [u8; 8] = *b"CPCMSAMP";
/// Length of the sample header, bytes.
pub const HEADER_LEN: usize = 16;
/// Length of a sample, bytes.
pub const SAMPLE_LEN: usize = 3;
/// Most samples: 5 min 49 s.
pub const MAX_SAMPLES: usize = (LEN - SAMPLES - HEADER_LEN) / SAMPLE_LEN;
/// Flag: end the simulation when all passages are evaluated.
pub const EXIT_WHEN_DONE: u32 = 1;

/// A sample's bytes.
pub fn encode_sample(code: SensorCode) -> [u8; SAMPLE_LEN] {
    let [low, middle, high, _] = code.get().to_le_bytes();
    [low, middle, high]
}

/// A sample from its bytes.
pub fn decode_sample([low, middle, high]: [u8; SAMPLE_LEN]) -> SensorCode {
    SensorCode::from_bits(u32::from_le_bytes([low, middle, high, 0]))
}

/// What is told before the samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Header {
    /// Number of samples.
    pub count: u32,
    /// See [`EXIT_WHEN_DONE`].
    pub flags: u32,
}

impl Header {
    /// The header's bytes.
    pub fn encode(self) -> [u8; HEADER_LEN] {
        let mut bytes = [0; HEADER_LEN];
        let (magic, numbers) = bytes.split_at_mut(MAGIC.len());
        magic.copy_from_slice(&MAGIC);
        numbers.copy_from_slice([self.count.to_le_bytes(), self.flags.to_le_bytes()].as_flattened());
        bytes
    }

    /// `None` without magic, or with more samples than fit.
    pub fn decode(bytes: &[u8; HEADER_LEN]) -> Option<Self> {
        let (magic, numbers) = bytes.split_first_chunk::<8>()?;
        let [count, flags] = *numbers.as_chunks::<4>().0 else { return None };
        let header = Header { count: u32::from_le_bytes(count), flags: u32::from_le_bytes(flags) };
        (*magic == MAGIC && header.count as usize <= MAX_SAMPLES).then_some(header)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn property_sample_round_trip() {
        for code in [SensorCode::MIN, SensorCode::MAX, SensorCode::new(-1), SensorCode::new(70_000)] {
            assert_eq!(decode_sample(encode_sample(code)), code);
        }
    }

    #[test]
    fn property_header_round_trip() {
        let header = Header { count: 7, flags: EXIT_WHEN_DONE };
        assert_eq!(Header::decode(&header.encode()), Some(header));
        assert_eq!(Header::decode(&[0xFF; HEADER_LEN]), None);
        let too_many = Header { count: MAX_SAMPLES as u32 + 1, flags: 0 };
        assert_eq!(Header::decode(&too_many.encode()), None);
    }
}
