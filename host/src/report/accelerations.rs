//! Measured accelerations of all passages.

use crate::analysis::PassageResult;

use super::page::{Figure, Key};
use super::plot::{Axis, BLUE, GREY, Layer, Plot, range_of};
use super::{ReportError, traces};

/// Overview of the whole train, then the first bogie.
pub(super) fn figures(passages: &[PassageResult]) -> Result<Vec<Figure>, ReportError> {
    let end = traces::train_length_m(passages);
    Ok(vec![
        Figure {
            title: "Sleeper acceleration".into(),
            caption: "Every passage, low-passed at 250 Hz and aligned on its first axle. Ticks along the top: axles."
                .into(),
            keys: vec![Key::line("one passage", BLUE)],
            svg: plot(passages, (-12.0, end + 12.0), 1)?,
        },
        Figure {
            title: "Sleeper acceleration, first bogie".into(),
            caption: "The same, closer.".into(),
            keys: vec![Key::line("one passage", BLUE)],
            svg: plot(passages, (-4.0, 7.0), 2)?,
        },
    ])
}

fn plot(passages: &[PassageResult], range: (f64, f64), width: u32) -> Result<String, ReportError> {
    let trace = |p: &PassageResult| {
        let points = traces::over_distance(p, &p.acceleration_m_s2);
        traces::thin(&points, range, 600)
    };
    let all: Vec<_> = passages.iter().map(trace).collect();
    let (low, high) = range_of(all.iter().flatten().map(|p| p.1), 0.06);
    let mut layers: Vec<Layer> =
        all.into_iter().map(|points| Layer::Line { points, color: BLUE, opacity: 0.35, width }).collect();
    let axles = traces::axle_distances_m(passages);
    let tick = 0.03 * (high - low);
    layers.push(Layer::Whiskers {
        points: axles.into_iter().map(|x| (x, high - tick, high)).collect(),
        color: GREY,
        opacity: 1.0,
        width: 4,
    });
    let plot = Plot {
        x: Axis { caption: "run since the first axle passed the nose tip, m", range },
        y: Axis { caption: "acceleration, m/s²", range: (low, high) },
        down: false,
        height: 720,
        layers,
    };
    plot.svg("sleeper acceleration of all passages over the run of the train")
}
