//! A time limit for the driver of a part that may stay busy.
//!
//! Such a driver asks for the status until the part is ready, and one that is broken or not connected never is. Here the
//! bus refuses when the time is over, so the driver returns the error. It refuses between two transactions only: a
//! future dropped inside one would leave the part selected, and the next command would reach it as data.

use core::cell::Cell;

use embedded_hal_async::spi::{self, ErrorKind, ErrorType, Operation, SpiDevice};

/// How long the bus may still be used; shared between the bus and whoever calls the driver.
pub struct Limit {
    now_us: fn() -> u64,
    until_us: Cell<u64>,
}

impl Limit {
    /// The bus is refused until [`Limit::allow`]. `now_us`: any monotonic clock, µs.
    pub const fn new(now_us: fn() -> u64) -> Self {
        Limit { now_us, until_us: Cell::new(0) }
    }

    /// Allows the bus for `us` from now on.
    pub fn allow(&self, us: u64) {
        self.until_us.set((self.now_us)().saturating_add(us));
    }

    fn is_over(&self) -> bool {
        (self.now_us)() > self.until_us.get()
    }
}

/// A device on a bus that may be used within a [`Limit`].
pub struct Limited<'a, D> {
    device: D,
    limit: &'a Limit,
}

impl<'a, D> Limited<'a, D> {
    /// Limits the use of `device`.
    pub const fn new(device: D, limit: &'a Limit) -> Self {
        Limited { device, limit }
    }
}

/// What went wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Error<E> {
    /// The bus failed.
    Spi(E),
    /// The time is over.
    TimedOut,
}

impl<E: spi::Error> spi::Error for Error<E> {
    fn kind(&self) -> ErrorKind {
        match self {
            Error::Spi(error) => error.kind(),
            Error::TimedOut => ErrorKind::Other,
        }
    }
}

impl<D: ErrorType> ErrorType for Limited<'_, D> {
    type Error = Error<D::Error>;
}

impl<D: SpiDevice> SpiDevice for Limited<'_, D> {
    async fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Self::Error> {
        if self.limit.is_over() {
            return Err(Error::TimedOut);
        }
        self.device.transaction(operations).await.map_err(Error::Spi)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::sync::atomic::{AtomicU64, Ordering::Relaxed};
    use embassy_futures::block_on;

    static NOW_US: AtomicU64 = AtomicU64::new(0);

    /// A part on a line that is stuck: it is busy for ever. A transaction takes 10 µs.
    struct Stuck;

    impl ErrorType for Stuck {
        type Error = core::convert::Infallible;
    }

    impl SpiDevice for Stuck {
        async fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Self::Error> {
            NOW_US.fetch_add(10, Relaxed);
            for operation in operations {
                if let Operation::TransferInPlace(bytes) = operation {
                    bytes.fill(0xFF);
                }
            }
            Ok(())
        }
    }

    /// As the flash driver does it.
    async fn wait_until_ready(bus: &mut impl SpiDevice) -> Result<(), ErrorKind> {
        loop {
            let mut status = [0x05, 0];
            bus.transfer_in_place(&mut status).await.map_err(|error| spi::Error::kind(&error))?;
            if status[1] & 1 == 0 {
                return Ok(());
            }
        }
    }

    /// The driver asked a flash that stays busy for ever, and with it the evaluation and the link waited for ever.
    #[test]
    fn regress_a_part_that_stays_busy_is_given_up() {
        let limit = Limit::new(|| NOW_US.load(Relaxed));
        let mut bus = Limited::new(Stuck, &limit);
        for _ in 0..3 {
            let began_us = NOW_US.load(Relaxed);
            limit.allow(1000);
            assert_eq!(block_on(wait_until_ready(&mut bus)), Err(ErrorKind::Other));
            let waited_us = NOW_US.load(Relaxed) - began_us;
            assert!((1000..1020).contains(&waited_us), "{waited_us} µs");
            assert_eq!(block_on(bus.write(&[6])), Err(Error::TimedOut));
        }
    }
}
