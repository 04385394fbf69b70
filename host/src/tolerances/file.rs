//! The file of tolerances: tables and keys as in crossing.toml, values in `"5 %"` of the entry or in its own unit.

use std::path::{Path, PathBuf};

use toml::Value;

use crate::analysis::Tolerance;
use crate::recording::files::{quoted, toml_table};
use crate::recording::{Crossing, RecordingError};

/// Tolerances of usual size, to begin with: the text of a file.
pub const USUAL: &str = include_str!("usual.toml");

/// Tolerances that cannot be used.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum ToleranceError {
    #[error(transparent)]
    Toml(Box<RecordingError>),

    #[error(
        "{file}: states no tolerance; `cpcm analyse SITE --out DIR --tolerances` writes a tolerances.toml to begin with"
    )]
    Empty { file: PathBuf },

    #[error("{file}: `{entry}` is no measured number of crossing.toml; remove it, or correct its name")]
    Entry { file: PathBuf, entry: String },

    #[error(
        "{file}: `{entry}` = {value} is no tolerance; write a number above zero in the unit of the entry, or \"5 %\" of it"
    )]
    Value { file: PathBuf, entry: String, value: String },

    #[error("{file}: {}", of_nothing(entries))]
    OfNothing { file: PathBuf, entries: Vec<String> },

    #[error(
        "{file}: no panel can have `{entry}` = {value} either less or more {plus_minus}; is the tolerance in the unit of the entry?"
    )]
    Impossible { file: PathBuf, entry: String, value: f64, plus_minus: f64, source: Box<RecordingError> },
}

/// What is wrong with per cent of entries that are 0.
pub fn of_nothing(entries: &[String]) -> String {
    let entries: Vec<String> = entries.iter().map(|e| format!("`{e}`")).collect();
    format!(
        "{} is 0 in crossing.toml, of which per cent are nothing; write a number in the unit of the entry",
        entries.join(", ")
    )
}

/// Tolerances of the entries of `crossing` as the text of a file states them, and the entries of which it states per cent that are 0, as
/// usual tolerances may: these count as right. `file` is for messages.
pub fn tolerances_of(
    file: &Path,
    text: &str,
    crossing: &Crossing,
) -> Result<(Vec<Tolerance>, Vec<String>), ToleranceError> {
    let table = toml_table(file, text).map_err(|e| ToleranceError::Toml(Box::new(e)))?;
    let (mut tolerances, mut nothing) = (Vec::new(), Vec::new());
    for (section, entries) in &table {
        let Value::Table(entries) = entries else {
            return Err(ToleranceError::Entry { file: file.into(), entry: quoted(section) });
        };
        for (key, value) in entries {
            let tolerance = tolerance(file, format!("{section}.{key}"), value, crossing)?;
            match tolerance.plus_minus > 0.0 {
                true => tolerances.push(tolerance),
                false => nothing.push(tolerance.entry),
            }
        }
    }
    match (tolerances.is_empty(), nothing.is_empty()) {
        (true, true) => Err(ToleranceError::Empty { file: file.into() }),
        (true, false) => Err(ToleranceError::OfNothing { file: file.into(), entries: nothing }),
        _ => Ok((tolerances, nothing)),
    }
}

/// Per cent of an entry that is 0 are 0. Refused is what is impossible either way; one way a sensor may be beyond the end of the sleeper.
fn tolerance(
    file: &Path,
    entry: String,
    stated: &Value,
    crossing: &Crossing,
) -> Result<Tolerance, ToleranceError> {
    let file = || PathBuf::from(file);
    let Some(value) = crossing.number(&entry) else {
        return Err(ToleranceError::Entry { file: file(), entry: quoted(&entry) });
    };
    let (stated_size, unit) = match stated {
        Value::Float(number) => (*number, 1.0),
        Value::Integer(number) => (*number as f64, 1.0),
        Value::String(text) => (percent(text).unwrap_or(f64::NAN), value.abs()),
        _ => (f64::NAN, 1.0),
    };
    let plus_minus = stated_size * unit;
    if !(stated_size > 0.0 && plus_minus.is_finite()) {
        return Err(ToleranceError::Value { file: file(), entry, value: quoted(&stated.to_string()) });
    }
    match [-plus_minus, plus_minus].map(|by| crossing.with_number(&entry, value + by)) {
        [Err(source), Err(_)] => Err(ToleranceError::Impossible {
            file: file(),
            entry,
            value,
            plus_minus,
            source: Box::new(source),
        }),
        _ => Ok(Tolerance { entry, value, plus_minus }),
    }
}

/// `5 %`, as a share.
fn percent(text: &str) -> Option<f64> {
    text.trim().strip_suffix('%')?.trim_end().parse::<f64>().ok().map(|percent| 1e-2 * percent)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::recording::read_site;

    fn crossing() -> Crossing {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field/reference-1");
        read_site(&dir).unwrap().crossing
    }

    fn read(text: &str) -> Result<Vec<Tolerance>, ToleranceError> {
        tolerances_of(Path::new("t.toml"), text, &crossing()).map(|(tolerances, _)| tolerances)
    }

    #[test]
    fn analytic_percent_and_units() {
        let of = |text: &str| read(text).unwrap().iter().map(|t| t.plus_minus).collect::<Vec<_>>();
        assert_eq!(of("[sensor]\ny_m = 0.05"), [0.05]);
        assert_eq!(of("[ballast]\ndamping_ns_m2 = 25_000"), [25e3]);
        // 40 % of 125 kNs/m², 10 % of -1.5 m.
        assert_eq!(of("[ballast]\ndamping_ns_m2 = \"40 %\""), [50e3]);
        assert!((of("[rail]\ncrossing_part_x0_m = \"10%\"")[0] - 0.15).abs() < 1e-12);
    }

    #[test]
    fn property_usual_tolerances_are_of_entries_of_the_file() {
        assert_eq!(read(USUAL).unwrap().len(), 21);
    }

    #[test]
    fn property_faults_are_named() {
        for (text, word) in [
            ("", "states no tolerance"),
            ("[rail]", "states no tolerance"),
            ("rail", "not valid TOML"),
            ("y_m = 0.05", "`y_m` is no measured number"),
            ("[sensor]\nx_m = 0.05", "`sensor.x_m` is no measured number"),
            ("[track]\nn_sleepers = 2", "`track.n_sleepers` is no measured number"),
            ("[sensor]\ny_m = 0", "`sensor.y_m` = 0 is no tolerance"),
            ("[sensor]\ny_m = nan", "is no tolerance"),
            ("[sensor]\ny_m = inf", "is no tolerance"),
            ("[sensor]\ny_m = \"5\"", "is no tolerance"),
            ("[sensor]\ny_m = \"-5 %\"", "is no tolerance"),
            ("[sensor]\ny_m = [5]", "is no tolerance"),
            ("[sensor]\ny_m = 50", "in the unit of the entry?"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.starts_with("t.toml: ") && error.contains(word), "{text}: {error}");
        }
    }

    /// Usual tolerances were refused for a panel whose pads are described without damping.
    #[test]
    fn regress_per_cent_of_nothing_count_as_right() {
        let mut crossing = crossing();
        crossing.pad.damping_ns_m = 0.0;
        let of = |text: &str| tolerances_of(Path::new("t.toml"), text, &crossing);
        let (tolerances, nothing) = of(USUAL).unwrap();
        assert_eq!((tolerances.len(), nothing), (20, vec!["pad.damping_ns_m".to_string()]));
        assert!(tolerances.iter().all(|t| t.entry != "pad.damping_ns_m"));
        assert_eq!(of("[pad]\ndamping_ns_m = 5e3").unwrap().0[0].plus_minus, 5e3);
        let error = of("[pad]\ndamping_ns_m = \"5 %\"").unwrap_err().to_string();
        assert!(error.starts_with("t.toml: `pad.damping_ns_m` is 0 in crossing.toml"), "{error}");
    }

    proptest! {
        #[test]
        fn property_any_text_is_read_or_refused(text in "[\\[\\]a-z_.=\"% 0-9\n-]{0,80}") {
            let _ = read(&text);
        }
    }
}
