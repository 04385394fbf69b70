//! ADXL357 accelerometer: ±40 g, 20 bit, 4000 samples/s, FIFO of 32 samples (8 ms); for the unit of a code see
//! [`crate::sample`].
//!
//! Only the vertical axis z leaves the driver. The sensor is mounted with its z axis down, so codes are positive
//! downwards like every vertical quantity of the project.
//!
//! `registers` has the data sheet's names, `driver` talks to the part over SPI, `silence` notices that it gives no
//! samples any more, `model` is the part as seen from the bus, for the simulated node and for tests.

pub mod driver;
pub mod model;
pub mod registers;
pub mod silence;

pub use driver::{Adxl357, Batch, Error};
pub use silence::Silence;

use crate::sample::RAW_RATE_HZ;

/// Time from one sample to the next, µs.
pub const SAMPLE_PERIOD_US: u32 = 1_000_000 / RAW_RATE_HZ;
/// Samples that the FIFO holds.
pub const FIFO_SAMPLES: usize = registers::FIFO_LEN / registers::AXES;
/// Samples that raise the interrupt: a quarter of the FIFO, so that 6 ms remain to serve it. (The longest step of another
/// task takes 2.3 ms at 31 million instructions a second; at half the FIFO it came up to 32 of 32.)
pub const WATERMARK_SAMPLES: usize = FIFO_SAMPLES / 4;
