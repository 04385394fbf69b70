//! The W25Q128 with a limit to every wait.
//!
//! The driver asks a busy part without end, and its erase of a range panics where a sector fails.

use cpcm_shared::limit::{Limit, Limited};
use embassy_stm32::gpio::Output;
use embassy_time::Instant;
use embedded_storage_async::nor_flash::{ErrorType, MultiwriteNorFlash, NorFlash, ReadNorFlash};
use static_cell::StaticCell;
use w25q32jv::{Error, W25q32jv};

use super::Bus;

type Part = W25q32jv<Limited<'static, Bus>, Output<'static>, Output<'static>>;

/// Longest time for a read, a write, or the erase of one sector, µs. By the data sheet a sector takes up to 0.4 s, a page
/// 3 ms; the rest is for the other tasks.
const LONGEST_US: u64 = 1_000_000;

static LIMIT: StaticCell<Limit> = StaticCell::new();

/// The flash.
pub struct Flash {
    part: Part,
    limit: &'static Limit,
}

impl Flash {
    /// To be called once.
    pub fn new(bus: Bus, hold: Output<'static>, protect: Output<'static>) -> Option<Self> {
        let limit: &'static Limit = LIMIT.init(Limit::new(|| Instant::now().as_micros()));
        let part = Part::new(Limited::new(bus, limit), hold, protect).ok()?;
        Some(Flash { part, limit })
    }
}

impl ErrorType for Flash {
    type Error = <Part as ErrorType>::Error;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = Part::READ_SIZE;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        self.limit.allow(LONGEST_US);
        self.part.read(offset, bytes).await
    }

    fn capacity(&self) -> usize {
        ReadNorFlash::capacity(&self.part)
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = Part::WRITE_SIZE;
    const ERASE_SIZE: usize = Part::ERASE_SIZE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        let sector = Self::ERASE_SIZE as u32;
        if !from.is_multiple_of(sector) || !to.is_multiple_of(sector) {
            return Err(Error::NotAligned);
        }
        if from > to {
            return Err(Error::OutOfBounds);
        }
        for index in from / sector..to / sector {
            self.limit.allow(LONGEST_US);
            self.part.erase_sector_async(index).await?;
        }
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        self.limit.allow(LONGEST_US);
        self.part.write(offset, bytes).await
    }
}

impl MultiwriteNorFlash for Flash {}
