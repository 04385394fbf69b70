//! Memory image of the simulated board: the file behind the 16 MiB of PSRAM in QEMU.
//!
//! ```text
//! offset       length    content (integers little-endian)
//! 0            8 MiB     NOR flash of the node (see [`crate::storage::Map::node`]); blank is 0xFF
//! 0x80_0000    8         magic "CPCMSAMP"; anything else: no samples, and the flash is blanked first
//! 0x80_0008    4         number of samples
//! 0x80_000C    4         flags: bit 0 = end the simulation when all passages are evaluated
//! 0x80_0010    4 each    samples: vertical sensor code, i32
//! ```
//!
//! The first sample is taken 250 µs after the sensor has been started.

/// Length of the image, bytes.
pub const LEN: usize = 16 << 20;
/// Where the sample header begins, bytes; the flash is before it.
pub const SAMPLES: usize = crate::storage::FLASH_LEN as usize;
/// First bytes of the sample header.
pub const MAGIC: [u8; 8] = *b"CPCMSAMP";
/// Length of the sample header, bytes.
pub const HEADER_LEN: usize = 16;
/// Most samples: 8 min 44 s.
pub const MAX_SAMPLES: usize = (LEN - SAMPLES - HEADER_LEN) / 4;
/// Flag: end the simulation when all passages are evaluated.
pub const EXIT_WHEN_DONE: u32 = 1;

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
    fn property_header_round_trip() {
        let header = Header { count: 7, flags: EXIT_WHEN_DONE };
        assert_eq!(Header::decode(&header.encode()), Some(header));
        assert_eq!(Header::decode(&[0xFF; HEADER_LEN]), None);
        let too_many = Header { count: MAX_SAMPLES as u32 + 1, flags: 0 };
        assert_eq!(Header::decode(&too_many.encode()), None);
    }
}
