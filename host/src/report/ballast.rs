//! Ballast stiffness per sleeper.

use crate::analysis::Analysis;

use super::ReportError;
use super::page::{Figure, Key};
use super::plot::{Axis, BLUE, GREY, Layer, ORANGE, Plot, range_of};

/// Sleepers shown on each side of the crossing sleeper; the stiffness is constant beyond two.
const SHOWN: usize = 7;

pub(super) fn figure(analysis: &Analysis) -> Result<Figure, ReportError> {
    let centre = analysis.crossing.track.crossing_sleeper_index;
    let nominal = analysis.crossing.ballast.stiffness_n_m2 / 1e6;
    let shown: Vec<(f64, f64, f64, f64)> = analysis
        .ballast
        .stiffness_n_m2
        .iter()
        .enumerate()
        .filter(|(i, _)| i.abs_diff(centre) <= SHOWN)
        .map(|(i, k)| (i as f64, k.value / 1e6, k.lower / 1e6, k.upper / 1e6))
        .collect();
    let ends = (centre as f64 - SHOWN as f64 - 0.6, centre as f64 + SHOWN as f64 + 0.6);
    let (_, high) = range_of(shown.iter().flat_map(|s| [s.1, s.3]).chain([nominal]), 0.0);
    let layers = vec![
        Layer::Dashed { points: vec![(ends.0, nominal), (ends.1, nominal)], color: GREY, width: 3 },
        Layer::Whiskers {
            points: shown.iter().map(|s| (s.0, s.2, s.3)).collect(),
            color: BLUE,
            opacity: 0.35,
            width: 22,
        },
        Layer::Dots {
            points: shown.iter().map(|s| (s.0, s.1)).collect(),
            color: BLUE,
            opacity: 1.0,
            size: 8,
        },
        Layer::Word {
            at: (centre as f64 + 0.12, 0.09 * high),
            text: "crossing sleeper".into(),
            color: ORANGE,
        },
        Layer::Dashed {
            points: vec![(centre as f64, 0.0), (centre as f64, 1.12 * high)],
            color: ORANGE,
            width: 2,
        },
    ];
    let plot = Plot {
        x: Axis { caption: "sleeper number (growing with x)", range: ends },
        y: Axis { caption: "stiffness, MN/m²", range: (0.0, 1.12 * high) },
        down: false,
        height: 640,
        layers,
    };
    Ok(Figure {
        title: "Ballast stiffness".into(),
        caption: "Per metre of sleeper, around the crossing sleeper; constant outside ±2 sleepers.".into(),
        keys: vec![
            Key::dot("calibrated", BLUE),
            Key::band("90 % interval", BLUE),
            Key::dashed("nominal", GREY),
        ],
        svg: plot.svg("ballast stiffness per sleeper with its 90 % interval")?,
    })
}
