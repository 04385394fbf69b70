//! Frames on the serial line.
//!
//! ```text
//! offset   length   content
//! 0        1        0x00: ends whatever noise came before
//! 1        e        COBS of (payload, then CRC-32/ISO-HDLC of the payload as 4 bytes little-endian); holds no 0x00
//! 1 + e    1        0x00: ends the frame
//! ```
//!
//! e = payload + 4 + one byte per 254 started. A receiver may start anywhere: it throws away bytes up to the next
//! 0x00 and is in step again. Empty frames are no error. A frame that is too long, is no COBS or fails its CRC is
//! counted and dropped without an answer; the other side repeats its request after a timeout.

use cobs::CobsEncoder;
use heapless::Vec;

use crate::checksum::{self, crc32};

/// Longest payload, bytes.
pub const MAX_PAYLOAD: usize = 1088;
/// Longest frame with both delimiters, bytes.
pub const MAX_FRAME: usize = MAX_PAYLOAD + checksum::LEN + (MAX_PAYLOAD + checksum::LEN).div_ceil(254) + 3;

const DELIMITER: u8 = 0;

/// The payload is longer than [`MAX_PAYLOAD`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooLong {
    /// Its length, bytes.
    pub payload: usize,
}

/// Writes the frame of `payload` into `out` and returns its length.
pub fn encode(payload: &[u8], out: &mut [u8; MAX_FRAME]) -> Result<usize, TooLong> {
    let too_long = TooLong { payload: payload.len() };
    if payload.len() > MAX_PAYLOAD {
        return Err(too_long);
    }
    let [first, rest @ ..] = out;
    *first = DELIMITER;
    let mut cobs = CobsEncoder::new(rest);
    cobs.push(payload).map_err(|_| too_long)?;
    cobs.push(&crc32(payload).to_le_bytes()).map_err(|_| too_long)?;
    let encoded = cobs.finalize();
    *rest.get_mut(encoded).ok_or(too_long)? = DELIMITER;
    Ok(encoded + 2)
}

/// What a decoder has seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Good frames.
    pub frames: u32,
    /// Frames longer than any sender may make them.
    pub too_long: u32,
    /// Frames that are not COBS, or too short for a CRC.
    pub malformed: u32,
    /// Frames with a wrong CRC.
    pub crc: u32,
}

impl Counters {
    /// All frames that were dropped.
    pub fn errors(&self) -> u32 {
        self.too_long.saturating_add(self.malformed).saturating_add(self.crc)
    }
}

/// Takes a byte stream apart into payloads.
#[derive(Default)]
pub struct Decoder {
    bytes: Vec<u8, MAX_FRAME>,
    overflowed: bool,
    delivered: bool,
    counters: Counters,
}

impl Decoder {
    /// Waits for the first frame.
    pub const fn new() -> Self {
        let counters = Counters { frames: 0, too_long: 0, malformed: 0, crc: 0 };
        Decoder { bytes: Vec::new(), overflowed: false, delivered: false, counters }
    }

    /// What was seen so far.
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// Takes one byte; returns the payload when it completes a good frame.
    pub fn push(&mut self, byte: u8) -> Option<&[u8]> {
        if self.delivered {
            self.restart();
        }
        if byte != DELIMITER {
            self.overflowed |= self.bytes.push(byte).is_err();
            return None;
        }
        if self.overflowed {
            self.counters.too_long = self.counters.too_long.saturating_add(1);
            self.restart();
            return None;
        }
        self.delivered = true;
        self.complete()
    }

    fn restart(&mut self) {
        self.bytes.clear();
        self.overflowed = false;
        self.delivered = false;
    }

    fn complete(&mut self) -> Option<&[u8]> {
        if self.bytes.is_empty() {
            return None;
        }
        let decoded = match cobs::decode_in_place(&mut self.bytes) {
            Ok(len) if len > checksum::LEN => self.bytes.get(..len)?,
            _ => {
                self.counters.malformed = self.counters.malformed.saturating_add(1);
                return None;
            }
        };
        let payload = checksum::verified(decoded);
        let counter = if payload.is_some() { &mut self.counters.frames } else { &mut self.counters.crc };
        *counter = counter.saturating_add(1);
        payload
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec as StdVec;

    fn framed(payload: &[u8]) -> StdVec<u8> {
        let mut out = [0; MAX_FRAME];
        let len = encode(payload, &mut out).unwrap();
        out[..len].to_vec()
    }

    fn payloads(decoder: &mut Decoder, bytes: &[u8]) -> StdVec<StdVec<u8>> {
        bytes.iter().filter_map(|&byte| decoder.push(byte).map(|payload| payload.to_vec())).collect()
    }

    /// The example of docs/protocol.md: CRC of payload 01 00 02, COBS groups of non-zero bytes.
    #[test]
    fn reference_bytes_of_a_frame() {
        let expected: [u8; 10] = [0x00, 0x02, 0x01, 0x06, 0x02, 0x09, 0xd2, 0x8d, 0x10, 0x00];
        assert_eq!(framed(&[1, 0, 2]), expected);
    }

    #[test]
    fn property_longest_payload_fits() {
        for fill in [0, 1, 0xFF] {
            let payload = [fill; MAX_PAYLOAD];
            assert_eq!(payloads(&mut Decoder::new(), &framed(&payload)), [payload.to_vec()]);
        }
        let mut out = [0; MAX_FRAME];
        let refused = TooLong { payload: MAX_PAYLOAD + 1 };
        assert_eq!(encode(&[1; MAX_PAYLOAD + 1], &mut out), Err(refused));
    }

    #[test]
    fn property_overlong_frame_is_counted_and_the_next_one_arrives() {
        let mut decoder = Decoder::new();
        let mut bytes = std::vec![7; 3 * MAX_FRAME];
        bytes.extend(framed(b"next"));
        assert_eq!(payloads(&mut decoder, &bytes), [b"next".to_vec()]);
        assert_eq!(decoder.counters(), Counters { frames: 1, too_long: 1, ..Counters::default() });
    }

    proptest! {
        #[test]
        fn property_round_trip_after_noise(
            payload in prop::collection::vec(any::<u8>(), 1..MAX_PAYLOAD),
            noise in prop::collection::vec(any::<u8>(), 0..100),
        ) {
            let mut decoder = Decoder::new();
            let mut bytes = noise;
            bytes.extend(framed(&payload));
            let got = payloads(&mut decoder, &bytes);
            prop_assert_eq!(got.last(), Some(&payload));
        }

        #[test]
        fn property_arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..4000)) {
            payloads(&mut Decoder::new(), &bytes);
        }

        /// Also flips that split the frame, or join it to the delimiter.
        #[test]
        fn property_every_single_bit_flip_is_rejected(payload in prop::collection::vec(any::<u8>(), 1..60)) {
            let good = framed(&payload);
            for bit in 0..8 * good.len() {
                let mut bad = good.clone();
                bad[bit / 8] ^= 1 << (bit % 8);
                let mut decoder = Decoder::new();
                let mut got = payloads(&mut decoder, &bad);
                // A flip of the first delimiter may only cost the frame, one of the last leaves it open.
                got.extend(payloads(&mut decoder, &[0]));
                prop_assert!(got.is_empty(), "bit {} gave {:?}", bit, got);
            }
        }
    }
}
