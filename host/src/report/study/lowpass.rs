//! Misfit over the cut-off, and displacements with and without low-pass (paper, eq. 3 and fig. 9).

use plotters::style::RGBColor;

use super::NamedSvg;
use crate::report::ReportError;
use crate::report::grid::grid;
use crate::report::plot::{Axis, BLUE, GREY, Layer, ORANGE, Plot, Point, RED, range_of};
use crate::study::lowpass::{Curve, LowPass, Misfit, PAPER_WAVELENGTH_M, PadResult};
use crate::study::panels;

/// Wavelengths shown, metres.
const SHOWN_M: (f64, f64) = (1.0, 6.0);
/// Positions shown, metres.
const POSITION_M: (f64, f64) = (-6.0, 9.0);
/// Every which sample is drawn.
const THIN: usize = 16;

/// Misfit, and the displacements on soft pads.
pub fn figures(study: &LowPass) -> Result<Vec<NamedSvg>, ReportError> {
    let soft = &study.pads[0];
    Ok(vec![
        ("study-lowpass-misfit".into(), misfit(study)?),
        ("study-lowpass-displacement".into(), displacement(soft)?),
    ])
}

fn misfit(study: &LowPass) -> Result<String, ReportError> {
    let colors = [ORANGE, BLUE];
    let line = |m: &Misfit| -> Vec<Point> {
        let points = m.cut_off_hz.iter().zip(&m.ratio).map(|(f, r)| (m.speed_m_s / f, 100.0 * r));
        points.filter(|p| p.0 >= SHOWN_M.0 && p.0 <= SHOWN_M.1).collect()
    };
    let lines: Vec<Vec<Point>> = study.pads.iter().map(|p| line(&p.all)).collect();
    let range = range_of(lines.iter().flatten().map(|p| p.1).chain([0.0]), 0.05);
    let mut layers = vec![
        Layer::Dashed {
            points: vec![(PAPER_WAVELENGTH_M, range.0), (PAPER_WAVELENGTH_M, range.1)],
            color: GREY,
            width: 4,
        },
        Layer::Word {
            at: (PAPER_WAVELENGTH_M + 0.05, 0.95 * range.1),
            text: "paper: 2.3 m".into(),
            color: GREY,
        },
    ];
    for (k, (pad, points)) in study.pads.iter().zip(lines).enumerate() {
        let best = (pad.all.best_m(), 100.0 * pad.all.least());
        let text = format!("{}: {:.2} m, {:.1} %", pad.pads.name, best.0, best.1);
        layers.push(Layer::Line { points, color: colors[k], opacity: 1.0, width: 5 });
        layers.push(Layer::Dots { points: vec![best], color: colors[k], opacity: 1.0, size: 12 });
        let height = (0.22 - 0.08 * k as f64) * range.1;
        layers.push(Layer::Word { at: (3.9, height), text, color: colors[k] });
    }
    Plot {
        x: Axis { caption: "cut-off as wavelength, m", range: SHOWN_M },
        y: Axis { caption: "misfit, %", range: (0.0, range.1) },
        down: false,
        height: 760,
        layers,
    }
    .svg("misfit of the low-passed displacement over the cut-off wavelength")
}

/// Above as simulated, below low-passed; a column per ballast.
fn displacement(pads: &PadResult) -> Result<String, ReportError> {
    let names: Vec<&str> = panels::all().iter().map(|p| p.name).collect();
    let mut plots = Vec::new();
    for (half, what) in ["as simulated", "low-passed"].iter().enumerate() {
        for (name, curves) in names.iter().zip(&pads.curves) {
            plots.push((format!("ballast {name}, {what}"), one(curves, half == 1)?));
        }
    }
    Ok(grid(
        &plots,
        3,
        600,
        "sleeper displacement of six geometries on six ballasts, with and without low-pass",
    ))
}

fn one(curves: &[Curve], low: bool) -> Result<String, ReportError> {
    let points = |c: &Curve, low: bool| -> Vec<Point> {
        let values = if low { &c.low_m } else { &c.displacement_m };
        let all = c.position_m.iter().zip(values).step_by(THIN).map(|(x, d)| (*x, 1e3 * d));
        all.filter(|p| p.0 >= POSITION_M.0 && p.0 <= POSITION_M.1).collect()
    };
    // The same scale in both rows, so that they can be compared.
    let range = range_of(curves.iter().flat_map(|c| points(c, false)).map(|p| p.1), 0.05);
    let mut layers: Vec<Layer> = curves
        .iter()
        .skip(1)
        .enumerate()
        .map(|(k, c)| Layer::Line { points: points(c, low), color: shade(k), opacity: 0.9, width: 3 })
        .collect();
    if let Some(level) = curves.first() {
        layers.push(Layer::Dashed { points: points(level, false), color: RED, width: 4 });
    }
    Plot {
        x: Axis { caption: "front wheels behind the nose tip, m", range: POSITION_M },
        y: Axis { caption: "displacement, mm", range },
        down: true,
        height: 600,
        layers,
    }
    .svg("sleeper displacement of six geometries and of a level rail (dashed)")
}

/// Six blues, light to dark.
fn shade(k: usize) -> RGBColor {
    let f = |from: f64, to: f64| (from + (to - from) * k as f64 / 5.0) as u8;
    RGBColor(f(150.0, 10.0), f(190.0, 50.0), f(230.0, 110.0))
}
