//! The `cpcm` command.
fn main() {}
