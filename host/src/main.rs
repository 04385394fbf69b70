//! The `cpcm` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    keep_freed_memory();
    cpcm::cmd::main()
}

/// Matrices of some megabytes come and go with every passage. glibc's allocator returns them to the kernel each time,
/// whose page faults are a sixth of an analysis; kept, they cost some megabytes of memory.
#[cfg(target_env = "gnu")]
fn keep_freed_memory() {
    /// The largest that glibc takes on every version; above it an allocation is mapped and unmapped by itself.
    const MAPPED_ALONE: libc::c_int = 32 << 20;
    const RETURNED: libc::c_int = 1 << 30;
    const TAKEN_AT_ONCE: libc::c_int = 64 << 20;
    // SAFETY: mallopt only sets limits of the allocator, and no other thread runs yet.
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, MAPPED_ALONE);
        libc::mallopt(libc::M_TRIM_THRESHOLD, RETURNED);
        libc::mallopt(libc::M_TOP_PAD, TAKEN_AT_ONCE);
    }
}

#[cfg(not(target_env = "gnu"))]
fn keep_freed_memory() {}
