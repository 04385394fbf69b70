//! Linker arguments of the firmware.

use std::env;
use std::path::Path;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return; // the stub for the PC
    }
    // The linker finds memory.x in the workspace root, where cargo runs it; without this line an edit of it would
    // not link anew.
    let manifest_dir = env::var("CARGO_MANIFEST_DIR").unwrap_or_default();
    println!("cargo:rerun-if-changed={}", Path::new(&manifest_dir).join("../memory.x").display());
    println!("cargo:rustc-link-search={}", Path::new(&manifest_dir).join("..").display());
    println!("cargo:rustc-link-arg-bins=--nmagic");
    println!("cargo:rustc-link-arg-bins=-Tlink.x");
    println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    if env::var_os("CARGO_FEATURE_BOARD_QEMU").is_some() {
        println!("cargo:rustc-link-arg-bins=--defsym=__board_qemu=1");
    }
}
