//! Matrix-vector products with matrices that stay in flash.
//!
//! A block is read in chunks of whole rows; its CRC is checked on the way, so a result is only good when the whole
//! block was. Each row is summed from left to right, however the rows are grouped, so the bits of the result
//! depend on nothing but the numbers.

use crate::checksum::{Running, crc32};
use crate::pace::Pace;
use crate::package::{Block, MAX_WINDOW};

/// Bytes read at a time: one row of the widest matrix, 1 ms of work.
pub const CHUNK_LEN: usize = 4 * MAX_WINDOW;
/// Work of the CRC per byte, in multiplications.
const CRC_WORK: usize = 2;
/// Bytes that go through the CRC between two chances to yield.
const CRC_PIECE: usize = 512;

/// Access to the payload of a kernel package.
#[allow(async_fn_in_trait, reason = "one executor, one thread: nobody needs the future to be Send")]
pub trait KernelRead {
    /// Fills `buf` from `payload_offset` bytes after the start of the payload.
    async fn read(&mut self, payload_offset: u32, buf: &mut [u8]) -> Result<(), ReadFailed>;
}

/// The flash did not deliver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadFailed;

/// A payload in memory.
#[derive(Clone, Copy, Debug)]
pub struct InMemory<'a>(pub &'a [u8]);

impl KernelRead for InMemory<'_> {
    async fn read(&mut self, payload_offset: u32, buf: &mut [u8]) -> Result<(), ReadFailed> {
        let from = usize::try_from(payload_offset).map_err(|_| ReadFailed)?;
        let source = self.0.get(from..).and_then(|rest| rest.get(..buf.len())).ok_or(ReadFailed)?;
        buf.copy_from_slice(source);
        Ok(())
    }
}

/// Why a block could not be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlockError {
    /// Reading failed at this payload offset.
    Read {
        /// Bytes from the start of the payload.
        offset: u32,
    },
    /// The bytes are not those that were written.
    Crc {
        /// Where the block begins.
        offset: u32,
        /// CRC in the header.
        expected: u32,
        /// CRC of what was read.
        found: u32,
    },
    /// The block does not fit what it is multiplied with, or a row is longer than [`CHUNK_LEN`].
    Shape {
        /// Columns of the block.
        cols: u16,
        /// Length of the vector.
        len: usize,
    },
}

/// Reads blocks through a chunk buffer.
#[derive(Debug)]
pub struct Blocks<'a, K> {
    /// Where the payload is.
    pub kernel: &'a mut K,
    /// Room for [`CHUNK_LEN`] bytes.
    pub chunk: &'a mut [u8],
}

impl<K: KernelRead> Blocks<'_, K> {
    /// `block · x`; `sink` gets each row's number and value, in order.
    pub async fn multiply(
        &mut self,
        block: Block,
        x: &[f32],
        pace: &mut Pace,
        mut sink: impl FnMut(usize, f32),
    ) -> Result<(), BlockError> {
        if x.len() != usize::from(block.cols) {
            return Err(BlockError::Shape { cols: block.cols, len: x.len() });
        }
        self.rows(block, pace, |mut row, bytes| {
            rows_times(bytes, x, |value| {
                sink(row, value);
                row += 1;
            });
        })
        .await
    }

    /// `sink` gets the number and value of every element, row by row.
    pub async fn elements(
        &mut self,
        block: Block,
        pace: &mut Pace,
        mut sink: impl FnMut(usize, f32),
    ) -> Result<(), BlockError> {
        let cols = usize::from(block.cols);
        self.rows(block, pace, |row, bytes| {
            for (k, bytes) in bytes.as_chunks::<4>().0.iter().enumerate() {
                sink(row * cols + k, f32::from_le_bytes(*bytes));
            }
        })
        .await
    }

    /// Hands out whole rows, with the number of the first, and checks the CRC at the end.
    async fn rows(
        &mut self,
        block: Block,
        pace: &mut Pace,
        mut sink: impl FnMut(usize, &[u8]),
    ) -> Result<(), BlockError> {
        let row_len = 4 * usize::from(block.cols);
        let together = self.chunk.len().checked_div(row_len).unwrap_or(0);
        if together == 0 {
            return Err(BlockError::Shape { cols: block.cols, len: self.chunk.len() / 4 });
        }
        let mut digest = Running::new();
        let mut row = 0;
        while row < usize::from(block.rows) {
            let count = together.min(usize::from(block.rows) - row);
            let offset = block.offset.saturating_add((row * row_len) as u32);
            let chunk = self.chunk.get_mut(..count * row_len).ok_or(BlockError::Read { offset })?;
            self.kernel.read(offset, chunk).await.map_err(|ReadFailed| BlockError::Read { offset })?;
            for piece in chunk.chunks(CRC_PIECE) {
                digest.update(piece);
                pace.spend(CRC_WORK * piece.len()).await;
            }
            sink(row, chunk);
            pace.spend(chunk.len() / 2).await;
            row += count;
        }
        let (expected, found) = (block.crc, digest.finish());
        if found == expected {
            Ok(())
        } else {
            Err(BlockError::Crc { offset: block.offset, expected, found })
        }
    }
}

/// Products of whole rows with `x`: four rows share each load of `x`, the rest go one by one.
fn rows_times(bytes: &[u8], x: &[f32], mut sink: impl FnMut(f32)) {
    let row_len = 4 * x.len();
    let mut fours = bytes.chunks_exact(4 * row_len);
    for four in &mut fours {
        let (ab, cd) = four.split_at(2 * row_len);
        let ((a, b), (c, d)) = (ab.split_at(row_len), cd.split_at(row_len));
        four_times([a, b, c, d], x).into_iter().for_each(&mut sink);
    }
    for row in fours.remainder().chunks_exact(row_len) {
        sink(row_times(row, x));
    }
}

fn four_times([a, b, c, d]: [&[u8]; 4], x: &[f32]) -> [f32; 4] {
    let mut sum = [0.0; 4];
    for ((((x, a), b), c), d) in x.iter().zip(words(a)).zip(words(b)).zip(words(c)).zip(words(d)) {
        sum[0] += f32::from_le_bytes(*a) * x;
        sum[1] += f32::from_le_bytes(*b) * x;
        sum[2] += f32::from_le_bytes(*c) * x;
        sum[3] += f32::from_le_bytes(*d) * x;
    }
    sum
}

fn words(row: &[u8]) -> impl Iterator<Item = &[u8; 4]> {
    row.as_chunks().0.iter()
}

fn row_times(row: &[u8], x: &[f32]) -> f32 {
    let mut sum = 0.0;
    for (x, a) in x.iter().zip(words(row)) {
        sum += f32::from_le_bytes(*a) * x;
    }
    sum
}

/// CRC of a block's bytes, as the header holds it.
pub fn block_crc(bytes: &[u8]) -> u32 {
    crc32(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use embassy_futures::block_on;
    use proptest::prelude::*;
    extern crate std;
    use std::vec;
    use std::vec::Vec;

    fn bytes_of(values: &[f32]) -> Vec<u8> {
        values.iter().flat_map(|v| v.to_le_bytes()).collect()
    }

    fn block(rows: u16, cols: u16, bytes: &[u8]) -> Block {
        Block { offset: 0, rows, cols, crc: block_crc(bytes) }
    }

    fn multiply(bytes: &[u8], block: Block, x: &[f32], chunk: usize) -> Result<Vec<f32>, BlockError> {
        let mut y = Vec::new();
        let mut kernel = InMemory(bytes);
        let mut blocks = Blocks { kernel: &mut kernel, chunk: &mut vec![0; chunk] };
        block_on(blocks.multiply(block, x, &mut Pace::default(), |row, value| {
            assert_eq!(row, y.len());
            y.push(value);
        }))?;
        Ok(y)
    }

    #[test]
    fn reference_crc_of_the_check_string() {
        assert_eq!(block_crc(b"123456789"), 0xCBF4_3926);
    }

    #[test]
    fn property_damage_is_noticed() {
        let mut bytes = bytes_of(&[1.0, 2.0, 3.0, 4.0]);
        let block = block(2, 2, &bytes);
        assert_eq!(multiply(&bytes, block, &[1.0, 10.0], 64), Ok(vec![21.0, 43.0]));
        bytes[5] ^= 1;
        assert!(matches!(multiply(&bytes, block, &[1.0, 10.0], 64), Err(BlockError::Crc { .. })));
        assert_eq!(multiply(&bytes[..15], block, &[1.0, 1.0], 64), Err(BlockError::Read { offset: 0 }));
        let shape = Err(BlockError::Shape { cols: 2, len: 3 });
        assert_eq!(multiply(&bytes, block, &[1.0; 3], 64), shape);
        assert_eq!(multiply(&bytes, block, &[1.0; 2], 7), Err(BlockError::Shape { cols: 2, len: 1 }));
    }

    proptest! {
        #[test]
        fn property_grouping_does_not_change_bits(
            rows in 1_u16..20, cols in 1_u16..20, seed in any::<u32>(), room in 0_usize..2000,
        ) {
            let mut state = seed;
            let mut next = || {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 8) as f32 / 1e6 - 8.0
            };
            let a: Vec<f32> = (0..rows * cols).map(|_| next()).collect();
            let x: Vec<f32> = (0..cols).map(|_| next()).collect();
            let bytes = bytes_of(&a);
            let y = multiply(&bytes, block(rows, cols, &bytes), &x, 4 * usize::from(cols) + room).unwrap();
            for (row, y) in a.chunks(x.len()).zip(&y) {
                let expected = row.iter().zip(&x).fold(0.0_f32, |sum, (a, x)| sum + a * x);
                prop_assert_eq!(y.to_bits(), expected.to_bits());
            }
        }
    }
}
