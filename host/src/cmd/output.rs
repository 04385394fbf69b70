//! What the subcommands print.

use std::io::{ErrorKind, Write};
use std::path::PathBuf;

use anyhow::Context;
use clap::Args;

use super::progress::Bar;
use crate::gap::corrected::{Purpose, corrected};
use crate::gap::included::{Diagnosed, Included, read_effects, taken};
use crate::recording::{Site, Skipped};
use crate::report::diagnosis::significant;

/// Prints to standard output. A reader that has gone away (`cpcm … | head`) is no failure.
pub(super) fn print(text: &str) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(error.into()),
        _ => Ok(()),
    }
}

/// Prints a value as JSON.
pub(super) fn print_json(value: &serde_json::Value) -> anyhow::Result<()> {
    print(&format!("{value:#}\n"))
}

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
        let diagnosed = read_effects(file).context("cannot read the effects to include")?;
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

/// Lists the passages that were left out, on standard error.
pub(super) fn warn_skipped(skipped: &[Skipped]) {
    for s in skipped {
        let id = s.passage_id.map_or("unknown".into(), |id| id.to_string());
        complain(&format!("warning: passage {id} is left out: {}\n", s.reason));
    }
}

/// One warning on standard error.
pub(super) fn warn(what: &str) {
    complain(&format!("warning: {what}\n"));
}

/// An error and its causes, outermost first.
pub(super) fn print_error(error: &anyhow::Error) {
    let mut text = format!("error: {error}\n");
    for cause in error.chain().skip(1) {
        text.push_str(&format!("  because: {cause}\n"));
    }
    complain(&text);
}

/// Standard error may be closed too; there is nowhere left to say so.
fn complain(text: &str) {
    let _ = std::io::stderr().lock().write_all(text.as_bytes());
}
