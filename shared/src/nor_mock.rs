//! NOR flash for tests: write-once bits, alignment checks, and a power supply that fails after any byte.

use std::ops::Range;
use std::vec;
use std::vec::Vec;

use embedded_storage_async::nor_flash::{
    ErrorType, MultiwriteNorFlash, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};

/// Sector size, bytes.
pub const SECTOR: usize = 4096;
/// An erase proceeds in steps of this many bytes, each costing one unit of the budget.
const ERASE_STEP: usize = 256;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    PowerCut,
    OutOfBounds,
    NotErased,
}

impl NorFlashError for Failure {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

#[derive(Clone)]
pub struct Nor {
    pub bytes: Vec<u8>,
    /// Bytes that may still be programmed (and erase steps made) before the power fails.
    pub budget: Option<usize>,
    /// Bytes programmed and erase steps made so far.
    pub spent: usize,
    /// Refuses to program a bit from 0 to 1.
    pub strict: bool,
    pub erased_sectors: usize,
}

impl Nor {
    pub fn new(sectors: usize) -> Self {
        let bytes = vec![0xFF; sectors * SECTOR];
        Nor { bytes, budget: None, spent: 0, strict: true, erased_sectors: 0 }
    }

    pub fn whole(&self) -> Range<u32> {
        0..self.bytes.len() as u32
    }

    /// The same flash on a supply that fails after `budget` more bytes.
    pub fn cut_after(&self, budget: usize) -> Self {
        Nor { budget: Some(budget), ..self.clone() }
    }

    /// The same flash after the power has come back.
    pub fn power_back(mut self) -> Self {
        self.budget = None;
        self
    }

    fn spend(&mut self) -> Result<(), Failure> {
        if let Some(budget) = &mut self.budget {
            *budget = budget.checked_sub(1).ok_or(Failure::PowerCut)?;
        }
        self.spent += 1;
        Ok(())
    }

    fn check(&self, offset: u32, length: usize) -> Result<usize, Failure> {
        let start = offset as usize;
        if start + length <= self.bytes.len() { Ok(start) } else { Err(Failure::OutOfBounds) }
    }
}

impl ErrorType for Nor {
    type Error = Failure;
}

impl ReadNorFlash for Nor {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Failure> {
        let start = self.check(offset, bytes.len())?;
        bytes.copy_from_slice(&self.bytes[start..start + bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl NorFlash for Nor {
    const WRITE_SIZE: usize = 1;
    const ERASE_SIZE: usize = SECTOR;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Failure> {
        let start = self.check(from, (to - from) as usize)?;
        assert!(start.is_multiple_of(SECTOR) && (to as usize).is_multiple_of(SECTOR), "unaligned erase");
        for step in (start..to as usize).step_by(ERASE_STEP) {
            self.spend()?;
            self.bytes[step..step + ERASE_STEP].fill(0xFF);
        }
        self.erased_sectors += (to - from) as usize / SECTOR;
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Failure> {
        let start = self.check(offset, bytes.len())?;
        for (cell, &byte) in (start..).zip(bytes) {
            if self.strict && self.bytes[cell] & byte != byte {
                return Err(Failure::NotErased);
            }
            self.spend()?;
            self.bytes[cell] &= byte;
        }
        Ok(())
    }
}

impl MultiwriteNorFlash for Nor {}
