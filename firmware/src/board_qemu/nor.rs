//! NOR flash in the first part of the PSRAM, which is a file of the host (see `cpcm_shared::image`).
//!
//! Bytes are programmed one by one, and only from 1 to 0, so killing QEMU tears a write as a power cut would.

use cpcm_shared::storage::FLASH_LEN;
use embassy_futures::yield_now;
use embedded_storage_async::nor_flash::{
    ErrorType, MultiwriteNorFlash, NorFlash, NorFlashErrorKind, ReadNorFlash,
};

/// Address of the PSRAM of mps2-an386.
pub const PSRAM: usize = 0x2100_0000;

const SECTOR: usize = 4096;

/// The flash; there is only one.
pub struct Nor(());

impl Nor {
    /// Opens the flash. Without a file behind it the PSRAM holds zeros, so it is blanked unless `keep`.
    pub fn open(keep: bool) -> Self {
        let mut nor = Nor(());
        if !keep {
            nor.fill(0, FLASH_LEN as usize);
        }
        nor
    }

    fn fill(&mut self, offset: usize, length: usize) {
        for address in (PSRAM + offset..PSRAM + offset + length).step_by(4) {
            // SAFETY: within the flash part of the PSRAM, which nothing else touches; aligned, as sectors are.
            unsafe { core::ptr::write_volatile(address as *mut u32, u32::MAX) };
        }
    }
}

/// Refuses what reaches beyond the flash; gives the address otherwise.
fn address(offset: u32, length: usize) -> Result<usize, NorFlashErrorKind> {
    match (offset as usize).checked_add(length) {
        Some(end) if end <= FLASH_LEN as usize => Ok(PSRAM + offset as usize),
        _ => Err(NorFlashErrorKind::OutOfBounds),
    }
}

impl ErrorType for Nor {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Nor {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        for (address, byte) in (address(offset, bytes.len())?..).zip(bytes) {
            // SAFETY: within the flash part of the PSRAM, as checked.
            *byte = unsafe { core::ptr::read_volatile(address as *const u8) };
        }
        // A real flash lets others run during the transfer.
        yield_now().await;
        Ok(())
    }

    fn capacity(&self) -> usize {
        FLASH_LEN as usize
    }
}

impl NorFlash for Nor {
    const WRITE_SIZE: usize = 1;
    const ERASE_SIZE: usize = SECTOR;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        if !(from as usize).is_multiple_of(SECTOR) || !(to as usize).is_multiple_of(SECTOR) {
            return Err(NorFlashErrorKind::NotAligned);
        }
        address(to, 0)?;
        for sector in (from as usize..to as usize).step_by(SECTOR) {
            self.fill(sector, SECTOR);
            yield_now().await;
        }
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        for (address, &byte) in (address(offset, bytes.len())?..).zip(bytes) {
            // SAFETY: within the flash part of the PSRAM, as checked.
            unsafe {
                let cell = address as *mut u8;
                core::ptr::write_volatile(cell, core::ptr::read_volatile(cell) & byte);
            }
        }
        yield_now().await;
        Ok(())
    }
}

impl MultiwriteNorFlash for Nor {}
