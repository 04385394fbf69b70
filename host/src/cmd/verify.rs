//! `cpcm verify`

use std::path::PathBuf;

use anyhow::{Context, bail};
use clap::Args;
use serde_json::json;

use super::output::{print, print_json};
use super::progress::Bar;
use crate::recording::files::{create_dir, write_atomic};
use crate::report::verification;
use crate::verification::{self as checks, Case, Verification};

/// Check the model against closed forms, reference curves and the cases of the paper
///
/// Prints a table and writes verification.html and verification.csv. Fails when a check fails.
#[derive(Args)]
#[command(after_help = "Example:\n  cpcm verify --out verification")]
pub(super) struct VerifyArgs {
    /// Directory for table and figures; created when missing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Print the table as JSON
    #[arg(long)]
    json: bool,
}

impl VerifyArgs {
    pub(super) fn run(self) -> anyhow::Result<()> {
        create_dir(&self.out)?;
        let result = checks::run(&Bar::new()).context("cannot run the checks")?;
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

fn json(result: &Verification) -> serde_json::Value {
    let case = |c: &Case| {
        json!({ "check": c.name, "source": c.source, "unit": c.unit, "expected": c.expected, "found": c.found,
                "relative_error": c.error(), "tolerance": c.tolerance, "passed": c.passed() })
    };
    json!({ "failures": result.failures(), "checks": result.cases.iter().map(case).collect::<Vec<_>>() })
}
