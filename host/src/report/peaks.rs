//! Force peaks, passage by passage.

use crate::analysis::{Analysis, PassageResult};

use super::ReportError;
use super::page::{Figure, Key};
use super::plot::{Axis, BLUE, Layer, ORANGE, Plot, Point, RED, range_of};

pub(super) fn figure(analysis: &Analysis) -> Result<Figure, ReportError> {
    let spread = analysis.indicators.peak_force_n;
    let threshold = 1e-3 * spread.threshold;
    let peaks: Vec<Peak> = analysis.passages.iter().enumerate().flat_map(peaks).collect();
    let ends = (0.2, analysis.passages.len().max(1) as f64 + 0.8);
    let range = range_of(peaks.iter().flat_map(|p| [p.lower, p.upper]).chain([threshold]), 0.06);
    let (low, high) = (1e-3 * spread.p10, 1e-3 * spread.p90);
    let mut layers = vec![
        Layer::Band { points: vec![(ends.0, low, high), (ends.1, low, high)], color: BLUE, opacity: 0.1 },
        Layer::Whiskers {
            points: peaks.iter().map(|p| (p.x, p.lower, p.upper)).collect(),
            color: BLUE,
            opacity: 0.4,
            width: 3,
        },
        Layer::Dots {
            points: peaks.iter().map(|p| (p.x, p.value)).collect(),
            color: BLUE,
            opacity: 0.9,
            size: 5,
        },
        Layer::Dashed { points: vec![(ends.0, threshold), (ends.1, threshold)], color: RED, width: 4 },
    ];
    let mean = |p| Layer::Line { points: mean(p), color: ORANGE, opacity: 1.0, width: 6 };
    layers.extend(analysis.passages.iter().enumerate().map(mean));
    let plot = Plot {
        x: Axis { caption: "passage, as in the table of peaks", range: ends },
        y: Axis { caption: "peak force, kN", range },
        down: false,
        height: 640,
        layers,
    };
    page(plot)
}

fn page(plot: Plot) -> Result<Figure, ReportError> {
    Ok(Figure {
        title: "Force peaks".into(),
        caption: "Largest contact force of each wheelset in the transition; the wheelsets of a passage side by side."
            .into(),
        keys: vec![
            Key::dot("one wheelset, with 90 % interval", BLUE),
            Key::line("mean of the passage", ORANGE),
            Key::faint("middle 80 % of all wheelsets", BLUE),
            Key::dashed("threshold", RED),
        ],
        svg: plot.svg("force peaks of all wheelsets per passage")?,
    })
}

/// Peak of one wheelset, kN, at its place on the passage axis.
struct Peak {
    x: f64,
    value: f64,
    lower: f64,
    upper: f64,
}

/// Place of a passage on the axis, from 1 on: identifiers may be far apart.
fn place(order: usize) -> f64 {
    order as f64 + 1.0
}

/// The wheelsets of a passage stand side by side over its place.
fn peaks((order, p): (usize, &PassageResult)) -> Vec<Peak> {
    let place = |k: usize| place(order) + 0.7 * ((k as f64 + 0.5) / p.wheelsets.len() as f64 - 0.5);
    let peak = |(k, w): (usize, &crate::analysis::WheelsetResult)| Peak {
        x: place(k),
        value: 1e-3 * w.peak_force_n.value,
        lower: 1e-3 * w.peak_force_n.lower,
        upper: 1e-3 * w.peak_force_n.upper,
    };
    p.wheelsets.iter().enumerate().map(peak).collect()
}

/// A short line at the mean of a passage.
fn mean((order, p): (usize, &PassageResult)) -> Vec<Point> {
    let all: Vec<f64> = p.wheelsets.iter().map(|w| 1e-3 * w.peak_force_n.value).collect();
    let (x, mean) = (place(order), crate::signal::mean(&all));
    if all.is_empty() { Vec::new() } else { vec![(x - 0.42, mean), (x + 0.42, mean)] }
}
