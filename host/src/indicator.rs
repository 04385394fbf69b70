//! Condition indicators over the passages of a site (paper, section 7).

use faer::Mat;

use crate::analysis::{Condition, Indicators, Interval, PassageResult, Spread, WheelsetResult, explained};
use crate::identify::Misdescription;
use crate::limits::{CLIPPED, MODEL_GAP};
use crate::mean_interval::MeanErrors;
use crate::signal::{HALF_WIDTH_90, mean, mean_of, quantile};

/// Force peak over static wheel force above which a crossing counts as damaged. The paper's fig. 21 separates healthy
/// from damaged panels between about 1.9 and 2.3 times the static force; the middle is taken.
pub const PEAK_RATIO_THRESHOLD: f64 = 2.1;
/// RMS of the band-passed irregularity above which a crossing counts as damaged, metres.
pub const IRREGULARITY_RMS_THRESHOLD_M: f64 = 0.20e-3;
/// Within this share of a threshold a healthy crossing is watched.
const NEAR: f64 = 0.1;

/// How soon to act where the numbers cannot tell.
const UNSURE: &str = "schedulable";
/// Advice where the model explains no passage.
const UNEXPLAINED: &str = "The calibrated model does not explain these recordings, so that forces and irregularity mean nothing: look at a \
                           few in the report for drift, interference, gaps or another train, compare crossing.toml with the crossing, and \
                           run `cpcm diagnose`.";
/// Advice where most recordings are clipped.
const CUT_OFF: &str = "The sensor clips in most of the recordings, so that force peaks are cut off and ballast and forces wrong by more than \
                       their intervals: fit one with a larger range.";
/// Advice where something acts that the model does not hold.
const GAP: &str = "Something acts that the calibrated model does not hold, so that forces may be wrong by more than their intervals: run \
                   `cpcm diagnose`, which may say what.";

/// Indicators of the passages that the model explains, of all where it explains none; `static_force_n` sets the force threshold.
pub fn indicators(passages: &[PassageResult], position_m: &[f64], static_force_n: f64) -> Indicators {
    let wheels: Vec<&WheelsetResult> = explained(passages).into_iter().flat_map(|p| &p.wheelsets).collect();
    let peaks: Vec<f64> = wheels.iter().map(|w| w.peak_force_n.value).collect();
    let rms: Vec<f64> = wheels.iter().map(|w| w.irregularity_rms_m).collect();
    let peak_force_n = spread(&peaks, PEAK_RATIO_THRESHOLD * static_force_n);
    let irregularity_rms_m = spread(&rms, IRREGULARITY_RMS_THRESHOLD_M);
    let nothing_explained = !passages.is_empty() && !passages.iter().any(PassageResult::explained);
    let condition =
        if nothing_explained { Condition::Watch } else { condition(&peak_force_n, &irregularity_rms_m) };
    let advice = advice(condition, &peak_force_n, &irregularity_rms_m);
    let (condition, urgency, recommended_action) =
        doubted(condition, advice, doubt(passages, nothing_explained));
    Indicators {
        peak_force_n,
        irregularity_rms_m,
        force_mode_n: first_mode(
            &wheels.iter().map(|w| w.contact_force_n.as_slice()).collect::<Vec<_>>(),
            position_m.len(),
        ),
        irregularity_mode_m: first_mode(
            &wheels.iter().map(|w| w.irregularity_m.as_slice()).collect::<Vec<_>>(),
            position_m.len(),
        ),
        mean_irregularity_m: mean_of(&wheels.iter().map(|w| w.irregularity_m.clone()).collect::<Vec<_>>())
            .into_iter()
            .map(|value| Interval { value, lower: f64::NAN, upper: f64::NAN })
            .collect(),
        position_m: position_m.to_vec(),
        condition,
        urgency: urgency.into(),
        recommended_action,
    }
}

/// Why a site's indicators are not to be taken at their word.
fn doubt(passages: &[PassageResult], nothing_explained: bool) -> Option<&'static str> {
    let most = |flag: &str| 2 * passages.iter().filter(|p| p.has_flag(flag)).count() > passages.len();
    let gravest_first = [(most(CLIPPED), CUT_OFF), (nothing_explained, UNEXPLAINED), (most(MODEL_GAP), GAP)];
    gravest_first.into_iter().find(|(holds, _)| *holds).map(|(_, why)| why)
}

/// A verdict with a doubt: no crossing is healthy then; one that is damaged all the same stays so.
fn doubted(
    condition: Condition,
    (urgency, action): (&'static str, &'static str),
    doubt: Option<&str>,
) -> (Condition, &'static str, String) {
    match (doubt, condition) {
        (None, _) => (condition, urgency, action.into()),
        (Some(doubt), Condition::Damaged) => (condition, urgency, format!("{action} {doubt}")),
        (Some(doubt), _) => (Condition::Watch, UNSURE, doubt.into()),
    }
}

impl Indicators {
    /// The same with the intervals of the means.
    pub fn with_errors(mut self, errors: &MeanErrors) -> Self {
        let around = |mean: f64, sd: f64| [mean - HALF_WIDTH_90 * sd, mean + HALF_WIDTH_90 * sd];
        for (spread, sd) in [
            (&mut self.peak_force_n, errors.peak_force_n),
            (&mut self.irregularity_rms_m, errors.irregularity_rms_m),
        ] {
            spread.mean90 = around(spread.mean, sd);
        }
        for (interval, sd) in self.mean_irregularity_m.iter_mut().zip(&errors.irregularity_m) {
            [interval.lower, interval.upper] = around(interval.value, *sd);
        }
        self
    }

    /// The same where crossing.toml describes another panel than the recorded one: no verdict, and what to correct.
    pub fn misdescribed(self, misdescription: &Misdescription) -> Self {
        Self {
            condition: Condition::Watch,
            urgency: UNSURE.into(),
            recommended_action: format!(
                "The recordings contradict crossing.toml: {misdescription}. Forces and irregularity mean nothing; correct it and analyse \
                 again."
            ),
            ..self
        }
    }
}

fn spread(values: &[f64], threshold: f64) -> Spread {
    Spread {
        mean: mean(values),
        mean90: [f64::NAN; 2],
        p10: quantile(values, 0.1),
        p90: quantile(values, 0.9),
        threshold,
    }
}

fn condition(force: &Spread, irregularity: &Spread) -> Condition {
    let above = |s: &Spread| s.mean > s.threshold;
    let near = |s: &Spread| s.mean > (1.0 - NEAR) * s.threshold;
    match (above(force), above(irregularity)) {
        (true, true) => Condition::Damaged,
        (false, false) if !near(force) && !near(irregularity) => Condition::Healthy,
        _ => Condition::Watch,
    }
}

fn advice(condition: Condition, force: &Spread, irregularity: &Spread) -> (&'static str, &'static str) {
    match condition {
        Condition::Healthy => ("none", "No action. Keep monitoring."),
        Condition::Watch if force.mean / force.threshold >= irregularity.mean / irregularity.threshold => (
            "schedulable",
            "Inspect the transition for a short dip or step at the position of the force peak; grind it at the next possession.",
        ),
        Condition::Watch => (
            "schedulable",
            "Measure the crossing geometry (scan or template); plan grinding or welding if the wear is confirmed.",
        ),
        Condition::Damaged => (
            "urgent: days",
            "Inspect the crossing now: forces and irregularity are both beyond the threshold. Weld and grind, or replace it.",
        ),
    }
}

/// First left singular vector of the wheels' curves times its singular value, scaled to the size of one wheel, and
/// with the sign of the mean (paper, section 6.2). Curves of another length than `len` are left out.
pub fn first_mode(curves: &[&[f64]], len: usize) -> Vec<f64> {
    let usable: Vec<&&[f64]> = curves.iter().filter(|c| c.len() == len).collect();
    if usable.is_empty() || len == 0 {
        return vec![0.0; len];
    }
    let matrix = Mat::from_fn(len, usable.len(), |i, j| usable[j][i]);
    let Ok(svd) = matrix.thin_svd() else { return vec![0.0; len] };
    let weight = mean(&(0..usable.len()).map(|j| svd.V()[(j, 0)]).collect::<Vec<_>>());
    let size = svd.S().column_vector()[0] * weight;
    (0..len).map(|i| svd.U()[(i, 0)] * size).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::examples::{passage, wheelset};

    /// Indicators of one wheel, as shares of their thresholds.
    fn of_wheel([force, irregularity]: [f64; 2], flags: &[&str]) -> Indicators {
        let static_n = 76e3;
        let peak_n = force * PEAK_RATIO_THRESHOLD * static_n;
        let wheel = wheelset(0, peak_n, irregularity * IRREGULARITY_RMS_THRESHOLD_M, flags);
        indicators(&[passage(vec![wheel])], &[0.0], static_n)
    }

    #[test]
    fn property_condition_urgency_and_advice_follow_from_both_thresholds() {
        use Condition::{Damaged, Healthy, Watch};
        let (dip, scan) = ("Inspect the transition for a short dip", "Measure the crossing geometry");
        for (shares, condition, urgency, advice) in [
            ([0.5, 0.5], Healthy, "none", "No action."),
            ([0.89, 0.89], Healthy, "none", "No action."),
            ([0.91, 0.5], Watch, "schedulable", dip),
            ([0.5, 0.91], Watch, "schedulable", scan),
            ([1.01, 0.99], Watch, "schedulable", dip),
            ([0.5, 1.5], Watch, "schedulable", scan),
            ([1.01, 1.01], Damaged, "urgent: days", "Inspect the crossing now"),
        ] {
            let found = of_wheel(shares, &[]);
            assert_eq!((found.condition, found.urgency.as_str()), (condition, urgency), "{shares:?}");
            assert!(found.recommended_action.starts_with(advice), "{shares:?}: {}", found.recommended_action);
        }
    }

    #[test]
    fn property_a_doubt_leaves_nothing_healthy_and_what_is_damaged_so() {
        let healthy = of_wheel([0.5, 0.5], &[CLIPPED]);
        assert_eq!((healthy.condition, healthy.recommended_action.as_str()), (Condition::Watch, CUT_OFF));
        let damaged = of_wheel([1.5, 1.5], &[CLIPPED]);
        assert_eq!((damaged.condition, damaged.urgency.as_str()), (Condition::Damaged, "urgent: days"));
        assert!(damaged.recommended_action.ends_with(CUT_OFF), "{}", damaged.recommended_action);
    }

    /// Of rank one: the singular vectors are the curve and the sizes, and their signs cancel.
    #[test]
    fn analytic_first_mode_of_one_curve_in_many_sizes_is_the_curve_in_their_mean_size() {
        let curve: [f64; 4] = [1.0, -2.0, 0.5, 3.0];
        let curves = [0.5, 2.0, -1.0, 1.5].map(|size| curve.map(|v| size * v));
        let mut all: Vec<&[f64]> = curves.iter().map(|c| c.as_slice()).collect();
        // Left out.
        all.push(&curve[..3]);
        let mode = first_mode(&all, 4);
        assert_eq!(mode.len(), 4);
        for (found, value) in mode.iter().zip(curve) {
            assert!((found - 0.75 * value).abs() < 1e-12, "{mode:?}");
        }
        assert_eq!(first_mode(&[], 2), [0.0, 0.0]);
    }
}
