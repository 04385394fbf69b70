//! The node's program; on the PC a stub, so that plain cargo works there.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(all(target_os = "none", not(any(feature = "board-qemu", feature = "board-stm32"))))]
compile_error!("choose a board: `cargo fw` or `cargo qemu`");

// The board module has the entry point and the panic handler.
#[cfg(target_os = "none")]
use cpcm_node as _;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!(
        "This is the PC stub of the firmware. Build the board with `cargo fw`, run in QEMU with `cargo qemu`."
    );
    std::process::exit(2);
}
