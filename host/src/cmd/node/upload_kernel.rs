//! `cpcm node upload-kernel`

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use serde_json::json;

use super::LineArgs;
use crate::cmd::output::{print, print_json};
use crate::cmd::progress::bytes_bar;
use crate::recording::files::read_bytes;

/// Upload a kernel package and put it in force
///
/// The package is checked here, on the way and as a whole on the node before it takes over; until then, and whenever
/// something fails, the old one stays in force. An upload that was cut goes on where it was.
#[derive(Args)]
#[command(after_help = "Example:\n  cpcm node upload-kernel kernel.bin --port /dev/ttyUSB0")]
pub(super) struct UploadKernelArgs {
    /// Kernel package, from `cpcm kernel`
    file: PathBuf,
    #[command(flatten)]
    line: LineArgs,
    /// Send it although it is in force already: its copy on the node may be damaged (flag `kernel-read`)
    #[arg(long)]
    again: bool,
    /// Print as JSON
    #[arg(long)]
    json: bool,
}

impl UploadKernelArgs {
    pub(super) fn run(self) -> anyhow::Result<()> {
        let package = read_bytes(&self.file).context("cannot read the kernel package")?;
        let mut client = self.line.open()?;
        let bar = bytes_bar("upload");
        let uploaded = client
            .upload(&package, self.again, &mut bar.on_piece())
            .with_context(|| format!("cannot upload {}", self.file.display()))?;
        drop(bar);
        let (id, sent, resumed) = (uploaded.kernel_id, uploaded.sent, uploaded.resumed);
        if self.json {
            let already = uploaded.already;
            return print_json(
                &json!({ "kernel_id": id, "sent": sent, "resumed": resumed, "already": already }),
            );
        }
        print(&match uploaded.already {
            true => format!(
                "kernel {id:#010x} was in force already; nothing sent (--again sends it all the same)\n"
            ),
            false => format!(
                "kernel {id:#010x} is in force; {sent} bytes sent, {resumed} were there from before\n"
            ),
        })
    }
}
