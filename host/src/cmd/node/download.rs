//! `cpcm node download`

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;
use serde_json::{Value, json};

use super::LineArgs;
use crate::cmd::output::{print, print_json};
use crate::cmd::progress::bytes_bar;
use crate::node_client::{Downloaded, NodeClient, write_records_parquet};

/// Download the records of a node
///
/// Writes records.bin (the records as the journal holds them) and records.parquet (decoded) into the directory. A
/// download that was cut leaves records.bin.part; the same command goes on from it. Nothing is deleted on the node.
#[derive(Args)]
#[command(after_help = "Example:\n  cpcm node download --port /dev/ttyUSB0 --out records")]
pub(super) struct DownloadArgs {
    #[command(flatten)]
    line: LineArgs,
    /// Directory for the files; created when missing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// First sequence number
    #[arg(long, value_name = "SEQUENCE", default_value_t = 0)]
    since: u32,
    /// Print a summary as JSON
    #[arg(long)]
    json: bool,
}

impl DownloadArgs {
    pub(super) fn run(self) -> anyhow::Result<()> {
        let mut client = self.line.open()?;
        let downloaded = download_into(&mut client, &self.out, self.since)?;
        if self.json {
            return print_json(&summary(&self.out, &downloaded));
        }
        print(&text(&self.out, &downloaded))
    }
}

/// Writes `records.bin` and `records.parquet` into `out`, unless records that are there would be lost.
pub(super) fn download_into(client: &mut NodeClient, out: &Path, since: u32) -> anyhow::Result<Downloaded> {
    std::fs::create_dir_all(out).with_context(|| format!("cannot create {}", out.display()))?;
    let file = out.join("records.bin");
    let lost = client.not_listed(&file, since)?;
    if lost > 0 {
        bail!(
            "{} holds {lost} records that the node does not list from sequence {since} on (overwritten since, of another node, or damaged), and \
             would lose them; give another directory",
            file.display()
        );
    }
    let bar = bytes_bar("download");
    let downloaded = client
        .download(&file, since, &mut bar.on_piece())
        .context("the download is not complete; the same command goes on where it was")?;
    drop(bar);
    write_records_parquet(&out.join("records.parquet"), &downloaded.records)?;
    Ok(downloaded)
}

/// Records without forces.
pub(super) fn not_evaluated(downloaded: &Downloaded) -> usize {
    downloaded.records.iter().filter(|record| record.wheelsets.is_empty()).count()
}

pub(super) fn summary(out: &Path, downloaded: &Downloaded) -> Value {
    json!({
        "out": out.display().to_string(),
        "records": downloaded.records.len(),
        "without_forces": not_evaluated(downloaded),
        "bytes": downloaded.bytes,
        "resumed": downloaded.resumed,
        "overwritten": downloaded.overwritten,
        "kept": downloaded.kept,
        "set_aside": downloaded.set_aside.as_ref().map(|path| path.display().to_string()),
    })
}

pub(super) fn text(out: &Path, downloaded: &Downloaded) -> String {
    let (records, bytes, resumed) = (downloaded.records.len(), downloaded.bytes, downloaded.resumed);
    let mut text = format!("{}: {records} records, {bytes} bytes", out.display());
    if resumed > 0 {
        text += &format!(", {resumed} of them from before");
    }
    text.push('\n');
    match not_evaluated(downloaded) {
        0 => {}
        count => text += &format!("{count} records have no forces; `cpcm node list` shows why\n"),
    }
    if downloaded.kept > 0 {
        text += &format!(
            "{} of them, from before, are not on the node any more, or before what was asked for\n",
            downloaded.kept
        );
    }
    if let Some(path) = &downloaded.set_aside {
        text += &format!("a beginning of another download was there; it is now {}\n", path.display());
    }
    if downloaded.overwritten > 0 {
        text += &format!("{} records were overwritten by newer ones meanwhile\n", downloaded.overwritten);
    }
    text
}
