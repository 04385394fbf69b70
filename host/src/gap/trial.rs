//! Withheld check: sites with a drawn effect from a simulation that differs from the diagnosis model (finer mesh, shorter
//! step, damped integrator, whole trains over the whole track), and the score of a diagnosis that saw only the site.

use std::path::Path;

use serde_json::Value;

use super::GapError;
use super::effects::{COMMON, LATENT};
use super::forward::BAND_HZ;
use crate::passage::random::Random;
use crate::progress::Silent;
use crate::recording::files::write_atomic;
use crate::recording::{Design, Site, TrafficDirection};
use crate::scenario::effects as kinds;
use crate::scenario::{Effects, Scenario, ScenarioError, read_scenario, simulate};

/// What a trial asks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Question {
    /// No effect acts.
    Nothing,
    /// One effect of the catalogue acts.
    One,
    /// One acts that is left out of the catalogue.
    LeftOut,
    /// Two act.
    Pair,
}

/// The sealed answer of a trial.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
pub struct Answer {
    /// What is asked.
    pub question: Question,
    /// Names of the effects.
    pub effects: Vec<String>,
    /// Value of the main parameter of each, as the diagnosis names it.
    pub parameters: Vec<(String, f64)>,
    /// Change of the signal by the effects, RMS relative to the signal.
    pub strength: f64,
    /// The same by each of them alone.
    pub alone: Vec<f64>,
}

/// A trial before the diagnosis.
pub struct Trial {
    /// What the diagnosis may see.
    pub site: Site,
    /// Effect to leave out of its catalogue.
    pub exclude: Option<&'static str>,
    /// The answer.
    pub answer: Answer,
}

/// Why a trial cannot be drawn.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum TrialError {
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    #[error(transparent)]
    File(#[from] crate::recording::RecordingError),
    #[error(transparent)]
    Gap(#[from] GapError),
}

/// Passages of a trial's site.
const PASSAGES: usize = 16;
/// Passages also simulated without the effect.
const STRENGTH_PASSAGES: usize = 3;

const NOMINAL: &str = include_str!("trial_site.toml");

/// Effects that trials draw; those without a detector in the catalogue are drawn as unknown ones.
const DRAWN: [&str; 20] = [
    "voided-sleepers",
    "ballast-stiffening",
    "ballast-mass",
    "support-loss",
    "pad-stiffness",
    "crossing-rail",
    "axle-load",
    "unsprung-mass",
    "load-transfer",
    "front-rear",
    "stock-irregularity",
    "gain-temperature",
    "saturation",
    "clock-error",
    "mount-resonance",
    "wheel-out-of-roundness",
    "tonal",
    "bias-step",
    "wheel-flat",
    "hollow-wheels",
];

/// Draws and simulates trial `index` of `seed`; `work` holds a file while the nominal site is read.
pub fn draw(seed: u64, index: u64, work: &Path) -> Result<Trial, TrialError> {
    let drawn = drawn(seed, index, work)?;
    let Drawn { question, names, mut scenario, mut random } = drawn;
    // A few passages tell how strong an effect is.
    let mut few = scenario.clone();
    few.simulation.passages = STRENGTH_PASSAGES;
    let mut alone_in = Vec::new();
    let mut parameters = Vec::new();
    for name in &names {
        // The same draw for the effect alone as beside the others.
        let mut again = random.clone();
        let value = put(&mut scenario.simulation.effects, name, &mut random);
        parameters.push(((*name).to_string(), value));
        let mut single = few.clone();
        put(&mut single.simulation.effects, name, &mut again);
        alone_in.push(single);
    }
    let changed = simulate(&scenario, &Silent)?;
    let (together, alone) = strengths(&few, &alone_in, &changed.site)?;
    let known =
        |name: &str| COMMON.iter().any(|e| e.name() == name) || LATENT.iter().any(|e| e.name() == name);
    let unknown = names.len() == 1 && !known(names[0]);
    let question = if question == Question::One && unknown { Question::LeftOut } else { question };
    let exclude = (question == Question::LeftOut).then(|| names[0]);
    Ok(Trial {
        site: changed.site,
        exclude,
        answer: Answer {
            question,
            effects: names.iter().map(|n| (*n).to_string()).collect(),
            parameters,
            strength: together,
            alone,
        },
    })
}

/// How much a site's effects change the signal of the plain scenario together, and each `alone` in it.
fn strengths(plain: &Scenario, alone: &[Scenario], changed: &Site) -> Result<(f64, Vec<f64>), ScenarioError> {
    if alone.is_empty() {
        return Ok((0.0, Vec::new()));
    }
    let plain = simulate(plain, &Silent)?.site;
    let together = strength(&plain, changed);
    if alone.len() == 1 {
        return Ok((together, vec![together]));
    }
    let each = alone.iter().map(|s| Ok(strength(&plain, &simulate(s, &Silent)?.site)));
    Ok((together, each.collect::<Result<_, ScenarioError>>()?))
}

/// A trial before its effects are put in.
struct Drawn {
    question: Question,
    names: Vec<&'static str>,
    scenario: Scenario,
    random: Random,
}

fn drawn(seed: u64, index: u64, work: &Path) -> Result<Drawn, TrialError> {
    let mut random = Random::new(seed, 1000 + index);
    let mut scenario = scenario(&mut random, work)?;
    scenario.simulation.seed = seed.wrapping_mul(100_003).wrapping_add(index);
    let question = match index % 10 {
        0 | 5 => Question::Nothing,
        3 => Question::LeftOut,
        7 => Question::Pair,
        _ => Question::One,
    };
    let count = match question {
        Question::Nothing => 0,
        Question::Pair => 2,
        _ => 1,
    };
    let mut names: Vec<&'static str> = Vec::new();
    while names.len() < count {
        let name = DRAWN[(random.unit() * DRAWN.len() as f64) as usize % DRAWN.len()];
        if !names.contains(&name) {
            names.push(name);
        }
    }
    Ok(Drawn { question, names, scenario, random })
}

/// The scenario of a trial with its effects, and their names.
pub fn scenario_of(seed: u64, index: u64, work: &Path) -> Result<(Scenario, Vec<String>), TrialError> {
    let mut drawn = drawn(seed, index, work)?;
    for name in &drawn.names {
        put(&mut drawn.scenario.simulation.effects, name, &mut drawn.random);
    }
    let names = drawn.names.iter().map(|n| (*n).to_string()).collect();
    Ok((drawn.scenario, names))
}

/// A site within what the field shows: both pads, both directions, soft and stiff ballast, shallow and deep crossings.
fn scenario(random: &mut Random, work: &Path) -> Result<Scenario, TrialError> {
    let file = work.join("nominal.toml");
    write_atomic(&file, NOMINAL.as_bytes())?;
    let mut s = read_scenario(&file)?;
    if random.unit() < 0.5 {
        s.crossing.design = Design::E60;
        (s.crossing.pad.stiffness_n_m, s.crossing.pad.damping_ns_m) = (60e6, 6e3);
    }
    if random.unit() < 0.5 {
        s.crossing.traffic_direction = TrafficDirection::Trailing;
    }
    let sim = &mut s.simulation;
    sim.passages = PASSAGES;
    sim.speed_m_s = random.between(34.0, 52.0);
    sim.operator_speed_error = Some(0.006);
    sim.ballast.p1_n_m2 = random.between(22e6, 38e6);
    sim.ballast.p2_n_m2 = random.between(10e6, 38e6);
    sim.ballast.p3 = random.between(0.3, 0.5);
    sim.geometry.dip_m = random.between(0.7e-3, 1.8e-3);
    sim.geometry.wear_m = random.between(0.05e-3, 0.15e-3);
    sim.solver.dt_s = 0.8e-4;
    sim.solver.theta = 0.52;
    sim.solver.rail_step_m = 0.2;
    sim.solver.sleeper_step_m = 0.2;
    sim.solver.sleeper_modes = 6;
    Ok(s)
}

/// Puts an effect of drawn strength into a scenario; its main parameter.
fn put(effects: &mut Effects, name: &str, random: &mut Random) -> f64 {
    let sign = if random.unit() < 0.5 { -1.0 } else { 1.0 };
    let log = |random: &mut Random, low: f64, high: f64| random.between(low.ln(), high.ln()).exp();
    let factor = |random: &mut Random, low: f64, high: f64| random.between(low, high).powf(sign);
    match name {
        "voided-sleepers" => {
            let gap_m = log(random, 0.2e-3, 4e-3);
            effects.voided_sleepers =
                Some(kinds::VoidedSleepers { gap_m, sleepers: vec![(-1, 0.5), (0, 1.0), (1, 0.5)] });
            gap_m
        }
        "ballast-stiffening" => {
            let doubling_m = log(random, 0.1e-3, 2e-3);
            effects.ballast_stiffening = Some(kinds::BallastStiffening { doubling_m, bilinear_factor: None });
            doubling_m
        }
        "ballast-mass" => {
            let mass_kg_m = log(random, 60.0, 800.0);
            effects.ballast_mass = Some(kinds::BallastMass { mass_kg_m });
            mass_kg_m
        }
        "support-loss" => {
            let f = log(random, 0.02, 0.5);
            let side = if sign > 0.0 { 3..=6 } else { -6..=-3 };
            effects.support_loss = Some(kinds::SupportLoss { factor: f, sleepers: side.collect() });
            f
        }
        "pad-stiffness" => {
            let f = factor(random, 1.4, 3.5);
            effects.pad_stiffness = Some(kinds::PadStiffness { factor: f, damping_factor: 1.0 });
            f
        }
        "crossing-rail" => {
            let f = factor(random, 1.3, 2.0);
            effects.crossing_rail = Some(kinds::CrossingRail { stiffness_factor: f, mass_factor: f.sqrt() });
            f
        }
        "axle-load" => {
            let f = factor(random, 1.06, 1.6);
            effects.axle_load = Some(kinds::Factor { factor: f });
            f
        }
        "unsprung-mass" => {
            let f = factor(random, 1.15, 2.0);
            effects.unsprung_mass = Some(kinds::Factor { factor: f });
            f
        }
        "load-transfer" => {
            let f = sign * log(random, 0.06, 0.4);
            effects.load_transfer = Some(kinds::LoadTransfer { to_crossing_side: f, to_front: 0.0 });
            f
        }
        "front-rear" => {
            let f = sign * log(random, 0.15, 1.5);
            effects.front_rear = Some(kinds::FrontRear { depth_difference: f });
            f
        }
        "stock-irregularity" => {
            let depth_m = log(random, 0.2e-3, 3e-3);
            let at_x_m = random.between(-1.5, 1.5);
            effects.stock_irregularity = Some(kinds::StockIrregularity { depth_m, at_x_m, length_m: 0.4 });
            depth_m
        }
        "gain-temperature" => {
            let per_kelvin = sign * log(random, 1e-3, 2e-2);
            effects.gain_temperature = Some(kinds::GainTemperature { per_kelvin, reference_c: 20.0 });
            per_kelvin
        }
        "saturation" => {
            let range_m_s2 = random.between(15.0, 50.0);
            effects.saturation = Some(kinds::Saturation { range_m_s2 });
            range_m_s2
        }
        "clock-error" => {
            let relative = sign * random.between(0.005, 0.03);
            effects.clock_error = Some(kinds::ClockError { relative });
            relative
        }
        "mount-resonance" => {
            let frequency_hz = log(random, 200.0, 600.0);
            effects.mount_resonance =
                Some(kinds::Mount { frequency_hz, damping_ratio: random.between(0.03, 0.2) });
            frequency_hz
        }
        "wheel-out-of-roundness" => {
            let order = 3 + (random.unit() * 8.0) as u32;
            let amplitude_m = log(random, 0.03e-3, 0.2e-3);
            effects.wheel_out_of_roundness =
                Some(kinds::WheelOutOfRoundness { order, amplitude_m, share: random.between(0.2, 0.6) });
            amplitude_m
        }
        "tonal" => {
            let (frequency_hz, amplitude_m_s2) = (random.between(16.0, 240.0), log(random, 0.2, 20.0));
            effects.tonal = Some(kinds::Tonal { frequency_hz, amplitude_m_s2 });
            amplitude_m_s2
        }
        "bias-step" => {
            let step_m_s2 = log(random, 0.3, 30.0);
            effects.bias_step = Some(kinds::BiasSteps { step_m_s2, decay_s: log(random, 0.1, 1.0) });
            step_m_s2
        }
        "wheel-flat" => {
            let length_m = random.between(0.03, 0.07);
            effects.wheel_flat = Some(kinds::WheelFlats { length_m, share: random.between(0.1, 0.5) });
            length_m
        }
        _ => {
            let depth_factor = random.between(1.4, 3.0);
            effects.hollow_wheels = Some(kinds::HollowWheels {
                depth_factor,
                shift_m: random.between(-0.08, 0.08),
                share: random.between(0.2, 0.5),
            });
            depth_factor
        }
    }
}

/// RMS of the change over RMS of the signal, in the band of the comparison.
fn strength(plain: &Site, changed: &Site) -> f64 {
    let (mut change, mut signal) = (0.0, 0.0);
    for (a, b) in plain.passages.iter().zip(&changed.passages) {
        let band = |v: &[f64]| crate::signal::brick_band(v, a.sample_rate_hz, 1.0, BAND_HZ[0]);
        let x: Vec<f64> = a.acceleration_m_s2.iter().map(|v| f64::from(*v)).collect();
        let difference: Vec<f64> =
            x.iter().zip(&b.acceleration_m_s2).map(|(x, y)| x - f64::from(*y)).collect();
        change += band(&difference).iter().map(|v| v * v).sum::<f64>();
        signal += band(&x).iter().map(|v| v * v).sum::<f64>();
    }
    (change / f64::max(signal, f64::MIN_POSITIVE)).sqrt()
}

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
            verdict == "unexplained" || answer.effects.iter().any(|e| stage == stage_of(e))
        }
    };
    let interval = effects.first().and_then(|e| {
        let name = text(&e["name"]);
        let (_, value) = answer.parameters.iter().find(|(n, _)| *n == name)?;
        let p = &e["parameters"][main_parameter(&name)];
        let (a, b) = (p["lower"].as_f64()? / value - 1.0, p["upper"].as_f64()? / value - 1.0);
        Some([a.min(b), a.max(b)])
    });
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

/// The parameter of an effect that a trial draws, as the diagnosis names it.
pub fn main_parameter(name: &str) -> &'static str {
    match name {
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
        _ => "factor",
    }
}

/// Stage of an effect in the contract.
fn stage_of(name: &str) -> &'static str {
    match name {
        "gain-temperature" | "saturation" | "bias-step" | "mount-resonance" | "tonal" => "sensor",
        "clock-error" => "timing",
        "stock-irregularity" => "geometry",
        "axle-load"
        | "unsprung-mass"
        | "load-transfer"
        | "front-rear"
        | "wheel-out-of-roundness"
        | "wheel-flat"
        | "hollow-wheels" => "vehicle",
        _ => "track",
    }
}
