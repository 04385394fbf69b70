//! Register map of the ADXL357 under the names of the data sheet (Analog Devices, ADXL356/ADXL357 Rev. A).
//!
//! On the bus a register access begins with `address << 1 | READ`; the address advances by itself,
//! except at `FIFO_DATA`.

/// Command bit: 1 reads, 0 writes.
pub const READ: u8 = 1;

/// Analog Devices identifier, [`DEVID_AD_VALUE`].
pub const DEVID_AD: u8 = 0x00;
/// Content of `DEVID_AD`.
pub const DEVID_AD_VALUE: u8 = 0xAD;
/// MEMS identifier, [`DEVID_MST_VALUE`].
pub const DEVID_MST: u8 = 0x01;
/// Content of `DEVID_MST`.
pub const DEVID_MST_VALUE: u8 = 0x1D;
/// Part identifier, [`PARTID_VALUE`] (octal 355, shared with the ADXL355).
pub const PARTID: u8 = 0x02;
/// Content of `PARTID`.
pub const PARTID_VALUE: u8 = 0xED;

/// Status; reading it clears the flags.
pub const STATUS: u8 = 0x04;
/// `STATUS`: the watermark is reached.
pub const FIFO_FULL: u8 = 1 << 1;
/// `STATUS`: the FIFO overran, the oldest data are lost.
pub const FIFO_OVR: u8 = 1 << 2;

/// Valid entries in the FIFO, one axis each, 0 … 96.
pub const FIFO_ENTRIES: u8 = 0x05;
/// `FIFO_ENTRIES`: bits in use.
pub const FIFO_ENTRIES_MASK: u8 = 0x7F;

/// FIFO access, 3 bytes per entry, most significant first: 20 bits of data, then flags in the low 4 bits.
pub const FIFO_DATA: u8 = 0x11;
/// Low bits of an entry: this is an x axis value.
pub const FIFO_X_MARKER: u8 = 1 << 0;
/// Low bits of an entry: there was nothing to read.
pub const FIFO_EMPTY: u8 = 1 << 1;

/// High-pass corner and output data rate.
pub const FILTER: u8 = 0x28;
/// `FILTER`: no high-pass, 4000 samples/s, low-pass at 1000 Hz.
pub const FILTER_ODR_4000_HZ: u8 = 0x00;

/// FIFO entries that raise `FIFO_FULL`, 1 … 96.
pub const FIFO_SAMPLES: u8 = 0x29;

/// Which conditions drive the interrupt pins.
pub const INT_MAP: u8 = 0x2A;
/// `INT_MAP`: `FIFO_FULL` drives INT1.
pub const FULL_EN1: u8 = 1 << 1;

/// Range, interrupt polarity and I²C speed.
pub const RANGE: u8 = 0x2C;
/// `RANGE`: ±40 g.
pub const RANGE_40_G: u8 = 0b11;
/// `RANGE`: interrupt pins are active high.
pub const INT_POL: u8 = 1 << 6;
/// `RANGE`: I²C high speed, set after reset; kept.
pub const I2C_HS: u8 = 1 << 7;

/// Power control; bit 0 set after reset = standby.
pub const POWER_CTL: u8 = 0x2D;
/// `POWER_CTL`: standby; ranges and filters are changed only in this state.
pub const STANDBY: u8 = 1 << 0;
/// `POWER_CTL`: measuring, temperature off (its conversions are not used).
pub const MEASURE_TEMP_OFF: u8 = 1 << 1;

/// Writing [`RESET_CODE`] resets the part.
pub const RESET: u8 = 0x2F;
/// Code for `RESET`.
pub const RESET_CODE: u8 = 0x52;

/// Entries that the FIFO holds.
pub const FIFO_LEN: usize = 96;
/// Bytes per FIFO entry.
pub const ENTRY_BYTES: usize = 3;
/// Axes, that is entries per sample.
pub const AXES: usize = 3;
