//! Identified crossing irregularity, against the scan where there is one.

use crate::analysis::{Analysis, WheelsetResult};

use super::page::{Figure, Key};
use super::plot::{Axis, BLUE, GREEN, GREY, Layer, ORANGE, Plot, Point, RED, range_of};
use super::{ReportError, traces};

pub(super) fn figure(analysis: &Analysis) -> Result<Figure, ReportError> {
    let passages = &analysis.passages;
    let on_grid = |w: &WheelsetResult| traces::on_grid(w, &w.irregularity_m, 1e3);
    let all: Vec<Vec<Point>> = traces::wheelsets(passages).map(on_grid).collect();
    let scan = analysis.scan.as_ref().map(|s| in_mm(&s.position_m, &s.irregularity_m));
    let range = range_of(all.iter().chain(&scan).flatten().map(|p| p.1), 0.06);
    let mut layers = layers(analysis, all);
    let mut keys = vec![
        Key::line("one wheelset", GREY),
        Key::line("mean", BLUE),
        Key::band("90 % interval of the mean", GREEN),
        Key::band("middle 80 % of the wheelsets", BLUE),
        Key::dashed("first SVD mode", RED),
    ];
    if let Some(points) = scan {
        layers.push(Layer::Line { points, color: ORANGE, opacity: 1.0, width: 5 });
        keys.push(Key::line("laser scan, same band (for comparison only)", ORANGE));
    }
    let plot = Plot {
        x: Axis { caption: "position x, m (0 is the nose tip)", range: traces::grid_ends_m(passages) },
        y: Axis { caption: "irregularity, mm (down)", range },
        down: true,
        height: 760,
        layers,
    };
    Ok(Figure {
        title: "Crossing irregularity".into(),
        caption: "Vertical path of the wheel over the crossing as the wheel feels it, wavelengths from 1 m down to \
                  the limit of 250 Hz. The interval of the mean holds what all wheels share and one sensor cannot tell (force, \
                  ballast, position), and which trains came; vehicle and track apart from the ballast are taken as described."
            .into(),
        keys,
        svg: plot.svg("crossing irregularity over position for all wheelsets")?,
    })
}

fn in_mm(x: &[f64], z: &[f64]) -> Vec<Point> {
    x.iter().zip(z).map(|(&x, &z)| (x, 1e3 * z)).collect()
}

/// Interval of the mean, where one is stated, in mm.
fn of_mean(analysis: &Analysis) -> Vec<(f64, f64, f64)> {
    let i = &analysis.indicators;
    let stated = (i.position_m.iter().zip(&i.mean_irregularity_m))
        .filter(|(_, z)| z.lower.is_finite() && z.upper.is_finite());
    stated.map(|(x, z)| (*x, 1e3 * z.lower, 1e3 * z.upper)).collect()
}

/// Every wheelset, their spread, mean and first mode.
fn layers(analysis: &Analysis, all: Vec<Vec<Point>>) -> Vec<Layer> {
    let spread = traces::spread(&all, traces::grid_m(&analysis.passages).iter().copied());
    let i = &analysis.indicators;
    let line = |points| Layer::Line { points, color: GREY, opacity: 0.12, width: 2 };
    let mut layers: Vec<Layer> = all.into_iter().map(line).collect();
    layers.extend([
        Layer::Band { points: traces::band(&spread), color: BLUE, opacity: 0.22 },
        Layer::Band { points: of_mean(analysis), color: GREEN, opacity: 0.35 },
        Layer::Line { points: traces::means(&spread), color: BLUE, opacity: 1.0, width: 5 },
        Layer::Dashed { points: in_mm(&i.position_m, &i.irregularity_mode_m), color: RED, width: 4 },
    ]);
    layers
}
