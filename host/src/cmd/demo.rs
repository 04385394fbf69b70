//! `cpcm demo`

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;
use cpcm_shared::record::Record;
use serde_json::json;

use super::analyse::summary;
use super::output::{print, print_json, warn_skipped};
use super::progress::Bar;
use crate::analysis::Analysis;
use crate::identify::identify;
use crate::pipeline;
use crate::recording::files::{create_dir, write_atomic};
use crate::recording::read_site;
use crate::recording::truth::{Side, Truth, read_truth};
use crate::report::text::{PeakComparison, peak_summary, peak_table};
use crate::results::write_results;
use crate::scoring::true_peak_n;

/// Show the whole chain on a recorded crossing: calibrate, make a kernel, run the node, report
///
/// Needs no data and no arguments: the recordings of one crossing with known forces are part of the program. They
/// are written to DIR/site, the results beside them.
#[derive(Args)]
#[command(after_help = "Example:\n  cpcm demo --out demo")]
pub(super) struct DemoArgs {
    /// Directory for recordings and results; created when missing
    #[arg(long, value_name = "DIR", default_value = "cpcm-demo")]
    out: PathBuf,
    /// Print the condition and the peaks, beside the true ones, as JSON
    #[arg(long)]
    json: bool,
}

/// The recordings that come with the program.
macro_rules! shipped {
    ($($file:literal),+) => {
        [$(($file, include_bytes!(concat!("../../../tests/data/field/reference-1/", $file)) as &[u8])),+]
    };
}
const SITE: [(&str, &[u8]); 5] =
    shipped!["crossing.toml", "passages.parquet", "irregularity.csv", "truth.parquet", "truth.toml"];

impl DemoArgs {
    pub(super) fn run(self) -> anyhow::Result<()> {
        let site_dir = self.out.join("site");
        unpack(&site_dir)?;
        let site = read_site(&site_dir).context("cannot read the recordings of the demo")?;
        warn_skipped(&site.skipped);
        let bar = Bar::new();
        let identified = identify(&site, &bar).context("cannot calibrate the demo site")?;
        let analysis = pipeline::evaluate(&identified, &bar).context("cannot analyse the demo site")?;
        let package = pipeline::package(&identified, &bar).context("cannot make the kernel package")?.bytes;
        write_atomic(&self.out.join("kernel.bin"), &package)?;
        let records =
            crate::node_sim::records(&site, &package, &bar).context("cannot run the simulated node")?;
        write_results(&self.out, &analysis)?;
        drop(bar);
        let truth = read_truth(&site_dir).context("cannot read the true forces of the demo")?;
        let rows = compare(&analysis, &records, &truth);
        self.report(&analysis, &rows)
    }

    fn report(&self, analysis: &Analysis, rows: &[PeakComparison]) -> anyhow::Result<()> {
        let table = peak_table(rows);
        write_atomic(&self.out.join("peaks.txt"), table.as_bytes())?;
        let page = self.out.join("report.html");
        if self.json {
            return print_json(&json!({
                "site": analysis.crossing.name,
                "condition": analysis.indicators.condition,
                "report": page.display().to_string(),
                "peaks": rows.iter().map(row_json).collect::<Vec<_>>(),
            }));
        }
        let (summary, peaks) = (summary(analysis), peak_summary(rows));
        print(&format!("{table}\n{peaks}\n{summary}\nreport: {}\n", page.display()))
    }
}

fn unpack(dir: &Path) -> anyhow::Result<()> {
    let others = |(name, bytes): &(&str, &[u8])| {
        let file = dir.join(name);
        file.exists() && std::fs::read(file).map_or(true, |there| there != *bytes)
    };
    let index = dir.join("passages.csv");
    if index.exists() {
        bail!("{} is there, which the demo does not use; name a new directory with --out", index.display());
    }
    if let Some((name, _)) = SITE.iter().find(|file| others(file)) {
        bail!(
            "{} already holds another {name}, which the demo would replace; name a new directory with --out",
            dir.display()
        );
    }
    create_dir(dir)?;
    for (name, bytes) in SITE {
        write_atomic(&dir.join(name), bytes)?;
    }
    Ok(())
}

/// Peaks of host, node and truth side by side. The node writes one record per passage, in the order of the site.
fn compare(analysis: &Analysis, records: &[Record], truth: &Truth) -> Vec<PeakComparison> {
    let true_peaks: HashMap<(i32, usize), f64> = truth
        .wheels
        .iter()
        .filter(|w| w.side == Side::Crossing)
        .map(|w| ((w.passage_id, w.wheelset), true_peak_n(w, analysis)))
        .collect();
    let mut rows = Vec::new();
    for (i, p) in analysis.passages.iter().enumerate() {
        for w in &p.wheelsets {
            let node = records.get(i).and_then(|r| r.wheelsets.get(w.wheelset));
            rows.push(PeakComparison {
                passage_id: p.passage_id,
                wheelset: w.wheelset,
                host_n: w.peak_force_n,
                node_n: node.map(|n| f64::from(n.peak_force_n)),
                truth_n: true_peaks.get(&(p.passage_id, w.wheelset)).copied(),
            });
        }
    }
    rows
}

fn row_json(row: &PeakComparison) -> serde_json::Value {
    json!({ "passage_id": row.passage_id, "wheelset": row.wheelset, "host_n": row.host_n.value,
            "host_lower_n": row.host_n.lower, "host_upper_n": row.host_n.upper, "node_n": row.node_n,
            "truth_n": row.truth_n })
}
