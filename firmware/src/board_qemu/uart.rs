//! CMSDK UART 0.

use core::convert::Infallible;

use embassy_futures::yield_now;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::pipe::Pipe;
use embedded_io_async::{ErrorType, Read, Write};

use super::registers::{Register, unmask};

/// Interrupt of the receiver.
pub const RX_IRQ: u16 = 0;

const BASE: usize = 0x4000_4000;
// SAFETY: registers of UART 0 of mps2-an386.
const DATA: Register = unsafe { Register::new(BASE) };
// SAFETY: as above.
const STATE: Register = unsafe { Register::new(BASE + 0x4) };
// SAFETY: as above.
const CONTROL: Register = unsafe { Register::new(BASE + 0x8) };
// SAFETY: as above.
const INTERRUPT: Register = unsafe { Register::new(BASE + 0xC) };
// SAFETY: as above.
const BAUD_DIVIDER: Register = unsafe { Register::new(BASE + 0x10) };

const TX_FULL: u32 = 1 << 0;
const RX_FULL: u32 = 1 << 1;
const TX_ENABLE: u32 = 1 << 0;
const RX_ENABLE: u32 = 1 << 1;
const RX_INTERRUPT_ENABLE: u32 = 1 << 3;
const RX_INTERRUPT: u32 = 1 << 1;

/// Holds the longest request twice.
static RECEIVED: Pipe<CriticalSectionRawMutex, 2304> = Pipe::new();

/// UART 0 with a receive buffer.
#[derive(Clone, Copy)]
pub struct Uart;

impl Uart {
    pub fn init() -> Self {
        BAUD_DIVIDER.write(16); // the smallest; QEMU does not wait
        CONTROL.write(TX_ENABLE | RX_ENABLE | RX_INTERRUPT_ENABLE);
        unmask(RX_IRQ);
        Uart
    }
}

/// Takes the bytes that have come. What does not fit is lost; the frame then fails its CRC.
pub fn on_receive() {
    // Before the data: a byte that comes in between raises the interrupt again.
    INTERRUPT.write(RX_INTERRUPT);
    while STATE.read() & RX_FULL != 0 {
        let _ = RECEIVED.try_write(&[DATA.read() as u8]);
    }
}

impl ErrorType for Uart {
    type Error = Infallible;
}

impl Read for Uart {
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, Infallible> {
        Ok(RECEIVED.read(buf).await)
    }
}

impl Write for Uart {
    async fn write(&mut self, buf: &[u8]) -> Result<usize, Infallible> {
        for &byte in buf {
            while STATE.read() & TX_FULL != 0 {
                yield_now().await; // the other side does not read: let the sensor be served
            }
            DATA.write(u32::from(byte));
        }
        Ok(buf.len())
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}
