//! The node in QEMU; on the PC a stub, so that plain cargo works there.
#![cfg_attr(target_os = "none", no_std, no_main)]

// The board module has the entry point and the panic handler.
#[cfg(target_os = "none")]
use cpcm_node as _;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("This is the PC stub of the firmware: build the real one with `cargo fw-qemu`.");
    std::process::exit(2);
}
