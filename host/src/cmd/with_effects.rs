//! `--with-effects`, of the subcommands that identify something.

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;

use super::output::warn;
use super::progress::Bar;
use crate::gap::corrected::{Purpose, corrected};
use crate::gap::included::{Diagnosed, Included, read_effects, taken};
use crate::recording::Site;
use crate::report::diagnosis::significant;

/// Which effects are included in an identification.
#[derive(Args)]
pub(super) struct Effects {
    /// Include the effects of a diagnosis.json
    #[arg(long, value_name = "FILE")]
    with_effects: Option<PathBuf>,
    /// Of effects that the recordings cannot tell apart, include this one; may be given more than once [default: the first]
    #[arg(long, value_name = "EFFECT", requires = "with_effects")]
    take: Vec<String>,
}

impl Effects {
    /// The site with the effects taken into account, and these in words, with their sizes.
    pub(super) fn included_in(&self, site: Site, purpose: Purpose) -> anyhow::Result<(Site, Vec<String>)> {
        let Some(file) = &self.with_effects else { return Ok((site, Vec::new())) };
        let (diagnosed, of_site) = read_effects(file).context("cannot read the effects to include")?;
        if let Some(other) = of_site.filter(|name| *name != site.crossing.name) {
            warn(&format!("{} is the diagnosis of {other}, not of {}", file.display(), site.crossing.name));
        }
        let effects = taken(&diagnosed, &self.take)
            .with_context(|| format!("cannot choose among the effects of {}", file.display()))?;
        warn_of_others(&diagnosed, &self.take);
        if purpose == Purpose::Analysis && effects.iter().any(Included::bends_the_bed) {
            warn(
                "recordings are analysed as they would be on a linear bed under the same wheel forces: deflections are smaller than those \
                 recorded, and intervals do not hold what is not known of the bed",
            );
        }
        let site = corrected(&site, &effects, purpose, &Bar::new())
            .context("cannot include the effects of the diagnosis")?;
        Ok((site, effects.iter().map(in_words).collect()))
    }
}

/// Says of effects between which nobody has chosen that there is a choice.
fn warn_of_others(diagnosed: &[Diagnosed], take: &[String]) {
    for d in diagnosed.iter().filter(|d| !d.alternatives.is_empty() && d.chosen(take).is_none()) {
        let others: Vec<String> = d.alternatives.iter().map(|a| format!("--take {}", a.name)).collect();
        warn(&format!(
            "{} is included; another effect would explain the recordings as well ({})",
            d.effect.name,
            others.join(", ")
        ));
    }
}

fn in_words(effect: &Included) -> String {
    let sizes: Vec<String> =
        effect.parameters.iter().map(|(name, value)| format!("{name} {}", significant(*value))).collect();
    if sizes.is_empty() { effect.name.clone() } else { format!("{} ({})", effect.name, sizes.join(", ")) }
}
