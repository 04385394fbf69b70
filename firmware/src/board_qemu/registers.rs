//! Memory-mapped registers.

/// A 32-bit register at a fixed address.
#[derive(Clone, Copy)]
pub struct Register(usize);

impl Register {
    /// # Safety
    /// `address` must be a register of the machine that may be read and written at any time without harm to memory
    /// safety.
    pub const unsafe fn new(address: usize) -> Self {
        Register(address)
    }

    pub fn read(self) -> u32 {
        // SAFETY: promised by the caller of `new`.
        unsafe { core::ptr::read_volatile(self.0 as *const u32) }
    }

    pub fn write(self, value: u32) {
        // SAFETY: promised by the caller of `new`.
        unsafe { core::ptr::write_volatile(self.0 as *mut u32, value) }
    }
}

/// Lets an interrupt through to `DefaultHandler`.
pub fn unmask(number: u16) {
    #[derive(Clone, Copy)]
    struct Number(u16);
    // SAFETY: the number is what it is.
    unsafe impl cortex_m::interrupt::InterruptNumber for Number {
        fn number(self) -> u16 {
            self.0
        }
    }
    // SAFETY: no critical section relies on a mask of single interrupts.
    unsafe { cortex_m::peripheral::NVIC::unmask(Number(number)) }
}
