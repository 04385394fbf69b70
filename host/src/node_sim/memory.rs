//! NOR flash in memory.

use std::convert::Infallible;
use std::ops::Range;

use cpcm_shared::storage::FLASH_LEN;
use embedded_storage_async::nor_flash::{ErrorType, MultiwriteNorFlash, NorFlash, ReadNorFlash};

/// Flash of a simulated node. Programming only clears bits, as in the real part.
#[derive(Clone)]
pub struct MemoryNor(Vec<u8>);

impl MemoryNor {
    /// A blank flash.
    pub fn blank() -> Self {
        MemoryNor(vec![0xFF; FLASH_LEN as usize])
    }

    /// A flash with this content; what is missing at the end is blank.
    pub fn with_content(mut bytes: Vec<u8>) -> Self {
        bytes.resize(FLASH_LEN as usize, 0xFF);
        MemoryNor(bytes)
    }

    /// The content.
    pub fn bytes(&self) -> &[u8] {
        &self.0
    }

    fn cells(&mut self, range: Range<u32>) -> &mut [u8] {
        // The node's map lies within the flash; anything else finds no cells.
        self.0.get_mut(range.start as usize..range.end as usize).unwrap_or_default()
    }
}

impl ErrorType for MemoryNor {
    type Error = Infallible;
}

impl ReadNorFlash for MemoryNor {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Infallible> {
        let cells = self.cells(offset..offset + bytes.len() as u32);
        bytes.iter_mut().zip(cells).for_each(|(byte, cell)| *byte = *cell);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.0.len()
    }
}

impl NorFlash for MemoryNor {
    const WRITE_SIZE: usize = 1;
    const ERASE_SIZE: usize = 4096;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Infallible> {
        self.cells(from..to).fill(0xFF);
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Infallible> {
        let cells = self.cells(offset..offset + bytes.len() as u32);
        cells.iter_mut().zip(bytes).for_each(|(cell, byte)| *cell &= byte);
        Ok(())
    }
}

impl MultiwriteNorFlash for MemoryNor {}
