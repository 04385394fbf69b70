//! The files that `analyse` leaves behind, each complete or absent.
//!
//! | file | content |
//! |---|---|
//! | `forces.parquet` | one row per passage and wheelset |
//! | `ballast.csv` | one row per sleeper |
//! | `indicators.json` | condition, urgency, action |
//! | `modes.csv` | first SVD modes that `indicators.json` refers to |
//! | `mean_irregularity.csv` | mean irregularity of all wheels with its 90 % interval |
//! | `tolerances.csv`, `tolerances.toml` | how far results follow what crossing.toml may be wrong by, where that was asked for |
//! | `report.html` | all of it for people ([`crate::report`]) |

mod forces;
mod indicators;
mod tolerances;

use std::path::Path;

pub use forces::{ForceRow, read_forces};
pub use tolerances::TOLERANCES_FILE;

use crate::analysis::Analysis;
use crate::recording::RecordingError;
use crate::recording::files::{create_dir, write_atomic};
use crate::report::{self, ReportError};

/// Results that cannot be written.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum ResultsError {
    #[error(transparent)]
    File(#[from] RecordingError),

    #[error(
        "passage {passage_id}, wheelset {wheelset}: {found} values of {column} on {expected} positions; this is \
         a fault of the program, please report it with the site"
    )]
    Ragged { passage_id: i32, wheelset: usize, column: &'static str, found: usize, expected: usize },

    #[error(transparent)]
    Report(#[from] ReportError),
}

/// Writes all results into `dir`, which is created when it does not exist.
pub fn write_results(dir: &Path, analysis: &Analysis) -> Result<(), ResultsError> {
    create_dir(dir)?;
    forces::write_forces(&dir.join("forces.parquet"), analysis)?;
    write_atomic(&dir.join("ballast.csv"), ballast_csv(analysis).as_bytes())?;
    write_atomic(&dir.join("modes.csv"), indicators::modes_csv(&analysis.indicators).as_bytes())?;
    let mean = indicators::mean_irregularity_csv(&analysis.indicators);
    write_atomic(&dir.join("mean_irregularity.csv"), mean.as_bytes())?;
    tolerances::write(dir, analysis.budget.as_ref())?;
    write_atomic(&dir.join("indicators.json"), indicators::json(analysis).as_bytes())?;
    write_atomic(&dir.join("report.html"), report::html(analysis)?.as_bytes())?;
    Ok(())
}

/// Summary for `--json` on the command line: the same as `indicators.json`.
pub fn summary_json(analysis: &Analysis) -> String {
    indicators::json(analysis)
}

fn ballast_csv(analysis: &Analysis) -> String {
    let mut text = String::from("sleeper,stiffness_n_m2,lower_n_m2,upper_n_m2\n");
    for (sleeper, k) in analysis.ballast.stiffness_n_m2.iter().enumerate() {
        text.push_str(&format!("{sleeper},{},{},{}\n", k.value, k.lower, k.upper));
    }
    text
}
