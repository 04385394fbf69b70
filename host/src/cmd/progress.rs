//! Progress as a bar on standard error; nothing when that is not a terminal.

use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

use crate::progress::Progress;

/// One bar at a time; a finished stage leaves no trace.
pub(super) struct Bar(Mutex<ProgressBar>);

impl Bar {
    pub(super) fn new() -> Self {
        Bar(Mutex::new(ProgressBar::hidden()))
    }

    fn current(&self) -> std::sync::MutexGuard<'_, ProgressBar> {
        // A poisoned bar is still a bar.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Progress for Bar {
    fn begin(&self, stage: &str, steps: u64) {
        let template = "{spinner} {msg:28} [{bar:32}] {pos}/{len}  {elapsed}, {eta} left";
        let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        let bar =
            ProgressBar::new(steps).with_style(style.progress_chars("=> ")).with_message(stage.to_string());
        bar.enable_steady_tick(Duration::from_millis(200));
        let mut current = self.current();
        current.finish_and_clear();
        *current = bar;
    }

    fn step(&self) {
        self.current().inc(1);
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.current().finish_and_clear();
    }
}
