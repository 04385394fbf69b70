//! The score of a diagnosis against the opened answer of its trial.

use serde_json::{Value, json};

use super::{Answer, Question};
use crate::gap::effects::stage_of;

/// Score of one trial.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
pub struct Score {
    /// The answer.
    pub answer: Answer,
    /// Change of the signal over the noise floor.
    pub strength_to_floor: f64,
    /// The same of the weaker effect alone.
    pub weaker_to_floor: f64,
    /// The verdict.
    pub verdict: String,
    /// Effects named, in order.
    pub named: Vec<String>,
    /// First effect, or a group of at most three with it.
    pub first_group: Vec<String>,
    /// Probability of the first.
    pub probability: f64,
    /// The question was answered right.
    pub right: bool,
    /// The main parameter is inside its interval, where the effect was named.
    pub covered: Option<bool>,
    /// Ends of that interval relative to the truth, less 1.
    pub interval: Option<[f64; 2]>,
    /// Closed fraction.
    pub closed_fraction: f64,
}

/// Scores a diagnosis against the opened answer.
pub fn score(answer: Answer, diagnosis: &Value) -> Score {
    let text = |v: &Value| v.as_str().unwrap_or_default().to_string();
    let effects = diagnosis["effects"].as_array().cloned().unwrap_or_default();
    let named: Vec<String> = effects.iter().map(|e| text(&e["name"])).collect();
    let group_of = |e: &Value| {
        let mut group = vec![text(&e["name"])];
        group.extend(e["indistinguishable_from"].as_array().into_iter().flatten().map(text));
        group
    };
    let groups: Vec<Vec<String>> = effects.iter().map(group_of).collect();
    let first_group = groups.first().cloned().unwrap_or_default();
    let verdict = text(&diagnosis["verdict"]);
    let holds = |group: &Vec<String>, name: &str| group.len() <= 3 && group.iter().any(|g| g == name);
    let right = match answer.question {
        Question::Nothing => verdict == "no-gap",
        Question::One => answer.effects.iter().all(|e| holds(&first_group, e)),
        Question::Pair => answer.effects.iter().all(|e| groups.iter().any(|g| holds(g, e))),
        Question::LeftOut => {
            let stage = text(&diagnosis["where"]["stage"]);
            verdict == "unexplained" || answer.effects.iter().any(|e| is_of(&stage, e))
        }
    };
    let ends = |e: &Value| {
        let name = text(&e["name"]);
        let (_, value) = answer.parameters.iter().find(|(n, _)| *n == name)?;
        let p = &e["parameters"][main_parameter(&name)?];
        let (a, b) = (p["lower"].as_f64()? / value - 1.0, p["upper"].as_f64()? / value - 1.0);
        Some([a.min(b), a.max(b)])
    };
    let of_group =
        |e: &Value| ends(e).or_else(|| e["alternatives"].as_array().into_iter().flatten().find_map(ends));
    let interval = effects.first().and_then(of_group);
    let covered = interval.map(|[l, u]| l <= 0.0 && 0.0 <= u);
    let floor = diagnosis["gap"]["noise_floor"].as_f64().unwrap_or(f64::NAN);
    Score {
        strength_to_floor: answer.strength / floor,
        weaker_to_floor: answer.alone.iter().copied().reduce(f64::min).unwrap_or(0.0) / floor,
        probability: effects.first().and_then(|e| e["probability"].as_f64()).unwrap_or(0.0),
        closed_fraction: diagnosis["gap"]["closed_fraction"].as_f64().unwrap_or(0.0),
        answer,
        verdict,
        named,
        first_group,
        right,
        covered,
        interval,
    }
}

/// Trials whose stated probability of the first effect is in a range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bin {
    /// From, to.
    pub range: (f64, f64),
    /// Mean stated probability.
    pub stated: f64,
    /// Trials in which the first effect was there.
    pub there: usize,
    /// Trials.
    pub of: usize,
}

/// Ends of the ranges of stated probability.
const BINS: [(f64, f64); 4] = [(0.0, 0.5), (0.5, 0.75), (0.75, 0.9), (0.9, 1.01)];

/// Reliability of the stated probabilities over all trials in which an effect was named.
pub fn bins(scores: &[Score]) -> Vec<Bin> {
    BINS.iter()
        .map(|range| {
            let of: Vec<&Score> = scores
                .iter()
                .filter(|s| !s.named.is_empty())
                .filter(|s| s.probability >= range.0 && s.probability < range.1)
                .collect();
            let there = |s: &&&Score| s.answer.effects.contains(&s.named[0]);
            Bin {
                range: *range,
                stated: crate::signal::mean(&of.iter().map(|s| s.probability).collect::<Vec<_>>()),
                there: of.iter().filter(there).count(),
                of: of.len(),
            }
        })
        .collect()
}

/// The parameter of an effect that a trial draws, as the diagnosis names it; none where that has one for either side.
pub fn main_parameter(name: &str) -> Option<&'static str> {
    Some(match name {
        "voided-sleepers" => "gap_m",
        "ballast-stiffening" => "doubling_m",
        "ballast-mass" => "mass_kg_m",
        "crossing-rail" => "stiffness_factor",
        "load-transfer" => "fraction",
        "front-rear" => "depth_difference",
        "stock-irregularity" => "depth_m",
        "gain-temperature" => "per_kelvin",
        "saturation" => "range_m_s2",
        "clock-error" => "relative",
        "mount-resonance" => "frequency_hz",
        "wheel-out-of-roundness" => "amplitude_m",
        "wheel-flat" => "length_m",
        "hollow-wheels" => "depth_factor",
        "tonal" => "amplitude_m_s2",
        "bias-step" => "step_m_s2",
        "pad-stiffness" | "axle-load" | "unsprung-mass" => "factor",
        _ => return None,
    })
}

/// Whether an effect of the catalogue is of a stage of the contract.
fn is_of(stage: &str, effect: &str) -> bool {
    stage_of(effect).is_some_and(|s| json!(s) == stage)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::effects::{common, names};

    #[test]
    fn property_the_main_parameter_is_one_of_the_diagnosis() {
        for name in names() {
            let main = main_parameter(name);
            assert_eq!(main.is_none(), name == "support-loss", "{name}");
            let known = common(name).map_or(&[][..], |e| e.parameters());
            let is_there = |main| known.is_empty() || known.iter().any(|p| p.name == main);
            assert!(main.is_none_or(is_there), "{name}: {main:?}");
        }
        assert!(is_of("sensor", "tonal") && is_of("track", "pad-stiffness") && !is_of("track", "tonal"));
    }
}
