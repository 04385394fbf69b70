//! Both condition indicators against their thresholds.

use plotters::style::RGBColor;

use crate::analysis::{Indicators, Spread};

use super::ReportError;
use super::page::{Figure, Key};
use super::plot::{Axis, BLUE, GREEN, Layer, ORANGE, Plot, RED};

/// From this part of the threshold on, the crossing is watched.
const WATCH_FROM: f64 = 0.9;
/// Longest axis, times the threshold; a bar beyond it ends at the edge.
const LONGEST: f64 = 20.0;

pub(super) fn figure(indicators: &Indicators) -> Result<Figure, ReportError> {
    let (force, rms) = (indicators.peak_force_n, indicators.irregularity_rms_m);
    let largest = [ratio(force, force.p90), ratio(rms, rms.p90), 1.2].into_iter().fold(1.0, f64::max);
    let end = 1.12 * largest.min(LONGEST);
    let mut layers = vec![
        zone((0.0, WATCH_FROM), GREEN),
        zone((WATCH_FROM, 1.0), ORANGE),
        zone((1.0, end), RED),
        Layer::Dashed { points: vec![(1.0, 0.0), (1.0, 2.0)], color: RED, width: 5 },
    ];
    let text = format!("force peak: {:.0} kN of {:.0} kN", 1e-3 * force.mean, 1e-3 * force.threshold);
    layers.extend(bar(force, 1.4, (0.02 * end, text)));
    let text = format!("irregularity RMS: {:.0} µm of {:.0} µm", 1e6 * rms.mean, 1e6 * rms.threshold);
    layers.extend(bar(rms, 0.4, (0.02 * end, text)));
    let plot = Plot {
        x: Axis { caption: "indicator ÷ threshold", range: (0.0, end) },
        y: Axis { caption: "", range: (0.0, 2.0) },
        down: false,
        height: 420,
        layers,
    };
    Ok(Figure {
        title: "Condition indicators".into(),
        caption: "Over all wheelsets. Up to nine tenths of both thresholds is healthy, beyond both damaged."
            .into(),
        keys: vec![
            Key::dot("mean", BLUE),
            Key::band("middle 80 % of the wheelsets", BLUE),
            Key::dashed("threshold", RED),
        ],
        svg: plot.svg("condition indicators against their thresholds")?,
    })
}

fn ratio(spread: Spread, value: f64) -> f64 {
    if spread.threshold > 0.0 { value / spread.threshold } else { f64::NAN }
}

fn zone((from, to): (f64, f64), color: RGBColor) -> Layer {
    Layer::Band { points: vec![(from, 0.0, 2.0), (to, 0.0, 2.0)], color, opacity: 0.13 }
}

/// Range and mean of one indicator at height `y`, with its text above, from `text.0` on.
fn bar(spread: Spread, y: f64, text: (f64, String)) -> Vec<Layer> {
    let (low, high) = (ratio(spread, spread.p10), ratio(spread, spread.p90).min(LONGEST));
    let ink = RGBColor(40, 46, 52);
    let edges = vec![(low, y - 0.13, y + 0.13), (high, y - 0.13, y + 0.13)];
    vec![
        Layer::Word { at: (text.0, y + 0.42), text: text.1, color: ink },
        Layer::Band { points: edges, color: BLUE, opacity: 0.55 },
        Layer::Dots { points: vec![(ratio(spread, spread.mean), y)], color: BLUE, opacity: 1.0, size: 18 },
    ]
}
