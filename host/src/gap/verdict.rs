//! From numbers to a verdict.

use super::diagnosis::{Named, Ranked};
use super::effect::Stage;
use super::measure::Gap;

/// The verdict.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// The base model is as good as the recordings allow.
    NoGap,
    /// The named effects close the gap.
    Explained,
    /// They close part of it.
    PartlyExplained,
    /// There is a gap that no effect of the catalogue closes.
    Unexplained,
}

/// Part of the gap beyond the floor, in quadrature, relative to the floor, below which there is none. The reference
/// recordings have up to 0.2.
const NO_GAP: f64 = 0.6;
/// Closed fraction from which the gap counts as explained, and as partly explained.
const EXPLAINED: f64 = 0.75;
const PARTLY: f64 = 0.5;

/// How far a gap is above its floor, in quadrature.
fn excess(gap: f64, floor: f64) -> f64 {
    (gap * gap - floor * floor).max(0.0).sqrt() / floor.max(f64::MIN_POSITIVE)
}

/// Whether what is left is as good as nothing.
pub fn closed(gap: &Gap) -> bool {
    excess(gap.after, gap.noise_floor) < NO_GAP
}

/// The verdict on a gap with the effects found; `denied`: however small the gap, something else speaks against the model with them, so
/// that they explain less than the gap says, by one step: path or ballast can hardly be like that, the operator's speeds show another
/// clock, the displacement is missed, or wheels differ more than sound ones do.
pub fn verdict(gap: &Gap, effects: &[Named], denied: bool) -> Verdict {
    let closes = excess(gap.after, gap.noise_floor) < 0.5 * NO_GAP;
    match (effects.is_empty(), denied) {
        (true, false) if closed(gap) => Verdict::NoGap,
        (true, _) => Verdict::Unexplained,
        (false, false) if closes || gap.closed_fraction >= EXPLAINED => Verdict::Explained,
        (false, false) if gap.closed_fraction >= PARTLY => Verdict::PartlyExplained,
        (false, true) if gap.closed_fraction >= EXPLAINED => Verdict::PartlyExplained,
        (false, _) => Verdict::Unexplained,
    }
}

/// Stage that a gap points to, by the best of what was tried and not named; what is known of the recorder was not tried.
pub fn stage(verdict: Verdict, effects: &[Named], ranking: &[Ranked]) -> Option<Stage> {
    match (verdict, effects.first()) {
        (Verdict::NoGap, _) => None,
        (_, Some(first)) => Some(first.stage),
        (_, None) => ranking
            .iter()
            .filter(|r| r.gain.is_finite())
            .max_by(|a, b| a.gain.total_cmp(&b.gain))
            .map(|r| r.stage),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gap(before: f64, after: f64) -> Gap {
        let closed_fraction = if before > 1.0 { (before - after) / (before - 1.0) } else { 0.0 };
        Gap {
            before,
            after,
            noise_floor: 1.0,
            closed_fraction,
            closed_fraction_ci90: [closed_fraction; 2],
            bands: Vec::new(),
        }
    }

    fn pads() -> [Named; 1] {
        [Named {
            name: "pad-stiffness",
            stage: Stage::Track,
            probability: 0.9,
            parameters: Vec::new(),
            indistinguishable_from: Vec::new(),
            alternatives: Vec::new(),
            gained: 1.0,
        }]
    }

    #[test]
    fn property_a_path_no_scan_allows_is_never_no_gap_nor_explained() {
        assert_eq!(verdict(&gap(1.02, 1.02), &[], false), Verdict::NoGap);
        assert_eq!(verdict(&gap(1.02, 1.02), &[], true), Verdict::Unexplained);
        assert_eq!(verdict(&gap(2.0, 1.01), &pads(), false), Verdict::Explained);
        assert_eq!(verdict(&gap(2.0, 1.01), &pads(), true), Verdict::PartlyExplained);
        assert_eq!(verdict(&gap(2.0, 1.9), &pads(), true), Verdict::Unexplained);
        // Neither is what closes a part of it, nor a gap that was hardly there before and is as it was.
        assert_eq!(verdict(&gap(2.0, 1.4), &pads(), false), Verdict::PartlyExplained);
        assert_eq!(verdict(&gap(2.0, 1.4), &pads(), true), Verdict::Unexplained);
        assert_eq!(verdict(&gap(1.03, 1.031), &pads(), true), Verdict::Unexplained);
    }
}
