//! `cpcm node info`

use clap::Args;
use cpcm_shared::message::Info;
use cpcm_shared::sample::RAW_RATE_HZ;

use super::LineArgs;
use super::text::{drift, duration, iso_utc, sample_time};
use crate::cmd::output::{print, print_json};

/// Show who a node is, what it holds and what it has lost
#[derive(Args)]
#[command(after_help = "Example:\n  cpcm node info --port /dev/ttyUSB0")]
pub(super) struct InfoArgs {
    #[command(flatten)]
    line: LineArgs,
    /// Print as JSON
    #[arg(long)]
    json: bool,
}

impl InfoArgs {
    pub(super) fn run(self) -> anyhow::Result<()> {
        let info = self.line.open()?.info()?;
        if self.json { print_json(&serde_json::to_value(&info)?) } else { print(&text(&info)) }
    }
}

fn text(info: &Info) -> String {
    let kernel = info.kernel.as_ref().map_or("none".into(), |kernel| {
        format!("{:#010x}, {} bytes, site {}, train {}", kernel.id, kernel.length, kernel.site, kernel.train)
    });
    let records =
        info.records.map_or("none".into(), |e| format!("{} from {} to {}", e.count, e.first, e.last));
    let (c, clock) = (info.counters, &info.clock);
    let set = match (clock.binding, clock.set_before_us) {
        (Some(_), _) => sample_time(c.samples, true, clock),
        (None, Some(before)) => format!("not set since start-up (set before at {})", iso_utc(before)),
        (None, None) => "never set; use `cpcm node set-clock`".into(),
    };
    let up = duration(c.samples / u64::from(RAW_RATE_HZ));
    let rows = [
        ("serial number", format!("{:016x}", info.serial)),
        ("firmware", format!("{} on {}, protocol {}", info.firmware, info.board, info.protocol)),
        ("kernel", kernel),
        ("records", records),
        (
            "samples",
            format!("{}, {} lost; {up} since start-up number {}", c.samples, c.lost_samples, clock.boots),
        ),
        ("passages", format!("{}, {} lost", c.passages, c.lost_passages)),
        (
            "errors",
            format!("sensor {}, storage {}, link {}", c.sensor_errors, c.storage_errors, c.link_errors),
        ),
        ("clock", set),
        ("drift", drift(clock.drift_ppb)),
    ];
    rows.map(|(name, value)| format!("{name:<14} {value}\n")).concat()
}
