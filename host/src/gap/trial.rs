//! Withheld check: sites with a drawn effect from a simulation that differs from the diagnosis model (finer mesh, shorter
//! step, damped integrator, whole trains over the whole track), and the score of a diagnosis that saw only the site.

mod panel;
mod score;
mod strength;

use std::path::Path;

use crate::passage::random::Random;
use crate::progress::Silent;
use crate::recording::files::write_atomic;
use crate::recording::{Design, Site, TrafficDirection};
use crate::scenario::{Scenario, ScenarioError, read_scenario, simulate};
pub use panel::Panels;
pub use score::{Bin, Score, bins, main_parameter, score};
use strength::{DRAWN, Drawn, Plain, is_told};

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
}

/// Passages of a trial's site.
const PASSAGES: usize = 16;
/// Streams of random numbers of one seed: for sites, for effects, for what takes the place of one in a pair, and for panels.
const SITE_STREAMS: u64 = 1000;
const EFFECT_STREAMS: u64 = 1_000_000;
const PAIR_STREAMS: u64 = 1_000_000_000;
const PANEL_STREAMS: u64 = 2_000_000_000;

const NOMINAL: &str = include_str!("trial_site.toml");

/// Draws and simulates trial `index` of `seed`; `work` holds a file while the nominal site is read.
pub fn draw(panels: Panels, seed: u64, index: u64, work: &Path) -> Result<Trial, TrialError> {
    let (mut scenario, names) = scenario_of(panels, seed, index, work)?;
    let question = asked(index);
    let mut answer =
        Answer { question, effects: Vec::new(), parameters: Vec::new(), strength: 0.0, alone: Vec::new() };
    if names.is_empty() {
        return Ok(Trial { site: simulate(&scenario, &Silent)?.site, exclude: None, answer });
    }
    let plain = Plain::of(&scenario)?;
    let stream = |k: usize| Random::new(seed, EFFECT_STREAMS + 2 * index + k as u64);
    let (drawn, mut alone) = match question {
        Question::Pair => told(names, (stream, Random::new(seed, PAIR_STREAMS + index)), &plain)?,
        _ => (vec![Drawn::new((names[0], question), stream(0), &plain)?], Vec::new()),
    };
    for d in &drawn {
        answer.effects.push(d.name.to_string());
        answer.parameters.push((d.name.to_string(), d.put(&mut scenario.simulation.effects)));
    }
    let site = simulate(&scenario, &Silent)?.site;
    answer.strength = plain.changed_by(&site);
    if alone.is_empty() {
        alone.push(answer.strength);
    }
    answer.alone = alone;
    let exclude = drawn.first().filter(|_| question == Question::LeftOut).map(|d| d.name);
    Ok(Trial { site, exclude, answer })
}

/// Two effects that can be told alone, and how much each changes the signal alone: one whose range ends before it changes this site's signal by as much gives way to another.
fn told(
    mut names: Vec<&'static str>,
    (stream, mut random): (impl Fn(usize) -> Random, Random),
    plain: &Plain,
) -> Result<(Vec<Drawn>, Vec<f64>), ScenarioError> {
    let (mut drawn, mut alone) = (Vec::new(), Vec::new());
    let mut k = 0;
    while drawn.len() < 2 {
        if k == names.len() {
            names.push(another(&names, &mut random));
        }
        let effect = Drawn::new((names[k], Question::Pair), stream(drawn.len()), plain)?;
        let strength = effect.alone(plain)?;
        if is_told(strength) {
            drawn.push(effect);
            alone.push(strength);
        }
        k += 1;
    }
    Ok((drawn, alone))
}

/// An effect that is not among `names`.
fn another(names: &[&'static str], random: &mut Random) -> &'static str {
    loop {
        let name = DRAWN[random.below(DRAWN.len())];
        if !names.contains(&name) {
            return name;
        }
    }
}

/// What the trial of a number asks.
fn asked(index: u64) -> Question {
    match index % 10 {
        0 | 5 => Question::Nothing,
        3 => Question::LeftOut,
        7 => Question::Pair,
        _ => Question::One,
    }
}

/// The scenario of a trial without its effects, and the names that are drawn for it.
pub fn scenario_of(
    panels: Panels,
    seed: u64,
    index: u64,
    work: &Path,
) -> Result<(Scenario, Vec<&'static str>), TrialError> {
    let mut random = Random::new(seed, SITE_STREAMS + index);
    let mut scenario = scenario(&mut random, work)?;
    if panels == Panels::Any {
        panel::draw(&mut scenario, &mut Random::new(seed, PANEL_STREAMS + index));
    }
    scenario.simulation.seed = seed.wrapping_mul(100_003).wrapping_add(index);
    let count = match asked(index) {
        Question::Nothing => 0,
        Question::Pair => 2,
        _ => 1,
    };
    let mut names: Vec<&'static str> = Vec::new();
    while names.len() < count {
        names.push(another(&names, &mut random));
    }
    Ok((scenario, names))
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::{Format, read_site, write_site};

    fn of(panels: Panels, index: u64) -> (Scenario, Vec<&'static str>) {
        let work = tempfile::tempdir().unwrap();
        scenario_of(panels, 5, index, work.path()).unwrap()
    }

    #[test]
    fn property_any_panel_makes_a_site_that_is_read_again() {
        for index in 0..8 {
            let (mut scenario, _) = of(Panels::Any, index);
            scenario.simulation.passages = 1;
            let site = simulate(&scenario, &Silent).unwrap().site;
            let dir = tempfile::tempdir().unwrap();
            write_site(dir.path(), &site, Format::Parquet).unwrap();
            assert_eq!(read_site(dir.path()).unwrap().crossing, scenario.crossing, "trial {index}");
        }
    }

    /// What acts on a site is drawn apart from the panel.
    #[test]
    fn property_panels_differ_and_what_acts_on_them_stays() {
        let (nominal, acting) = of(Panels::Nominal, 1);
        let (any, acting_on_any) = of(Panels::Any, 1);
        let (other, _) = of(Panels::Any, 2);
        assert_eq!(acting, acting_on_any);
        assert_eq!(nominal.simulation.ballast, any.simulation.ballast);
        assert_eq!(nominal.crossing.track, of(Panels::Nominal, 2).0.crossing.track);
        assert_ne!(any.crossing.track, other.crossing.track);
        assert_eq!(any.crossing, of(Panels::Any, 1).0.crossing);
    }
}
