//! Both condition indicators against their thresholds.

use crate::analysis::{Indicators, Spread};

use super::ReportError;
use super::page::{Figure, Key};
use super::plot::{Axis, BLUE, GREEN, Layer, ORANGE, Plot, RED};

/// Below this part of the threshold the crossing counts as healthy.
const WATCH_FROM: f64 = 0.9;

pub(super) fn figure(indicators: &Indicators) -> Result<Figure, ReportError> {
    let force = indicators.peak_force_n;
    let rms = indicators.irregularity_rms_m;
    let ratio = |s: Spread, v: f64| if s.threshold > 0.0 { v / s.threshold } else { f64::NAN };
    let largest = [ratio(force, force.p90), ratio(rms, rms.p90), 1.2].into_iter().fold(1.0, f64::max);
    let end = 1.12 * largest.min(20.0);
    let zone = |from: f64, to: f64, color| Layer::Band {
        points: vec![(from, 0.0, 2.0), (to, 0.0, 2.0)],
        color,
        opacity: 0.13,
    };
    let mut layers = vec![zone(0.0, WATCH_FROM, GREEN), zone(WATCH_FROM, 1.0, ORANGE), zone(1.0, end, RED)];
    let texts = [
        (force, 1.4, format!("force peak: {:.0} kN of {:.0} kN", 1e-3 * force.mean, 1e-3 * force.threshold)),
        (rms, 0.4, format!("irregularity RMS: {:.0} µm of {:.0} µm", 1e6 * rms.mean, 1e6 * rms.threshold)),
    ];
    for (spread, y, text) in texts {
        let bar = (ratio(spread, spread.p10), ratio(spread, spread.p90));
        let mean = ratio(spread, spread.mean);
        layers.extend([
            Layer::Word { at: (0.02 * end, y + 0.42), text, color: plotters::style::RGBColor(40, 46, 52) },
            Layer::Band {
                points: vec![(bar.0, y - 0.13, y + 0.13), (bar.1, y - 0.13, y + 0.13)],
                color: BLUE,
                opacity: 0.55,
            },
            Layer::Dots { points: vec![(mean, y)], color: BLUE, opacity: 1.0, size: 18 },
        ]);
    }
    layers.push(Layer::Dashed { points: vec![(1.0, 0.0), (1.0, 2.0)], color: RED, width: 5 });
    let plot = Plot {
        x: Axis { caption: "indicator ÷ threshold", range: (0.0, end) },
        y: Axis { caption: "", range: (0.0, 2.0) },
        down: false,
        height: 420,
        layers,
    };
    Ok(Figure {
        title: "Condition indicators".into(),
        caption: "Over all wheelsets. Left of the threshold is healthy.".into(),
        keys: vec![
            Key::dot("mean", BLUE),
            Key::band("middle 80 % of the wheelsets", BLUE),
            Key::dashed("threshold", RED),
        ],
        svg: plot.svg("condition indicators against their thresholds")?,
    })
}
