//! Force peaks, passage by passage.

use crate::analysis::Analysis;

use super::ReportError;
use super::page::{Figure, Key};
use super::plot::{Axis, BLUE, Layer, ORANGE, Plot, RED, range_of};

pub(super) fn figure(analysis: &Analysis) -> Result<Figure, ReportError> {
    let passages = &analysis.passages;
    let (mut whiskers, mut dots, mut means) = (Vec::new(), Vec::new(), Vec::new());
    for p in passages {
        let count = p.wheelsets.len();
        for (k, w) in p.wheelsets.iter().enumerate() {
            // The wheelsets of a passage stand side by side over its number.
            let x = f64::from(p.passage_id) + 0.7 * ((k as f64 + 0.5) / count as f64 - 0.5);
            let peak = w.peak_force_n;
            whiskers.push((x, 1e-3 * peak.lower, 1e-3 * peak.upper));
            dots.push((x, 1e-3 * peak.value));
        }
        let mean = 1e-3 * p.wheelsets.iter().map(|w| w.peak_force_n.value).sum::<f64>() / count.max(1) as f64;
        let id = f64::from(p.passage_id);
        means.push(vec![(id - 0.42, mean), (id + 0.42, mean)]);
    }
    let spread = analysis.indicators.peak_force_n;
    let threshold = 1e-3 * spread.threshold;
    let (x0, x1) = range_of(passages.iter().map(|p| f64::from(p.passage_id)), 0.0);
    let ends = (x0 - 0.8, x1 + 0.8);
    let all = whiskers.iter().flat_map(|w| [w.1, w.2]).chain([threshold]);
    let (low, high) = range_of(all, 0.06);
    let band = (1e-3 * spread.p10, 1e-3 * spread.p90);
    let mut layers = vec![
        Layer::Band {
            points: vec![(ends.0, band.0, band.1), (ends.1, band.0, band.1)],
            color: BLUE,
            opacity: 0.1,
        },
        Layer::Whiskers { points: whiskers, color: BLUE, opacity: 0.4, width: 3 },
        Layer::Dots { points: dots, color: BLUE, opacity: 0.9, size: 5 },
        Layer::Dashed { points: vec![(ends.0, threshold), (ends.1, threshold)], color: RED, width: 4 },
    ];
    let mean = |points| Layer::Line { points, color: ORANGE, opacity: 1.0, width: 6 };
    layers.extend(means.into_iter().map(mean));
    let plot = Plot {
        x: Axis { caption: "passage", range: ends },
        y: Axis { caption: "peak force, kN", range: (low, high) },
        down: false,
        height: 640,
        layers,
    };
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
