//! Size of the firmware: `cargo test --package cpcm-tests --test firmware -- --nocapture` prints it.

use std::path::Path;

use cpcm_tests::elf;

/// Flash of the MCU, bytes.
const FLASH: u32 = 1 << 20;
/// Its RAM without the part that the stack has to itself, bytes.
const RAM: u32 = 96 << 10;
/// Where the RAM begins on both boards.
const RAM_START: u32 = 0x2000_0000;
/// Section holds memory at run time.
const ALLOCATED: u32 = 1 << 1;
/// Section takes no room in the file.
const NO_BITS: u32 = 8;

struct Size {
    flash: u32,
    ram: u32,
}

/// Sums the sections of a 32-bit little-endian ELF.
fn size_of(elf: &Path) -> Size {
    let bytes = std::fs::read(elf).unwrap();
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    let half = |at: usize| usize::from(u16::from_le_bytes(bytes[at..at + 2].try_into().unwrap()));
    let (first, length, count) = (word(0x20) as usize, half(0x2E), half(0x30));
    let mut size = Size { flash: 0, ram: 0 };
    for section in (0..count).map(|index| first + index * length) {
        let (kind, flags) = (word(section + 4), word(section + 8));
        let (address, bytes) = (word(section + 12), word(section + 20));
        if flags & ALLOCATED == 0 {
            continue;
        }
        size.flash += if kind == NO_BITS { 0 } else { bytes };
        size.ram += if address >= RAM_START { bytes } else { 0 };
    }
    size
}

#[test]
fn regress_firmware_fits_with_room_to_spare() {
    for (alias, name) in [("fw", "node"), ("fw-qemu", "node-qemu")] {
        let size = size_of(&elf::build(alias, name));
        println!(
            "{name:<10} flash {:>7} of {FLASH} bytes, static RAM {:>6} of {RAM} bytes",
            size.flash, size.ram
        );
        assert!(size.flash < FLASH / 4, "{name}: room for an update beside the running image, twice over");
        assert!(size.ram < RAM - 2048, "{name}");
        assert!(size.flash > 50_000 && size.ram > 60_000, "{name}: nothing measured");
    }
}
