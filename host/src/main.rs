//! The `cpcm` command.

use std::process::ExitCode;

/// Many large matrices come and go on two threads; giving their pages back to the system each time costs a tenth of an
/// analysis.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    cpcm::cmd::main()
}
