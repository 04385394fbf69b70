//! `cpcm diagnose`

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use clap::builder::PossibleValuesParser;

use super::output::{print, print_json, warn_skipped};
use super::progress::Bar;
use crate::gap::consequences::{Consequences, consequences};
use crate::gap::diagnosis::{DiagnoseOptions, Diagnosis, diagnose};
use crate::gap::effect::Stated;
use crate::gap::effects::names;
use crate::gap::hammer::{BAND_HZ, Hammer};
use crate::gap::receptance::read_receptance;
use crate::gap::results::{diagnosis_json, write_diagnosis};
use crate::recording::files::check_dir;
use crate::recording::read_site;
use crate::report::diagnosis::{closed_in_words, gap_in_words, sentence, significant};

/// Say why recordings and simulation of a crossing differ: where, which effect, and how far the gap shrinks with it
///
/// Reads a site directory and writes diagnosis.json, predictions.parquet and diagnosis.html. Needs crossing.toml and
/// recordings; a laser scan, several trains, speeds, loads and temperatures make it better, and the page says which of
/// them is missing.
#[derive(Args)]
#[command(after_help = "Example:\n  cpcm diagnose tests/data/field/known-voided-sleepers --out diagnosis")]
pub(super) struct DiagnoseArgs {
    /// Site directory
    site: PathBuf,
    /// Directory for the results; created when missing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Say where the gap is, not which effect makes it
    #[arg(long)]
    quick: bool,
    /// Leave an effect out of the catalogue; may be given more than once
    #[arg(long = "exclude", value_name = "EFFECT", conflicts_with = "quick", value_parser = PossibleValuesParser::new(names()))]
    exclude: Vec<String>,
    /// Measured receptance of the track: hits on the head of the crossing rail, read by the site's sensor. One CSV file per hit
    /// (time_s,force_n,acceleration_m_s2), an estimate (frequency_hz,real_m_n,imaginary_m_n,coherence), or a universal file
    /// (.uff, .unv, dataset 58); may be given more than once
    #[arg(long = "hammer", value_name = "FILE")]
    hammer: Vec<PathBuf>,
    /// Place x of the hits, metres from the nose [default: above the sensor's sleeper]
    #[arg(long, value_name = "METRES", requires = "hammer", allow_negative_numbers = true)]
    hammer_x: Option<f64>,
    /// Also analyse the site without and with the effects found, and say what they change in force peaks, irregularity and
    /// ballast
    #[arg(long, conflicts_with = "quick")]
    consequences: bool,
    /// Print diagnosis.json
    #[arg(long)]
    json: bool,
}

impl DiagnoseArgs {
    pub(super) fn run(self) -> anyhow::Result<()> {
        let site =
            read_site(&self.site).with_context(|| format!("cannot read site {}", self.site.display()))?;
        warn_skipped(&site.skipped);
        check_dir(&self.out)?;
        let x_m = self.hammer_x.unwrap_or_else(|| site.crossing.sensor_x_m());
        let hammer = (!self.hammer.is_empty()).then(|| read_hammer(&self.hammer, x_m)).transpose()?;
        let options = DiagnoseOptions { quick: self.quick, exclude: self.exclude, hammer };
        let mut found = diagnose(&site, &options, &Bar::new())
            .with_context(|| format!("cannot diagnose site {}", self.site.display()))?;
        if self.consequences && !found.effects.is_empty() {
            match consequences(&site, &found, &Bar::new()) {
                Ok(c) => found.consequences = Some(c),
                // The diagnosis stands without them.
                Err(e) => found.remarks.push(format!("consequences: {e}")),
            }
        }
        write_diagnosis(&self.out, &site.crossing.name, &found)
            .with_context(|| format!("cannot write results to {}", self.out.display()))?;
        if self.json {
            return print_json(&diagnosis_json(&site.crossing.name, &found));
        }
        print(&format!("{}report: {}\n", summary(&found), self.out.join("diagnosis.html").display()))
    }
}

fn read_hammer(files: &[PathBuf], x_m: f64) -> anyhow::Result<Hammer> {
    let receptance = read_receptance(files, BAND_HZ[1]).context("cannot use the hammer's hits")?;
    Hammer::new(&receptance, x_m).context("cannot use the hammer's hits")
}

fn in_words((name, value, lower, upper): &Stated) -> String {
    let [value, lower, upper] = [value, lower, upper].map(|v| significant(*v));
    format!("{name} {value} (90 %: {lower} … {upper})")
}

fn summary(d: &Diagnosis) -> String {
    let closed = closed_in_words(d).map_or(",".into(), |c| format!("\nclosed        {c}"));
    let mut text = format!(
        "{}\ngap           {}{closed} on {} held-out passages\n",
        sentence(d),
        gap_in_words(d),
        d.predictions.len()
    );
    for e in &d.effects {
        text.push_str(&format!(
            "effect        {}: {} (probability {:.2})\n",
            e.name,
            e.meaning(),
            e.probability
        ));
        for size in &e.parameters {
            text.push_str(&format!("              {}\n", in_words(size)));
        }
        for same in &e.indistinguishable_from {
            text.push_str(&format!("              cannot be told from: {same}\n"));
            for size in e.alternative(same).into_iter().flat_map(|a| &a.parameters) {
                text.push_str(&format!("                {}\n", in_words(size)));
            }
        }
    }
    for e in &d.effects {
        if let Some(action) = d.recommended_action(e) {
            text.push_str(&format!("action        {action}\n"));
        }
    }
    for (name, change) in d.consequences.iter().flat_map(Consequences::rows) {
        text.push_str(&format!(
            "with effects  {name}: {:.1} instead of {:.1}\n",
            change.with, change.without
        ));
    }
    for r in &d.remarks {
        text.push_str(&format!("note          {r}\n"));
    }
    text
}
