//! How far the results of a site follow what crossing.toml may be wrong by.

use super::Spread;
use crate::signal::{self, HALF_WIDTH_90};

/// What an entry of crossing.toml may be wrong by.
#[derive(Clone, Debug, PartialEq)]
pub struct Tolerance {
    /// Its place in the file, as `rail.second_moment_m4`.
    pub entry: String,
    /// The number there, in its unit.
    pub value: f64,
    /// By how much it may be wrong, either way, in nine of ten cases; in the same unit.
    pub plus_minus: f64,
}

/// Change of results over the results themselves.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Change {
    /// Of the mean force peak.
    pub force_peak: f64,
    /// Of the mean RMS of the irregularity.
    pub irregularity_rms: f64,
    /// Of the outer stiffness of the ballast.
    pub p1: f64,
    /// Of the stiffness under the crossing sleeper.
    pub p2: f64,
}

impl Change {
    fn each(changes: &[Self], of: impl Fn(&[f64]) -> f64) -> Self {
        let result = |place: fn(&Self) -> f64| of(&changes.iter().map(place).collect::<Vec<_>>());
        Self {
            force_peak: result(|c| c.force_peak),
            irregularity_rms: result(|c| c.irregularity_rms),
            p1: result(|c| c.p1),
            p2: result(|c| c.p2),
        }
    }

    /// Whether all are numbers.
    pub fn is_finite(&self) -> bool {
        [self.force_peak, self.irregularity_rms, self.p1, self.p2].iter().all(|c| c.is_finite())
    }
}

/// The analysis with an entry changed by its tolerance, or by the largest part of it (by halves) that the analysis does not notice: an entry
/// cannot be wrong by more, or that of the site as described would say so.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// The change, in the unit of the entry.
    pub by: f64,
    /// How far the results follow; none where a small part of the tolerance is noticed.
    pub change: Option<Change>,
    /// What the analysis says with the whole tolerance that it does not say of the site as described.
    pub noticed: Option<String>,
}

/// What follows of the tolerance of an entry.
#[derive(Clone, Debug, PartialEq)]
pub struct Consequence {
    /// The tolerance.
    pub tolerance: Tolerance,
    /// With the entry smaller by it.
    pub smaller: Outcome,
    /// With the entry larger by it.
    pub larger: Outcome,
}

impl Consequence {
    /// Size of the change that either way makes, the root of the mean of its squares: results need not follow in proportion, nor with
    /// either sign.
    pub fn size(&self) -> Change {
        let counted: Vec<Change> =
            [&self.smaller, &self.larger].into_iter().filter_map(|o| o.change).collect();
        rms(&counted, 1.0)
    }
}

/// Descriptions drawn within all tolerances at once, each analysed.
#[derive(Clone, Debug, PartialEq)]
pub struct Drawn {
    /// How many.
    pub count: usize,
    /// How far the results follow those of which the analysis notices nothing that it does not of the site as described: others are not so.
    pub unnoticed: Vec<Change>,
    /// The same of all others for which there are results.
    pub noticed: Vec<Change>,
}

impl Drawn {
    /// What counts: with few that go unnoticed those that are noticed as well; none where there are few of both.
    fn counted(&self) -> Option<Vec<Change>> {
        let mut counted = self.unnoticed.clone();
        if counted.len() < FEWEST {
            counted.extend(&self.noticed);
        }
        (counted.len() >= FEWEST).then_some(counted)
    }

    /// Which of the descriptions the total is of, in words.
    pub fn of_which(&self) -> String {
        let (unnoticed, results) = (self.unnoticed.len(), self.unnoticed.len() + self.noticed.len());
        match (unnoticed < FEWEST, results < FEWEST) {
            (false, _) => format!("of which {unnoticed} go unnoticed"),
            (true, false) => {
                format!("of which only {unnoticed} go unnoticed, so that all {results} with results count")
            }
            (true, true) => format!(
                "of which only {results} have results: too few, so that the consequences of single entries are added up in squares instead"
            ),
        }
    }
}

/// Descriptions that speak for all.
const FEWEST: usize = 8;

/// What follows of all tolerances.
#[derive(Clone, Debug, PartialEq)]
pub struct Budget {
    /// By how far the force peaks follow, farthest first.
    pub consequences: Vec<Consequence>,
    /// All at once; none where there is one tolerance only.
    pub drawn: Option<Drawn>,
    /// The tolerances as the text of a file, to be changed and given back.
    pub stated: String,
}

impl Budget {
    /// Of consequences in any order.
    pub fn new(mut consequences: Vec<Consequence>, drawn: Option<Drawn>, stated: &str) -> Self {
        consequences.sort_by(|a, b| b.size().force_peak.total_cmp(&a.size().force_peak));
        Self { consequences, drawn, stated: stated.into() }
    }

    /// Half widths of 90 % intervals that hold all tolerances and nothing else, over the results. Errors of one entry hide those of another
    /// from the analysis, so that together they do more than one by one.
    pub fn total(&self) -> Change {
        if let Some(counted) = self.drawn.as_ref().and_then(Drawn::counted) {
            return rms(&counted, HALF_WIDTH_90);
        }
        let sizes: Vec<Change> = self.consequences.iter().map(Consequence::size).collect();
        rms(&sizes, (sizes.len() as f64).sqrt())
    }

    /// 90 % interval of the mean force peak, tolerances included, newtons.
    pub fn peak_force_n(&self, spread: &Spread) -> [f64; 2] {
        widened(spread, self.total().force_peak)
    }

    /// 90 % interval of the mean RMS of the irregularity, tolerances included, metres.
    pub fn irregularity_rms_m(&self, spread: &Spread) -> [f64; 2] {
        widened(spread, self.total().irregularity_rms)
    }
}

/// Root of the mean of the squares, times a factor: wrong descriptions move results in one direction rather than the other, which is an error
/// as well.
fn rms(changes: &[Change], factor: f64) -> Change {
    Change::each(changes, |c| factor * signal::rms(c))
}

/// The interval of a mean with a further error, relative to it, that is independent of it.
fn widened(spread: &Spread, relative: f64) -> [f64; 2] {
    let Spread { mean, mean90: [lower, upper], .. } = *spread;
    let further = relative * mean;
    [mean - (mean - lower).hypot(further), mean + (upper - mean).hypot(further)]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn consequence(entry: &str, [smaller, larger]: [Option<f64>; 2]) -> Consequence {
        let of = |force_peak: f64| Change { force_peak, p1: -2.0 * force_peak, ..Change::default() };
        let outcome = |change: Option<f64>| Outcome { by: 0.1, change: change.map(of), noticed: None };
        Consequence {
            tolerance: Tolerance { entry: entry.into(), value: 1.0, plus_minus: 0.1 },
            smaller: outcome(smaller),
            larger: outcome(larger),
        }
    }

    fn changes(force_peaks: &[f64]) -> Vec<Change> {
        force_peaks.iter().map(|f| Change { force_peak: *f, p1: -2.0 * f, ..Change::default() }).collect()
    }

    #[test]
    fn analytic_entries_are_ordered_by_their_size() {
        let budget = Budget::new(
            vec![
                consequence("a", [Some(-0.03), Some(0.03)]),
                consequence("b", [Some(0.12), None]),
                consequence("c", [Some(0.0), Some(0.04 * 2f64.sqrt())]),
                consequence("d", [None, None]),
            ],
            None,
            "",
        );
        let sized = |c: &Consequence| (c.tolerance.entry.clone(), (1e4 * c.size().force_peak).round());
        let sizes: Vec<(String, f64)> = budget.consequences.iter().map(sized).collect();
        let expected = [("b", 1200.0), ("c", 400.0), ("a", 300.0), ("d", 0.0)];
        assert_eq!(sizes, expected.map(|(entry, size)| (entry.to_string(), size)));
    }

    /// One tolerance is its own total, beside 10 kN of the mean's own interval.
    #[test]
    fn analytic_one_tolerance() {
        let budget = Budget::new(vec![consequence("a", [Some(-0.12), Some(0.12)])], None, "");
        let spread = Spread { mean: 200e3, mean90: [190e3, 200e3], p10: 0.0, p90: 0.0, threshold: 0.0 };
        let [lower, upper] = budget.peak_force_n(&spread);
        assert!((lower - 174e3).abs() < 1e-6 && (upper - 224e3).abs() < 1e-6, "{lower} {upper}");
        assert_eq!(Budget::new(Vec::new(), None, "").peak_force_n(&spread), [190e3, 200e3]);
    }

    /// Of drawn descriptions those that are noticed count where there are few others.
    #[test]
    fn analytic_drawn_descriptions() {
        let total = |unnoticed: &[f64], noticed: &[f64]| {
            let (unnoticed, noticed) = (changes(unnoticed), changes(noticed));
            Budget::new(Vec::new(), Some(Drawn { count: 20, unnoticed, noticed }), "").total()
        };
        let many = total(&[0.03, -0.03, 0.03, 0.03, -0.03, 0.03, 0.03, 0.03], &[0.5]);
        assert!((many.force_peak - 0.03 * HALF_WIDTH_90).abs() < 1e-12, "{many:?}");
        assert!((many.p1 - 0.06 * HALF_WIDTH_90).abs() < 1e-12, "{many:?}");
        let few = total(&[0.01; 4], &[0.07; 4]);
        assert!((few.force_peak - 0.05 * HALF_WIDTH_90).abs() < 1e-12, "{few:?}");
    }

    /// Tolerances with which next to no description has results were followed by ± 0 %.
    #[test]
    fn regress_without_drawn_results_entries_are_added_up() {
        let entries =
            || vec![consequence("a", [Some(-0.03), Some(0.03)]), consequence("b", [Some(0.04), Some(0.04)])];
        let drawn = Drawn { count: 32, unnoticed: Vec::new(), noticed: changes(&[0.5]) };
        assert!(drawn.of_which().contains("too few"), "{}", drawn.of_which());
        let budget = Budget::new(entries(), Some(drawn), "");
        assert!((budget.total().force_peak - 0.05).abs() < 1e-12, "{:?}", budget.total());
    }
}
