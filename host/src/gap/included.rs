//! Effects to include in an identification, with their sizes, as a `diagnosis.json` has them.

use std::path::Path;

use serde_json::Value;

use crate::recording::RecordingError;
use crate::recording::files::read_bytes;

/// An effect with the values of its parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Included {
    /// Name in the contract.
    pub name: String,
    /// Name and value, SI units.
    pub parameters: Vec<(String, f64)>,
}

/// An effect that a diagnosis names, and those from which the recordings cannot tell it, in its place.
#[derive(Clone, Debug, PartialEq)]
pub struct Diagnosed {
    /// The one that explains the recordings best.
    pub effect: Included,
    /// The others whose sizes are stated.
    pub alternatives: Vec<Included>,
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
    /// An effect is asked for that the diagnosis does not offer.
    #[error("the diagnosis does not offer {effect}: it names {}", if offered.is_empty() { "no effect" } else { offered })]
    NotOffered {
        /// As asked for.
        effect: String,
        /// What could be.
        offered: String,
    },
}

/// Effects named in a `diagnosis.json`.
pub fn read_effects(file: &Path) -> Result<Vec<Diagnosed>, IncludedError> {
    let wrong = |what: String| IncludedError::Format { file: file.display().to_string(), what };
    let json: Value = serde_json::from_slice(&read_bytes(file)?).map_err(|e| wrong(e.to_string()))?;
    diagnosed(&json).map_err(|what| wrong(what.into()))
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
    let all = |d: &Diagnosed| [std::slice::from_ref(&d.effect), d.alternatives.as_slice()].concat();
    if let Some(effect) = take.iter().find(|t| !diagnosed.iter().flat_map(all).any(|i| i.name == **t)) {
        let names = |d| all(d).into_iter().map(|i| i.name).collect::<Vec<_>>().join(" or ");
        let offered = diagnosed.iter().map(names).collect::<Vec<_>>().join(", ");
        return Err(IncludedError::NotOffered { effect: effect.clone(), offered });
    }
    let of =
        |d: &Diagnosed| d.alternatives.iter().find(|a| take.contains(&a.name)).unwrap_or(&d.effect).clone();
    Ok(diagnosed.iter().map(of).collect())
}

#[cfg(test)]
mod tests {
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
}
