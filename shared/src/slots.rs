//! A small value in NOR flash that is replaced by one write that either happened or did not.
//!
//! The region is a row of sectors, cut into slots of [`SLOT`] bytes:
//!
//! ```text
//! offset   length   content (integers little-endian)
//! 0        4        generation, one more than that of the slot before; never 0xFFFF_FFFF
//! 4        52       value, filled up with 0xFF
//! 56       4        CRC-32/ISO-HDLC of bytes 0 … 55
//! 60       4        0xFF (the slot is a power of two)
//! ```
//!
//! The value in force is the one with the highest generation among slots with a good CRC. A new value goes to the
//! next blank slot; when the sector is full, the next sector is erased first, while the value in force stays where
//! it is. A write that the power cut short leaves a slot with a bad CRC, which is skipped from then on.

use core::ops::Range;

use embedded_storage_async::nor_flash::NorFlash;

use crate::checksum;

/// Bytes of a slot.
pub const SLOT: usize = 64;
/// Bytes of a value.
pub const VALUE: usize = 52;

const CHECKED: usize = 4 + VALUE;

/// Why a value could not be stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Error<E> {
    /// The flash failed.
    Flash(E),
    /// None of the slots took the value; the old one is still in force.
    WornOut {
        /// Slots in the region.
        slots: u32,
    },
}

/// The value in force and where the next one goes.
#[derive(Clone, Debug)]
pub struct Slots {
    region: Range<u32>,
    newest: Option<Newest>,
}

#[derive(Clone, Debug)]
struct Newest {
    address: u32,
    generation: u32,
    value: [u8; VALUE],
}

impl Slots {
    /// Knows nothing of the flash yet. `region`: at least two sectors.
    pub const fn new(region: Range<u32>) -> Self {
        Slots { region, newest: None }
    }

    /// Looks for the value in force.
    pub async fn mount<F: NorFlash>(&mut self, flash: &mut F) -> Result<(), F::Error> {
        self.newest = None;
        for address in self.region.clone().step_by(SLOT) {
            let mut slot = [0; SLOT];
            flash.read(address, &mut slot).await?;
            if let Some((generation, value)) = decode(&slot)
                && self.newest.as_ref().is_none_or(|n| generation > n.generation)
            {
                self.newest = Some(Newest { address, generation, value });
            }
        }
        Ok(())
    }

    /// The value in force.
    pub fn value(&self) -> Option<&[u8; VALUE]> {
        self.newest.as_ref().map(|n| &n.value)
    }

    /// How many values were stored before and including the one in force.
    pub fn generation(&self) -> u32 {
        self.newest.as_ref().map_or(0, |n| n.generation)
    }

    /// Puts `value` in force.
    pub async fn store<F: NorFlash>(
        &mut self,
        flash: &mut F,
        value: [u8; VALUE],
    ) -> Result<(), Error<F::Error>> {
        let generation = self.generation().saturating_add(1);
        let slot = encode(generation, &value);
        let mut address = self.newest.as_ref().map(|n| n.address);
        let slots = (self.region.end - self.region.start) / SLOT as u32;
        for _ in 0..slots {
            let Some(next) = self.make_room(flash, address).await.map_err(Error::Flash)? else { break };
            address = Some(next);
            let mut found = [0; SLOT];
            flash.read(next, &mut found).await.map_err(Error::Flash)?;
            if found != [0xFF; SLOT] {
                continue; // a write before this one was cut short
            }
            flash.write(next, &slot).await.map_err(Error::Flash)?;
            flash.read(next, &mut found).await.map_err(Error::Flash)?;
            if found == slot {
                self.newest = Some(Newest { address: next, generation, value });
                return Ok(());
            }
        }
        Err(Error::WornOut { slots })
    }

    /// The slot after `address`; erases its sector when the slot is the first of it. `None` when that sector holds
    /// the value in force: all others have been tried, the flash is worn out.
    async fn make_room<F: NorFlash>(
        &self,
        flash: &mut F,
        address: Option<u32>,
    ) -> Result<Option<u32>, F::Error> {
        let next = match address {
            Some(address) if address + (SLOT as u32) < self.region.end => address + SLOT as u32,
            _ => self.region.start,
        };
        let sector = next..next + F::ERASE_SIZE as u32;
        if (next - self.region.start).is_multiple_of(F::ERASE_SIZE as u32) {
            if self.newest.as_ref().is_some_and(|n| sector.contains(&n.address)) {
                return Ok(None);
            }
            flash.erase(sector.start, sector.end).await?;
        }
        Ok(Some(next))
    }
}

fn encode(generation: u32, value: &[u8; VALUE]) -> [u8; SLOT] {
    let mut slot = [0xFF; SLOT];
    slot[..4].copy_from_slice(&generation.to_le_bytes());
    slot[4..CHECKED].copy_from_slice(value);
    let crc = checksum::crc32(&slot[..CHECKED]);
    slot[CHECKED..CHECKED + checksum::LEN].copy_from_slice(&crc.to_le_bytes());
    slot
}

fn decode(slot: &[u8; SLOT]) -> Option<(u32, [u8; VALUE])> {
    let content = checksum::verified(&slot[..CHECKED + checksum::LEN])?;
    let (generation, value) = content.split_first_chunk::<4>()?;
    Some((u32::from_le_bytes(*generation), value.try_into().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nor_mock::Nor;
    use embassy_futures::block_on;

    fn value(k: u32) -> [u8; VALUE] {
        let mut value = [k as u8; VALUE];
        value[..4].copy_from_slice(&k.to_le_bytes());
        value
    }

    fn mounted(nor: &mut Nor) -> Slots {
        let mut slots = Slots::new(nor.whole());
        block_on(slots.mount(nor)).unwrap();
        slots
    }

    #[test]
    fn property_newest_value_survives_a_restart_around_the_ring() {
        let mut nor = Nor::new(2);
        assert_eq!(mounted(&mut nor).value(), None);
        for k in 0..300 {
            block_on(mounted(&mut nor).store(&mut nor, value(k))).unwrap();
            assert_eq!(mounted(&mut nor).value(), Some(&value(k)));
        }
        assert_eq!(mounted(&mut nor).generation(), 300);
    }

    /// Power is cut at every byte of 140 stores, which go twice around two sectors; after each cut a second store
    /// is cut at the same byte again, and then one goes through.
    #[test]
    fn property_power_cut_leaves_old_or_new_value() {
        let mut nor = Nor::new(2);
        for k in 1..140 {
            block_on(mounted(&mut nor).store(&mut nor, value(k - 1))).unwrap();
            for cut in 0.. {
                let mut hurt = nor.cut_after(cut);
                let mut slots = mounted(&mut hurt);
                let outcome = block_on(slots.store(&mut hurt, value(k)));
                let mut back = hurt.power_back();
                let found = *mounted(&mut back).value().expect("never none");
                assert!(found == value(k - 1) || found == value(k), "store {k} cut at {cut}");
                if outcome.is_ok() {
                    assert_eq!(found, value(k), "acknowledged, then gone: store {k} cut at {cut}");
                    break;
                }
                let mut again = back.cut_after(cut);
                let _ = block_on(mounted(&mut again).store(&mut again, value(k)));
                let mut back = again.power_back();
                block_on(mounted(&mut back).store(&mut back, value(k + 1000))).unwrap();
                assert_eq!(mounted(&mut back).value(), Some(&value(k + 1000)));
            }
        }
    }

    #[test]
    fn property_garbage_flash_mounts_as_nothing() {
        let mut nor = Nor::new(2);
        nor.bytes.iter_mut().enumerate().for_each(|(i, byte)| *byte = ((i * 7919) >> 3) as u8);
        assert_eq!(mounted(&mut nor).value(), None);
        block_on(mounted(&mut nor).store(&mut nor, value(5))).unwrap();
        assert_eq!(mounted(&mut nor).value(), Some(&value(5)));
    }
}
