//! Two banks for kernel packages: one in force, one to upload into.
//!
//! ```text
//! region      content
//! marker      slots (see [`crate::slots`]); the newest says which bank is in force and what is in it:
//!             offset 0: bank (0 or 1), 1: length u32, 5: CRC-32 of the whole package u32, 9: kernel id u32
//! bank 0, 1   the package (see [`crate::package`]) from the first byte; a sector is erased when it is first written
//! ```
//!
//! An upload goes in chunks, in order, to the bank that is not in force. Its header is checked as soon as it is
//! complete, so that a package that does not fit is refused early. [`Banks::commit`] reads the whole package back
//! from flash, checks it, and only then writes the marker: one slot, that is there or not. Whatever happens before,
//! and wherever the power fails, the old package stays in force.
//!
//! How far an upload is, is kept in RAM: it survives a broken line, not a restart.

mod outcome;

use core::ops::Range;

use embedded_storage_async::nor_flash::NorFlash;
use heapless::String;

use crate::checksum::Running;
use crate::package::check::header_len;
use crate::package::{Header, MAX_HEADER_LEN, PREFIX_LEN};
use crate::slots::{Slots, VALUE};

pub use outcome::{Progress, Refusal};

/// Where markers and banks are in the flash. Banks begin and end at sectors.
#[derive(Clone, Debug)]
pub struct Regions {
    /// At least two sectors.
    pub marker: Range<u32>,
    /// Of equal length.
    pub banks: [Range<u32>; 2],
}

/// The package in force.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Active {
    bank: u8,
    /// Length of the package, bytes.
    pub length: u32,
    /// CRC-32 of the whole package.
    pub crc: u32,
    /// CRC-32 of its header: the `kernel_id` of records.
    pub kernel_id: u32,
}

impl Active {
    fn to_value(self) -> [u8; VALUE] {
        let mut value = [0xFF; VALUE];
        let fields = [self.length, self.crc, self.kernel_id];
        value[0] = self.bank;
        value[1..13].copy_from_slice(fields.map(u32::to_le_bytes).as_flattened());
        value
    }

    fn from_value(value: &[u8; VALUE]) -> Option<Self> {
        let [bank @ (0 | 1), rest @ ..] = value else { return None };
        let [length, crc, kernel_id] = *rest.as_chunks::<4>().0.first_chunk::<3>()?;
        Some(Active {
            bank: *bank,
            length: u32::from_le_bytes(length),
            crc: u32::from_le_bytes(crc),
            kernel_id: u32::from_le_bytes(kernel_id),
        })
    }
}

/// What the header of a package tells.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// CRC-32 of the header: the `kernel_id` of records.
    pub id: u32,
    /// Site name.
    pub site: String<48>,
    /// Name of the train type.
    pub train: String<16>,
}

/// Bytes for prefix and header.
pub const SCRATCH: usize = PREFIX_LEN + MAX_HEADER_LEN;

/// The banks; the flash itself is passed to each call, because others use it too.
#[derive(Clone, Debug)]
pub struct Banks {
    regions: Regions,
    marker: Slots,
    active: Option<Active>,
    upload: Option<Progress>,
}

impl Banks {
    /// Knows nothing of the flash yet.
    pub const fn new(regions: Regions) -> Self {
        let Regions { marker: Range { start, end }, .. } = regions;
        Banks { marker: Slots::new(start..end), regions, active: None, upload: None }
    }

    /// Looks for the package in force. A marker whose bank does not hold the header it names puts none in force.
    pub async fn mount<F: NorFlash>(
        &mut self,
        flash: &mut F,
        scratch: &mut [u8; SCRATCH],
    ) -> Result<(), F::Error> {
        self.marker.mount(flash).await?;
        let marked = self.marker.value().and_then(Active::from_value);
        self.active = marked;
        let found = self.found(flash, scratch).await;
        self.active = marked.filter(|marked| found.is_ok_and(|found| found.id == marked.kernel_id));
        Ok(())
    }

    /// The package in force.
    pub fn active(&self) -> Option<Active> {
        self.active
    }

    /// Length of a bank: the longest package, bytes.
    pub fn capacity(&self) -> u32 {
        let [bank, _] = &self.regions.banks;
        bank.end - bank.start
    }

    /// How far the upload is; `None` when there is none.
    pub fn progress(&self) -> Option<Progress> {
        self.upload
    }

    /// What the header of the package in force tells.
    pub async fn found<F: NorFlash>(
        &self,
        flash: &mut F,
        scratch: &mut [u8; SCRATCH],
    ) -> Result<Found, Refusal> {
        let active = self.active.ok_or(Refusal::NoPackage)?;
        let bytes = self.header_bytes(flash, active.bank, scratch).await?;
        check(bytes, active.length)
    }

    /// Reads the header of the package in force into `header`; the package is what to read matrices from. After an
    /// error `header` is not to be used.
    pub async fn header<F: NorFlash>(
        &self,
        flash: &mut F,
        header: &mut Header,
        scratch: &mut [u8; SCRATCH],
    ) -> Result<Active, Refusal> {
        let active = self.active.ok_or(Refusal::NoPackage)?;
        let bytes = self.header_bytes(flash, active.bank, scratch).await?;
        header.decode_into(bytes).map_err(Refusal::Header)?;
        Ok(active)
    }

    /// Reads from `package`, `offset` bytes from the beginning of the file.
    pub async fn read<F: NorFlash>(
        &self,
        flash: &mut F,
        package: Active,
        offset: u32,
        bytes: &mut [u8],
    ) -> Result<(), Refusal> {
        let failed = Refusal::Flash { offset };
        let end = offset.checked_add(bytes.len() as u32).ok_or(failed)?;
        if end > package.length {
            return Err(Refusal::Overrun { end, length: package.length });
        }
        flash.read(self.start(package.bank) + offset, bytes).await.map_err(|_| failed)
    }

    /// Begins an upload, or goes on with the one of the same length and CRC.
    pub fn begin(&mut self, length: u32, crc: u32) -> Result<Progress, Refusal> {
        if let Some(upload) = self.upload.filter(|upload| (upload.length, upload.crc) == (length, crc)) {
            return Ok(upload);
        }
        if length > self.capacity() {
            return Err(Refusal::TooLong { length, max: self.capacity() });
        }
        Ok(*self.upload.insert(Progress { received: 0, length, crc }))
    }

    /// Stores the next piece. A piece that is already there is acknowledged without writing it again.
    pub async fn chunk<F: NorFlash>(
        &mut self,
        flash: &mut F,
        offset: u32,
        bytes: &[u8],
        scratch: &mut [u8; SCRATCH],
    ) -> Result<Progress, Refusal> {
        let upload = self.upload.ok_or(Refusal::NotBegun)?;
        let end = offset.saturating_add(bytes.len() as u32);
        if end > upload.length {
            return Err(Refusal::Overrun { end, length: upload.length });
        }
        if offset > upload.received {
            return Err(Refusal::Gap { offset, received: upload.received });
        }
        let known = (upload.received - offset) as usize;
        let Some(fresh) = bytes.get(known..).filter(|fresh| !fresh.is_empty()) else { return Ok(upload) };
        self.write(flash, upload.received, fresh).await?;
        let done = Progress { received: end, ..upload };
        self.upload = Some(done);
        if let Err(refusal) = self.check_early(flash, upload.received, done, scratch).await {
            self.upload = None;
            return Err(refusal);
        }
        Ok(done)
    }

    /// Checks the uploaded package, whose CRC-32 is `crc`, as it is in flash and puts it in force. Once it is, a
    /// repetition has no effect.
    pub async fn commit<F: NorFlash>(
        &mut self,
        flash: &mut F,
        crc: u32,
        scratch: &mut [u8; SCRATCH],
    ) -> Result<Active, Refusal> {
        let Some(upload) = self.upload.filter(|upload| upload.crc == crc) else {
            return self.active.filter(|active| active.crc == crc).ok_or(Refusal::NotBegun);
        };
        if upload.received < upload.length {
            return Err(Refusal::Incomplete { received: upload.received, length: upload.length });
        }
        self.upload = None;
        let found = self.crc_of_upload(flash, upload.length, scratch).await?;
        if found != upload.crc {
            return Err(Refusal::Crc { announced: upload.crc, found });
        }
        let bank = self.inactive();
        let bytes = self.header_bytes(flash, bank, scratch).await?;
        let found = check(bytes, upload.length)?;
        let active = Active { bank, length: upload.length, crc: upload.crc, kernel_id: found.id };
        self.marker.store(flash, active.to_value()).await.map_err(|_| Refusal::Flash { offset: 0 })?;
        self.active = Some(active);
        Ok(active)
    }

    /// Gives the upload up.
    pub fn abort(&mut self) {
        self.upload = None;
    }

    fn inactive(&self) -> u8 {
        self.active.map_or(0, |active| 1 - active.bank)
    }

    fn start(&self, bank: u8) -> u32 {
        let [first, second] = &self.regions.banks;
        if bank == 0 { first.start } else { second.start }
    }

    /// Writes into the inactive bank; erases each sector when its first byte comes.
    async fn write<F: NorFlash>(&self, flash: &mut F, offset: u32, bytes: &[u8]) -> Result<(), Refusal> {
        let (start, sector) = (self.start(self.inactive()), F::ERASE_SIZE as u32);
        let (mut offset, mut rest) = (offset, bytes);
        while !rest.is_empty() {
            let failed = |_| Refusal::Flash { offset };
            if offset.is_multiple_of(sector) {
                flash.erase(start + offset, start + offset + sector).await.map_err(failed)?;
            }
            let room = (sector - offset % sector) as usize;
            let (now, later) = rest.split_at_checked(room).unwrap_or((rest, &[]));
            flash.write(start + offset, now).await.map_err(failed)?;
            offset += now.len() as u32;
            rest = later;
        }
        Ok(())
    }

    /// Checks the header with the chunk that completes it.
    async fn check_early<F: NorFlash>(
        &self,
        flash: &mut F,
        before: u32,
        upload: Progress,
        scratch: &mut [u8; SCRATCH],
    ) -> Result<(), Refusal> {
        let mut prefix = [0; PREFIX_LEN];
        if upload.received < PREFIX_LEN as u32 {
            return Ok(());
        }
        let bank = self.inactive();
        flash.read(self.start(bank), &mut prefix).await.map_err(|_| Refusal::Flash { offset: 0 })?;
        let end = (PREFIX_LEN + header_len(&prefix).map_err(Refusal::Header)?) as u32;
        if before < end && end <= upload.received {
            let bytes = self.header_bytes(flash, bank, scratch).await?;
            check(bytes, upload.length)?;
        }
        Ok(())
    }

    async fn header_bytes<'s, F: NorFlash>(
        &self,
        flash: &mut F,
        bank: u8,
        scratch: &'s mut [u8; SCRATCH],
    ) -> Result<&'s [u8], Refusal> {
        let failed = |_| Refusal::Flash { offset: 0 };
        let mut prefix = [0; PREFIX_LEN];
        flash.read(self.start(bank), &mut prefix).await.map_err(failed)?;
        let end = PREFIX_LEN + header_len(&prefix).map_err(Refusal::Header)?;
        let bytes = scratch.get_mut(..end).unwrap_or_default();
        flash.read(self.start(bank), bytes).await.map_err(failed)?;
        Ok(bytes)
    }

    async fn crc_of_upload<F: NorFlash>(
        &self,
        flash: &mut F,
        length: u32,
        scratch: &mut [u8; SCRATCH],
    ) -> Result<u32, Refusal> {
        /// Small enough that others are not kept waiting: 512 bytes take 0.3 ms at 16 MHz.
        const PIECE: u32 = 512;
        let (start, mut crc) = (self.start(self.inactive()), Running::new());
        for offset in (0..length).step_by(PIECE as usize) {
            let piece = scratch.get_mut(..PIECE.min(length - offset) as usize).unwrap_or_default();
            flash.read(start + offset, piece).await.map_err(|_| Refusal::Flash { offset })?;
            crc.update(piece);
        }
        Ok(crc.finish())
    }
}

/// Checks prefix and header of a package of `package` bytes in all.
fn check(bytes: &[u8], package: u32) -> Result<Found, Refusal> {
    let mut header = Header::empty();
    let id = header.decode_into(bytes).map_err(Refusal::Header)?;
    let parts = bytes.len() as u64 + u64::from(header.payload_len);
    if parts != u64::from(package) {
        return Err(Refusal::Length { package, parts });
    }
    Ok(Found { id, site: header.provenance.site, train: header.train.name })
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::checksum::crc32;
    use crate::nor_mock::{Nor, SECTOR};
    use crate::package::check::{PackageError, SensorField};
    use crate::package::{Bin, Block, FORMAT, Group, Operator, Provenance, Sensor, Train};
    use crate::sample::{FULL_SCALE_CODE, M_S2_PER_CODE};
    use embassy_futures::block_on;
    use std::vec::Vec;

    const CHUNK: usize = 100;

    fn operator() -> Operator {
        let block = |offset, rows, cols| Block { offset, rows, cols, crc: 0 };
        Operator {
            before: 2,
            project: block(0, 2, 8),
            expand: block(64, 6, 2),
            offset_n: block(112, 6, 1),
            half_width_n: block(136, 6, 1),
            template_m_s2: block(160, 1, 8),
        }
    }

    /// A small header: one bin, one operator, two axles; `payload` bytes of matrices.
    pub(crate) fn header(site: &str) -> Header {
        Header {
            format: FORMAT,
            provenance: Provenance {
                site: site.try_into().unwrap(),
                model_hash: 7,
                calibrated_on: String::new(),
                written_by: "test".try_into().unwrap(),
            },
            sensor: Sensor {
                sample_rate_hz: 4000.0,
                decimation: 4,
                m_s2_per_code: M_S2_PER_CODE,
                range_m_s2: FULL_SCALE_CODE as f32 * M_S2_PER_CODE,
            },
            direction: 1,
            train: Train {
                name: "X2".try_into().unwrap(),
                axle_offset_m: heapless::Vec::from_slice(&[0.0, 2.9]).unwrap(),
                static_force_n: 76_000.0,
                groups: heapless::Vec::from_slice(&[Group { first_axle: 0, axles: 2, operator: 0 }]).unwrap(),
            },
            grid_first_m: -0.9,
            grid_step_m: 0.01,
            grid_len: 3,
            bins: heapless::Vec::from_slice(&[Bin {
                speed_m_s: 40.0,
                operators: heapless::Vec::from_slice(&[operator()]).unwrap(),
            }])
            .unwrap(),
            payload_len: 192,
        }
    }

    /// The file of `header` with a payload that counts.
    pub(crate) fn package(header: &Header) -> Vec<u8> {
        let mut encoded = [0; SCRATCH];
        let length = header.encode(&mut encoded).unwrap();
        encoded[..length].iter().copied().chain((0..header.payload_len).map(|k| k as u8)).collect()
    }

    fn regions() -> Regions {
        let sector = SECTOR as u32;
        Regions { marker: 0..2 * sector, banks: [2 * sector..4 * sector, 4 * sector..6 * sector] }
    }

    fn mounted(nor: &mut Nor) -> Banks {
        let mut banks = Banks::new(regions());
        block_on(banks.mount(nor, &mut [0; SCRATCH])).unwrap();
        banks
    }

    fn site(nor: &mut Nor) -> Option<std::string::String> {
        let banks = mounted(nor);
        let found = block_on(banks.found(nor, &mut [0; SCRATCH])).ok()?;
        Some(found.site.as_str().into())
    }

    fn upload(nor: &mut Nor, file: &[u8]) -> Result<Active, Refusal> {
        let (mut banks, mut scratch) = (mounted(nor), [0; SCRATCH]);
        banks.begin(file.len() as u32, crc32(file))?;
        for (index, chunk) in file.chunks(CHUNK).enumerate() {
            block_on(banks.chunk(nor, (index * CHUNK) as u32, chunk, &mut scratch))?;
        }
        block_on(banks.commit(nor, crc32(file), &mut scratch))
    }

    fn with_payload(site: &str, payload: u32) -> Vec<u8> {
        let mut header = header(site);
        header.payload_len = payload;
        package(&header)
    }

    /// As the module's documentation has it.
    #[test]
    fn reference_bytes_of_a_marker() {
        let active = Active { bank: 1, length: 0x0201, crc: 3, kernel_id: 4 };
        let fields: [u8; 13] = [1, 1, 2, 0, 0, 3, 0, 0, 0, 4, 0, 0, 0];
        let value = active.to_value();
        assert_eq!(value[..13], fields);
        assert!(value[13..].iter().all(|byte| *byte == 0xFF));
    }

    #[test]
    fn property_uploads_alternate_and_read_back() {
        let mut nor = Nor::new(6);
        assert_eq!(site(&mut nor), None);
        for k in 0..20 {
            let name = std::format!("site {k}");
            let file = with_payload(&name, 5000);
            let active = upload(&mut nor, &file).unwrap();
            assert_eq!((usize::from(active.bank), active.length), (k % 2, file.len() as u32));
            assert_eq!(site(&mut nor), Some(name));
            let (banks, mut back) = (mounted(&mut nor), Vec::from_iter(file.iter().map(|_| 0)));
            block_on(banks.read(&mut nor, active, 0, &mut back)).unwrap();
            assert_eq!(back, file);
            assert!(block_on(banks.read(&mut nor, active, file.len() as u32, &mut [0])).is_err());
        }
    }

    /// Power fails at every byte of an upload over a package in force.
    #[test]
    fn property_power_cut_leaves_old_or_new() {
        let mut nor = Nor::new(6);
        upload(&mut nor, &with_payload("old", 192)).unwrap();
        let new = with_payload("new", 400);
        for cut in 0.. {
            let mut hurt = nor.cut_after(cut);
            let outcome = upload(&mut hurt, &new);
            let mut back = hurt.power_back();
            let name = site(&mut back).expect("never none");
            assert!(name == "new" || outcome.is_err(), "cut at {cut}: {name}");
            upload(&mut back, &new).unwrap();
            assert_eq!(site(&mut back).as_deref(), Some("new"));
            if outcome.is_ok() {
                assert!(cut > new.len());
                return;
            }
        }
    }

    #[test]
    fn property_refused_package_leaves_the_old_one() {
        let mut nor = Nor::new(6);
        upload(&mut nor, &with_payload("old", 192)).unwrap();
        let good = with_payload("new", 400);
        let mut damaged = good.clone();
        *damaged.last_mut().unwrap() ^= 1;
        let mut other_rate = header("rate");
        other_rate.sensor.sample_rate_hz = 2000.0;
        let capacity = 2 * SECTOR as u32;
        let too_long = with_payload("long", capacity);
        let refusals = [
            upload(&mut nor, &too_long).unwrap_err(),
            upload(&mut nor, &package(&other_rate)).unwrap_err(),
            upload(&mut nor, b"not a package, but long enough").unwrap_err(),
            upload(&mut nor, &good[..good.len() - 1]).unwrap_err(),
        ];
        assert_eq!(refusals[0], Refusal::TooLong { length: too_long.len() as u32, max: capacity });
        let rate = PackageError::Sensor { field: SensorField::SampleRate, package: 2000.0, node: 4000.0 };
        assert_eq!(refusals[1], Refusal::Header(rate));
        assert_eq!(refusals[2], Refusal::Header(PackageError::Magic));
        let length = good.len() as u32 - 1;
        assert_eq!(refusals[3], Refusal::Length { package: length, parts: u64::from(length) + 1 });
        // Announced one thing, sent another.
        let (mut banks, mut scratch) = (mounted(&mut nor), [0; SCRATCH]);
        banks.begin(good.len() as u32, crc32(&good)).unwrap();
        block_on(banks.chunk(&mut nor, 0, &damaged, &mut scratch)).unwrap();
        let crc = Refusal::Crc { announced: crc32(&good), found: crc32(&damaged) };
        assert_eq!(block_on(banks.commit(&mut nor, crc32(&good), &mut scratch)), Err(crc));
        assert_eq!(site(&mut nor).as_deref(), Some("old"));
    }

    #[test]
    fn property_chunks_may_repeat_and_overlap_but_leave_no_gap() {
        let (mut nor, mut scratch) = (Nor::new(6), [0; SCRATCH]);
        let file = with_payload("x", 5000);
        let mut banks = mounted(&mut nor);
        assert_eq!(block_on(banks.chunk(&mut nor, 0, &file, &mut scratch)), Err(Refusal::NotBegun));
        banks.begin(file.len() as u32, crc32(&file)).unwrap();
        for (from, to) in [(0, 90), (0, 90), (50, 4200), (10, 20), (4100, file.len())] {
            let progress =
                block_on(banks.chunk(&mut nor, from as u32, &file[from..to], &mut scratch)).unwrap();
            assert!(progress.received >= to as u32);
            let gap = Refusal::Gap { offset: progress.received + 1, received: progress.received };
            if progress.received < file.len() as u32 {
                let skipped = block_on(banks.chunk(&mut nor, progress.received + 1, &[], &mut scratch));
                assert_eq!(skipped, Err(gap));
                assert!(matches!(
                    block_on(banks.commit(&mut nor, crc32(&file), &mut scratch)),
                    Err(Refusal::Incomplete { .. })
                ));
            }
            // The same upload again goes on where it was.
            assert_eq!(banks.begin(file.len() as u32, crc32(&file)), Ok(progress));
        }
        let active = block_on(banks.commit(&mut nor, crc32(&file), &mut scratch)).unwrap();
        assert_eq!(site(&mut nor).as_deref(), Some("x"));
        // An answer that was lost is asked for again.
        assert_eq!(block_on(banks.commit(&mut nor, crc32(&file), &mut scratch)), Ok(active));
        assert_eq!(block_on(banks.commit(&mut nor, 1, &mut scratch)), Err(Refusal::NotBegun));
    }

    #[test]
    fn property_marker_of_a_damaged_bank_puts_nothing_in_force() {
        let mut nor = Nor::new(6);
        upload(&mut nor, &with_payload("x", 192)).unwrap();
        nor.bytes[regions().banks[0].start as usize + 40] ^= 0x10;
        assert_eq!(site(&mut nor), None);
        upload(&mut nor, &with_payload("y", 192)).unwrap();
        assert_eq!(site(&mut nor).as_deref(), Some("y"));
    }
}
