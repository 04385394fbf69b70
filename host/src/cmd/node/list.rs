//! `cpcm node list`

use clap::Args;
use cpcm_shared::message::Entry;
use serde_json::json;

use super::LineArgs;
use super::text::sample_time;
use crate::cmd::output::{print, print_json};
use crate::node_client::{flag_names, recorded_since_start};

/// List the records in a node's journal
///
/// Times are those of the clock set since the node's last start-up; records from before it show the time after their own
/// start-up ("earlier start + 2 d 03:10:00").
#[derive(Args)]
#[command(after_help = "Example:\n  cpcm node list --port /dev/ttyUSB0 --since 120")]
pub(super) struct ListArgs {
    #[command(flatten)]
    line: LineArgs,
    /// First sequence number
    #[arg(long, value_name = "SEQUENCE", default_value_t = 0)]
    since: u32,
    /// Print as JSON
    #[arg(long)]
    json: bool,
}

impl ListArgs {
    pub(super) fn run(self) -> anyhow::Result<()> {
        let mut client = self.line.open()?;
        let info = client.info()?;
        let entries = client.list(self.since)?;
        let time = |entry: &Entry| {
            sample_time(entry.first_axle_sample, recorded_since_start(&info, entry), &info.clock)
        };
        if self.json {
            let entries: Vec<_> = entries
                .iter()
                .map(|e| {
                    json!({
                        "sequence": e.sequence,
                        "first_axle_sample": e.first_axle_sample,
                        "time": time(e),
                        "speed_m_s": e.speed_m_s,
                        "wheelsets": e.wheelsets,
                        "flags": flag_names(e.flags),
                        "bytes": e.length,
                    })
                })
                .collect();
            return print_json(&json!(entries));
        }
        let mut text = String::from("sequence  time                   km/h  wheelsets  bytes  flags\n");
        for e in &entries {
            let (speed, flags) = (3.6 * e.speed_m_s, flag_names(e.flags).join(" "));
            let (time, axles, bytes) = (time(e), e.wheelsets, e.length);
            text += format!("{:>8}  {time:<20}  {speed:>5.1}  {axles:>9}  {bytes:>5}  {flags}", e.sequence)
                .trim_end();
            text.push('\n');
        }
        print(&text)
    }
}
