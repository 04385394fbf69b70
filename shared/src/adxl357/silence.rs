//! Notices that the sensor has fallen silent.
//!
//! A part that a dip of its supply has reset stands by with an empty FIFO, and a data line that is stuck reads all 0 or
//! all 1. The bus works in each case, so only the missing samples tell.

use super::{Batch, SAMPLE_PERIOD_US};

/// Longest time without a sample, µs: a sensor that measures fills its FIFO six times in it.
pub const LONGEST_SILENCE_US: u64 = 50_000;

/// When samples came last, and up to when they are accounted for. Times are of any monotonic clock, µs.
#[derive(Clone, Copy, Debug)]
pub struct Silence {
    heard_us: u64,
    accounted_us: u64,
}

impl Silence {
    /// The sensor begins to measure.
    pub const fn new(now_us: u64) -> Self {
        Silence { heard_us: now_us, accounted_us: now_us }
    }

    /// Takes note of a visit to the FIFO; says whether the sensor has stalled and is to be started again.
    pub fn stalled(&mut self, now_us: u64, batch: &Batch) -> bool {
        if !batch.codes.is_empty() {
            *self = Silence::new(now_us);
            return false;
        }
        // What a line stuck at 1 reads as an overrun is counted already and must not count twice.
        let lost_us = u64::from(batch.lost) * u64::from(SAMPLE_PERIOD_US);
        self.accounted_us = self.accounted_us.saturating_add(lost_us).min(now_us);
        now_us.saturating_sub(self.heard_us) > LONGEST_SILENCE_US
    }

    /// Samples until now that nobody has accounted for; they are accounted for now. To be asked while the sensor is being
    /// started as well, so that the sample count keeps the time by which a clock is set.
    pub fn account(&mut self, now_us: u64) -> u32 {
        let missed = now_us.saturating_sub(self.accounted_us) / u64::from(SAMPLE_PERIOD_US);
        let missed = u32::try_from(missed).unwrap_or(u32::MAX);
        self.accounted_us += u64::from(missed) * u64::from(SAMPLE_PERIOD_US);
        missed
    }
}

#[cfg(test)]
mod tests {
    use super::super::model::Model;
    use super::super::registers::{RESET, RESET_CODE};
    use super::super::{Adxl357, Error, FIFO_SAMPLES, WATERMARK_SAMPLES};
    use super::*;
    use crate::sample::SensorCode;
    use embassy_futures::block_on;
    use embedded_hal_async::spi::{ErrorType, Operation, SpiDevice};

    /// What befalls the sensor.
    #[derive(Clone, Copy, Debug)]
    enum Fault {
        Reset,
        Stuck(u8),
    }

    /// A sensor that measures for ever, and its data line.
    struct Bus<S> {
        model: Model<S>,
        stuck: Option<u8>,
    }

    impl<S> ErrorType for Bus<S> {
        type Error = core::convert::Infallible;
    }

    impl<S: super::super::model::Source> SpiDevice for Bus<S> {
        async fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Self::Error> {
            match operations {
                [Operation::Write(bytes)] => self.model.transfer(bytes, &mut []),
                [Operation::Write(bytes), Operation::Read(answer)] => {
                    self.model.transfer(bytes, answer);
                    self.stuck.into_iter().for_each(|byte| answer.fill(byte));
                }
                _ => panic!("not used by the driver"),
            }
            Ok(())
        }
    }

    /// Lets `periods` sample periods go by and visits the FIFO; returns whether the sensor has stalled.
    fn visit<S: super::super::model::Source>(
        sensor: &mut Adxl357<&mut Bus<S>>,
        silence: &mut Silence,
        (now_us, counted): (&mut u64, &mut u64),
        periods: usize,
    ) -> bool {
        let mut batch = Batch::default();
        sensor.bus().model.elapse(periods as u32);
        *now_us += periods as u64 * u64::from(SAMPLE_PERIOD_US);
        block_on(sensor.drain(*now_us, &mut batch)).unwrap();
        *counted += batch.codes.len() as u64 + u64::from(batch.lost);
        silence.stalled(*now_us, &batch)
    }

    /// A sensor that gave no samples any more was visited for ever: nothing was counted as lost, and no train recorded.
    #[test]
    fn regress_a_sensor_that_falls_silent_is_started_again() {
        for fault in [Fault::Reset, Fault::Stuck(0x00), Fault::Stuck(0xFF)] {
            let mut bus = Bus { model: Model::new(|| Some(SensorCode::new(1))), stuck: None };
            let (mut now_us, mut counted, mut silence) = (0, 0, Silence::new(0));
            let mut sensor = block_on(Adxl357::start(&mut bus, now_us)).unwrap();
            for _ in 0..100 {
                assert!(!visit(&mut sensor, &mut silence, (&mut now_us, &mut counted), WATERMARK_SAMPLES));
            }
            match fault {
                Fault::Reset => sensor.bus().model.transfer(&[RESET << 1, RESET_CODE], &mut []),
                Fault::Stuck(byte) => sensor.bus().stuck = Some(byte),
            }
            let failed_us = now_us;
            // No interrupt comes, so the FIFO is visited when patience ends.
            while !visit(&mut sensor, &mut silence, (&mut now_us, &mut counted), FIFO_SAMPLES * 3 / 4) {
                assert!(now_us - failed_us <= LONGEST_SILENCE_US, "{fault:?}");
            }
            // A line that is still stuck does not look like the part.
            let started = block_on(Adxl357::start(&mut bus, now_us)).err();
            assert_eq!(
                matches!(started, Some(Error::Id { .. })),
                matches!(fault, Fault::Stuck(_)),
                "{fault:?}"
            );
            bus.stuck = None;
            for _ in 0..3 {
                now_us += 500_130;
                counted += u64::from(silence.account(now_us));
            }
            // Every sample is accounted for once.
            assert_eq!(counted, now_us / u64::from(SAMPLE_PERIOD_US), "{fault:?}");
            silence = Silence::new(now_us);
            let mut sensor = block_on(Adxl357::start(&mut bus, now_us)).unwrap();
            for _ in 0..100 {
                assert!(!visit(&mut sensor, &mut silence, (&mut now_us, &mut counted), WATERMARK_SAMPLES));
            }
        }
    }

    /// A line that reads wrong for one visit costs what the FIFO had, not a start.
    #[test]
    fn property_a_short_silence_is_no_stall() {
        let mut bus = Bus { model: Model::new(|| Some(SensorCode::new(1))), stuck: None };
        let (mut now_us, mut counted, mut silence) = (0, 0, Silence::new(0));
        let mut sensor = block_on(Adxl357::start(&mut bus, now_us)).unwrap();
        for stuck in [None, Some(0x00), None, Some(0xFF), None, None].into_iter().cycle().take(600) {
            sensor.bus().stuck = stuck;
            assert!(!visit(&mut sensor, &mut silence, (&mut now_us, &mut counted), WATERMARK_SAMPLES));
        }
        assert_eq!(counted, now_us / u64::from(SAMPLE_PERIOD_US));
    }
}
