//! ADXL357 accelerometer: ±40 g, 20 bit, 4000 samples/s, FIFO of 32 samples (8 ms).
//!
//! Only the vertical axis z leaves the driver. The sensor is mounted with its z axis down, so codes are positive
//! downwards like every vertical quantity of the project.
//!
//! `registers` has the data sheet's names, `driver` talks to the part over SPI, `model` is the part as seen from
//! the bus, for the simulated node and for tests.

pub mod driver;
pub mod model;
pub mod registers;

pub use driver::{Adxl357, Batch, Error};

/// Samples per second and axis.
pub const SAMPLE_RATE_HZ: u32 = 4000;
/// Time from one sample to the next, µs.
pub const SAMPLE_PERIOD_US: u32 = 1_000_000 / SAMPLE_RATE_HZ;
/// Codes per standard gravity in the ±40 g range (data sheet, sensitivity).
pub const CODES_PER_G: f32 = 12_800.0;
/// Standard gravity, m/s².
pub const STANDARD_GRAVITY_M_S2: f32 = 9.806_65;
/// Acceleration of one code, m/s².
pub const M_S2_PER_CODE: f32 = STANDARD_GRAVITY_M_S2 / CODES_PER_G;
/// Full scale, m/s².
pub const RANGE_M_S2: f32 = 40.0 * STANDARD_GRAVITY_M_S2;
/// Largest code, 2¹⁹ − 1 (the converter reaches ±40.96 g).
pub const MAX_CODE: i32 = (1 << 19) - 1;
/// Samples that the FIFO holds.
pub const FIFO_SAMPLES: usize = registers::FIFO_LEN / registers::AXES;
/// Samples that raise the interrupt: half the FIFO, so that 4 ms remain to serve it.
pub const WATERMARK_SAMPLES: usize = FIFO_SAMPLES / 2;
