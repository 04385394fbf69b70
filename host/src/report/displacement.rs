//! Reconstructed sleeper displacement against the calibrated model.

use crate::analysis::PassageResult;

use super::ReportError;
use super::page::{Figure, Key};
use super::plot::{Axis, BLUE, GREY, Layer, ORANGE, Plot, Point, range_of};
use super::traces::{self, Spread};

/// Step of the common grid, metres: a twentieth of the wheelbase at least.
const STEP_M: f64 = 0.05;

/// Overview of the whole train, then the first bogie.
pub(super) fn figures(passages: &[PassageResult], misfit: f64) -> Result<Vec<Figure>, ReportError> {
    let end = traces::train_length_m(passages);
    let measured = statistics(passages, end, |p| &p.displacement_m);
    let model = statistics(passages, end, |p| &p.model_displacement_m);
    let keys = || {
        vec![
            Key::line("measured above 3 Hz, mean", BLUE),
            Key::band("measured above 3 Hz, middle 80 % of the passages", BLUE),
            Key::line("calibrated model, constant wheel forces, mean", ORANGE),
        ]
    };
    let percent = 100.0 * misfit;
    Ok(vec![
        Figure {
            title: "Sleeper displacement".into(),
            caption: format!(
                "Displacement from the measured acceleration against the calibrated model. Below 3 Hz, where an acceleration \
                 says nothing of it, the model's own is shown: most of the curve where trains are slow. Remaining misfit: {percent:.1} % \
                 of the displacement shown."
            ),
            keys: keys(),
            svg: plot(&measured, &model, (-12.0, end + 12.0), passages)?,
        },
        Figure {
            title: "Sleeper displacement, first bogie".into(),
            caption: "The same, closer. What the model does not follow is the dynamic part that the crossing causes."
                .into(),
            keys: keys(),
            svg: plot(&measured, &model, (-4.0, 7.0), passages)?,
        },
    ])
}

fn statistics(passages: &[PassageResult], end: f64, trace: fn(&PassageResult) -> &[f64]) -> Vec<Spread> {
    let in_mm = |p: &PassageResult| -> Vec<Point> {
        traces::over_distance(p, trace(p)).into_iter().map(|(x, v)| (x, 1e3 * v)).collect()
    };
    let all: Vec<Vec<Point>> = passages.iter().map(in_mm).collect();
    let steps = ((end + 24.0) / STEP_M) as usize;
    traces::spread(&all, (0..=steps).map(|i| -12.0 + STEP_M * i as f64))
}

fn plot(
    measured: &[Spread],
    model: &[Spread],
    range: (f64, f64),
    passages: &[PassageResult],
) -> Result<String, ReportError> {
    let within = |s: &&Spread| s.x >= range.0 && s.x <= range.1;
    let values = measured.iter().chain(model).filter(within).flat_map(|s| [s.p10, s.p90, s.mean]);
    let (low, high) = range_of(values, 0.08);
    let axles = traces::axle_distances_m(passages).into_iter();
    let tick = 0.03 * (high - low);
    let layers = vec![
        Layer::Band { points: traces::band(measured), color: BLUE, opacity: 0.22 },
        Layer::Line { points: traces::means(measured), color: BLUE, opacity: 1.0, width: 4 },
        Layer::Line { points: traces::means(model), color: ORANGE, opacity: 1.0, width: 4 },
        Layer::Whiskers {
            points: axles.map(|x| (x, low, low + tick)).collect(),
            color: GREY,
            opacity: 1.0,
            width: 4,
        },
    ];
    let plot = Plot {
        x: Axis { caption: "run since the first axle passed the nose tip, m", range },
        y: Axis { caption: "displacement, mm (down)", range: (low, high) },
        down: true,
        height: 680,
        layers,
    };
    plot.svg("measured sleeper displacement against the calibrated model")
}
