//! How far the results of a site follow what crossing.toml may be wrong by.

use super::Spread;

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
        let n = counted.len().max(1) as f64;
        Change::each(&counted, |c| (c.iter().map(|v| v * v).sum::<f64>() / n).sqrt())
    }
}

/// What follows of all tolerances.
#[derive(Clone, Debug, PartialEq)]
pub struct Budget {
    /// By how far the force peaks follow, farthest first.
    pub consequences: Vec<Consequence>,
    /// The tolerances as the text of a file, to be changed and given back.
    pub stated: String,
}

impl Budget {
    /// Of these, in any order.
    pub fn new(mut consequences: Vec<Consequence>, stated: &str) -> Self {
        consequences.sort_by(|a, b| b.size().force_peak.total_cmp(&a.size().force_peak));
        Self { consequences, stated: stated.into() }
    }

    /// Half widths of 90 % intervals that hold all tolerances and nothing else, over the results: entries are wrong independently.
    pub fn total(&self) -> Change {
        let sizes: Vec<Change> = self.consequences.iter().map(Consequence::size).collect();
        Change::each(&sizes, |c| c.iter().map(|v| v * v).sum::<f64>().sqrt())
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

    /// 3, 4 and 12 % make 13 %, and with 5 % of the mean's own 13.93 %.
    #[test]
    fn analytic_tolerances_add_in_quadrature() {
        let consequences = vec![
            consequence("a", [Some(-0.03), Some(0.03)]),
            consequence("b", [Some(0.12), None]),
            consequence("c", [Some(0.0), Some(0.04 * 2f64.sqrt())]),
            consequence("d", [None, None]),
        ];
        let budget = Budget::new(consequences, "");
        let order: Vec<&str> = budget.consequences.iter().map(|c| c.tolerance.entry.as_str()).collect();
        assert_eq!(order, ["b", "c", "a", "d"]);
        let total = budget.total();
        assert!((total.force_peak - 0.13).abs() < 1e-12 && (total.p1 - 0.26).abs() < 1e-12, "{total:?}");
        let spread = Spread { mean: 200e3, mean90: [190e3, 200e3], p10: 0.0, p90: 0.0, threshold: 0.0 };
        let [lower, upper] = budget.peak_force_n(&spread);
        assert!((upper - 226e3).abs() < 1e-6, "{upper}");
        assert!((lower - (200e3 - 10e3f64.hypot(26e3))).abs() < 1e-6, "{lower}");
        assert_eq!(Budget::new(Vec::new(), "").peak_force_n(&spread), [190e3, 200e3]);
    }
}
