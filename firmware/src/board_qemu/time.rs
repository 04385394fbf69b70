//! Clock and alarm on two CMSDK timers: timer 0 counts down freely, timer 1 is loaded for each alarm.

use core::cell::RefCell;
use core::sync::atomic::{AtomicU32, Ordering};
use core::task::Waker;

use critical_section::Mutex;
use embassy_time_driver::Driver;
use embassy_time_queue_utils::Queue;

use super::registers::{Register, unmask};

/// Interrupt of timer 0: the free counter has gone round.
pub const OVERFLOW_IRQ: u16 = 8;
/// Interrupt of timer 1: the alarm.
pub const ALARM_IRQ: u16 = 9;

const TICKS_PER_US: u64 = 25;
const ENABLE: u32 = 1 << 0;
const INTERRUPT: u32 = 1 << 3;

struct Timer {
    control: Register,
    value: Register,
    reload: Register,
    interrupt: Register,
}

impl Timer {
    /// # Safety
    /// `base` must be a CMSDK timer of the machine.
    const unsafe fn new(base: usize) -> Self {
        // SAFETY: promised by the caller.
        unsafe {
            Timer {
                control: Register::new(base),
                value: Register::new(base + 0x4),
                reload: Register::new(base + 0x8),
                interrupt: Register::new(base + 0xC),
            }
        }
    }

    fn start(&self, ticks: u32) {
        self.reload.write(ticks);
        self.value.write(ticks);
        self.control.write(ENABLE | INTERRUPT);
    }

    fn stop(&self) {
        self.control.write(0);
        self.interrupt.write(1);
    }
}

// SAFETY: these are the addresses of timers 0 and 1 of mps2-an386.
const COUNTER: Timer = unsafe { Timer::new(0x4000_0000) };
// SAFETY: as above.
const ALARM: Timer = unsafe { Timer::new(0x4000_1000) };

struct TimeDriver {
    rounds: AtomicU32,
    queue: Mutex<RefCell<Queue>>,
}

embassy_time_driver::time_driver_impl!(static DRIVER: TimeDriver = TimeDriver {
    rounds: AtomicU32::new(0),
    queue: Mutex::new(RefCell::new(Queue::new())),
});

/// Starts the clock.
pub fn init() {
    COUNTER.start(u32::MAX);
    unmask(OVERFLOW_IRQ);
    unmask(ALARM_IRQ);
}

/// Stops clock and alarm for good, so that an idle QEMU has nothing to wake for.
pub fn stop() {
    COUNTER.stop();
    ALARM.stop();
}

/// The free counter has gone round.
pub fn on_overflow() {
    COUNTER.interrupt.write(1);
    DRIVER.rounds.fetch_add(1, Ordering::Relaxed);
}

/// The alarm.
pub fn on_alarm() {
    ALARM.stop();
    critical_section::with(|cs| DRIVER.serve(&mut DRIVER.queue.borrow_ref_mut(cs)));
}

impl TimeDriver {
    fn ticks(&self) -> u64 {
        critical_section::with(|_| {
            let mut low = u32::MAX - COUNTER.value.read();
            let mut rounds = self.rounds.load(Ordering::Relaxed);
            if COUNTER.interrupt.read() & 1 != 0 {
                // Gone round, and the interrupt still waits: read again, so that low belongs to the new round.
                low = u32::MAX - COUNTER.value.read();
                rounds = rounds.wrapping_add(1);
            }
            u64::from(rounds) << 32 | u64::from(low)
        })
    }

    /// Wakes what is due and sets the alarm for what comes next.
    fn serve(&self, queue: &mut Queue) {
        loop {
            let now = self.now();
            let next = queue.next_expiration(now);
            ALARM.stop();
            if next == u64::MAX {
                return;
            }
            if next > now {
                let ticks = (next - now).saturating_mul(TICKS_PER_US).min(u64::from(u32::MAX));
                ALARM.start(ticks as u32);
                return;
            }
        }
    }
}

impl Driver for TimeDriver {
    fn now(&self) -> u64 {
        self.ticks() / TICKS_PER_US
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        critical_section::with(|cs| {
            let mut queue = self.queue.borrow_ref_mut(cs);
            if queue.schedule_wake(at, waker) {
                self.serve(&mut queue);
            }
        });
    }
}
