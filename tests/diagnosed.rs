//! Diagnoses of field recordings and of the sites of trials.

use std::path::Path;

use cpcm::gap::GapError;
use cpcm::gap::diagnosis::{DiagnoseOptions, Diagnosis, diagnose};
use cpcm::gap::effects::names;
use cpcm::gap::trial::{Panels, scenario_of};
use cpcm::gap::verdict::Verdict;
use cpcm::progress::Silent;
use cpcm::recording::{Site, read_site};
use cpcm::scenario::{Scenario, simulate};

/// A site of the field recordings.
pub fn field(name: &str) -> Site {
    read_site(&Path::new(env!("CARGO_MANIFEST_DIR")).join("data/field").join(name)).unwrap()
}

/// A site that is fast to diagnose.
pub fn small(name: &str, passages: usize) -> Site {
    let mut site = field(name);
    site.passages.truncate(passages);
    site
}

/// Where, not which.
pub fn quick(site: &Site) -> Result<Diagnosis, GapError> {
    diagnose(site, &DiagnoseOptions { quick: true, ..DiagnoseOptions::default() }, &Silent)
}

/// With the whole catalogue.
pub fn full(site: &Site) -> Diagnosis {
    diagnose(site, &DiagnoseOptions::default(), &Silent).unwrap()
}

/// Diagnosis with only some effects in the catalogue, which takes a part of the time.
pub fn among(site: &Site, effects: &[&str]) -> Diagnosis {
    diagnose(site, &DiagnoseOptions { exclude: all_but(effects), ..DiagnoseOptions::default() }, &Silent)
        .unwrap()
}

/// The catalogue without `effects`.
pub fn all_but(effects: &[&str]) -> Vec<String> {
    names().filter(|name| !effects.contains(name)).map(Into::into).collect()
}

/// Names of the effects of a verdict, in their order.
pub fn named(found: &Diagnosis) -> Vec<&'static str> {
    found.effects.iter().map(|e| e.name).collect()
}

/// Whether a remark of a diagnosis holds a word.
pub fn says(found: &Diagnosis, word: &str) -> bool {
    found.remarks.iter().any(|r| r.contains(word))
}

/// The whole diagnosis of field recordings without an effect: no gap, a clock that is right, and wheels that differ as sound ones do; among
/// the references are wheels that lose contact, whose scatter is large for another reason.
pub fn assert_sound(name: &str) {
    let found = full(&field(name));
    assert_eq!(found.verdict, Verdict::NoGap, "{name}: {:?} {:?}", named(&found), found.remarks);
    assert!(found.wheels.unnatural().is_none(), "{name}: {:?}", found.wheels);
    for word in ["wheels differ", "clock is off by"] {
        assert!(!says(&found, word), "{name}: {:?}", found.remarks);
    }
}

/// Scenario of a trial's site without the effects that are drawn there, which must be `drawn`: tests put in their own.
pub fn trial(seed: u64, index: u64, drawn: &[&str]) -> Scenario {
    let work = tempfile::tempdir().unwrap();
    let (scenario, names) = scenario_of(Panels::Nominal, seed, index, work.path()).unwrap();
    assert_eq!(names, drawn, "trial {index} of seed {seed}");
    scenario
}

/// What the sensor recorded of a scenario.
pub fn recorded(scenario: &Scenario) -> Site {
    simulate(scenario, &Silent).unwrap().site
}

const FEW: usize = 9;

/// What the sensor recorded of as many passages as most effects need to be told.
pub fn few(scenario: &Scenario) -> Site {
    let mut few = scenario.clone();
    few.simulation.passages = FEW;
    recorded(&few)
}
