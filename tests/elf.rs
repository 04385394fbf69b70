//! Builds the firmware for tests.

use std::path::{Path, PathBuf};
use std::process::Command;

/// Builds with a cargo alias (`fw`, `fw-qemu`) and returns the path of the program `name`.
pub fn build(alias: &str, name: &str) -> PathBuf {
    // target/PROFILE/deps/test-HASH
    let exe = std::env::current_exe().unwrap();
    let target = exe.ancestors().nth(3).unwrap();
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo.current_dir(workspace).arg(alias).arg("--quiet").arg("--target-dir").arg(target);
    // Set by the cargo that runs this test, for the host.
    cargo.env_remove("RUSTFLAGS").env_remove("CARGO_ENCODED_RUSTFLAGS");
    let status = cargo.status().unwrap();
    assert!(
        status.success(),
        "`cargo {alias}` fails; is the target installed? `rustup target add thumbv7em-none-eabihf`"
    );
    target.join("thumbv7em-none-eabihf/firmware").join(name)
}
