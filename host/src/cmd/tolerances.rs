//! `--tolerances` of `cpcm analyse`.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Args;

use super::output::warn;
use super::progress::Bar;
use crate::analysis::{Analysis, Budget, Consequence, Tolerance};
use crate::recording::files::read_text;
use crate::recording::{Crossing, Site};
use crate::results::TOLERANCES_FILE;
use crate::tolerances::{USUAL, budget, of_nothing, tolerances_of};

/// Entries that the terminal names.
const NAMED: usize = 3;

/// Whether to follow what crossing.toml may be wrong by.
#[derive(Args)]
pub(super) struct Tolerances {
    /// Say how far the results follow what crossing.toml may be wrong by: as FILE has it [default: DIR/tolerances.toml, or usual ones; where
    /// DIR has none, those used are left there, to be changed]. Takes a hundred analyses, some five minutes for 24 passages on two cores
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true)]
    tolerances: Option<Option<PathBuf>>,
}

/// Tolerances and the text that states them.
pub(super) struct Stated {
    tolerances: Vec<Tolerance>,
    text: String,
}

impl Tolerances {
    /// Those of a site, if they are asked for. `dir`: where its results go.
    pub(super) fn of(&self, crossing: &Crossing, dir: &Path) -> anyhow::Result<Option<Stated>> {
        let Some(file) = &self.tolerances else { return Ok(None) };
        let own = dir.join(TOLERANCES_FILE);
        let (file, text) = match file.as_ref().or(own.exists().then_some(&own)) {
            Some(file) => (file.as_path(), read_text(file).context("cannot read the tolerances")?),
            None => (Path::new("the usual tolerances"), USUAL.to_string()),
        };
        let (tolerances, nothing) =
            tolerances_of(file, &text, crossing).context("cannot use the tolerances")?;
        if !nothing.is_empty() {
            warn(&format!("{}: {}; until then it counts as right", file.display(), of_nothing(&nothing)));
        }
        if read_text(&own).is_ok_and(|kept| kept != text) {
            warn(&format!(
                "{} is another file than {} and stays as it is: tolerances.csv holds what these results are of",
                own.display(),
                file.display()
            ));
        }
        Ok(Some(Stated { tolerances, text }))
    }
}

impl Stated {
    /// What follows of them, unless there is nothing for it to follow in.
    pub(super) fn followed(&self, site: &Site, analysis: &Analysis) -> Option<Budget> {
        if !analysis.means_something() {
            warn("tolerances are not followed: as crossing.toml is, the results mean nothing");
            return None;
        }
        let of = (self.tolerances.as_slice(), self.text.as_str());
        Some(budget(site, analysis, of, &Bar::new()))
    }
}

/// What follows, for the terminal: lines that begin with a line feed.
pub(super) fn summary(analysis: &Analysis) -> String {
    let Some(budget) = &analysis.budget else { return String::new() };
    let total = budget.total();
    let [lower, upper] = budget.peak_force_n(&analysis.indicators.peak_force_n).map(|f| 1e-3 * f);
    let name = |c: &Consequence| format!("{} (±{:.1} %)", c.tolerance.entry, 100.0 * c.size().force_peak);
    let first: Vec<String> = budget.consequences.iter().take(NAMED).map(name).collect();
    format!(
        "\ntolerances    what crossing.toml may be wrong by alone: force peak ±{:.1} %, irregularity ±{:.1} %, ballast ±{:.0} % under the\n\
         \x20             crossing, ±{:.0} % elsewhere; with its interval the mean force peak is {lower:.1} … {upper:.1} kN\n\
         \x20             most of the force peak's: {}",
        100.0 * total.force_peak,
        100.0 * total.irregularity_rms,
        100.0 * total.p2,
        100.0 * total.p1,
        first.join(", ")
    )
}
