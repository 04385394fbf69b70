//! `cpcm kernel`

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use serde_json::json;

use super::output::{print, print_json, warn_skipped, with_effects};
use super::progress::Bar;
use crate::pipeline::{self, AnalyseOptions};
use crate::recording::files::write_atomic;
use crate::recording::read_site;

/// Calibrate a crossing and write the kernel package for its node
#[derive(Args)]
#[command(after_help = "Example:\n  cpcm kernel tests/data/field/reference-1 --out kernel.bin")]
pub(super) struct KernelArgs {
    /// Site directory
    site: PathBuf,
    /// File for the package
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Include the effects of a diagnosis.json
    #[arg(long, value_name = "FILE")]
    with_effects: Option<PathBuf>,
    /// Print a summary as JSON
    #[arg(long)]
    json: bool,
}

impl KernelArgs {
    pub(super) fn run(self) -> anyhow::Result<()> {
        let site =
            read_site(&self.site).with_context(|| format!("cannot read site {}", self.site.display()))?;
        warn_skipped(&site.skipped);
        let site = with_effects(site, self.with_effects.as_deref())?;
        let package = pipeline::kernel(&site, &AnalyseOptions::default(), &Bar::new())
            .with_context(|| format!("cannot make a kernel for site {}", self.site.display()))?;
        write_atomic(&self.out, &package).context("cannot write the kernel package")?;
        let (file, bytes) = (self.out.display().to_string(), package.len());
        if self.json {
            return print_json(&json!({ "site": site.crossing.name, "file": file, "bytes": bytes }));
        }
        print(&format!("{file}: kernel package of {bytes} bytes for site {}\n", site.crossing.name))
    }
}
