//! CRC-32/ISO-HDLC (the one of Ethernet and zip): the one checksum of frames, records, packages and flash slots.

use crc::{CRC_32_ISO_HDLC, Crc, Digest};

static CRC32: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Length of a checksum in bytes; stored little-endian.
pub const LEN: usize = 4;

/// Checksum of `bytes`.
pub fn crc32(bytes: &[u8]) -> u32 {
    CRC32.checksum(bytes)
}

/// Splits `bytes` into content and trailing checksum; `None` when they do not agree.
pub fn verified(bytes: &[u8]) -> Option<&[u8]> {
    let (content, stored) = bytes.split_last_chunk::<LEN>()?;
    (crc32(content) == u32::from_le_bytes(*stored)).then_some(content)
}

/// A checksum over bytes that arrive in pieces.
#[derive(Clone)]
pub struct Running(Digest<'static, u32>);

impl Running {
    /// Nothing seen yet.
    pub fn new() -> Self {
        Running(CRC32.digest())
    }

    /// Takes in the next piece.
    pub fn update(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    /// Checksum of all pieces.
    pub fn finish(self) -> u32 {
        self.0.finalize()
    }
}

impl Default for Running {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Check value of CRC-32/ISO-HDLC in the catalogue of parametrised CRC algorithms (reveng).
    #[test]
    fn reference_check_value() {
        assert_eq!(crc32(b"123456789"), 0xCBF4_3926);
    }

    #[test]
    fn property_pieces_equal_whole() {
        let mut running = Running::new();
        running.update(b"1234");
        running.update(b"");
        running.update(b"56789");
        assert_eq!(running.finish(), crc32(b"123456789"));
    }

    #[test]
    fn property_verified_needs_intact_bytes() {
        let mut bytes = *b"abcd\0\0\0\0";
        bytes[4..].copy_from_slice(&crc32(b"abcd").to_le_bytes());
        assert_eq!(verified(&bytes), Some(&b"abcd"[..]));
        bytes[1] ^= 1;
        assert_eq!(verified(&bytes), None);
        assert_eq!(verified(&bytes[..3]), None);
    }
}
