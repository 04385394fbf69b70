//! Effects of trials, as strong as a trial asks.

use super::Question;
use crate::gap::forward::BAND_HZ;
use crate::passage::random::Random;
use crate::progress::Silent;
use crate::recording::Site;
use crate::scenario::effects as kinds;
use crate::scenario::{Effects, Scenario, ScenarioError, simulate};

/// Effects that trials draw: the whole catalogue.
pub(super) const DRAWN: [&str; 20] = [
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

/// Change of the signal by a drawn effect, RMS relative to the signal: from well below what sites without effect leave (a tenth
/// to a third) to several times that, evenly in its logarithm.
const SPREAD: (f64, f64) = (0.04, 2.0);
/// The same of an effect that is left out of the catalogue, and of two together: from where one is told alone. How weak effects
/// fare is asked of them alone.
const TOLD: (f64, f64) = (0.25, 2.0);
/// Shifts the samples of a long recording by more than a wave whatever its size: its level is drawn, not its strength.
const CLOCK_ERROR: &str = "clock-error";
/// Halvings of the range of an effect in search of a strength.
const HALVINGS: usize = 6;
/// How far the strength of a level found by them may be below the one that is wanted.
const SHORT: f64 = 0.9;

/// Passages that tell how strong an effect is.
const STRENGTH_PASSAGES: usize = 3;

/// A few passages of a scenario without effects, beside which effects show how strong they are.
pub(super) struct Plain {
    scenario: Scenario,
    site: Site,
}

impl Plain {
    pub fn of(scenario: &Scenario) -> Result<Self, ScenarioError> {
        let mut scenario = scenario.clone();
        scenario.simulation.passages = STRENGTH_PASSAGES;
        let site = simulate(&scenario, &Silent)?.site;
        Ok(Self { scenario, site })
    }

    /// RMS of the change over RMS of the signal, in the band of the comparison.
    pub fn changed_by(&self, site: &Site) -> f64 {
        let (mut change, mut signal) = (0.0, 0.0);
        for (a, b) in self.site.passages.iter().zip(&site.passages) {
            let band = |v: &[f64]| crate::signal::brick_band(v, a.sample_rate_hz, 1.0, BAND_HZ[0]);
            let x: Vec<f64> = a.acceleration_m_s2.iter().map(|v| f64::from(*v)).collect();
            let difference: Vec<f64> =
                x.iter().zip(&b.acceleration_m_s2).map(|(x, y)| x - f64::from(*y)).collect();
            change += band(&difference).iter().map(|v| v * v).sum::<f64>();
            signal += band(&x).iter().map(|v| v * v).sum::<f64>();
        }
        (change / f64::max(signal, f64::MIN_POSITIVE)).sqrt()
    }
}

/// Whether an effect that changes the signal by as much can be told alone.
pub(super) fn is_told(alone: f64) -> bool {
    alone > SHORT * TOLD.0
}

/// An effect of a trial: its strength is along its range, all else of it is drawn once.
pub(super) struct Drawn {
    pub name: &'static str,
    random: Random,
    /// 0: hardly there, 1: as strong as it gets.
    level: f64,
}

impl Drawn {
    /// Draws how much the effect is to change the signal, and finds the level at which it does alone. An effect whose range ends before
    /// stays at the end.
    pub fn new(
        (name, question): (&'static str, Question),
        mut random: Random,
        plain: &Plain,
    ) -> Result<Self, ScenarioError> {
        let spread = if question == Question::One { SPREAD } else { TOLD };
        let (wanted, any) = (random.between_logarithms(spread.0, spread.1), random.unit());
        if name == CLOCK_ERROR {
            return Ok(Self { name, random, level: any });
        }
        let mut drawn = Self { name, random, level: 0.5 };
        let mut step = 0.25;
        for _ in 0..HALVINGS {
            drawn.level += if drawn.alone(plain)? < wanted { step } else { -step };
            step *= 0.5;
        }
        Ok(drawn)
    }

    /// How much it changes the signal alone.
    pub fn alone(&self, plain: &Plain) -> Result<f64, ScenarioError> {
        let mut scenario = plain.scenario.clone();
        self.put(&mut scenario.simulation.effects);
        Ok(plain.changed_by(&simulate(&scenario, &Silent)?.site))
    }

    /// Puts it into a scenario's effects; its main parameter.
    pub fn put(&self, effects: &mut Effects) -> f64 {
        put(effects, (self.name, self.level), self.random.clone())
    }
}

fn put(effects: &mut Effects, (name, level): (&str, f64), mut random: Random) -> f64 {
    let sign = if random.unit() < 0.5 { -1.0 } else { 1.0 };
    let between = |low: f64, high: f64| low * (high / low).powf(level);
    let factor = |low: f64, high: f64| between(low, high).powf(sign);
    match name {
        "voided-sleepers" => {
            let gap_m = between(0.1e-3, 4e-3);
            effects.voided_sleepers = Some(kinds::VoidedSleepers::in_the_middle(gap_m));
            gap_m
        }
        "ballast-stiffening" => {
            let doubling_m = between(4e-3, 0.1e-3);
            effects.ballast_stiffening = Some(kinds::BallastStiffening { doubling_m, bilinear_factor: None });
            doubling_m
        }
        "ballast-mass" => {
            let mass_kg_m = between(20.0, 800.0);
            effects.ballast_mass = Some(kinds::BallastMass { mass_kg_m });
            mass_kg_m
        }
        "support-loss" => {
            let f = between(0.9, 0.02);
            let side = if sign > 0.0 { 3..=6 } else { -6..=-3 };
            effects.support_loss = Some(kinds::SupportLoss { factor: f, sleepers: side.collect() });
            f
        }
        "pad-stiffness" => {
            let f = factor(1.05, 3.5);
            effects.pad_stiffness = Some(kinds::PadStiffness { factor: f, damping_factor: 1.0 });
            f
        }
        "crossing-rail" => {
            let f = factor(1.05, 2.0);
            effects.crossing_rail = Some(kinds::CrossingRail { stiffness_factor: f, mass_factor: f.sqrt() });
            f
        }
        "axle-load" => {
            let f = factor(1.02, 1.6);
            effects.axle_load = Some(kinds::Factor { factor: f });
            f
        }
        "unsprung-mass" => {
            let f = factor(1.05, 2.0);
            effects.unsprung_mass = Some(kinds::Factor { factor: f });
            f
        }
        "load-transfer" => {
            let f = sign * between(0.02, 0.4);
            effects.load_transfer = Some(kinds::LoadTransfer { to_crossing_side: f, to_front: 0.0 });
            f
        }
        "front-rear" => {
            let f = sign * between(0.05, 1.5);
            effects.front_rear = Some(kinds::FrontRear { depth_difference: f });
            f
        }
        "stock-irregularity" => {
            let depth_m = between(0.05e-3, 3e-3);
            let at_x_m = random.between(-1.5, 1.5);
            effects.stock_irregularity = Some(kinds::StockIrregularity { depth_m, at_x_m, length_m: 0.4 });
            depth_m
        }
        "gain-temperature" => {
            let per_kelvin = sign * between(0.3e-3, 2e-2);
            effects.gain_temperature = Some(kinds::GainTemperature { per_kelvin, reference_c: 20.0 });
            per_kelvin
        }
        "saturation" => {
            let range_m_s2 = between(80.0, 15.0);
            effects.saturation = Some(kinds::Saturation { range_m_s2 });
            range_m_s2
        }
        "clock-error" => {
            let relative = sign * between(0.005, 0.03);
            effects.clock_error = Some(kinds::ClockError { relative });
            relative
        }
        "mount-resonance" => {
            let frequency_hz = between(700.0, 200.0);
            effects.mount_resonance =
                Some(kinds::Mount { frequency_hz, damping_ratio: random.between(0.03, 0.2) });
            frequency_hz
        }
        "wheel-out-of-roundness" => {
            let order = 3 + (random.unit() * 8.0) as u32;
            let amplitude_m = between(0.01e-3, 0.2e-3);
            effects.wheel_out_of_roundness =
                Some(kinds::WheelOutOfRoundness { order, amplitude_m, share: random.between(0.2, 0.6) });
            amplitude_m
        }
        "tonal" => {
            let (frequency_hz, amplitude_m_s2) = (random.between(16.0, 240.0), between(0.05, 30.0));
            effects.tonal = Some(kinds::Tonal { frequency_hz, amplitude_m_s2 });
            amplitude_m_s2
        }
        "bias-step" => {
            let step_m_s2 = between(0.1, 30.0);
            effects.bias_step =
                Some(kinds::BiasSteps { step_m_s2, decay_s: random.between_logarithms(0.1, 1.0) });
            step_m_s2
        }
        "wheel-flat" => {
            let length_m = between(0.02, 0.07);
            effects.wheel_flat = Some(kinds::WheelFlats { length_m, share: random.between(0.1, 0.5) });
            length_m
        }
        "hollow-wheels" => {
            let depth_factor = between(1.1, 3.0);
            effects.hollow_wheels = Some(kinds::HollowWheels {
                depth_factor,
                shift_m: random.between(-0.08, 0.08) * level,
                share: random.between(0.2, 0.5),
            });
            depth_factor
        }
        _ => unreachable!("{name} is drawn, and nothing puts it into a scenario"),
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::effects::{COMMON, LATENT};
    use super::*;

    #[test]
    fn property_all_that_is_drawn_is_in_the_catalogue() {
        let known = |name: &&str| {
            COMMON.iter().any(|e| e.name() == *name) || LATENT.iter().any(|e| e.name() == *name)
        };
        assert!(DRAWN.iter().all(known));
        assert_eq!(DRAWN.len(), COMMON.len() + LATENT.len());
    }

    #[test]
    fn property_a_level_moves_every_effect() {
        for name in DRAWN {
            let value = |level: f64| put(&mut Effects::default(), (name, level), Random::new(1, 2));
            let mut effects = Effects::default();
            put(&mut effects, (name, 0.5), Random::new(1, 2));
            assert_eq!(effects.names(), [name]);
            let (low, middle, high) = (value(0.0), value(0.5), value(1.0));
            assert!((middle - low) * (high - middle) > 0.0, "{name}: {low} {middle} {high}");
        }
    }
}
