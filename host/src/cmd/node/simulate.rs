//! `cpcm node simulate`

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use anyhow::{Context, bail};
use clap::Args;
use cpcm_shared::message::Activity;
use cpcm_shared::sample::{RAW_RATE_HZ, SensorCode};

use super::download::{download_into, summary, text};
use crate::cmd::output::{complain, print, print_json, warn, warn_skipped};
use crate::cmd::progress::Bar;
use crate::node_client::{Downloaded, NodeClient};
use crate::node_sim::{
    Listener, MemoryNor, Qemu, SharedNode, codes_of_site, find_elf, in_process, with_kernel,
};
use crate::progress::Progress;
use crate::recording::files::read_bytes;
use crate::recording::{Site, read_site};

/// Feed the recordings of a site to a simulated node and keep its records
///
/// The node runs in this program, or with --qemu as the firmware's ELF on an emulated processor; both give the same
/// bytes. Writes records.bin and records.parquet. With --listen the simulated node stays and answers the other
/// commands.
#[derive(Args)]
#[command(
    after_help = "Example:\n  cpcm node simulate tests/data/field/reference-1 --kernel kernel.bin --out records"
)]
pub(super) struct SimulateArgs {
    /// Site directory
    site: PathBuf,
    /// Kernel package, from `cpcm kernel`
    #[arg(long, value_name = "FILE")]
    kernel: PathBuf,
    /// Directory for the files; created when missing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Run the firmware's ELF in QEMU; needs qemu-system-arm and `cargo fw-qemu`
    #[arg(long)]
    qemu: bool,
    /// Firmware for --qemu; without it, where `cargo fw-qemu` puts it
    #[arg(long, value_name = "FILE", requires = "qemu", env = "CPCM_NODE_ELF")]
    elf: Option<PathBuf>,
    /// Afterwards answer on this TCP address, as 127.0.0.1:7000, or on a pseudo-terminal with “pty” (not on Windows)
    #[arg(long, value_name = "ADDRESS", conflicts_with = "qemu", value_parser = listening)]
    listen: Option<Listening>,
    /// Print a summary as JSON
    #[arg(long)]
    json: bool,
}

impl SimulateArgs {
    pub(super) fn run(self) -> anyhow::Result<()> {
        let site =
            read_site(&self.site).with_context(|| format!("cannot read site {}", self.site.display()))?;
        warn_skipped(&site.skipped);
        let package = read_bytes(&self.kernel).context("cannot read the kernel package")?;
        let codes = codes_of_site(&site).with_context(|| format!("site {}", self.site.display()))?;
        std::fs::create_dir_all(&self.out)
            .with_context(|| format!("cannot create {}", self.out.display()))?;
        let node = with_kernel(&package).with_context(|| {
            format!("the node does not take the kernel package {}", self.kernel.display())
        })?;
        if self.qemu {
            let node = Arc::into_inner(node).and_then(|node| node.into_inner().ok());
            let flash = node.context("the simulated node is still in use")?.into_flash();
            let downloaded = in_qemu(&codes, &flash, self.elf.as_deref(), &self.out)?;
            return self.tell(&site, &downloaded);
        }
        sense(&site, codes, &node);
        let downloaded = download_into(&mut NodeClient::over(in_process(node.clone())), &self.out, 0)?;
        self.tell(&site, &downloaded)?;
        self.listen.map_or(Ok(()), |at| listen(at, node, self.json))
    }

    fn tell(&self, site: &Site, downloaded: &Downloaded) -> anyhow::Result<()> {
        let (passages, records) = (site.passages.len(), downloaded.records.len());
        if records != passages {
            warn(&format!("{passages} passages were fed, {records} were recorded"));
        }
        if self.json {
            print_json(&summary(&self.out, downloaded))
        } else {
            print(&text(&self.out, downloaded))
        }
    }
}

fn sense(site: &Site, codes: Vec<SensorCode>, node: &SharedNode) {
    let bar = Bar::new();
    bar.begin("passages", site.passages.len() as u64);
    node.lock().unwrap_or_else(PoisonError::into_inner).sense(codes, |_| bar.step());
}

fn in_qemu(
    codes: &[SensorCode],
    flash: &MemoryNor,
    elf: Option<&Path>,
    out: &Path,
) -> anyhow::Result<Downloaded> {
    let elf = find_elf(elf)?;
    let dir = tempfile::tempdir().context("cannot create a directory for the simulation")?;
    Qemu::write_image(dir.path(), flash, codes, 0)?;
    let mut qemu = Qemu::start(&elf, dir.path())?;
    let mut client = NodeClient::open(&qemu.address())?;
    let bar = Bar::new();
    bar.begin("seconds of recording", codes.len() as u64 / u64::from(RAW_RATE_HZ));
    let mut seconds = 0;
    loop {
        let live = client.watch().with_context(|| format!("the node in QEMU is silent: {}", qemu.log()))?;
        let now = live.sample / u64::from(RAW_RATE_HZ);
        (seconds..now).for_each(|_| bar.step());
        seconds = now;
        if live.activity == Activity::Ended {
            break;
        }
        if qemu.ended().is_some() {
            bail!("QEMU ended before the node had seen all samples: {}", qemu.log());
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    drop(bar);
    download_into(&mut client, out, 0)
}

/// Where a simulated node answers.
#[derive(Clone, Copy, Debug)]
enum Listening {
    #[cfg(unix)]
    PseudoTerminal,
    Tcp(SocketAddr),
}

fn listening(text: &str) -> Result<Listening, String> {
    match (text, text.strip_prefix("tcp:").unwrap_or(text).parse()) {
        #[cfg(unix)]
        ("pty", _) => Ok(Listening::PseudoTerminal),
        (_, Ok(address)) => Ok(Listening::Tcp(address)),
        _ => Err("give an address like 127.0.0.1:7000, or pty".into()),
    }
}

/// Answers until the program is interrupted. Says where; not among the JSON.
fn listen(at: Listening, node: SharedNode, json: bool) -> anyhow::Result<()> {
    let listener = match at {
        #[cfg(unix)]
        Listening::PseudoTerminal => {
            Listener::pseudo_terminal(node).context("cannot open a pseudo-terminal")?
        }
        Listening::Tcp(address) => {
            Listener::tcp(address, node).with_context(|| format!("cannot listen on {address}"))?
        }
    };
    let answers = format!("the node answers at --port {}; Ctrl-C ends it\n", listener.address);
    if json {
        complain(&answers)
    } else {
        print(&answers)?
    }
    loop {
        std::thread::park();
    }
}
