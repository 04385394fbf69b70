//! Contact force over position, all wheelsets.

use crate::analysis::Analysis;

use super::page::{Figure, Key};
use super::plot::{Axis, BLUE, GREY, Layer, ORANGE, Plot, Point, RED, range_of};
use super::{ReportError, traces};

pub(super) fn figure(analysis: &Analysis) -> Result<Figure, ReportError> {
    let passages = &analysis.passages;
    let all: Vec<Vec<Point>> =
        traces::wheelsets(passages).map(|w| traces::on_grid(w, &w.contact_force_n, 1e-3)).collect();
    let grid = traces::grid_m(passages);
    let spread = traces::spread(&all, grid.iter().copied());
    let half_widths: Vec<Vec<Point>> = traces::wheelsets(passages)
        .map(|w| {
            let half: Vec<f64> = w.upper_n.iter().zip(&w.lower_n).map(|(u, l)| 0.5e-3 * (u - l)).collect();
            traces::on_grid(w, &half, 1.0)
        })
        .collect();
    let half = traces::spread(&half_widths, grid.iter().copied());
    let i = &analysis.indicators;
    let mode = i.position_m.iter().zip(&i.force_mode_n).map(|(&x, &f)| (x, 1e-3 * f)).collect();
    let tops =
        traces::wheelsets(passages).map(|w| (w.peak_position_m, 1e-3 * w.peak_force_n.value)).collect();
    let v = &analysis.crossing.vehicle;
    let resting = 0.5e-3 * v.axle_load_kg * v.gravity_m_s2;
    let range = range_of(all.iter().flatten().map(|p| p.1).chain([0.0]), 0.04);
    let ends = (grid.first().copied().unwrap_or(-1.0), grid.last().copied().unwrap_or(1.0));
    let mut layers: Vec<Layer> =
        all.into_iter().map(|points| Layer::Line { points, color: GREY, opacity: 0.09, width: 2 }).collect();
    layers.extend([
        Layer::Dots { points: tops, color: GREY, opacity: 0.5, size: 4 },
        Layer::Band {
            points: spread.iter().map(|s| (s.x, s.p10, s.p90)).collect(),
            color: BLUE,
            opacity: 0.25,
        },
        Layer::Band {
            points: spread.iter().zip(&half).map(|(s, h)| (s.x, s.mean - h.mean, s.mean + h.mean)).collect(),
            color: BLUE,
            opacity: 0.55,
        },
        Layer::Dashed { points: vec![(ends.0, resting), (ends.1, resting)], color: GREY, width: 3 },
        Layer::Line {
            points: spread.iter().map(|s| (s.x, s.mean)).collect(),
            color: BLUE,
            opacity: 1.0,
            width: 3,
        },
        Layer::Dashed { points: mode, color: RED, width: 3 },
        Layer::Dashed { points: vec![(0.0, range.0), (0.0, range.1)], color: ORANGE, width: 2 },
        Layer::Word {
            at: (0.012, range.1 - 0.03 * (range.1 - range.0)),
            text: "nose tip".into(),
            color: ORANGE,
        },
    ]);
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
