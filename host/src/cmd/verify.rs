//! `cpcm verify`

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;
use serde_json::json;

use super::output::{print, print_json, warn, warn_skipped};
use super::progress::Bar;
use crate::recording::files::{create_dir, write_atomic};
use crate::recording::read_site;
use crate::recording::truth::read_truth;
use crate::report::verification;
use crate::verification::{self as checks, Baseline, Case, Table, Verification};

/// Check the model against closed forms, reference curves and the cases of the paper
///
/// Prints a table and writes verification.html and verification.csv. Fails when a check fails. With --site, also analyses
/// recordings whose truth is known (truth.parquet, truth.toml) and scores this program beside the paper's chain.
#[derive(Args)]
#[command(
    after_help = "Examples:\n  cpcm verify --out verification\n  cpcm verify --out verification --site tests/data/field/reference-1"
)]
pub(super) struct VerifyArgs {
    /// Directory for table and figures; created when missing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Site directory with truth to score on; may be given more than once
    #[arg(long = "site", value_name = "SITE")]
    sites: Vec<PathBuf>,
    /// Leave out the checks that need no recordings
    #[arg(long, requires = "sites")]
    sites_only: bool,
    /// Run the numpy baseline (bench/peers) on each site too, 70 s of CPU time each; without it, or without python3,
    /// numpy, scipy and pyarrow, its documented figures stand in the table
    #[arg(long, requires = "sites")]
    baseline: bool,
    /// Python that runs the baseline
    #[arg(long, value_name = "PROGRAM", default_value = "python3")]
    python: String,
    /// Print the table as JSON
    #[arg(long)]
    json: bool,
}

impl VerifyArgs {
    pub(super) fn run(self) -> anyhow::Result<()> {
        create_dir(&self.out)?;
        let bar = Bar::new();
        let mut result = match self.sites_only {
            true => Verification::default(),
            false => checks::run(&bar).context("cannot run the checks")?,
        };
        for dir in &self.sites {
            add_site(&mut result, dir, self.baseline_of(dir), &bar)
                .with_context(|| format!("cannot score on site {}", dir.display()))?;
        }
        drop(bar);
        write_atomic(&self.out.join("verification.csv"), verification::csv(&result).as_bytes())?;
        write_atomic(&self.out.join("verification.html"), verification::html(&result)?.as_bytes())?;
        match self.json {
            true => print_json(&json(&result))?,
            false => print(&verification::table(&result))?,
        }
        match result.failures() {
            0 => Ok(()),
            n => bail!("{n} of {} checks failed; see {}", result.cases.len(), self.out.display()),
        }
    }
}

impl VerifyArgs {
    /// The baseline run on a site; why it was not run goes to standard error.
    fn baseline_of(&self, dir: &Path) -> Option<Baseline> {
        if !self.baseline {
            return None;
        }
        match Baseline::run(dir, &self.python) {
            Ok(found) => Some(found),
            Err(reason) => {
                warn(&format!("the numpy baseline is skipped on {}: {reason}", dir.display()));
                None
            }
        }
    }
}

fn add_site(
    result: &mut Verification,
    dir: &Path,
    baseline: Option<Baseline>,
    bar: &Bar,
) -> anyhow::Result<()> {
    let site = read_site(dir)?;
    warn_skipped(&site.skipped);
    let truth = read_truth(dir).context("a site without truth cannot be scored on")?;
    let name = dir.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let baseline = baseline.or_else(|| Baseline::documented(&name));
    checks::add_site(result, &site, &truth, baseline.as_ref(), bar)?;
    Ok(())
}

fn json(result: &Verification) -> serde_json::Value {
    let case = |c: &Case| {
        json!({ "check": c.name, "source": c.source, "unit": c.unit, "expected": c.expected, "found": c.found,
                "relative_error": c.error(), "tolerance": c.tolerance, "passed": c.passed() })
    };
    let table = |t: &Table| json!({ "title": t.title, "note": t.note, "columns": t.columns, "rows": t.rows });
    json!({ "failures": result.failures(), "checks": result.cases.iter().map(case).collect::<Vec<_>>(),
            "tables": result.tables.iter().map(table).collect::<Vec<_>>() })
}
