//! Effects to include in an identification, with their sizes, as a `diagnosis.json` has them, and what becomes of each.

use std::path::Path;

use serde_json::Value;

use crate::recording::files::read_bytes;
use crate::recording::{RecordingError, Site};

/// An effect with the values of its parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Included {
    /// Name in the contract.
    pub name: String,
    /// Name and value, SI units.
    pub parameters: Vec<(String, f64)>,
}

/// A size that is missing (NaN), or outside physics.
#[derive(Debug, thiserror::Error)]
#[error("effect {effect}: {parameter} is {value}, expected {low} … {high}")]
pub struct OutOfRange {
    /// Name in the contract.
    pub effect: String,
    /// Name of the parameter.
    pub parameter: &'static str,
    /// As read; NaN where it is missing.
    pub value: f64,
    /// Ends of the range.
    pub low: f64,
    /// Ends of the range.
    pub high: f64,
}

impl Included {
    /// A size of the effect, within a range.
    pub fn value(&self, parameter: &'static str, [low, high]: [f64; 2]) -> Result<f64, OutOfRange> {
        let value = self.parameters.iter().find(|(n, _)| n == parameter).map_or(f64::NAN, |p| p.1);
        if value >= low && value <= high {
            return Ok(value);
        }
        Err(OutOfRange { effect: self.name.clone(), parameter, value, low, high })
    }
}

/// What `--with-effects` does with an effect.
#[derive(Clone, Copy)]
pub struct Inclusion {
    /// In the words of whoever wants forces before it is mended; `None` where that is not worth saying.
    pub does: Option<&'static str>,
    /// How it is done.
    pub how: How,
}

/// How an effect is included in the identification, which itself stays linear, with the three-parameter ballast.
#[derive(Clone, Copy)]
pub enum How {
    /// Not at all: the identification estimates what the effect changes anyway.
    Needless,
    /// Description or recordings are corrected.
    Corrected(fn(&mut Site, &Included) -> Result<(), OutOfRange>),
    /// What a sound recorder would have recorded is put in the place of the recordings. A node has a recorder of its own, which is not
    /// corrected.
    Recorded(fn(&mut Site, &Included) -> Result<(), OutOfRange>),
    /// The same of what the recorder adds: by its own clock, and so before that is put right.
    Added(fn(&mut Site, &Included) -> Result<(), OutOfRange>),
    /// Recordings are made those of a linear bed. The effect's main parameter, and what it may be.
    Linearised(&'static str, [f64; 2]),
    /// Its steps are found in each recording, and taken off.
    Steadied,
    /// It cannot be: nothing that the identification starts from would be what it is without the effect. Why.
    Refused(&'static str),
}

impl Inclusion {
    /// Of an effect of which everything that matters is estimated anyway.
    pub const NEEDLESS: Self = Self { does: None, how: How::Needless };

    /// Of an effect for which description or recordings are corrected.
    pub fn corrected(does: &'static str, by: fn(&mut Site, &Included) -> Result<(), OutOfRange>) -> Self {
        Self { does: Some(does), how: How::Corrected(by) }
    }
}

/// What is done where a bed is not linear.
pub const TAKEN_OFF: &str = "Forces: `analyse --with-effects` takes what the bed adds off the recordings.";

/// What a factor on a stiffness, mass or load may be.
pub const FACTOR: [f64; 2] = [0.05, 20.0];

/// An effect that a diagnosis names, and those from which the recordings cannot tell it, in its place.
#[derive(Clone, Debug, PartialEq)]
pub struct Diagnosed {
    /// The one that explains the recordings best.
    pub effect: Included,
    /// The others whose sizes are stated.
    pub alternatives: Vec<Included>,
}

impl Diagnosed {
    /// The effect and its alternatives.
    fn offered(&self) -> impl Iterator<Item = &Included> {
        std::iter::once(&self.effect).chain(&self.alternatives)
    }

    /// The one of them that is in `take`.
    pub fn chosen(&self, take: &[String]) -> Option<&Included> {
        self.offered().find(|o| take.contains(&o.name))
    }
}

/// Why there are no effects to include.
#[derive(Debug, thiserror::Error)]
pub enum IncludedError {
    /// No file.
    #[error(transparent)]
    File(#[from] RecordingError),
    /// The file is not a diagnosis.
    #[error("{file}: not a diagnosis.json: {what}; make it with `cpcm diagnose SITE --out DIR`")]
    Format {
        /// Which file.
        file: String,
        /// What is wrong.
        what: String,
    },
    /// Two are asked for of which the recordings show one.
    #[error("{first} and {second} are one and the same to the recordings: take one of the two")]
    InEachOthersPlace {
        /// As asked for.
        first: String,
        /// The same.
        second: String,
    },
    /// An effect is asked for that the diagnosis does not offer.
    #[error("the diagnosis does not offer {effect}: it names {}", if offered.is_empty() { "no effect" } else { offered })]
    NotOffered {
        /// As asked for.
        effect: String,
        /// What could be.
        offered: String,
    },
}

/// Effects named in a `diagnosis.json`, and the name of the site that they were found at; those of older versions do not say it.
pub fn read_effects(file: &Path) -> Result<(Vec<Diagnosed>, Option<String>), IncludedError> {
    let wrong = |what: String| IncludedError::Format { file: file.display().to_string(), what };
    let json: Value = serde_json::from_slice(&read_bytes(file)?).map_err(|e| wrong(e.to_string()))?;
    let effects = diagnosed(&json).map_err(|what| wrong(what.into()))?;
    Ok((effects, json["site"].as_str().map(Into::into)))
}

fn diagnosed(json: &Value) -> Result<Vec<Diagnosed>, &'static str> {
    let of_effect = |e: &Value| {
        // Diagnoses of older versions state no sizes of alternatives.
        let others = e["alternatives"].as_array().into_iter().flatten();
        Ok(Diagnosed { effect: included(e)?, alternatives: others.map(included).collect::<Result<_, _>>()? })
    };
    json["effects"].as_array().ok_or("no list `effects`")?.iter().map(of_effect).collect()
}

fn included(effect: &Value) -> Result<Included, &'static str> {
    let name = effect["name"].as_str().ok_or("an effect has no name")?;
    let parameters = effect["parameters"].as_object().into_iter().flatten();
    let of_name = |(n, p): (&String, &Value)| (n.clone(), p["value"].as_f64().unwrap_or(f64::NAN));
    Ok(Included { name: name.into(), parameters: parameters.map(of_name).collect() })
}

/// Of every effect itself, or the one of its alternatives that is in `take`.
pub fn taken(diagnosed: &[Diagnosed], take: &[String]) -> Result<Vec<Included>, IncludedError> {
    let offered = || diagnosed.iter().flat_map(Diagnosed::offered);
    if let Some(effect) = take.iter().find(|t| !offered().any(|o| o.name == **t)) {
        let names = |d: &Diagnosed| d.offered().map(|o| o.name.as_str()).collect::<Vec<_>>().join(" or ");
        let offered = diagnosed.iter().map(names).collect::<Vec<_>>().join(", ");
        return Err(IncludedError::NotOffered { effect: effect.clone(), offered });
    }
    for d in diagnosed {
        let mut asked = d.offered().filter(|o| take.contains(&o.name));
        if let (Some(first), Some(second)) = (asked.next(), asked.next()) {
            let [first, second] = [first, second].map(|o| o.name.clone());
            return Err(IncludedError::InEachOthersPlace { first, second });
        }
    }
    // Two effects may have the same alternative, which acts once.
    let mut out: Vec<Included> = Vec::new();
    for effect in diagnosed.iter().map(|d| d.chosen(take).unwrap_or(&d.effect)) {
        if out.iter().all(|o| o.name != effect.name) {
            out.push(effect.clone());
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use proptest::prelude::*;

    use super::*;

    fn of_two() -> Vec<Diagnosed> {
        let json = serde_json::json!({"effects": [
            {"name": "axle-load", "parameters": {"factor": {"value": 1.1}}, "indistinguishable_from": ["load-transfer"],
             "alternatives": [{"name": "load-transfer", "parameters": {"fraction": {"value": 0.12}}, "gap_after": 0.2}]},
            {"name": "tonal", "parameters": {"frequency_hz": {"value": 50.0}}, "indistinguishable_from": []}]});
        diagnosed(&json).unwrap()
    }

    fn names(take: &[&str]) -> Result<Vec<String>, IncludedError> {
        let take: Vec<String> = take.iter().map(|t| (*t).into()).collect();
        Ok(taken(&of_two(), &take)?.into_iter().map(|i| i.name).collect())
    }

    #[test]
    fn property_an_alternative_is_taken_with_its_own_size() {
        assert_eq!(names(&[]).unwrap(), ["axle-load", "tonal"]);
        assert_eq!(names(&["axle-load"]).unwrap(), ["axle-load", "tonal"]);
        assert_eq!(names(&["load-transfer"]).unwrap(), ["load-transfer", "tonal"]);
        let with = taken(&of_two(), &["load-transfer".into()]).unwrap();
        assert_eq!(with[0].parameters, [("fraction".to_string(), 0.12)]);
    }

    #[test]
    fn property_what_is_not_offered_is_refused() {
        let error = names(&["load-transfer", "voids"]).unwrap_err().to_string();
        assert_eq!(error, "the diagnosis does not offer voids: it names axle-load or load-transfer, tonal");
        assert!(taken(&[], &["voids".into()]).unwrap_err().to_string().ends_with("names no effect"));
    }

    /// The second name was ignored without a word; of two effects that share an alternative it acted twice.
    #[test]
    fn regress_what_is_one_to_the_recordings_is_taken_once() {
        let error = names(&["axle-load", "load-transfer"]).unwrap_err().to_string();
        assert_eq!(
            error,
            "axle-load and load-transfer are one and the same to the recordings: take one of the two"
        );
        let twice = [of_two(), of_two()].concat();
        let found = taken(&twice, &["load-transfer".into()]).unwrap();
        let found: Vec<&str> = found.iter().map(|i| i.name.as_str()).collect();
        assert_eq!(found, ["load-transfer", "tonal"]);
    }

    /// JSON of any shape, its keys those of a diagnosis.
    fn any_json() -> impl Strategy<Value = Value> {
        let leaf = prop_oneof![
            Just(Value::Null),
            any::<bool>().prop_map(Value::from),
            any::<f64>().prop_map(Value::from),
            "[a-z-]{0,8}".prop_map(Value::from),
        ];
        let key = "effects|name|parameters|value|alternatives|factor";
        leaf.prop_recursive(5, 60, 4, move |inner| {
            prop_oneof![
                proptest::collection::vec(inner.clone(), 0..4).prop_map(Value::from),
                proptest::collection::btree_map(key, inner, 0..4)
                    .prop_map(|map| Value::Object(map.into_iter().collect())),
            ]
        })
    }

    proptest! {
        #[test]
        fn property_any_json_is_read_or_refused(json in any_json()) {
            let whole = serde_json::json!({ "effects": [json] });
            for found in [diagnosed(&json), diagnosed(&whole)].into_iter().flatten() {
                let named: HashSet<&str> = found.iter().map(|d| d.effect.name.as_str()).collect();
                prop_assert!(taken(&found, &[]).is_ok_and(|all| all.len() == named.len()));
            }
        }
    }
}
