//! The accelerometer: the register model, paced by virtual time, fed with samples from the PSRAM.

use core::cell::RefCell;
use core::convert::Infallible;

use cpcm_shared::adxl357::model::{Model, Source};
use cpcm_shared::adxl357::{SAMPLE_PERIOD_US, WATERMARK_SAMPLES};
use cpcm_shared::image::{HEADER_LEN, Header, SAMPLE_LEN, SAMPLES, decode_sample};
use cpcm_shared::sample::SensorCode;
use embassy_time::{Instant, Timer};
use embedded_hal_async::spi::{ErrorType, Operation, SpiDevice};

use super::nor::PSRAM;
use crate::app::{Ended, Interrupt};

/// What the image tells of its samples; `None` without an image.
pub fn header() -> Option<Header> {
    let mut bytes = [0; HEADER_LEN];
    for (address, byte) in (PSRAM + SAMPLES..).zip(&mut bytes) {
        // SAFETY: the sample part of the PSRAM; only read.
        *byte = unsafe { core::ptr::read_volatile(address as *const u8) };
    }
    Header::decode(&bytes)
}

/// The samples of the image.
struct Samples {
    next: usize,
    count: usize,
}

impl Source for Samples {
    fn next_code(&mut self) -> Option<SensorCode> {
        if self.next == self.count {
            return None;
        }
        let mut bytes = [0; SAMPLE_LEN];
        let address = PSRAM + SAMPLES + HEADER_LEN + SAMPLE_LEN * self.next;
        self.next += 1;
        for (address, byte) in (address..).zip(&mut bytes) {
            // SAFETY: the sample part of the PSRAM, which is only read; the header's count fits in it.
            *byte = unsafe { core::ptr::read_volatile(address as *const u8) };
        }
        Some(decode_sample(bytes))
    }
}

/// The sensor as bus device and as interrupt line.
pub struct Sensor(RefCell<Paced>);

struct Paced {
    model: Model<Samples>,
    sampled_us: u64,
}

impl Sensor {
    /// A sensor that will give `count` samples.
    pub fn new(count: u32) -> Self {
        let samples = Samples { next: 0, count: count as usize };
        Sensor(RefCell::new(Paced { model: Model::new(samples), sampled_us: Instant::now().as_micros() }))
    }
}

impl Paced {
    /// Lets the sample periods go by that virtual time has seen. In standby there are none.
    fn catch_up(&mut self) {
        let now_us = Instant::now().as_micros();
        if !self.model.measures() {
            self.sampled_us = now_us;
        }
        let periods = now_us.saturating_sub(self.sampled_us) / u64::from(SAMPLE_PERIOD_US);
        self.sampled_us += periods * u64::from(SAMPLE_PERIOD_US);
        self.model.elapse(u32::try_from(periods).unwrap_or(u32::MAX));
    }
}

impl ErrorType for &Sensor {
    type Error = Infallible;
}

impl SpiDevice for &Sensor {
    async fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        let mut paced = self.0.borrow_mut();
        paced.catch_up();
        // The driver's transactions are a write, or a write and a read.
        match operations {
            [Operation::Write(bytes)] => paced.model.transfer(bytes, &mut []),
            [Operation::Write(bytes), Operation::Read(answer)] => paced.model.transfer(bytes, answer),
            _ => {}
        }
        Ok(())
    }
}

impl Interrupt for &Sensor {
    async fn active(&mut self) -> Result<(), Ended> {
        loop {
            let at_us = {
                let mut paced = self.0.borrow_mut();
                paced.catch_up();
                if paced.model.int1() {
                    return Ok(());
                }
                if paced.model.exhausted() {
                    return Err(Ended);
                }
                let missing = WATERMARK_SAMPLES.saturating_sub(paced.model.queued()).max(1);
                paced.sampled_us + missing as u64 * u64::from(SAMPLE_PERIOD_US)
            };
            Timer::at(Instant::from_micros(at_us)).await;
        }
    }
}
