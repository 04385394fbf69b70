//! Figures of a run of blind trials: what is found at which strength, whether stated probabilities hold, whether intervals
//! hold.

use std::collections::BTreeMap;

use super::ReportError;
use super::plot::{Axis, BLUE, GREEN, GREY, INK, Layer, ORANGE, Plot, Point, RED};
use crate::gap::trial::{Question, Score, bins};

/// Names of files and their content.
pub fn figures(scores: &[Score]) -> Result<Vec<(&'static str, String)>, ReportError> {
    Ok(vec![
        ("detection.svg", detection(scores)?),
        ("reliability.svg", reliability(scores)?),
        ("coverage.svg", coverage(scores)?),
    ])
}

/// Shown strengths, logarithm to base 10.
const STRENGTH: (f64, f64) = (-2.0, 1.6);

/// One row per effect: found or not over the change of the signal relative to the noise floor.
fn detection(scores: &[Score]) -> Result<String, ReportError> {
    let mut rows: BTreeMap<&str, Vec<&Score>> = BTreeMap::new();
    for s in scores.iter().filter(|s| s.answer.question == Question::One) {
        rows.entry(s.answer.effects[0].as_str()).or_default().push(s);
    }
    let n = rows.len().max(1) as f64;
    let mut layers =
        vec![Layer::Dashed { points: vec![(2f64.log10(), -0.5), (2f64.log10(), n)], color: GREY, width: 3 }];
    let (mut found, mut missed): (Vec<Point>, Vec<Point>) = (Vec::new(), Vec::new());
    for (i, (name, list)) in rows.iter().enumerate() {
        for s in list {
            let x = s.strength_to_floor.max(1e-9).log10().clamp(STRENGTH.0, STRENGTH.1);
            (if s.right { &mut found } else { &mut missed }).push((x, i as f64));
        }
        layers.push(Layer::Word { at: (-3.25, i as f64 + 0.28), text: (*name).into(), color: INK });
    }
    layers.push(Layer::Dots { points: missed, color: RED, opacity: 0.7, size: 9 });
    layers.push(Layer::Dots { points: found, color: GREEN, opacity: 0.7, size: 9 });
    Plot {
        x: Axis {
            caption: "change of the signal over the noise floor, log10 (dashed: twice)",
            range: (-3.3, 1.7),
        },
        y: Axis { caption: "", range: (-0.7, n) },
        down: false,
        height: 160 + 60 * n as u32,
        layers,
    }
    .svg("found (green) or not (red) against strength, per effect")
}

/// How often the first effect was there against its stated probability, with 90 % intervals.
fn reliability(scores: &[Score]) -> Result<String, ReportError> {
    let used: Vec<_> = bins(scores).into_iter().filter(|b| b.of > 0).collect();
    let share = |b: &crate::gap::trial::Bin| b.there as f64 / b.of as f64;
    let ends = |b: &crate::gap::trial::Bin| {
        let half = 1.645 * (share(b) * (1.0 - share(b)) / b.of as f64 + 0.25 / (b.of as f64).powi(2)).sqrt();
        (b.stated, (share(b) - half).max(0.0), (share(b) + half).min(1.0))
    };
    let mut layers = vec![
        Layer::Dashed { points: vec![(0.0, 0.0), (1.0, 1.0)], color: GREY, width: 3 },
        Layer::Whiskers { points: used.iter().map(ends).collect(), color: BLUE, opacity: 0.6, width: 3 },
        Layer::Dots {
            points: used.iter().map(|b| (b.stated, share(b))).collect(),
            color: BLUE,
            opacity: 1.0,
            size: 9,
        },
    ];
    layers.extend(used.iter().map(|b| Layer::Word {
        at: (b.stated + 0.015, share(b)),
        text: format!("{} of {}", b.there, b.of),
        color: BLUE,
    }));
    Plot {
        x: Axis { caption: "stated probability of the first effect", range: (0.0, 1.12) },
        y: Axis { caption: "part in which it was there", range: (0.0, 1.08) },
        down: false,
        height: 800,
        layers,
    }
    .svg("stated probability against frequency")
}

/// Intervals of the main parameter relative to the truth, ordered; a sound one crosses nought nine times in ten.
fn coverage(scores: &[Score]) -> Result<String, ReportError> {
    let mut intervals: Vec<[f64; 2]> = scores.iter().filter_map(|s| s.interval).collect();
    intervals.sort_by(|a, b| (a[0] + a[1]).total_cmp(&(b[0] + b[1])));
    let bar = |(i, v): (usize, &[f64; 2])| (i as f64, 100.0 * v[0], 100.0 * v[1]);
    let part = |inside: bool| -> Vec<(f64, f64, f64)> {
        let all = intervals.iter().enumerate();
        all.filter(|(_, v)| (v[0] <= 0.0 && v[1] >= 0.0) == inside).map(bar).collect()
    };
    let n = intervals.len().max(1) as f64;
    Plot {
        x: Axis { caption: "trials in which the effect was named, by error", range: (-1.0, n) },
        y: Axis { caption: "parameter over truth less 1, %", range: (-60.0, 60.0) },
        down: false,
        height: 760,
        layers: vec![
            Layer::Dashed { points: vec![(-1.0, 0.0), (n, 0.0)], color: GREY, width: 3 },
            Layer::Whiskers { points: part(true), color: BLUE, opacity: 0.8, width: 5 },
            Layer::Whiskers { points: part(false), color: ORANGE, opacity: 0.9, width: 5 },
        ],
    }
    .svg("90 % intervals of the main parameter relative to the truth; orange ones miss it")
}
