//! `cpcm study`

use std::path::PathBuf;

use anyhow::Context;
use clap::{Args, ValueEnum};
use serde_json::json;

use super::output::{print, print_json};
use super::progress::Bar;
use crate::recording::files::{create_dir, write_atomic};
use crate::report::study::{self as draw, NamedSvg};
use crate::report::verification::table_text;
use crate::study::{assumptions, kernels, lowpass, samples, simulation};
use crate::verification::Table;

/// Repeat a study of the paper on simulated panels
///
/// Prints what this program finds beside what the paper says, and writes the same as Markdown with the figures as SVG.
/// lowpass: the wavelength that separates quasi-static from dynamic displacement (eq. 3, fig. 9). crossings: Green's
/// functions, forces and irregularities of six panels (fig. 11, 12, 15 to 21). assumptions: what each costs when broken.
#[derive(Args)]
#[command(after_help = "Example:\n  cpcm study lowpass --out docs/figures")]
pub(super) struct StudyArgs {
    /// Which study
    study: Study,
    /// Directory for tables and figures; created when missing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Print the tables as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Study {
    /// Cut-off of the low-pass of eq. 2
    Lowpass,
    /// Six crossing panels through the whole chain
    Crossings,
    /// Assumptions of the inverse broken one by one
    Assumptions,
}

impl Study {
    fn name(self) -> &'static str {
        match self {
            Study::Lowpass => "lowpass",
            Study::Crossings => "crossings",
            Study::Assumptions => "assumptions",
        }
    }

    fn run(self) -> anyhow::Result<(Vec<Table>, Vec<NamedSvg>)> {
        let bar = Bar::new();
        match self {
            Study::Lowpass => {
                let study = lowpass::run(&bar)?;
                Ok((study.tables(), draw::lowpass(&study)?))
            }
            Study::Crossings => crossings(&bar),
            Study::Assumptions => {
                let all = assumptions::run(&bar)?;
                Ok((vec![assumptions::bogie_table(&all), assumptions::site_table(&all)], Vec::new()))
            }
        }
    }
}

fn crossings(bar: &Bar) -> anyhow::Result<(Vec<Table>, Vec<NamedSvg>)> {
    let greens = kernels::run();
    let bogies = simulation::run(bar)?;
    let sites = samples::run(bar)?;
    let tables = vec![
        kernels::table(&greens),
        simulation::table(&bogies),
        samples::table(&sites),
        samples::indicator_table(&sites),
    ];
    let figures = [draw::greens(&greens)?, draw::simulation(&bogies)?, draw::samples(&sites)?].concat();
    Ok((tables, figures))
}

impl StudyArgs {
    pub(super) fn run(self) -> anyhow::Result<()> {
        let name = self.study.name();
        create_dir(&self.out)?;
        let (tables, figures) = self.study.run().with_context(|| format!("cannot make the study {name}"))?;
        let markdown: Vec<String> = tables.iter().map(draw::markdown).collect();
        write_atomic(&self.out.join(format!("study-{name}.md")), markdown.join("\n").as_bytes())?;
        for (file, svg) in &figures {
            write_atomic(&self.out.join(format!("{file}.svg")), svg.as_bytes())?;
        }
        if self.json {
            let table =
                |t: &Table| json!({ "title": t.title, "note": t.note, "columns": t.columns, "rows": t.rows });
            return print_json(
                &json!({ "study": name, "tables": tables.iter().map(table).collect::<Vec<_>>() }),
            );
        }
        print(&tables.iter().map(table_text).collect::<String>())
    }
}
