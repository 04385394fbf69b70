//! The `cpcm` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    cpcm::cmd::main()
}
