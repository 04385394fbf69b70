//! `tolerances.csv` and `tolerances.toml`.

use std::path::Path;

use crate::analysis::{Budget, Outcome};
use crate::recording::RecordingError;
use crate::recording::files::{remove, write_atomic};

const TABLE: &str = "tolerances.csv";
/// The tolerances themselves, which are the user's once they are there.
pub const TOLERANCES_FILE: &str = "tolerances.toml";

/// Writes the table, and the tolerances where there are none. Without a budget a table that an earlier analysis has left goes: it is not of
/// these results.
pub(super) fn write(dir: &Path, budget: Option<&Budget>) -> Result<(), RecordingError> {
    let Some(budget) = budget else { return remove(&dir.join(TABLE)) };
    let stated = dir.join(TOLERANCES_FILE);
    if !stated.exists() {
        write_atomic(&stated, budget.stated.as_bytes())?;
    }
    write_atomic(&dir.join(TABLE), &csv(budget))
}

/// Two rows per tolerance: changes of the results over the results, empty where a small part of the tolerance is noticed.
fn csv(budget: &Budget) -> Vec<u8> {
    let mut table = csv::Writer::from_writer(Vec::new());
    let mut row = |cells: [String; 9]| {
        // Into memory: there is nothing that could fail.
        let _ = table.write_record(cells);
    };
    row([
        "entry",
        "value",
        "plus_minus",
        "changed_to",
        "force_peak",
        "irregularity_rms",
        "p1",
        "p2",
        "noticed",
    ]
    .map(String::from));
    for c in &budget.consequences {
        let t = &c.tolerance;
        for Outcome { by, change, noticed } in [&c.smaller, &c.larger] {
            let cell = |of: Option<f64>| of.map_or(String::new(), |v| v.to_string());
            row([
                t.entry.clone(),
                t.value.to_string(),
                t.plus_minus.to_string(),
                (t.value + by).to_string(),
                cell(change.map(|c| c.force_peak)),
                cell(change.map(|c| c.irregularity_rms)),
                cell(change.map(|c| c.p1)),
                cell(change.map(|c| c.p2)),
                noticed.clone().unwrap_or_default(),
            ]);
        }
    }
    table.into_inner().unwrap_or_default()
}
