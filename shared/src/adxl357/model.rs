//! The ADXL357 as seen from the bus: registers, FIFO with watermark, overrun and markers.
//!
//! The part has no clock of its own here: whoever owns the model calls [`Model::elapse`] for the sample periods
//! that have gone by, so the same model runs in virtual time (QEMU), on demand (simulated node) and in tests.

use heapless::Deque;

use super::FIFO_SAMPLES as CAPACITY;
use super::registers::*;
use crate::sample::SensorCode;

/// Where the samples come from.
pub trait Source {
    /// Vertical acceleration of the next sample; `None` when there are no more.
    fn next_code(&mut self) -> Option<SensorCode>;
}

impl<F: FnMut() -> Option<SensorCode>> Source for F {
    fn next_code(&mut self) -> Option<SensorCode> {
        self()
    }
}

/// An ADXL357. Axes x and y read 0.
pub struct Model<S> {
    source: S,
    registers: [u8; 0x30],
    fifo: Deque<SensorCode, CAPACITY>,
    entry: usize, // of the oldest sample, that is to be read next
    overrun: bool,
    exhausted: bool,
}

impl<S: Source> Model<S> {
    /// A part after power-up, in standby.
    pub fn new(source: S) -> Self {
        let mut model = Model {
            source,
            registers: [0; 0x30],
            fifo: Deque::new(),
            entry: 0,
            overrun: false,
            exhausted: false,
        };
        model.reset();
        model
    }

    /// Lets `periods` sample periods go by.
    pub fn elapse(&mut self, periods: u32) {
        for _ in 0..periods {
            if !self.measures() || self.exhausted {
                return;
            }
            let Some(code) = self.source.next_code() else {
                self.exhausted = true;
                return;
            };
            if self.fifo.is_full() {
                self.fifo.pop_front();
                self.entry = 0;
                self.overrun = true;
            }
            // Full was ruled out above.
            let _ = self.fifo.push_back(code);
        }
    }

    /// Whether the part measures, that is, is not in standby.
    pub fn measures(&self) -> bool {
        self.registers[usize::from(POWER_CTL)] & STANDBY == 0
    }

    /// Whether INT1 is active (active high, watermark).
    pub fn int1(&self) -> bool {
        self.registers[usize::from(INT_MAP)] & FULL_EN1 != 0 && self.watermark()
    }

    /// Samples in the FIFO.
    pub fn queued(&self) -> usize {
        self.fifo.len()
    }

    /// Whether the source has ended.
    pub fn exhausted(&self) -> bool {
        self.exhausted
    }

    /// One SPI transaction: the bytes written, then the bytes read.
    pub fn transfer(&mut self, written: &[u8], read: &mut [u8]) {
        let Some((&command, values)) = written.split_first() else { return };
        let address = usize::from(command >> 1);
        if command & READ != 0 {
            for (address, byte) in ReadAddresses(address).zip(read.iter_mut()) {
                *byte = self.read(address);
            }
        } else {
            for (address, &value) in (address..).zip(values) {
                self.write(address, value);
            }
        }
    }

    fn reset(&mut self) {
        self.registers = [0; 0x30];
        self.fifo.clear();
        self.entry = 0;
        self.overrun = false;
        let reset_values = [
            (DEVID_AD, DEVID_AD_VALUE),
            (DEVID_MST, DEVID_MST_VALUE),
            (PARTID, PARTID_VALUE),
            (FIFO_SAMPLES, FIFO_LEN as u8),
            (RANGE, I2C_HS | 1),
            (POWER_CTL, STANDBY),
        ];
        for (register, value) in reset_values {
            self.registers[usize::from(register)] = value;
        }
    }

    fn entries(&self) -> usize {
        (self.fifo.len() * AXES * ENTRY_BYTES - self.entry) / ENTRY_BYTES
    }

    fn watermark(&self) -> bool {
        self.entries() >= usize::from(self.registers[usize::from(FIFO_SAMPLES)])
    }

    fn read(&mut self, address: usize) -> u8 {
        match u8::try_from(address) {
            Ok(STATUS) => {
                let full = if self.watermark() { FIFO_FULL } else { 0 };
                let overrun = if self.overrun { FIFO_OVR } else { 0 };
                self.overrun = false;
                full | overrun
            }
            Ok(FIFO_ENTRIES) => self.entries() as u8,
            Ok(FIFO_DATA) => self.pop_byte(),
            _ => self.registers.get(address).copied().unwrap_or(0),
        }
    }

    /// `entry` counts bytes of the oldest sample, so that a burst may stop anywhere.
    fn pop_byte(&mut self) -> u8 {
        let Some(&z) = self.fifo.front() else { return FIFO_EMPTY };
        let (axis, byte) = (self.entry / ENTRY_BYTES, self.entry % ENTRY_BYTES);
        let code = if axis == 2 { z.get() } else { 0 };
        let marker = if axis == 0 { FIFO_X_MARKER } else { 0 };
        let bytes = (((code as u32) << 4) | u32::from(marker)).to_be_bytes();
        self.entry += 1;
        if self.entry == AXES * ENTRY_BYTES {
            self.entry = 0;
            self.fifo.pop_front();
        }
        bytes[1 + byte]
    }

    fn write(&mut self, address: usize, value: u8) {
        match u8::try_from(address) {
            Ok(RESET) if value == RESET_CODE => self.reset(),
            Ok(register) if register > FIFO_DATA => {
                if let Some(byte) = self.registers.get_mut(address) {
                    *byte = value;
                }
            }
            _ => {} // read-only
        }
    }
}

/// Register addresses of a burst read: they advance, but stay at `FIFO_DATA`.
struct ReadAddresses(usize);

impl Iterator for ReadAddresses {
    type Item = usize;

    fn next(&mut self) -> Option<usize> {
        let address = self.0;
        self.0 += usize::from(address != usize::from(FIFO_DATA));
        Some(address)
    }
}
