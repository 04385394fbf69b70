//! Contact force over position, all wheelsets.

use crate::analysis::{Analysis, WheelsetResult};
use crate::indicator::PEAK_RATIO_THRESHOLD;

use super::page::{Figure, Key};
use super::plot::{Axis, BLUE, GREY, Layer, ORANGE, Plot, Point, RED, range_of};
use super::{ReportError, traces};

pub(super) fn figure(analysis: &Analysis) -> Result<Figure, ReportError> {
    let passages = &analysis.passages;
    let on_grid = |w: &WheelsetResult| traces::on_grid(w, &w.contact_force_n, 1e-3);
    let all: Vec<Vec<Point>> = traces::wheelsets(passages).map(on_grid).collect();
    let range = range_of(all.iter().flatten().map(|p| p.1).chain([0.0]), 0.04);
    let ends = traces::grid_ends_m(passages);
    let mut layers = wheelsets(analysis, &all);
    layers.extend(statistics(analysis, &all));
    layers.extend(landmarks(analysis, ends, range));
    let plot = Plot {
        x: Axis { caption: "position x, m", range: ends },
        y: Axis { caption: "contact force, kN", range },
        down: false,
        height: 800,
        layers,
    };
    Ok(Figure {
        title: "Wheel\u{2013}rail contact force".into(),
        caption: "Crossing side, low-passed at 250 Hz, over the transition from wing rail to nose.".into(),
        keys: vec![
            Key::line("one wheelset, with its peak", GREY),
            Key::line("mean", BLUE),
            Key::band("90 % interval of one wheelset, about the mean", BLUE),
            Key::faint("middle 80 % of the wheelsets", BLUE),
            Key::dashed("first SVD mode", RED),
            Key::dashed("static wheel force", GREY),
        ],
        svg: plot.svg("contact force over position for all wheelsets")?,
    })
}

/// Every wheelset and its peak; faint, because there are hundreds.
fn wheelsets(analysis: &Analysis, all: &[Vec<Point>]) -> Vec<Layer> {
    let line =
        |points: &Vec<Point>| Layer::Line { points: points.clone(), color: GREY, opacity: 0.09, width: 2 };
    let peak = |w: &WheelsetResult| (w.peak_position_m, 1e-3 * w.peak_force_n.value);
    let peaks = traces::wheelsets(&analysis.passages).map(peak).collect();
    let dots = Layer::Dots { points: peaks, color: GREY, opacity: 0.5, size: 4 };
    all.iter().map(line).chain([dots]).collect()
}

/// Spread over the wheelsets, mean with the interval of one wheelset, first mode.
fn statistics(analysis: &Analysis, all: &[Vec<Point>]) -> Vec<Layer> {
    let passages = &analysis.passages;
    let grid = traces::grid_m(passages);
    let half_width = |w: &WheelsetResult| {
        let half: Vec<f64> =
            w.upper_n.iter().zip(&w.lower_n).map(|(upper, lower)| 0.5 * (upper - lower)).collect();
        traces::on_grid(w, &half, 1e-3)
    };
    let half_widths: Vec<Vec<Point>> = traces::wheelsets(passages).map(half_width).collect();
    let spread = traces::spread(all, grid.iter().copied());
    let half = traces::spread(&half_widths, grid.iter().copied());
    let interval = spread.iter().zip(&half).map(|(s, h)| (s.x, s.mean - h.mean, s.mean + h.mean)).collect();
    let i = &analysis.indicators;
    let mode = i.position_m.iter().zip(&i.force_mode_n).map(|(&x, &f)| (x, 1e-3 * f)).collect();
    vec![
        Layer::Band { points: traces::band(&spread), color: BLUE, opacity: 0.25 },
        Layer::Band { points: interval, color: BLUE, opacity: 0.55 },
        Layer::Line { points: traces::means(&spread), color: BLUE, opacity: 1.0, width: 3 },
        Layer::Dashed { points: mode, color: RED, width: 3 },
    ]
}

/// Static wheel force and nose tip.
fn landmarks(analysis: &Analysis, ends: (f64, f64), range: (f64, f64)) -> Vec<Layer> {
    let resting = 1e-3 * analysis.indicators.peak_force_n.threshold / PEAK_RATIO_THRESHOLD;
    let word = (0.012, range.1 - 0.03 * (range.1 - range.0));
    vec![
        Layer::Dashed { points: vec![(ends.0, resting), (ends.1, resting)], color: GREY, width: 3 },
        Layer::Dashed { points: vec![(0.0, range.0), (0.0, range.1)], color: ORANGE, width: 2 },
        Layer::Word { at: word, text: "nose tip".into(), color: ORANGE },
    ]
}
