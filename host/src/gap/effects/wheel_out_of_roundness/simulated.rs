//! Waves of one order and amplitude around the wheels, simulated at every phase: a wheel leaves the rail on high ones.

use std::f64::consts::TAU;

use super::super::around_wheels::{Added, Around};
use crate::gap::departures::Plain;
use crate::gap::forward::Detail;
use crate::gap::latent::Scene;
use crate::passage::OutOfRoundness;

/// Phases simulated: what a wheel does besides following its wave has twice and three times its frequency.
const PHASES: usize = 12;
/// Phases tried for each of them.
const BETWEEN: usize = 4;
/// Factors tried of the amplitude: 0.3 to 3.
const FACTORS: (f64, f64, usize) = (0.3, 1.05, 48);

/// Waves in the training passages.
pub(super) fn waves(scene: &Scene, (order, amplitude_m): (u32, f64)) -> Option<Around> {
    let windows = vec![[Vec::new(), Vec::new()]; scene.observed.len()];
    let mut around = Around { windows, factors: FACTORS, mute: vec![false; PHASES * BETWEEN] };
    around.simulate(scene.train, |i| of_passage(scene, (order, amplitude_m), i))?;
    Some(around)
}

/// The same in all passages.
pub(super) fn complete(scene: &Scene, (order, amplitude_m): (u32, f64), around: &mut Around) -> Option<()> {
    around.simulate(&scene.held_out(), |i| of_passage(scene, (order, amplitude_m), i))
}

/// Windows of a passage with waves of every phase around the front wheelset, and around the rear one.
fn of_passage(scene: &Scene, (order, amplitude_m): (u32, f64), passage: usize) -> Option<Added> {
    let plain = Plain::of(&scene.observed[passage], scene.world, Detail::Scouting, Vec::new()).ok()?;
    let one = |axle: usize, phase: usize| {
        let phase_rad = phase as f64 / PHASES as f64 * TAU;
        let other = plain.simulator().with_waves(axle, OutOfRoundness { order, amplitude_m, phase_rad });
        let departure = plain.departure(&other, f64::NEG_INFINITY).ok()?;
        Some(plain.in_window(&departure, 0.0))
    };
    let of_axle = |axle: usize| {
        let simulated: Vec<Vec<f64>> = (0..PHASES).map(|phase| one(axle, phase)).collect::<Option<_>>()?;
        Some((0..PHASES * BETWEEN).map(|phase| between(&simulated, phase)).collect())
    };
    Some([of_axle(0)?, of_axle(1)?])
}

/// What is simulated at [`PHASES`], at the one of an index: the trigonometric polynomial through all of them.
fn between(simulated: &[Vec<f64>], index: usize) -> Vec<f64> {
    let mut out = vec![0.0; simulated[0].len()];
    for (phase, window) in simulated.iter().enumerate() {
        let apart = index as f64 / BETWEEN as f64 - phase as f64;
        let weight = dirichlet(apart / PHASES as f64 * TAU);
        out.iter_mut().zip(window).for_each(|(o, w)| *o += weight * w);
    }
    out
}

/// 1 at 0, 0 at the other [`PHASES`]: cosines up to half of their number, of which the last counts half.
fn dirichlet(angle_rad: f64) -> f64 {
    let half = PHASES / 2;
    let cosine = |k: usize| (k as f64 * angle_rad).cos();
    (1.0 + 2.0 * (1..half).map(cosine).sum::<f64>() + cosine(half)) / PHASES as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_waves_between_the_simulated_phases() {
        let of = |angle: f64| {
            vec![1.0 + angle.sin() - 0.3 * (2.0 * angle + 0.4).cos() + 0.1 * (5.0 * angle).sin()]
        };
        let simulated: Vec<Vec<f64>> = (0..PHASES).map(|p| of(p as f64 / PHASES as f64 * TAU)).collect();
        for index in 0..PHASES * BETWEEN {
            let expected = of(index as f64 / (PHASES * BETWEEN) as f64 * TAU)[0];
            assert!((between(&simulated, index)[0] - expected).abs() < 1e-12, "{index}");
        }
    }
}
