//! `cpcm node …`: the field tool.

mod download;
mod info;
mod list;
mod ports;
mod set_clock;
mod simulate;
mod text;
mod upload_kernel;
mod watch;

use std::time::{Duration, Instant};

use anyhow::bail;
use clap::{Args, Subcommand};

use crate::node_client::{Address, ClientError, NodeClient, serial_ports};

/// Talk to a node at the track, or simulate one
///
/// A node is named by --port: a serial port (/dev/ttyUSB0, COM3), tcp:HOST:PORT, or unix:PATH. Without --port the only
/// USB serial port of this computer is used. Connecting neither resets the node nor changes anything on it.
#[derive(Args)]
#[command(
    after_help = "Examples:\n  cpcm node info --port /dev/ttyUSB0\n  cpcm node download --port /dev/ttyUSB0 --out records\n  \
                  cpcm node simulate tests/data/field/reference-1 --kernel kernel.bin --out records"
)]
pub struct NodeArgs {
    #[command(subcommand)]
    command: NodeCommand,
}

#[derive(Subcommand)]
enum NodeCommand {
    Ports(ports::PortsArgs),
    Info(info::InfoArgs),
    SetClock(set_clock::SetClockArgs),
    UploadKernel(upload_kernel::UploadKernelArgs),
    List(list::ListArgs),
    Download(download::DownloadArgs),
    Watch(watch::WatchArgs),
    Simulate(simulate::SimulateArgs),
}

impl NodeArgs {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        match self.command {
            NodeCommand::Ports(args) => args.run(),
            NodeCommand::Info(args) => args.run(),
            NodeCommand::SetClock(args) => args.run(),
            NodeCommand::UploadKernel(args) => args.run(),
            NodeCommand::List(args) => args.run(),
            NodeCommand::Download(args) => args.run(),
            NodeCommand::Watch(args) => args.run(),
            NodeCommand::Simulate(args) => args.run(),
        }
    }
}

/// Where the node is.
#[derive(Args)]
struct LineArgs {
    /// Serial port, tcp:HOST:PORT or unix:PATH; without it, the only USB serial port
    #[arg(long, value_name = "ADDRESS")]
    port: Option<Address>,
    /// Baud rate of a serial port
    #[arg(long, value_name = "N", default_value_t = 115_200)]
    baud: u32,
    /// Wait up to this many seconds for the node to appear
    #[arg(long, value_name = "S", default_value_t = 0, value_parser = clap::value_parser!(u64).range(..=86_400))]
    wait: u64,
}

impl LineArgs {
    fn open(&self) -> anyhow::Result<NodeClient> {
        let deadline = Instant::now() + Duration::from_secs(self.wait);
        loop {
            match self.try_open() {
                Err(_) if Instant::now() < deadline => std::thread::sleep(Duration::from_millis(300)),
                outcome => return outcome,
            }
        }
    }

    fn try_open(&self) -> anyhow::Result<NodeClient> {
        let address = match &self.port {
            Some(Address::Serial { port, .. }) => Address::Serial { port: port.clone(), baud: self.baud },
            Some(address) => address.clone(),
            None => Address::Serial { port: only_usb_port()?, baud: self.baud },
        };
        Ok(NodeClient::open(&address)?)
    }
}

fn only_usb_port() -> anyhow::Result<String> {
    let ports: Result<Vec<(String, String)>, ClientError> = serial_ports();
    let mut usb: Vec<_> = ports?.into_iter().filter(|(_, what)| what.starts_with("USB")).collect();
    match (usb.pop(), usb.len()) {
        (Some((name, _)), 0) => Ok(name),
        (None, _) => bail!("no USB serial port found; name the node with --port (see `cpcm node ports`)"),
        (Some(_), more) => {
            bail!("{} USB serial ports found; choose one with --port (see `cpcm node ports`)", more + 1)
        }
    }
}
