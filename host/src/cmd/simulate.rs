//! `cpcm simulate`

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context;
use clap::Args;

use super::output::{print, print_json};
use super::progress::Bar;
use crate::recording::files::{check_dir, create_dir, read_bytes, write_atomic};
use crate::recording::truth::write_truth;
use crate::recording::{Format, check_unoccupied, format_of, write_site};
use crate::scenario::{read_scenario, simulate};

/// Simulate train passages over a crossing with known geometry and write a site directory with truth
///
/// The scenario is a crossing.toml with a [simulation] table: seed, passages, speed, true ballast, path through the
/// crossing, roughness, wheel variation, numerics and effects. The site directory holds crossing.toml,
/// passages.parquet and irregularity.csv, which everything downstream reads, and truth.parquet, truth.toml and
/// truth.scenario.toml, which only scoring reads.
#[derive(Args)]
#[command(after_help = "Example:\n  cpcm simulate docs/examples/site.toml --out simulated")]
pub(super) struct SimulateArgs {
    /// Scenario file
    scenario: PathBuf,
    /// Directory for the site; created when missing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

impl SimulateArgs {
    pub(super) fn run(self) -> anyhow::Result<()> {
        let failed = || format!("cannot simulate {}", self.scenario.display());
        let scenario = read_scenario(&self.scenario).with_context(failed)?;
        self.check_out()?;
        let clock = Instant::now();
        let simulated = simulate(&scenario, &Bar::new()).with_context(failed)?;
        let seconds = clock.elapsed().as_secs_f64();
        self.write(&simulated).with_context(|| format!("cannot write {}", self.out.display()))?;
        let (passages, wheels) = (simulated.site.passages.len(), simulated.truth.wheels.len());
        if self.json {
            return print_json(&serde_json::json!({
                "site": self.out, "passages": passages, "wheels": wheels, "simulation_s": seconds,
                "effects": scenario.simulation.effects.names(),
            }));
        }
        print(&format!(
            "{passages} passages ({wheels} wheels) over {} simulated in {seconds:.1} s: {}\n",
            scenario.crossing.name,
            self.out.display()
        ))
    }

    /// Recordings that were not simulated are not replaced.
    fn check_out(&self) -> anyhow::Result<()> {
        let simulated =
            self.out.join("truth.scenario.toml").exists() && format_of(&self.out) == Format::Parquet;
        if !simulated {
            check_unoccupied(&self.out)?;
        }
        Ok(check_dir(&self.out)?)
    }

    /// Truth first: a site that can be read is complete.
    fn write(&self, simulated: &crate::scenario::SimulatedSite) -> anyhow::Result<()> {
        create_dir(&self.out)?;
        write_atomic(&self.out.join("truth.scenario.toml"), &read_bytes(&self.scenario)?)?;
        write_truth(&self.out, &simulated.truth)?;
        write_site(&self.out, &simulated.site, Format::Parquet)?;
        Ok(())
    }
}
