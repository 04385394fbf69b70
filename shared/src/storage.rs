//! Everything that the node keeps in its NOR flash.

use core::ops::Range;

use embedded_storage_async::nor_flash::MultiwriteNorFlash;

use crate::bank::{Active, Banks, Refusal, Regions, SCRATCH};
use crate::clock::Clock;
use crate::journal::{AppendError, Journal, SEGMENT};
use crate::message::Kernel;
use crate::operator::ReadFailed;
use crate::package::Header;
use crate::record::Record;

/// What is where in the flash, bytes from its beginning. Everything begins and ends at 4 KiB sectors.
#[derive(Clone, Debug)]
pub struct Map {
    /// See [`crate::clock`]; at least two sectors.
    pub clock: Range<u32>,
    /// See [`crate::journal`]; whole segments.
    pub journal: Range<u32>,
    /// Length of a journal segment.
    pub segment: u32,
    /// See [`crate::bank`].
    pub banks: Regions,
}

/// What the node uses of its flash of 128 Mbit, bytes. The rest is free, and QEMU's memory has no room for it.
pub const FLASH_LEN: u32 = 12 << 20;

impl Map {
    /// The node's map:
    ///
    /// ```text
    /// 0x00_0000   32 KiB     clock
    /// 0x00_8000   32 KiB     marker of the kernel banks
    /// 0x01_0000   1984 KiB   journal, 62 segments: about 3600 records of 24 wheelsets
    /// 0x20_0000   5 MiB      kernel bank 0
    /// 0x70_0000   5 MiB      kernel bank 1
    /// ```
    pub const fn node() -> Self {
        Map {
            clock: 0x00_0000..0x00_8000,
            journal: 0x01_0000..0x20_0000,
            segment: SEGMENT,
            banks: Regions {
                marker: 0x00_8000..0x01_0000,
                banks: [0x20_0000..0x70_0000, 0x70_0000..FLASH_LEN],
            },
        }
    }
}

/// The package in force, as the evaluation needs it; 7 kB, for a `static`.
pub struct InForce {
    package: Option<Active>,
    header: Header,
}

/// Where the payload of a package is.
#[derive(Clone, Copy, Debug)]
pub struct Payload {
    package: Active,
    start: u32,
}

impl InForce {
    /// None is known to be in force.
    pub const fn new() -> Self {
        InForce { package: None, header: Header::empty() }
    }

    /// Header, kernel id for records, and where to read the payload.
    pub fn get(&self) -> Option<(&Header, u32, Payload)> {
        let package = self.package?;
        let start = package.length.saturating_sub(self.header.payload_len);
        Some((&self.header, package.kernel_id, Payload { package, start }))
    }
}

impl Default for InForce {
    fn default() -> Self {
        Self::new()
    }
}

/// The flash and what is in it.
pub struct Storage<F> {
    pub(crate) flash: F,
    pub(crate) journal: Journal,
    pub(crate) banks: Banks,
    pub(crate) clock: Clock,
    /// For a header or a record, whichever is at hand.
    pub(crate) scratch: [u8; SCRATCH],
    mounted: bool,
    errors: u32,
}

impl<F: MultiwriteNorFlash> Storage<F> {
    /// Knows nothing of the flash yet. The flash must take single bytes (`WRITE_SIZE` 1).
    pub const fn new(flash: F, map: Map) -> Self {
        Storage {
            flash,
            journal: Journal::new(map.journal, map.segment),
            banks: Banks::new(map.banks),
            clock: Clock::new(map.clock),
            scratch: [0; SCRATCH],
            mounted: false,
            errors: 0,
        }
    }

    /// Reads the flash and counts the start-up.
    pub async fn mount(&mut self) -> Result<(), F::Error> {
        self.clock.mount(&mut self.flash).await?;
        self.banks.mount(&mut self.flash, &mut self.scratch).await?;
        self.journal.mount(&mut self.flash, &mut self.scratch).await;
        self.mounted = true;
        Ok(())
    }

    /// Whether the flash has been read.
    pub fn is_mounted(&self) -> bool {
        self.mounted
    }

    /// The journal.
    pub fn journal(&self) -> &Journal {
        &self.journal
    }

    /// Kernel id of the package in force.
    pub fn kernel_id(&self) -> Option<u32> {
        self.banks.active().map(|active| active.kernel_id)
    }

    /// Failures since start-up.
    pub fn errors(&self) -> u32 {
        self.errors.saturating_add(self.journal.errors())
    }

    /// Stores a record; when this returns `Ok` it survives a power cut.
    pub async fn append(&mut self, record: &Record) -> Result<(), AppendError> {
        self.journal.append(&mut self.flash, record, &mut self.scratch).await
    }

    /// Makes `kernel` the package in force; its header is read only when it is another one than before.
    pub async fn refresh(&mut self, kernel: &mut InForce) {
        if self.banks.active() == kernel.package {
            return;
        }
        kernel.package = None;
        let package = self.banks.header(&mut self.flash, &mut kernel.header, &mut self.scratch).await;
        kernel.package = self.count(package).ok();
    }

    /// Reads from the payload of a package, `offset` bytes from its beginning.
    pub async fn payload(
        &mut self,
        package: Payload,
        offset: u32,
        bytes: &mut [u8],
    ) -> Result<(), ReadFailed> {
        let outcome = match package.start.checked_add(offset) {
            Some(offset) => self.banks.read(&mut self.flash, package.package, offset, bytes).await,
            None => Err(Refusal::Flash { offset }),
        };
        self.count(outcome).map_err(|_| ReadFailed)
    }

    /// What to tell of the package in force.
    pub async fn kernel(&mut self) -> Option<Kernel> {
        let active = self.banks.active()?;
        let found = self.banks.found(&mut self.flash, &mut self.scratch).await;
        let found = self.count(found).ok()?;
        let Active { length, crc, .. } = active;
        Some(Kernel { id: found.id, crc, length, site: found.site, train: found.train })
    }

    /// Gives the flash back.
    pub fn into_flash(self) -> F {
        self.flash
    }

    pub(crate) fn count<T>(&mut self, outcome: Result<T, Refusal>) -> Result<T, Refusal> {
        if let Err(Refusal::Flash { .. }) = outcome {
            self.errors = self.errors.saturating_add(1);
        }
        outcome
    }
}
