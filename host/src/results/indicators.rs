//! `indicators.json`, `modes.csv` and `mean_irregularity.csv`.

use serde::Serialize;

use crate::analysis::{Analysis, Budget, Change, Condition, Indicators, Interval, Spread};
use crate::recording::Skipped;

#[derive(Serialize)]
struct File<'a> {
    site: &'a str,
    cpcm_version: &'static str,
    condition: Condition,
    urgency: &'a str,
    recommended_action: &'a str,
    peak_force_n: Indicator,
    irregularity_rms_m: Indicator,
    ballast: Ballast,
    passages: Passages<'a>,
    /// Where they were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    tolerances: Option<Tolerances>,
    /// Description and recordings were corrected for them before.
    #[serde(skip_serializing_if = "<[String]>::is_empty")]
    effects_included: &'a [String],
}

#[derive(Serialize)]
struct Indicator {
    mean: f64,
    /// 90 % interval of the mean.
    mean90: [f64; 2],
    range80: [f64; 2],
    threshold: f64,
    first_svd_mode: Mode,
}

#[derive(Serialize)]
struct Mode {
    file: &'static str,
    column: &'static str,
}

#[derive(Serialize)]
struct Ballast {
    p1_n_m2: IntervalJson,
    p2_n_m2: IntervalJson,
    p3: IntervalJson,
    damping: Damping,
    misfit: f64,
}

/// Per metre of sleeper.
#[derive(Serialize)]
struct Damping {
    recorded_ns_m2: IntervalJson,
    used_ns_m2: f64,
    contradicts_description: bool,
}

/// 90 % intervals with all that crossing.toml may be wrong by, and the part of that alone, relative to the results.
#[derive(Serialize)]
struct Tolerances {
    file: &'static str,
    peak_force_mean90_n: [f64; 2],
    irregularity_rms_mean90_m: [f64; 2],
    plus_minus: Parts,
    /// Descriptions that were wrong by all tolerances at once, and those of which nothing was noticed; none with one tolerance.
    drawn: Option<usize>,
    unnoticed: Option<usize>,
}

#[derive(Serialize)]
struct Parts {
    peak_force: f64,
    irregularity_rms: f64,
    p1: f64,
    p2: f64,
}

/// A value with its 90 % interval.
#[derive(Serialize)]
struct IntervalJson {
    value: f64,
    lower: f64,
    upper: f64,
}

#[derive(Serialize)]
struct Passages<'a> {
    /// That the model explains, and their wheelsets: what the numbers above are of, unless it explains none, and they are of all.
    used: usize,
    wheelsets: usize,
    /// Read, and not explained by the model (flag `unlike-model`).
    left_out: Vec<i32>,
    /// Not usable, as read.
    skipped: &'a [Skipped],
}

impl From<Interval> for IntervalJson {
    fn from(i: Interval) -> Self {
        IntervalJson { value: i.value, lower: i.lower, upper: i.upper }
    }
}

fn indicator(spread: Spread, column: &'static str) -> Indicator {
    Indicator {
        mean: spread.mean,
        mean90: spread.mean90,
        range80: [spread.p10, spread.p90],
        threshold: spread.threshold,
        first_svd_mode: Mode { file: "modes.csv", column },
    }
}

fn tolerances(budget: &Budget, i: &Indicators) -> Tolerances {
    let Change { force_peak, irregularity_rms, p1, p2 } = budget.total();
    Tolerances {
        file: "tolerances.csv",
        peak_force_mean90_n: budget.peak_force_n(&i.peak_force_n),
        irregularity_rms_mean90_m: budget.irregularity_rms_m(&i.irregularity_rms_m),
        plus_minus: Parts { peak_force: force_peak, irregularity_rms, p1, p2 },
        drawn: budget.drawn.as_ref().map(|d| d.count),
        unnoticed: budget.drawn.as_ref().map(|d| d.unnoticed.len()),
    }
}

/// The text of `indicators.json`.
pub(super) fn json(analysis: &Analysis) -> String {
    let (i, b) = (&analysis.indicators, &analysis.ballast);
    let file = File {
        site: &analysis.crossing.name,
        cpcm_version: env!("CARGO_PKG_VERSION"),
        condition: i.condition,
        urgency: &i.urgency,
        recommended_action: &i.recommended_action,
        peak_force_n: indicator(i.peak_force_n, "force_mode_n"),
        irregularity_rms_m: indicator(i.irregularity_rms_m, "irregularity_mode_m"),
        ballast: Ballast {
            p1_n_m2: b.p1_n_m2.into(),
            p2_n_m2: b.p2_n_m2.into(),
            p3: b.p3.into(),
            damping: Damping {
                recorded_ns_m2: b.damping.recorded_ns_m2.into(),
                used_ns_m2: b.damping.used_ns_m2,
                contradicts_description: b.damping.contradicts_description(),
            },
            misfit: b.misfit,
        },
        passages: Passages {
            used: analysis.used_and_left_out().0,
            wheelsets: analysis.wheelsets(),
            left_out: analysis.passages.iter().filter(|p| !p.explained()).map(|p| p.passage_id).collect(),
            skipped: &analysis.skipped,
        },
        tolerances: analysis.budget.as_ref().map(|b| tolerances(b, i)),
        effects_included: &analysis.effects_included,
    };
    // Numbers and strings only: serde_json writes NaN as null and has nothing else to refuse.
    serde_json::to_string_pretty(&file).unwrap_or_default() + "\n"
}

/// Mean irregularity with its 90 % interval.
pub(super) fn mean_irregularity_csv(indicators: &Indicators) -> String {
    let mut text = String::from("position_m,irregularity_m,lower_m,upper_m\n");
    for (x, z) in indicators.position_m.iter().zip(&indicators.mean_irregularity_m) {
        text.push_str(&format!("{x:.6},{},{},{}\n", z.value, z.lower, z.upper));
    }
    text
}

/// First SVD modes on their common grid.
pub(super) fn modes_csv(indicators: &Indicators) -> String {
    let mut text = String::from("position_m,force_mode_n,irregularity_mode_m\n");
    let modes = indicators.force_mode_n.iter().zip(&indicators.irregularity_mode_m);
    for (x, (f, z)) in indicators.position_m.iter().zip(modes) {
        text.push_str(&format!("{x:.6},{f},{z}\n"));
    }
    text
}
