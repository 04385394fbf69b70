//! `cpcm node set-clock`

use clap::Args;

use super::LineArgs;
use super::text::{drift, duration, iso_utc};
use crate::cmd::output::{print, print_json};

/// Bind this computer's time to the node's sample count
///
/// The second time, ten minutes or more after the first, gives the drift of the sensor's clock; the node stores it.
#[derive(Args)]
#[command(after_help = "Example:\n  cpcm node set-clock --port /dev/ttyUSB0")]
pub(super) struct SetClockArgs {
    #[command(flatten)]
    line: LineArgs,
    /// Print as JSON
    #[arg(long)]
    json: bool,
}

impl SetClockArgs {
    pub(super) fn run(self) -> anyhow::Result<()> {
        let set = self.line.open()?.set_clock()?;
        if self.json {
            return print_json(&serde_json::to_value(set)?);
        }
        let before = set.ahead_us.map_or("was not set since start-up".into(), |us| {
            format!("was {:+.3} s off after {}", us as f64 / 1e6, duration(set.span_us / 1_000_000))
        });
        print(&format!(
            "sample {} is {}\nclock {before}\ndrift {}{}\n",
            set.binding.sample,
            iso_utc(set.binding.unix_us),
            drift(set.drift_ppb),
            if set.stored { "" } else { " (NOT stored: the node's flash fails)" }
        ))
    }
}
