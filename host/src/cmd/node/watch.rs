//! `cpcm node watch`

use std::time::Duration;

use clap::Args;
use cpcm_shared::message::{Activity, Live};

use super::LineArgs;
use crate::cmd::output::print;

/// Show what a node's sensor sees, until interrupted
#[derive(Args)]
#[command(after_help = "Example:\n  cpcm node watch --port /dev/ttyUSB0 --every 0.5")]
pub(super) struct WatchArgs {
    #[command(flatten)]
    line: LineArgs,
    /// Seconds between two lines
    #[arg(long, value_name = "S", default_value_t = 1.0, value_parser = interval)]
    every: f64,
    /// Stop after this many lines
    #[arg(long, value_name = "N")]
    count: Option<u64>,
    /// Print one JSON object per line
    #[arg(long)]
    json: bool,
}

fn interval(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds) if (0.05..=3600.0).contains(&seconds) => Ok(seconds),
        _ => Err("from 0.05 to 3600 seconds".into()),
    }
}

impl WatchArgs {
    pub(super) fn run(self) -> anyhow::Result<()> {
        let mut client = self.line.open()?;
        if !self.json {
            print("    sample  state       mean m/s²  rms m/s²  peak m/s²  passages  lost samples\n")?;
        }
        for line in 0.. {
            if Some(line) == self.count {
                break;
            }
            if line > 0 {
                std::thread::sleep(Duration::from_secs_f64(self.every));
            }
            let live = client.watch()?;
            print(&if self.json { format!("{}\n", serde_json::to_string(&live)?) } else { text(&live) })?;
        }
        Ok(())
    }
}

fn text(live: &Live) -> String {
    let state = match live.activity {
        Activity::Starting => "starting",
        Activity::Quiet => "quiet",
        Activity::Passage => "train",
        Activity::Evaluating => "evaluating",
        Activity::Ended => "ended",
    };
    let (mean, rms, peak) = (live.mean_m_s2, live.rms_m_s2, live.peak_m_s2);
    let (passages, lost) = (live.counters.passages, live.counters.lost_samples);
    format!(
        "{:>10}  {state:<10}  {mean:>9.3}  {rms:>8.3}  {peak:>9.2}  {passages:>8}  {lost:>12}\n",
        live.sample
    )
}
