//! Progress as a bar on standard error; nothing when that is not a terminal.

use std::fmt::Write;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use indicatif::{HumanDuration, ProgressBar, ProgressState, ProgressStyle};

use crate::node_client::Piece;
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

/// Time left; nothing is known of it before the first step.
fn left(state: &ProgressState, out: &mut dyn Write) {
    if state.pos() > 0 {
        // The bar has no other place to complain.
        let _ = write!(out, ", {} left", HumanDuration(state.eta()));
    }
}

impl Progress for Bar {
    fn begin(&self, stage: &str, steps: u64) {
        let template = "{spinner} {msg:28} [{bar:32}] {pos}/{len}  {elapsed}{left}";
        let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        let style = style.with_key("left", left);
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

/// A transfer: bytes, rate and time left. Ends with the value.
pub(super) struct BytesBar(ProgressBar);

/// A bar for a transfer that has not begun.
pub(super) fn bytes_bar(what: &'static str) -> BytesBar {
    let template = "{msg:10} [{bar:32}] {bytes}/{total_bytes}  {bytes_per_sec}, {eta} left";
    let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    BytesBar(ProgressBar::new(0).with_style(style.progress_chars("=> ")).with_message(what))
}

impl BytesBar {
    /// Listener for the transfer.
    pub(super) fn on_piece(&self) -> impl FnMut(Piece) {
        let mut begun = false;
        move |piece| {
            self.0.set_length(piece.total);
            self.0.set_position(piece.done);
            if !begun {
                // What was across before must not count as speed.
                self.0.reset_eta();
                begun = true;
            }
        }
    }
}

impl Drop for BytesBar {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}
