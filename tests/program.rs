//! The `cpcm` program as a user runs it.

use std::path::PathBuf;
use std::process::{Command, Output};
use std::sync::OnceLock;

/// Path of the program in the profile of the running test. Cargo does not build the programs of a dependency for
/// its tests, so this does, once.
fn program() -> &'static PathBuf {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| {
        // target/PROFILE/deps/test-HASH
        let profile_dir = std::env::current_exe().unwrap().parent().unwrap().parent().unwrap().to_path_buf();
        let mut build = Command::new(env!("CARGO"));
        build.args(["build", "--quiet", "--package", "cpcm", "--bin", "cpcm"]);
        build.arg("--target-dir").arg(profile_dir.parent().unwrap());
        if profile_dir.ends_with("release") {
            build.arg("--release");
        }
        assert!(build.status().unwrap().success(), "cpcm does not build");
        profile_dir.join("cpcm")
    })
}

/// Runs `cpcm` with these arguments.
pub fn cpcm(args: &[&str]) -> Output {
    Command::new(program()).args(args).output().unwrap()
}
