//! Driver for the ADXL357 over SPI.

use embedded_hal_async::spi::{Operation, SpiDevice};
use heapless::Vec;

use super::registers::*;
use super::{FIFO_SAMPLES as CAPACITY, SAMPLE_PERIOD_US, WATERMARK_SAMPLES};
use crate::sample::SensorCode;

/// What went wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Error<E> {
    /// The bus failed.
    Spi(E),
    /// An identification register does not hold what this part has: not connected, or another part.
    Id {
        /// Register address.
        register: u8,
        /// Its content.
        found: u8,
        /// What it should be.
        expected: u8,
    },
    /// A setting did not read back: the write was lost.
    Setting {
        /// Register address.
        register: u8,
        /// Its content.
        found: u8,
        /// What was written.
        expected: u8,
    },
}

/// Samples from one visit to the FIFO.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Batch {
    /// Samples lost since the visit before, to be taken as lost ahead of `codes`.
    pub lost: u32,
    /// Vertical acceleration, oldest first.
    pub codes: Vec<SensorCode, CAPACITY>,
}

/// An ADXL357 that measures.
pub struct Adxl357<S> {
    spi: S,
    emptied_at_us: u64,
    step: Step,
}

/// Settings, in the order in which they are written; standby first, measuring last.
const SETTINGS: [(u8, u8); 6] = [
    (POWER_CTL, STANDBY),
    (RANGE, I2C_HS | INT_POL | RANGE_40_G),
    (FILTER, FILTER_ODR_4000_HZ),
    (FIFO_SAMPLES, (WATERMARK_SAMPLES * AXES) as u8),
    (INT_MAP, FULL_EN1),
    (POWER_CTL, MEASURE_TEMP_OFF),
];

impl<S: SpiDevice> Adxl357<S> {
    /// Checks the identity, writes and reads back the settings, starts measuring. `now_us`: any monotonic clock, µs.
    pub async fn start(spi: S, now_us: u64) -> Result<Self, Error<S::Error>> {
        let mut part = Adxl357 { spi, emptied_at_us: now_us, step: Step::default() };
        let mut id = [0; 3];
        part.read(DEVID_AD, &mut id).await?;
        let expected = [DEVID_AD_VALUE, DEVID_MST_VALUE, PARTID_VALUE];
        for (register, (&found, expected)) in (DEVID_AD..).zip(id.iter().zip(expected)) {
            if found != expected {
                return Err(Error::Id { register, found, expected });
            }
        }
        for (register, expected) in SETTINGS {
            part.spi.write(&[register << 1, expected]).await.map_err(Error::Spi)?;
            let mut found = [0];
            part.read(register, &mut found).await?;
            if found[0] != expected {
                return Err(Error::Setting { register, found: found[0], expected });
            }
        }
        Ok(part)
    }

    /// The bus, for whoever simulates it.
    pub fn bus(&mut self) -> &mut S {
        &mut self.spi
    }

    /// Takes everything out of the FIFO into `batch`. `now_us`: the clock of [`Adxl357::start`], µs; it is used only
    /// after an overrun, where the part does not tell how many samples are gone (right to ±1 sample).
    pub async fn drain(&mut self, now_us: u64, batch: &mut Batch) -> Result<(), Error<S::Error>> {
        batch.codes.clear();
        batch.lost = 0;
        let mut status = [0; 2]; // STATUS, FIFO_ENTRIES
        self.read(STATUS, &mut status).await?;
        let entries = usize::from(status[1] & FIFO_ENTRIES_MASK).min(FIFO_LEN);
        let mut fifo = [0; FIFO_LEN * ENTRY_BYTES];
        let fifo = fifo.get_mut(..entries * ENTRY_BYTES).unwrap_or_default();
        if !fifo.is_empty() {
            self.read(FIFO_DATA, fifo).await?;
        }
        batch.lost = self.step.decode(fifo, &mut batch.codes);
        if status[0] & FIFO_OVR != 0 {
            let expected = now_us.saturating_sub(self.emptied_at_us) / u64::from(SAMPLE_PERIOD_US);
            let missing =
                u32::try_from(expected).unwrap_or(u32::MAX).saturating_sub(batch.codes.len() as u32);
            batch.lost = batch.lost.max(missing).max(1);
        }
        self.emptied_at_us = now_us;
        Ok(())
    }

    async fn read(&mut self, register: u8, bytes: &mut [u8]) -> Result<(), Error<S::Error>> {
        let command = [register << 1 | READ];
        self.spi
            .transaction(&mut [Operation::Write(&command), Operation::Read(bytes)])
            .await
            .map_err(Error::Spi)
    }
}

/// Finds the samples in the stream of FIFO entries: an x marker starts one, z completes it. It lasts from one burst
/// to the next, so a burst may end inside a sample.
#[derive(Default)]
struct Step {
    axis: usize,
    skipping: bool,
}

impl Step {
    /// Picks the z values out of `fifo`; returns how many samples were torn.
    fn decode(&mut self, fifo: &[u8], codes: &mut Vec<SensorCode, CAPACITY>) -> u32 {
        let mut torn = 0;
        for entry in fifo.as_chunks::<ENTRY_BYTES>().0 {
            if entry[2] & FIFO_EMPTY != 0 {
                break;
            }
            let starts = entry[2] & FIFO_X_MARKER != 0;
            if starts != (self.axis == 0) {
                torn += u32::from(!self.skipping);
                self.axis = 0;
            }
            self.skipping = !starts && self.axis == 0;
            if self.skipping {
                continue;
            }
            self.axis += 1;
            if self.axis == AXES {
                self.axis = 0;
                // The 20 bits are left-justified in 24.
                let word = u32::from_be_bytes([0, entry[0], entry[1], entry[2]]) >> 4;
                torn += u32::from(codes.push(SensorCode::from_bits(word)).is_err());
            }
        }
        torn
    }
}

#[cfg(test)]
mod tests {
    use super::super::model::Model;
    use super::*;
    use embassy_futures::block_on;
    use embedded_hal_async::spi::ErrorType;
    use embedded_hal_mock::eh1::spi::{Mock, Transaction};
    use std::vec::Vec as StdVec;

    fn write(bytes: &[u8]) -> [Transaction<u8>; 3] {
        [
            Transaction::transaction_start(),
            Transaction::write_vec(bytes.to_vec()),
            Transaction::transaction_end(),
        ]
    }

    fn read(command: u8, answer: &[u8]) -> [Transaction<u8>; 4] {
        [
            Transaction::transaction_start(),
            Transaction::write_vec(std::vec![command]),
            Transaction::read_vec(answer.to_vec()),
            Transaction::transaction_end(),
        ]
    }

    fn start_sequence() -> StdVec<Transaction<u8>> {
        let mut bus = read(0x01, &[0xAD, 0x1D, 0xED]).to_vec();
        for (address, value) in [(0x2D, 1), (0x2C, 0xC3), (0x28, 0), (0x29, 24), (0x2A, 2), (0x2D, 2)] {
            bus.extend(write(&[address << 1, value]));
            bus.extend(read(address << 1 | 1, &[value]));
        }
        bus
    }

    /// Bytes of FIFO entries: 20 bits left-justified in 24, marker in bit 0 (data sheet, FIFO_DATA).
    #[test]
    fn reference_bus_sequence_of_start_and_drain() {
        let mut bus = start_sequence();
        bus.extend(read(0x09, &[0x02, 6]));
        let (x, y) = ([0x00, 0x01, 0x01], [0xFF, 0xFF, 0xF0]);
        let fifo = [x, y, [0x80, 0x00, 0x00], x, y, [0x7F, 0xFF, 0xF0]];
        bus.extend(read(0x23, fifo.as_flattened()));
        bus.extend(read(0x09, &[0x00, 0]));
        let mut mock = Mock::new(&bus);
        block_on(async {
            let mut part = Adxl357::start(mock.clone(), 0).await.unwrap();
            let mut batch = Batch::default();
            part.drain(500, &mut batch).await.unwrap();
            assert_eq!((batch.lost, &batch.codes[..]), (0, &[SensorCode::MIN, SensorCode::MAX][..]));
            part.drain(500, &mut batch).await.unwrap();
            assert_eq!((batch.lost, batch.codes.len()), (0, 0));
        });
        mock.done();
    }

    #[test]
    fn reference_wrong_part_and_lost_setting_are_named() {
        let mut mock = Mock::new(&read(0x01, &[0xAD, 0x1D, 0xFA]));
        let refused = block_on(Adxl357::start(mock.clone(), 0)).err();
        assert_eq!(refused, Some(Error::Id { register: 2, found: 0xFA, expected: 0xED }));
        mock.done();
        let mut bus = read(0x01, &[0xAD, 0x1D, 0xED]).to_vec();
        bus.extend(write(&[0x2D << 1, 1]));
        bus.extend(read(0x2D << 1 | 1, &[0xFF]));
        let mut mock = Mock::new(&bus);
        let refused = block_on(Adxl357::start(mock.clone(), 0)).err();
        assert_eq!(refused, Some(Error::Setting { register: 0x2D, found: 0xFF, expected: 1 }));
        mock.done();
    }

    /// The model behind a bus on which the test decides how much time goes by.
    struct Bus<S>(Model<S>);

    impl<S> ErrorType for Bus<S> {
        type Error = core::convert::Infallible;
    }

    impl<S: super::super::model::Source> SpiDevice for Bus<S> {
        async fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Self::Error> {
            match operations {
                [Operation::Write(bytes)] => self.0.transfer(bytes, &mut []),
                [Operation::Write(bytes), Operation::Read(answer)] => self.0.transfer(bytes, answer),
                _ => panic!("not used by the driver"),
            }
            Ok(())
        }
    }

    fn codes(numbers: impl IntoIterator<Item = i32>) -> StdVec<SensorCode> {
        numbers.into_iter().map(SensorCode::new).collect()
    }

    fn ramp(first: i32, count: i32) -> impl FnMut() -> Option<SensorCode> {
        let mut codes = first..first + count;
        move || codes.next().map(SensorCode::new)
    }

    #[test]
    fn property_every_sample_arrives_once_and_in_order() {
        let mut part = block_on(Adxl357::start(Bus(Model::new(ramp(-500, 1000))), 0)).unwrap();
        let (mut batch, mut got, mut now_us) = (Batch::default(), StdVec::new(), 0);
        for visit in 0.. {
            let periods = 1 + visit % 32;
            part.spi.0.elapse(periods);
            now_us += u64::from(periods * SAMPLE_PERIOD_US);
            block_on(part.drain(now_us, &mut batch)).unwrap();
            assert_eq!(batch.lost, 0);
            got.extend_from_slice(&batch.codes);
            if part.spi.0.exhausted() {
                break;
            }
        }
        assert_eq!(got, codes(-500..500));
    }

    #[test]
    fn property_overrun_counts_what_is_gone_and_keeps_the_newest() {
        let mut part = block_on(Adxl357::start(Bus(Model::new(ramp(0, 1000))), 0)).unwrap();
        let mut batch = Batch::default();
        part.spi.0.elapse(132);
        block_on(part.drain(132 * u64::from(SAMPLE_PERIOD_US), &mut batch)).unwrap();
        assert_eq!(batch.lost, 100);
        assert_eq!(&batch.codes[..], codes(100..132));
        part.spi.0.elapse(1);
        block_on(part.drain(133 * u64::from(SAMPLE_PERIOD_US), &mut batch)).unwrap();
        assert_eq!((batch.lost, &batch.codes[..]), (0, &codes([132])[..]));
    }

    #[test]
    fn property_a_torn_burst_is_counted_and_the_stream_falls_into_step() {
        for stolen in 1..AXES {
            let mut part = block_on(Adxl357::start(Bus(Model::new(ramp(0, 1000))), 0)).unwrap();
            part.spi.0.elapse(16);
            // Another master on the bus, or a cut transaction, takes entries away.
            let mut away = [0; AXES * ENTRY_BYTES];
            part.spi.0.transfer(&[FIFO_DATA << 1 | READ], &mut away[..stolen * ENTRY_BYTES]);
            let mut batch = Batch::default();
            block_on(part.drain(4000, &mut batch)).unwrap();
            assert_eq!(batch.lost, 1);
            assert_eq!(&batch.codes[..], codes(1..16));
            part.spi.0.elapse(2);
            block_on(part.drain(4500, &mut batch)).unwrap();
            assert_eq!((batch.lost, &batch.codes[..]), (0, &codes([16, 17])[..]));
        }
    }

    #[test]
    fn property_interrupt_follows_the_watermark() {
        let mut part = block_on(Adxl357::start(Bus(Model::new(ramp(0, 1000))), 0)).unwrap();
        part.spi.0.elapse(WATERMARK_SAMPLES as u32 - 1);
        assert!(!part.spi.0.int1());
        part.spi.0.elapse(1);
        assert!(part.spi.0.int1());
        block_on(part.drain(0, &mut Batch::default())).unwrap();
        assert!(!part.spi.0.int1());
    }

    proptest::proptest! {
        #[test]
        fn property_arbitrary_fifo_bytes_never_panic(bytes in proptest::collection::vec(0u8.., 0..300)) {
            let mut codes = Vec::new();
            let torn = Step::default().decode(&bytes, &mut codes);
            assert!(codes.len() + torn as usize <= bytes.len());
        }
    }
}
