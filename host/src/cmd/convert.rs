//! `cpcm convert`

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use serde_json::json;

use super::output::{print, print_json, warn_skipped};
use crate::recording::{Format, check_unoccupied, format_of, read_site, write_site};

/// Convert the recordings of a site between Parquet and text
///
/// IN is a site directory with passages.parquet, or with the index passages.csv. The index names one sample file
/// per passage: .csv, .mat (MAT v5, numeric array acceleration_m_s2) or .mseed (miniSEED 2 or 3; integer counts
/// need the column m_s2_per_count in the index). OUT becomes a site directory with Parquet or CSV recordings;
/// MAT and miniSEED are read, not written. Passages that cannot be used are named and left out.
#[derive(Args)]
#[command(
    after_help = "Examples:\n  cpcm convert site site-csv\n  cpcm convert site-mat site-parquet --to parquet"
)]
pub(super) struct ConvertArgs {
    /// Site directory to read
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// Site directory to write; created when missing
    #[arg(value_name = "OUT")]
    output: PathBuf,
    /// Format of OUT; without it, the one that IN does not have
    #[arg(long)]
    to: Option<Format>,
    /// Print a summary as JSON
    #[arg(long)]
    json: bool,
}

impl ConvertArgs {
    pub(super) fn run(self) -> anyhow::Result<()> {
        let site =
            read_site(&self.input).with_context(|| format!("cannot read site {}", self.input.display()))?;
        let to = self.to.unwrap_or(match format_of(&self.input) {
            Format::Parquet => Format::Csv,
            Format::Csv => Format::Parquet,
        });
        check_unoccupied(&self.output)?;
        warn_skipped(&site.skipped);
        write_site(&self.output, &site, to)
            .with_context(|| format!("cannot write site {}", self.output.display()))?;
        let (out, used, left_out) =
            (self.output.display().to_string(), site.passages.len(), site.skipped.len());
        if self.json {
            return print_json(&json!({ "out": out, "passages": used, "left_out": left_out }));
        }
        print(&format!("{out}: {used} passages written, {left_out} left out\n"))
    }
}
