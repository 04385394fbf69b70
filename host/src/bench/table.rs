//! Rows of the comparison.

use serde_json::{Value, json};

use super::child::Usage;

/// One job done by both.
#[derive(Clone, Debug)]
pub struct Row {
    /// What was done.
    pub job: String,
    /// Program beside this one; empty when there is none.
    pub peer: String,
    /// Runs of this program.
    pub ours: Vec<Usage>,
    /// Runs of the other, or why there are none.
    pub theirs: Outcome,
    /// What the row has to reach.
    pub target: Target,
}

/// Runs of the other program.
#[derive(Clone, Debug)]
pub enum Outcome {
    /// It ran.
    Ran(Vec<Usage>),
    /// It did not, and what to do about it.
    NotRun(String),
    /// The job has no other program.
    Alone,
}

/// Bounds of a row; each holds where it is given.
#[derive(Clone, Copy, Debug, Default)]
pub struct Target {
    /// CPU time of the other over ours, at least.
    pub cpu_ratio: Option<f64>,
    /// Our peak memory over the other's, at most.
    pub memory_share: Option<f64>,
    /// Our CPU time, s, at most.
    pub cpu_s: Option<f64>,
    /// Our elapsed time, s, at most.
    pub wall_s: Option<f64>,
}

/// Least value of the runs: other load only adds.
fn least(runs: &[Usage], of: impl Fn(&Usage) -> f64) -> f64 {
    runs.iter().map(of).fold(f64::INFINITY, f64::min)
}

impl Row {
    fn theirs(&self) -> Option<&[Usage]> {
        match &self.theirs {
            Outcome::Ran(runs) if !runs.is_empty() => Some(runs),
            _ => None,
        }
    }

    /// CPU time of the other over ours.
    pub fn cpu_ratio(&self) -> Option<f64> {
        Some(least(self.theirs()?, |u| u.cpu_s) / least(&self.ours, |u| u.cpu_s))
    }

    /// Our peak memory over the other's.
    pub fn memory_share(&self) -> Option<f64> {
        Some(least(&self.ours, |u| u.peak_mib) / least(self.theirs()?, |u| u.peak_mib))
    }

    /// Whether every bound that could be checked holds; `None` when none could.
    pub fn reached(&self) -> Option<bool> {
        let t = &self.target;
        let at_least = |found: Option<f64>, bound: Option<f64>| Some(found? >= bound?);
        let at_most = |found: Option<f64>, bound: Option<f64>| Some(found? <= bound?);
        let checks = [
            at_least(self.cpu_ratio(), t.cpu_ratio),
            at_most(self.memory_share(), t.memory_share),
            at_most(Some(least(&self.ours, |u| u.cpu_s)), t.cpu_s),
            at_most(Some(least(&self.ours, |u| u.wall_s)), t.wall_s),
        ];
        checks.into_iter().flatten().reduce(|a, b| a && b)
    }

    /// For `--json`.
    pub fn json(&self) -> Value {
        let run = |u: &Usage| json!({ "cpu_s": u.cpu_s, "wall_s": u.wall_s, "peak_mib": u.peak_mib, "answer": u.answer });
        let runs = |runs: &[Usage]| runs.iter().map(run).collect::<Vec<Value>>();
        let theirs = match &self.theirs {
            Outcome::Ran(r) => json!(runs(r)),
            Outcome::NotRun(reason) => json!({ "not_run": reason }),
            Outcome::Alone => Value::Null,
        };
        json!({ "job": self.job, "peer": self.peer, "ours": runs(&self.ours), "theirs": theirs,
                "cpu_ratio": self.cpu_ratio(), "memory_share": self.memory_share(), "reached": self.reached() })
    }

    /// Cells of the printed table.
    fn cells(&self) -> [String; 8] {
        let usage = |runs: &[Usage]| {
            let [cpu, wall, peak] =
                [least(runs, |u| u.cpu_s), least(runs, |u| u.wall_s), least(runs, |u| u.peak_mib)];
            (format!("{cpu:.3}"), format!("{wall:.3}"), format!("{peak:.0}"))
        };
        let (cpu, wall, peak) = usage(&self.ours);
        let (their_cpu, their_peak) = match &self.theirs {
            Outcome::Ran(runs) => (usage(runs).0, usage(runs).2),
            Outcome::NotRun(_) => ("not run".into(), "not run".into()),
            Outcome::Alone => ("-".into(), "-".into()),
        };
        let ratio = self.cpu_ratio().map_or("-".into(), |r| format!("{r:.0}"));
        let verdict = match self.reached() {
            Some(true) => "yes",
            Some(false) => "NO",
            None => "not run",
        };
        [
            self.job.clone(),
            cpu,
            wall,
            peak,
            their_cpu,
            their_peak,
            ratio,
            format!("{verdict} ({})", self.bounds()),
        ]
    }

    /// The bounds in words.
    fn bounds(&self) -> String {
        let t = &self.target;
        let words = [
            t.cpu_ratio.map(|b| format!("ratio \u{2265} {b:.0}")),
            t.memory_share.map(|b| format!("memory \u{2264} {b:.2}")),
            t.cpu_s.map(|b| format!("CPU \u{2264} {b} s")),
            t.wall_s.map(|b| format!("elapsed \u{2264} {b} s")),
        ];
        words.into_iter().flatten().collect::<Vec<String>>().join(", ")
    }
}

const CAPTIONS: [&str; 8] =
    ["job", "CPU s", "elapsed s", "MiB", "other: CPU s", "MiB", "CPU ratio", "target reached"];

/// The comparison as a Markdown table, with the answers of both and what was not run.
pub fn markdown(rows: &[Row]) -> String {
    let cells: Vec<Vec<String>> = rows.iter().map(|row| row.cells().to_vec()).collect();
    let mut text = crate::report::markdown::rows(&CAPTIONS, &cells);
    for row in rows {
        if let Some(run) = row.ours.first() {
            text.push_str(&format!("\n{}: {}\n", row.job, run.answer));
        }
        match &row.theirs {
            Outcome::Ran(runs) => {
                let answer = runs.first().map_or("", |u| &u.answer);
                text.push_str(&format!("  {}: {answer}\n", row.peer));
            }
            Outcome::NotRun(reason) => text.push_str(&format!("  {} NOT RUN: {reason}\n", row.peer)),
            Outcome::Alone => {}
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn usage(cpu_s: f64, peak_mib: f64) -> Usage {
        Usage { cpu_s, wall_s: cpu_s, peak_mib, answer: "x".into() }
    }

    #[test]
    fn analytic_ratios_of_the_best_runs_and_bounds() {
        let target = Target { cpu_ratio: Some(50.0), memory_share: Some(0.25), ..Target::default() };
        let mut row = Row {
            job: "job".into(),
            peer: "peer".into(),
            ours: vec![usage(0.2, 40.0), usage(0.1, 50.0)],
            theirs: Outcome::Ran(vec![usage(9.0, 200.0), usage(8.0, 400.0)]),
            target,
        };
        assert!((row.cpu_ratio().unwrap() - 80.0).abs() < 1e-9);
        assert!((row.memory_share().unwrap() - 0.2).abs() < 1e-12);
        assert_eq!(row.reached(), Some(true));
        row.theirs = Outcome::NotRun("install it".into());
        assert_eq!(row.reached(), None);
        assert!(markdown(&[row]).contains("peer NOT RUN: install it"));
    }
}
