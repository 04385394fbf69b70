//! Figures of the studies, as SVG files of their own.

mod lowpass;
mod samples;
mod simulation;

pub use lowpass::figures as lowpass;
pub use samples::figures as samples;
pub use simulation::{figures as simulation, greens};

/// A figure: name of the file without ending, and the SVG.
pub type NamedSvg = (String, String);

/// A table as Markdown, title and note included.
pub fn markdown(table: &crate::verification::Table) -> String {
    let rows = super::markdown::rows(&table.columns, &table.rows);
    format!("**{}**\n\n{}\n\n{rows}", table.title, table.note)
}
