//! `cpcm analyse`

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;

use super::output::{print, warn, warn_skipped};
use super::progress::Bar;
use super::tolerances::{self, Tolerances};
use super::with_effects::Effects;
use crate::analysis::{Analysis, Condition, DampingEstimate};
use crate::gap::corrected::Purpose;
use crate::limits::{MODEL_GAP, OTHER_DIRECTION, UNLIKE_DESCRIPTION, UNLIKE_MODEL};
use crate::pipeline::{self, AnalyseOptions};
use crate::recording::files::check_dir;
use crate::recording::{TrafficDirection, read_site};
use crate::results::{summary_json, write_results};

/// Analyse the recordings of one crossing: ballast, contact forces, irregularity, condition
///
/// Reads a site directory (crossing.toml and passages.parquet, or passages.csv with passages/*.csv) and writes
/// forces.parquet, ballast.csv, indicators.json, modes.csv, mean_irregularity.csv and report.html; with --tolerances
/// tolerances.csv and tolerances.toml.
#[derive(Args)]
#[command(after_help = "Example:\n  cpcm analyse tests/data/field/reference-1 --out results")]
pub(super) struct AnalyseArgs {
    /// Site directory
    site: PathBuf,
    /// Directory for the results; created when missing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    effects: Effects,
    #[command(flatten)]
    tolerances: Tolerances,
    /// Print the summary as JSON (the content of indicators.json)
    #[arg(long)]
    json: bool,
}

impl AnalyseArgs {
    pub(super) fn run(self) -> anyhow::Result<()> {
        let site =
            read_site(&self.site).with_context(|| format!("cannot read site {}", self.site.display()))?;
        warn_skipped(&site.skipped);
        check_dir(&self.out)?;
        let read = site.skipped.len();
        let (site, included) = self.effects.included_in(site, Purpose::Analysis)?;
        warn_skipped(&site.skipped[read..]);
        let tolerances = self.tolerances.of(&site.crossing, &self.out)?;
        let mut analysis = pipeline::analyse(&site, &AnalyseOptions::default(), &Bar::new())
            .with_context(|| format!("cannot analyse site {}", self.site.display()))?;
        analysis.effects_included = included;
        if let Some(stated) = tolerances {
            analysis.budget = stated.followed(&site, &analysis);
        }
        write_results(&self.out, &analysis)
            .with_context(|| format!("cannot write results to {}", self.out.display()))?;
        warn_unexplained(&analysis);
        if self.json {
            return print(&summary_json(&analysis));
        }
        print(&format!("{}\nreport: {}\n", summary(&analysis), self.out.join("report.html").display()))
    }
}

/// Says on standard error what the model does not explain.
fn warn_unexplained(analysis: &Analysis) {
    let flagged = |flag: &str| -> Vec<String> {
        let flagged = analysis.passages.iter().filter(|p| p.has_flag(flag));
        flagged.map(|p| p.passage_id.to_string()).collect()
    };
    let other_way = flagged(OTHER_DIRECTION);
    warn_of_other_way(&other_way, analysis.crossing.traffic_direction);
    let (mut unlike, all) = (flagged(UNLIKE_MODEL), analysis.passages.len() - other_way.len());
    unlike.retain(|id| !other_way.contains(id));
    if !unlike.is_empty() {
        let what = match unlike.len() < all {
            true => format!("passages {} are left out of ballast and indicators", unlike.join(", ")),
            false => "ballast, forces and irregularity mean nothing".into(),
        };
        warn(&format!(
            "the model does not explain {} of {all} recordings (flag {UNLIKE_MODEL}): {what}; look at them in the report for spikes, \
             gaps, drift, interference, a wheel flat or another train",
            unlike.len()
        ));
    }
    if let Some(misdescription) = &analysis.misdescription {
        warn(&format!(
            "the recordings contradict crossing.toml (flag {UNLIKE_DESCRIPTION}): {misdescription}; forces and irregularity mean nothing \
             until it is corrected"
        ));
        return;
    }
    if unlike.len() == all {
        return;
    }
    warn_of_damping(&analysis.ballast.damping);
    if !flagged(MODEL_GAP).is_empty() {
        warn(&format!(
            "the calibrated model leaves more than three times the noise of quiet track (flag {MODEL_GAP}): something acts that it does \
             not hold, and forces may be wrong by more than their intervals; `cpcm diagnose` may say what"
        ));
    }
}

/// Says on standard error which passages run in the other direction than the panel is described for.
pub(super) fn warn_of_other_way(passages: &[String], described: TrafficDirection) {
    if passages.is_empty() {
        return;
    }
    let other = described.reversed();
    warn(&format!(
        "passages {} run {other}, not {described} (flag {OTHER_DIRECTION}) and are left out; for them, take a copy of the site with \
         traffic_direction = \"{other}\" in crossing.toml",
        passages.join(", ")
    ));
}

/// Says on standard error that crossing.toml states another damping than recordings speak for.
pub(super) fn warn_of_damping(damping: &DampingEstimate) {
    if !damping.contradicts_description() {
        return;
    }
    let recorded = damping.recorded_ns_m2;
    let [described, value, lower, upper] =
        [damping.described_ns_m2, recorded.value, recorded.lower, recorded.upper].map(|d| 1e-3 * d);
    warn(&format!(
        "the recordings contradict the damping of the ballast in crossing.toml, {described:.0} kNs/m² per metre of sleeper: they speak for \
         {value:.0} (90 %, all else being right: {lower:.0} … {upper:.0}), which is used; correct ballast.damping_ns_m2, or what else may be wrong: \
         where the crossing part begins and ends, its stiffness, the sleepers. Until then intervals are wider"
    ));
}

/// Condition, action and the numbers behind them, for the terminal.
pub(super) fn summary(analysis: &Analysis) -> String {
    let i = &analysis.indicators;
    let condition = match i.condition {
        Condition::Healthy => "healthy",
        Condition::Watch => "watch",
        Condition::Damaged => "damaged",
    };
    let (used, left_out) = analysis.used_and_left_out();
    let (f, r, b) = (i.peak_force_n, i.irregularity_rms_m, &analysis.ballast);
    let damping = match b.damping.contradicts_description() {
        true => {
            format!("\n              damping {:.0} kNs/m² per metre of sleeper", 1e-3 * b.damping.used_ns_m2)
        }
        false => String::new(),
    };
    let included: String = analysis.effects_included.iter().map(|e| format!("\nincluded      {e}")).collect();
    format!(
        "site          {}\ncondition     {condition}\nurgency       {}\naction        {}\n\
         force peak    {:.1} kN in the mean (90 %: {:.1} … {:.1}), threshold {:.0}\n\
         \x20             {:.0} … {:.0} kN in the middle 80 % of the wheels\n\
         irregularity  {:.0} µm RMS in the mean (90 %: {:.0} … {:.0}), threshold {:.0}\n\
         \x20             {:.0} … {:.0} µm in the middle 80 % of the wheels\n\
         ballast       {:.1} MN/m² under the crossing (90 %: {:.1} … {:.1}), {:.1} elsewhere{damping}\n\
         passages      {} used, {} left out{}{included}",
        analysis.crossing.name,
        i.urgency,
        i.recommended_action,
        1e-3 * f.mean,
        1e-3 * f.mean90[0],
        1e-3 * f.mean90[1],
        1e-3 * f.threshold,
        1e-3 * f.p10,
        1e-3 * f.p90,
        1e6 * r.mean,
        1e6 * r.mean90[0],
        1e6 * r.mean90[1],
        1e6 * r.threshold,
        1e6 * r.p10,
        1e6 * r.p90,
        1e-6 * b.p2_n_m2.value,
        1e-6 * b.p2_n_m2.lower,
        1e-6 * b.p2_n_m2.upper,
        1e-6 * b.p1_n_m2.value,
        used,
        left_out,
        tolerances::summary(analysis),
    )
}
