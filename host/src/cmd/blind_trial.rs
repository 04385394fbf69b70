//! `cpcm blind-trial`

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, anyhow, bail};
use clap::Args;

use super::output::{print, print_json};
use super::progress::Bar;
use crate::gap::trial::{Panels, Question, Score, bins, draw, score};
use crate::progress::Progress;
use crate::recording::files::{create_dir, read_bytes, write_atomic};
use crate::recording::{Format, write_site};
use crate::report::trials::figures;

/// Check the diagnosis on simulated sites whose effect is withheld from it
///
/// Every trial draws a site and an effect, simulates it with another mesh, step and damping than the diagnosis has, runs
/// `cpcm diagnose` in a process of its own that sees only the site, and then opens the answer, which until then is in no
/// file. Writes trials.json and trials.csv after every trial, so that a run that was stopped can be resumed.
#[derive(Args)]
#[command(after_help = "Example:\n  cpcm blind-trial --seed 1 --trials 20 --out trials")]
pub(super) struct BlindTrialArgs {
    /// Same seed, same trials
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Number of trials
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    trials: u64,
    /// Panels that the trials are of
    #[arg(long, value_enum, default_value_t)]
    panels: Panels,
    /// Run these trials only, by number: to look at what went wrong
    #[arg(long, value_name = "N", value_delimiter = ',', conflicts_with_all = ["trials", "resume"])]
    only: Vec<u64>,
    /// Take over the trials of these panels, this seed and this build that trials.json in the output directory holds
    #[arg(long)]
    resume: bool,
    /// Directory for the scores; created when missing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Keep the sites and their diagnoses below the output directory
    #[arg(long)]
    keep: bool,
    /// Trials at a time; 0: as many as there are cores
    #[arg(long, default_value_t = 0)]
    jobs: usize,
    /// End with a failure when the diagnosis does worse than a version fit for use
    #[arg(long)]
    check: bool,
    /// Print the scores as JSON
    #[arg(long)]
    json: bool,
}

impl BlindTrialArgs {
    pub(super) fn run(self) -> anyhow::Result<()> {
        create_dir(&self.out)?;
        let scores = self.scores();
        if !self.resume && scores.exists() {
            bail!(
                "{} holds the scores of another run, which this one would replace; choose another --out, or go on with that one \
                 (--resume), if it is of this build",
                scores.display()
            );
        }
        let bar = Bar::new();
        bar.begin("trials", self.numbers().len() as u64);
        let scores = self.all(&bar)?;
        drop(bar);
        match self.json {
            true => print_json(&serde_json::to_value(&scores)?)?,
            false => print(&table(&scores))?,
        }
        if self.check { check(&scores) } else { Ok(()) }
    }

    /// File of the scores.
    fn scores(&self) -> PathBuf {
        self.out.join("trials.json")
    }

    /// Numbers of the trials that are asked for.
    fn numbers(&self) -> Vec<u64> {
        if self.only.is_empty() { (0..self.trials).collect() } else { self.only.clone() }
    }

    /// Runs the trials, several at a time; the order in which they end changes nothing.
    fn all(&self, bar: &Bar) -> anyhow::Result<Vec<Score>> {
        let jobs = match self.jobs {
            0 => std::thread::available_parallelism().map_or(1, usize::from),
            n => n,
        };
        let version = version()?;
        let known = if self.resume { self.known(&version)? } else { BTreeMap::new() };
        known.iter().for_each(|_| bar.step());
        let left: Vec<u64> = self.numbers().into_iter().filter(|i| !known.contains_key(i)).collect();
        let next = AtomicUsize::new(0);
        let done: Mutex<BTreeMap<u64, Score>> = Mutex::new(known);
        let work = || -> anyhow::Result<()> {
            while let Some(&index) = left.get(next.fetch_add(1, Ordering::Relaxed)) {
                let kept = self.keep.then(|| self.out.join(format!("trial-{index}")));
                let found = one(self.panels, (self.seed, index), kept.as_deref())
                    .with_context(|| format!("trial {index}"))?;
                let mut done = done.lock().unwrap_or_else(PoisonError::into_inner);
                done.insert(index, found);
                bar.step();
                self.write(&done, &version)?;
            }
            Ok(())
        };
        std::thread::scope(|scope| {
            let threads: Vec<_> = (0..jobs.min(left.len())).map(|_| scope.spawn(work)).collect();
            threads.into_iter().try_for_each(|t| t.join().map_err(|_| anyhow!("a trial broke down"))?)
        })?;
        Ok(done.into_inner().unwrap_or_else(PoisonError::into_inner).into_values().collect())
    }

    /// Trials of an earlier run with these panels, this seed and this build.
    fn known(&self, version: &str) -> anyhow::Result<BTreeMap<u64, Score>> {
        let path = self.scores();
        if !path.exists() {
            return Ok(BTreeMap::new());
        }
        let records: Vec<Record> = serde_json::from_slice(&read_bytes(&path)?).with_context(|| {
            format!("{} is not from this version of blind-trial; choose another --out", path.display())
        })?;
        let same = |r: &Record| {
            r.panels == self.panels && r.seed == self.seed && r.version == version && r.trial < self.trials
        };
        let others = records.iter().filter(|r| !same(r)).count();
        if others > 0 {
            bail!(
                "{} holds {others} trials of another build, seed, kind of panels, or beyond --trials, which would be lost; choose another --out",
                path.display()
            );
        }
        Ok(records.into_iter().map(|r| (r.trial, r.score)).collect())
    }

    fn write(&self, done: &BTreeMap<u64, Score>, version: &str) -> anyhow::Result<()> {
        let scores: Vec<Score> = done.values().cloned().collect();
        let record = |(trial, score): (&u64, &Score)| Record {
            panels: self.panels,
            seed: self.seed,
            trial: *trial,
            version: version.to_string(),
            score: score.clone(),
        };
        let records: Vec<Record> = done.iter().map(record).collect();
        write_atomic(&self.scores(), serde_json::to_string_pretty(&records)?.as_bytes())?;
        write_atomic(&self.out.join("trials.csv"), csv(&records).as_bytes())?;
        write_atomic(&self.out.join("table.txt"), table(&scores).as_bytes())?;
        for (name, svg) in figures(&scores)? {
            write_atomic(&self.out.join(name), svg.as_bytes())?;
        }
        Ok(())
    }
}

/// A trial in trials.json.
#[derive(serde::Serialize, serde::Deserialize)]
struct Record {
    /// Earlier versions had the nominal one only.
    #[serde(default)]
    panels: Panels,
    seed: u64,
    trial: u64,
    version: String,
    #[serde(flatten)]
    score: Score,
}

/// Version of the package and checksum of the program: scores of different builds do not mix.
fn version() -> anyhow::Result<String> {
    let program = read_bytes(&std::env::current_exe().context("this program has no path")?)?;
    let checksum = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&program);
    Ok(format!("{}-{checksum:08x}", env!("CARGO_PKG_VERSION")))
}

/// Draws, diagnoses and scores one trial.
fn one(panels: Panels, (seed, index): (u64, u64), kept: Option<&Path>) -> anyhow::Result<Score> {
    let work = tempfile::tempdir().context("no temporary directory")?;
    let trial = draw(panels, seed, index, work.path())?;
    let place = kept.unwrap_or(work.path());
    let (site, out) = (place.join("site"), place.join("diagnosis"));
    write_site(&site, &trial.site, Format::Parquet)?;
    let diagnosis = diagnose(&site, &out, trial.exclude)?;
    Ok(score(trial.answer, &diagnosis))
}

/// Runs the diagnosis in a process of its own.
fn diagnose(site: &Path, out: &Path, exclude: Option<&str>) -> anyhow::Result<serde_json::Value> {
    let program = std::env::current_exe().context("this program has no path")?;
    let mut command = Command::new(program);
    // Nothing but the site is handed over, neither seed nor number; one thread each, as trials run side by side.
    command.env_clear().env("RAYON_NUM_THREADS", "1");
    command.arg("diagnose").arg(site).arg("--out").arg(out);
    if let Some(name) = exclude {
        command.args(["--exclude", name]);
    }
    let run = command.output().context("cannot start the diagnosis")?;
    if !run.status.success() {
        bail!("the diagnosis failed: {}", String::from_utf8_lossy(&run.stderr));
    }
    Ok(serde_json::from_slice(&read_bytes(&out.join("diagnosis.json"))?)?)
}

/// Part of the trials of each kind that must be right; of single effects those above twice the floor count. Less than is asked of a full
/// run, because 20 trials hold four of the first kind, about three of the second and two of the others.
const LEAST_RIGHT: [(Question, &str, f64); 4] = [
    (Question::Nothing, "sites without effect", 0.75),
    (Question::One, "strong effects", 0.6),
    (Question::LeftOut, "sites whose effect is left out", 0.5),
    (Question::Pair, "pairs", 0.5),
];

fn check(scores: &[Score]) -> anyhow::Result<()> {
    for (question, what, least) in LEAST_RIGHT {
        let counts = |s: &&Score| {
            s.answer.question == question && (question != Question::One || s.strength_to_floor > STRONG)
        };
        let of: Vec<&Score> = scores.iter().filter(counts).collect();
        let right = of.iter().filter(|s| s.right).count();
        if (right as f64) < least * of.len() as f64 {
            bail!("{right} of {} {what} are right, at least {:.0} % are asked", of.len(), 100.0 * least);
        }
    }
    Ok(())
}

fn csv(records: &[Record]) -> String {
    let mut text = String::from(
        "trial,question,effects,strength_to_floor,weaker_to_floor,verdict,named,first_group,probability,right,covered,closed\n",
    );
    for Record { trial, score: s, .. } in records {
        text.push_str(&format!(
            "{trial},{:?},{},{:.3},{:.3},{},{},{},{:.3},{},{},{:.3}\n",
            s.answer.question,
            s.answer.effects.join(" "),
            s.strength_to_floor,
            s.weaker_to_floor,
            s.verdict,
            s.named.join(" "),
            s.first_group.join(" "),
            s.probability,
            s.right,
            s.covered.map_or(String::new(), |c| c.to_string()),
            s.closed_fraction,
        ));
    }
    text
}

/// An effect is strong when it changes the signal by more than twice the noise floor.
const STRONG: f64 = 2.0;

/// Right answers by question and effect, with 90 % intervals (Wilson).
fn table(scores: &[Score]) -> String {
    let mut text = String::new();
    let mut line = |name: &str, of: Vec<&Score>| {
        let right = of.iter().filter(|s| s.right).count();
        let (low, high) = wilson(right, of.len());
        text.push_str(&format!(
            "{name:44} {right:4} of {:4}  {:3.0} % ({low:3.0} … {high:3.0})\n",
            of.len(),
            percent(right, of.len())
        ));
    };
    let asked = |q: Question| scores.iter().filter(move |s| s.answer.question == q);
    let strong = |s: &&Score| s.strength_to_floor > STRONG;
    line("no effect: no-gap", asked(Question::Nothing).collect());
    line("one effect, all strengths", asked(Question::One).collect());
    line("one effect, above twice the floor", asked(Question::One).filter(strong).collect());
    line("left out: unexplained or right stage", asked(Question::LeftOut).collect());
    line("left out, above twice the floor", asked(Question::LeftOut).filter(strong).collect());
    line("pair: both", asked(Question::Pair).collect());
    line("pair, above twice the floor", asked(Question::Pair).filter(strong).collect());
    let both_strong = |s: &&Score| s.weaker_to_floor > STRONG;
    line("pair, each alone above twice the floor", asked(Question::Pair).filter(both_strong).collect());
    let mut by: BTreeMap<&str, Vec<&Score>> = BTreeMap::new();
    for s in asked(Question::One) {
        by.entry(s.answer.effects.first().map_or("", String::as_str)).or_default().push(s);
    }
    for (name, list) in by {
        line(&format!("  {name}"), list);
    }
    let covered: Vec<bool> = scores.iter().filter_map(|s| s.covered).collect();
    let inside = covered.iter().filter(|c| **c).count();
    let (low, high) = wilson(inside, covered.len());
    text.push_str(&format!(
        "{:44} {inside:4} of {:4}  {:3.0} % ({low:3.0} … {high:3.0})\n",
        "parameter inside its 90 % interval",
        covered.len(),
        percent(inside, covered.len())
    ));
    text.push_str(&reliability(scores));
    text
}

/// Stated probability of the first effect against how often it was there, over all trials that named one.
fn reliability(scores: &[Score]) -> String {
    let mut text = String::new();
    for bin in bins(scores) {
        let name =
            format!("stated probability {:.2} … {:.2}: first is there", bin.range.0, bin.range.1.min(1.0));
        text.push_str(&format!(
            "{name:44} {:4} of {:4}  {:3.0} %, stated {:3.0} %\n",
            bin.there,
            bin.of,
            percent(bin.there, bin.of),
            100.0 * bin.stated
        ));
    }
    text
}

fn percent(part: usize, of: usize) -> f64 {
    100.0 * part as f64 / of.max(1) as f64
}

/// 90 % interval of a share, %.
fn wilson(part: usize, of: usize) -> (f64, f64) {
    if of == 0 {
        return (0.0, 100.0);
    }
    let (n, p, z) = (of as f64, part as f64 / of as f64, 1.645);
    let middle = p + z * z / (2.0 * n);
    let half = z * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
    let scale = 100.0 / (1.0 + z * z / n);
    (scale * (middle - half), scale * (middle + half))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_wilson_interval() {
        // Half of 100 at z = 1.645: 50 ± 8.1 %.
        let (low, high) = wilson(50, 100);
        assert!((low - 41.9).abs() < 0.1 && (high - 58.1).abs() < 0.1, "{low} {high}");
    }
}
