//! Ballast stiffness per sleeper.

use crate::analysis::Analysis;

use super::ReportError;
use super::page::{Figure, Key};
use super::plot::{Axis, BLUE, GREY, Layer, ORANGE, Plot, range_of};

/// Sleepers shown on each side of the crossing sleeper; the stiffness is constant beyond two.
const SHOWN: f64 = 7.0;

pub(super) fn figure(analysis: &Analysis) -> Result<Figure, ReportError> {
    let centre = analysis.crossing.track.crossing_sleeper_index as f64;
    let ends = (centre - SHOWN - 0.6, centre + SHOWN + 0.6);
    let shown: Vec<Sleeper> = sleepers(analysis).filter(|s| (s.x - centre).abs() <= SHOWN).collect();
    let nominal = analysis.crossing.ballast.stiffness_n_m2 / 1e6;
    let (_, high) = range_of(shown.iter().flat_map(|s| [s.value, s.upper]).chain([nominal]), 0.0);
    let top = 1.12 * high;
    let mut layers = stiffness(&shown);
    layers.extend([
        Layer::Dashed { points: vec![(ends.0, nominal), (ends.1, nominal)], color: GREY, width: 3 },
        Layer::Dashed { points: vec![(centre, 0.0), (centre, top)], color: ORANGE, width: 2 },
        Layer::Word { at: (centre + 0.12, 0.09 * high), text: "crossing sleeper".into(), color: ORANGE },
    ]);
    let plot = Plot {
        x: Axis { caption: "sleeper number (growing with x)", range: ends },
        y: Axis { caption: "stiffness, MN/m²", range: (0.0, top) },
        down: false,
        height: 640,
        layers,
    };
    Ok(Figure {
        title: "Ballast stiffness".into(),
        caption: "Per metre of sleeper, around the crossing sleeper; constant outside ±2 sleepers but for supports that a diagnosis found lost."
            .into(),
        keys: vec![
            Key::dot("calibrated", BLUE),
            Key::band("90 % interval", BLUE),
            Key::dashed("nominal", GREY),
        ],
        svg: plot.svg("ballast stiffness per sleeper with its 90 % interval")?,
    })
}

/// Stiffness of one sleeper, MN/m².
struct Sleeper {
    x: f64,
    value: f64,
    lower: f64,
    upper: f64,
}

fn sleepers(analysis: &Analysis) -> impl Iterator<Item = Sleeper> {
    analysis.ballast.stiffness_n_m2.iter().enumerate().map(|(i, k)| Sleeper {
        x: i as f64,
        value: k.value / 1e6,
        lower: k.lower / 1e6,
        upper: k.upper / 1e6,
    })
}

fn stiffness(shown: &[Sleeper]) -> Vec<Layer> {
    let intervals = shown.iter().map(|s| (s.x, s.lower, s.upper)).collect();
    let values = shown.iter().map(|s| (s.x, s.value)).collect();
    vec![
        Layer::Whiskers { points: intervals, color: BLUE, opacity: 0.35, width: 22 },
        Layer::Dots { points: values, color: BLUE, opacity: 1.0, size: 8 },
    ]
}
