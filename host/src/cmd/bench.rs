//! `cpcm bench`

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, anyhow};
use clap::Args;
use serde_json::json;

use super::output::{print, print_json};
use super::progress::Bar;
use crate::bench::child::{self, Usage};
use crate::bench::growth;
use crate::bench::peers::Peers;
use crate::bench::table::{Target, markdown};
use crate::bench::{Job, Outcome, Row};
use crate::progress::Progress as _;
use crate::recording::files::{check_dir, create_dir, write_atomic};

/// Measure CPU time and memory beside the programs that a user would take instead
///
/// Runs each job in turn with this program and with a numpy or OpenSees script, as child processes, and prints the ratios.
/// The scripts are part of this program (bench/peers); they need python3 with numpy, scipy, threadpoolctl, pyarrow and
/// openseespy. What is missing is said with the command that installs it, and that row is marked as not run.
#[derive(Args)]
#[command(
    after_help = "Examples:\n  cpcm bench --out bench-results\n  cpcm bench --ours-only\n  cpcm bench --growth --out docs/figures"
)]
pub(super) struct BenchArgs {
    /// Directory for bench.md and bench.json, or for the figures of --growth; created when missing
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print the measurements as JSON
    #[arg(long)]
    json: bool,
    /// Site of 24 passages with truth and scan
    #[arg(long, value_name = "SITE", default_value = "tests/data/field/reference-1")]
    site: PathBuf,
    /// Runs of each program; the best one counts
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=20))]
    repeat: u8,
    /// Python that runs the scripts
    #[arg(long, value_name = "PROGRAM", default_value = "python3")]
    python: String,
    /// Leave out the other programs
    #[arg(long)]
    ours_only: bool,
    /// How cost grows with passages, sleepers and speeds instead: table and figures
    #[arg(long)]
    growth: bool,
    /// Do one job and print its answer; the measured child process
    #[arg(long, hide = true, value_name = "JOB")]
    job: Option<Job>,
    /// What the job works on
    #[arg(long, hide = true, value_name = "PATH", default_value = ".")]
    input: PathBuf,
}

/// A comparison before it is run.
struct Plan<'a> {
    job: &'static str,
    peer: &'static str,
    modules: &'static [&'static str],
    theirs: Option<(&'static str, Vec<&'a Path>)>,
    target: Target,
}

impl BenchArgs {
    pub(super) fn run(self) -> anyhow::Result<()> {
        if let Some(job) = self.job {
            let answer = job.run(&self.input).map_err(|e| anyhow!("{e}"))?;
            return print(&format!("{answer}\n"));
        }
        if let Some(dir) = &self.out {
            check_dir(dir)?;
        }
        if self.growth {
            return self.growth();
        }
        let rows = self.compare()?;
        let value = json!({ "rows": rows.iter().map(Row::json).collect::<Vec<_>>() });
        let table = markdown(&rows);
        if let Some(dir) = &self.out {
            create_dir(dir)?;
            write_atomic(&dir.join("bench.json"), format!("{value:#}\n").as_bytes())?;
            write_atomic(&dir.join("bench.md"), table.as_bytes())?;
        }
        if self.json { print_json(&value) } else { print(&table) }
    }

    fn growth(&self) -> anyhow::Result<()> {
        let bar = Bar::new();
        let curves = growth::measure(&self.site, &bar).map_err(|e| anyhow!("{e}"))?;
        drop(bar);
        let table = growth::markdown(&curves);
        if let Some(dir) = &self.out {
            create_dir(dir)?;
            write_atomic(&dir.join("growth.md"), table.as_bytes())?;
            for curve in &curves {
                let svg = crate::report::growth::figure(curve)?;
                write_atomic(&dir.join(format!("growth-{}.svg", curve.name)), svg.as_bytes())?;
            }
        }
        let value = json!({ "curves": curves.iter().map(growth::Curve::json).collect::<Vec<_>>() });
        if self.json { print_json(&value) } else { print(&table) }
    }

    fn compare(&self) -> anyhow::Result<Vec<Row>> {
        let peers = Peers::unpack(&self.python).context("cannot unpack the scripts")?;
        let site = self.site.canonicalize().with_context(|| format!("no site at {}", self.site.display()))?;
        let (passages, results) = (peers.passages(), tempfile::tempdir()?);
        let ratio = |cpu_ratio: f64| Target { cpu_ratio: Some(cpu_ratio), ..Target::default() };
        let step = [Path::new("mid"), Path::new("0.15"), Path::new("1e-4")].to_vec();
        let plans = [
            (
                own(Job::Whole, &passages)?,
                Plan {
                    job: "ballast, forces, irregularity of 100 passages",
                    peer: "numpy_cpcm.py",
                    modules: &["numpy", "scipy", "threadpoolctl", "pyarrow"],
                    theirs: Some(("whole_job.py", vec![&passages])),
                    target: Target { memory_share: Some(0.25), ..ratio(50.0) },
                },
            ),
            (
                own(Job::MovingForce, Path::new(""))?,
                Plan {
                    job: "moving force on T1, 0.15 m, 9000 steps",
                    peer: "t1_opensees.py",
                    modules: &["numpy", "openseespy.opensees"],
                    theirs: Some(("t1_opensees.py", step)),
                    target: ratio(50.0),
                },
            ),
            (
                own(Job::Passage, &site)?,
                Plan {
                    job: "one passage of three cars, program start included",
                    peer: "",
                    modules: &[],
                    theirs: None,
                    target: Target { cpu_s: Some(0.06), ..Target::default() },
                },
            ),
            (
                analyse(&site, results.path())?,
                Plan {
                    job: "analyse a site of 24 passages",
                    peer: "field_baseline.py",
                    modules: &["numpy", "scipy", "pyarrow"],
                    theirs: Some(("site_job.py", vec![&site])),
                    target: Target { wall_s: Some(3.0), ..ratio(20.0) },
                },
            ),
        ];
        let bar = Bar::new();
        bar.begin("jobs", plans.len() as u64 * u64::from(self.repeat));
        plans.iter().map(|(ours, plan)| self.row(ours, plan, &peers, &bar)).collect()
    }

    /// Both programs in turn.
    fn row(&self, ours: &[PathBuf], plan: &Plan, peers: &Peers, bar: &Bar) -> anyhow::Result<Row> {
        let missing = plan.theirs.as_ref().and_then(|_| match self.ours_only {
            true => Some("left out by --ours-only".to_owned()),
            false => peers.missing(plan.modules),
        });
        let mut own_runs = Vec::new();
        let mut their_runs: Vec<Usage> = Vec::new();
        let mut trouble = missing;
        for _ in 0..self.repeat {
            own_runs.push(child::measure(Command::new(&ours[0]).args(&ours[1..]))?);
            if let (Some((script, arguments)), None) = (&plan.theirs, &trouble) {
                match child::measure(&mut peers.command(script, arguments)) {
                    Ok(usage) => their_runs.push(usage),
                    Err(error) => trouble = Some(error.to_string()),
                }
            }
            bar.step();
        }
        let theirs = match (&plan.theirs, trouble) {
            (None, _) => Outcome::Alone,
            (_, Some(reason)) => Outcome::NotRun(reason),
            (_, None) => Outcome::Ran(their_runs),
        };
        Ok(Row { job: plan.job.into(), peer: plan.peer.into(), ours: own_runs, theirs, target: plan.target })
    }
}

/// This program, doing a job.
fn own(job: Job, input: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let name = clap::ValueEnum::to_possible_value(&job).map(|v| v.get_name().to_owned()).unwrap_or_default();
    let mut words = vec![this_program()?, "bench".into(), "--job".into(), name.into()];
    if !input.as_os_str().is_empty() {
        words.extend(["--input".into(), input.to_owned()]);
    }
    Ok(words)
}

fn analyse(site: &Path, out: &Path) -> anyhow::Result<Vec<PathBuf>> {
    Ok(vec![this_program()?, "analyse".into(), site.to_owned(), "--out".into(), out.to_owned()])
}

fn this_program() -> anyhow::Result<PathBuf> {
    std::env::current_exe().context("cannot find this program")
}
