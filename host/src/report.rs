//! The report: one HTML file that needs nothing else, and tables for the terminal.
//!
//! The page holds no date of its own: the same analysis gives the same bytes.

mod accelerations;
mod ballast;
pub mod diagnosis;
mod displacement;
mod forces;
mod grid;
pub mod growth;
mod headline;
mod indicator;
mod irregularity;
pub(crate) mod markdown;
mod page;
mod peaks;
mod plot;
pub mod study;
mod tables;
pub mod text;
mod tolerances;
mod traces;
pub mod trials;
pub mod verification;

use page::Figure;

use crate::analysis::Analysis;

/// A figure that cannot be drawn.
#[derive(Debug, thiserror::Error)]
#[error("a figure of the report cannot be drawn: {reason}")]
pub struct ReportError {
    reason: String,
}

impl ReportError {
    fn draw(error: impl std::fmt::Display) -> Self {
        ReportError { reason: error.to_string() }
    }
}

/// The report as one HTML document.
pub fn html(analysis: &Analysis) -> Result<String, ReportError> {
    let mut body = headline::html(analysis);
    body.push_str(&tables::skipped(&analysis.skipped));
    body.push_str("<h2>Condition</h2>\n");
    let explained = analysis.of_explained();
    body.push_str(&left_out(analysis.passages.len() - explained.passages.len(), analysis.passages.len()));
    let condition = [
        indicator::figure(&analysis.indicators)?,
        forces::figure(&explained)?,
        peaks::figure(&explained)?,
        irregularity::figure(&explained)?,
    ];
    body.extend(condition.iter().map(Figure::html));
    body.push_str("<h2>Support and measurement</h2>\n");
    let mut support = vec![ballast::figure(analysis)?];
    support.extend(displacement::figures(&analysis.passages, analysis.ballast.misfit)?);
    support.extend(accelerations::figures(&analysis.passages)?);
    body.extend(support.iter().map(Figure::html));
    body.push_str(&tolerances::html(analysis)?);
    body.push_str("<h2>Peaks per wheelset</h2>\n");
    body.push_str(&tables::peaks(analysis));
    body.push_str(&tables::flags(analysis));
    body.push_str(&provenance(analysis));
    Ok(page::document(&format!("{} \u{2013} crossing condition", analysis.crossing.name), &body))
}

fn left_out(passages: usize, all: usize) -> String {
    match passages {
        0 => String::new(),
        _ => format!(
            "<p>Left out of the figures of forces, peaks and irregularity, because theirs mean nothing: {passages} of {all} passages \
             (flags below the table of peaks).</p>\n"
        ),
    }
}

fn provenance(analysis: &Analysis) -> String {
    let ids: Vec<i32> = analysis.passages.iter().map(|p| p.passage_id).collect();
    let range = match (ids.iter().min(), ids.iter().max()) {
        (Some(first), Some(last)) if first != last => {
            format!("{} passages ({first} \u{2026} {last})", ids.len())
        }
        (Some(only), _) => format!("passage {only}"),
        _ => "no passages".into(),
    };
    format!(
        "<footer>cpcm {}. Site {}, {range}, recorded at {:.0} Hz with a range of ±{:.0} m/s². Intervals hold 90 %. Forces \
         and accelerations are low-passed at 250 Hz; vertical quantities are positive downwards; x = 0 is the nose \
         tip, x grows from the wing rail towards the nose. All numbers: forces.parquet, ballast.csv, \
         indicators.json, modes.csv, mean_irregularity.csv.</footer>\n",
        env!("CARGO_PKG_VERSION"),
        page::escape(&analysis.crossing.name),
        analysis.crossing.sensor.sample_rate_hz,
        analysis.crossing.sensor.range_m_s2,
    )
}
