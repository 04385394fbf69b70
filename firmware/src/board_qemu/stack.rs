//! How deep the stack has been: it is painted at the start, and what is still paint was never used.

const PAINT: u32 = 0xC0DE_CAFE;
/// Bytes below the stack pointer that are left alone while painting: the frame of the painter itself.
const MARGIN: usize = 256;

unsafe extern "C" {
    static _stack_end: u32;
    static _stack_start: u32;
}

fn low() -> usize {
    &raw const _stack_end as usize
}

fn high() -> usize {
    &raw const _stack_start as usize
}

/// Paints the unused part of the stack.
pub fn paint() {
    let top = cortex_m::register::msp::read() as usize - MARGIN;
    for address in (low()..top).step_by(4) {
        // SAFETY: below everything that is on the stack, and within it.
        unsafe { core::ptr::write_volatile(address as *mut u32, PAINT) };
    }
}

/// Bytes that were used at the deepest point.
pub fn used() -> usize {
    // SAFETY: within the stack; only read.
    let painted = |address: &usize| unsafe { core::ptr::read_volatile(*address as *const u32) } == PAINT;
    high() - (low()..high()).step_by(4).take_while(painted).last().unwrap_or(low())
}

/// Bytes that there are.
pub fn size() -> usize {
    high() - low()
}
