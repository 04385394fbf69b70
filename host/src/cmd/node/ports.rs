//! `cpcm node ports`

use clap::Args;
use serde_json::json;

use crate::cmd::output::{print, print_json};
use crate::node_client::serial_ports;

/// List the serial ports of this computer
#[derive(Args)]
#[command(after_help = "Example:\n  cpcm node ports")]
pub(super) struct PortsArgs {
    /// Print as JSON
    #[arg(long)]
    json: bool,
}

impl PortsArgs {
    pub(super) fn run(self) -> anyhow::Result<()> {
        let ports = serial_ports()?;
        if self.json {
            let ports: Vec<_> =
                ports.iter().map(|(port, device)| json!({ "port": port, "device": device })).collect();
            return print_json(&json!(ports));
        }
        if ports.is_empty() {
            return print("no serial ports\n");
        }
        print(&ports.iter().map(|(port, device)| format!("{port:<20} {device}\n")).collect::<String>())
    }
}
