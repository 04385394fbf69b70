//! The `cpcm` program as a user runs it.

use std::path::PathBuf;
use std::process::{Command, Output};
use std::sync::OnceLock;

/// Path of the program in the profile of the running test. Cargo does not build the programs of a dependency for
/// its tests, so this does, once.
pub fn program() -> &'static PathBuf {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| {
        // target/PROFILE/deps/test-HASH
        let profile_dir = std::env::current_exe().unwrap().parent().unwrap().parent().unwrap().to_path_buf();
        let mut build = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
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
    cpcm_command(args).output().unwrap()
}

/// `cpcm` with these arguments, to be run otherwise.
pub fn cpcm_command(args: &[&str]) -> Command {
    let mut command = Command::new(program());
    command.args(args);
    command
}

/// Runs `cpcm`, which must succeed, and returns what it prints.
pub fn succeeds(args: &[&str]) -> String {
    let run = cpcm(args);
    let error = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(0), "cpcm {args:?}: {error}");
    String::from_utf8(run.stdout).unwrap()
}
