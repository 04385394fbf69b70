//! Decoders that can panic on damaged files.
//!
//! The `parquet` crate indexes with numbers that it reads from the file (about one in 1000 random damages makes it
//! panic), `matfile` calls itself alpha, `miniseed-rs` slices by header fields. Here, and nowhere else in the project, a panic
//! becomes an error: the file is damaged, as for any other contradiction in it.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};

thread_local! {
    static GUARDED: Cell<bool> = const { Cell::new(false) };
}

/// Runs a decoder. What it was building is dropped on a panic, so no broken state can be seen afterwards.
pub(super) fn guarded<T>(decode: impl FnOnce() -> T) -> Result<T, String> {
    let outer = GUARDED.replace(true);
    let result = catch_unwind(AssertUnwindSafe(decode));
    GUARDED.set(outer);
    result.map_err(|_| "its contents contradict each other".to_string())
}

/// Keeps the panics that are turned into errors here off standard error. For programs, once, at the start.
pub fn silence_guarded_panics() {
    let report = take_hook();
    set_hook(Box::new(move |info| {
        if !GUARDED.get() {
            report(info);
        }
    }));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regress_panic_becomes_an_error() {
        assert!(guarded(|| Vec::<u8>::new()[3]).is_err());
        assert_eq!(guarded(|| 3), Ok(3));
    }
}
