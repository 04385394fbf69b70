//! Baselines that step by as much as the signal and decay, beside another effect.

use cpcm::scenario::Effects;
use cpcm::scenario::effects::{BallastStiffening, BiasSteps, VoidedSleepers};
use cpcm_tests::diagnosed::{among, few, named, trial};
use cpcm_tests::tolerance;

/// Steps moved speeds by two percent and axles by a car, so that passages did not resemble one another and nothing was looked for; what
/// was left of steps, at the wrong place with a decay off a grid, passed for wheels that differ from one another.
#[test]
fn regress_stiffening_ballast_is_named_beside_steps_of_the_baseline() {
    let mut scenario = trial(501, 387, &["bias-step", "crossing-rail"]);
    let truth = BiasSteps { step_m_s2: 26.25, decay_s: 0.506 };
    scenario.simulation.effects = Effects {
        ballast_stiffening: Some(BallastStiffening { doubling_m: 0.103e-3, bilinear_factor: None }),
        bias_step: Some(truth),
        ..Effects::default()
    };
    let found = among(&few(&scenario), &["ballast-stiffening", "bias-step"]);
    assert_eq!(named(&found), ["bias-step", "ballast-stiffening"], "{:?} {:?}", found.verdict, found.remarks);
    assert!(found.gap.closed_fraction > tolerance::BESIDE_STEPS_CLOSED, "{:?}", found.gap);
    let value = |name: &str| found.effects[0].parameters.iter().find(|p| p.0 == name).unwrap().1;
    let off = [value("step_m_s2") / truth.step_m_s2, value("decay_s") / truth.decay_s];
    assert!(off.iter().all(|r| (r - 1.0).abs() < tolerance::STEP_SIZE_AND_DECAY), "{off:?}");
}

/// The sleeper rings on behind the train, and the train-free ends do not show the steps; but no void makes bogies of one train differ
/// in sign.
#[test]
fn regress_steps_of_the_baseline_are_named_beside_voids() {
    let mut scenario = trial(501, 57, &["support-loss", "axle-load"]);
    scenario.simulation.effects = Effects {
        voided_sleepers: Some(VoidedSleepers::in_the_middle(2.184e-3)),
        bias_step: Some(BiasSteps { step_m_s2: 5.277, decay_s: 0.186 }),
        ..Effects::default()
    };
    let found = among(&few(&scenario), &["voided-sleepers", "bias-step"]);
    assert_eq!(named(&found), ["bias-step", "voided-sleepers"], "{:?} {:?}", found.verdict, found.remarks);
    assert!(found.gap.closed_fraction > tolerance::STEPS_BESIDE_VOIDS_CLOSED, "{:?}", found.gap);
}
