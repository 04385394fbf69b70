//! Samples of passages (paper, fig. 18–20) and condition indicators of all panels (fig. 21).

use super::NamedSvg;
use crate::analysis::{Indicators, Spread};
use crate::report::ReportError;
use crate::report::grid::grid;
use crate::report::plot::{Axis, BLUE, GREEN, GREY, Layer, ORANGE, Plot, Point, RED, range_of};
use crate::signal::quantile;
use crate::study::samples::{PanelSample, Sample};

const HEIGHT: u32 = 560;
/// Panels of the paper's figures 18 to 20.
const SHOWN: [(&str, &str); 3] = [("Ho 21B", "ho-21b"), ("Sg 21B", "sg-21b"), ("Vad 131", "vad-131")];

/// Figures 18 to 21.
pub fn figures(panels: &[PanelSample]) -> Result<Vec<NamedSvg>, ReportError> {
    let mut out = Vec::new();
    for (name, file) in SHOWN {
        if let Some(panel) = panels.iter().find(|p| p.panel.name == name) {
            out.push((format!("study-crossings-sample-{file}"), sample(panel)?));
        }
    }
    out.push(("study-crossings-indicators".into(), indicators(panels)?));
    Ok(out)
}

/// Left what was identified, right what was simulated.
fn sample(p: &PanelSample) -> Result<String, ReportError> {
    let rows = [
        ("displacement", "front wheels behind the nose tip, m", "displacement, mm", 1e3, true),
        ("contact force", "position x, m", "contact force, kN", 1e-3, false),
        ("irregularity", "position x, m", "irregularity, mm", 1e3, true),
    ];
    let mut plots = Vec::new();
    for (k, (what, x, y, factor, down)) in rows.into_iter().enumerate() {
        let (a, b) = (&p.identified[k], &p.simulated[k]);
        let values = [a, b].into_iter().flat_map(|s| s.curves.iter().flatten()).map(|v| factor * v);
        let range = range_of(values, 0.03);
        let panel = p.panel.name;
        plots.push((format!("{panel}, {what}: identified"), one(a, [x, y], factor, down, range)?));
        plots.push((format!("{what}: simulated"), one(b, [x, y], factor, down, range)?));
    }
    Ok(grid(&plots, 2, HEIGHT as usize, "displacement, force and irregularity of all passages"))
}

/// All curves thin, the middle 80 % as a band, the first mode on top.
fn one(
    s: &Sample,
    captions: [&str; 2],
    factor: f64,
    down: bool,
    range: (f64, f64),
) -> Result<String, ReportError> {
    let line = |c: &[f64]| -> Vec<Point> {
        s.position_m.iter().zip(c).step_by(3).map(|(x, v)| (*x, factor * v)).collect()
    };
    // A few dozen curves show the scatter; all of them would only blacken the figure.
    let every = s.curves.len().div_ceil(40).max(1);
    let thin = s.curves.iter().step_by(every).map(|c| Layer::Line {
        points: line(c),
        color: GREY,
        opacity: 0.35,
        width: 2,
    });
    let band = s.position_m.iter().enumerate().step_by(3).map(|(i, x)| {
        let values: Vec<f64> = s.curves.iter().map(|c| factor * c[i]).collect();
        (*x, quantile(&values, 0.1), quantile(&values, 0.9))
    });
    let mut layers: Vec<Layer> = thin.collect();
    layers.push(Layer::Band { points: band.collect(), color: BLUE, opacity: 0.25 });
    layers.push(Layer::Line { points: line(&s.mode), color: RED, opacity: 1.0, width: 5 });
    let ends = (s.position_m.first().copied().unwrap_or(-1.0), s.position_m.last().copied().unwrap_or(1.0));
    Plot {
        x: Axis { caption: captions[0], range: ends },
        y: Axis { caption: captions[1], range },
        down,
        height: HEIGHT,
        layers,
    }
    .svg(captions[1])
}

/// Per panel three bars: truth, this program, the paper's chain.
fn indicators(panels: &[PanelSample]) -> Result<String, ReportError> {
    let bars = |of: fn(&Indicators) -> Spread, factor: f64, caption: &str| -> Result<String, ReportError> {
        let mut layers = Vec::new();
        let mut highest: f64 = 0.0;
        for (k, p) in panels.iter().enumerate() {
            let all = [
                (Some(p.true_indicators.clone()), ORANGE),
                (p.indicators(0), GREEN),
                (p.indicators(1), BLUE),
            ];
            for (j, (i, color)) in all.into_iter().enumerate() {
                let Some(i) = i else { continue };
                let s = of(&i);
                let x = k as f64 + 0.18 * (j as f64 - 1.0);
                let bar = vec![(x, factor * s.p10, factor * s.p90)];
                highest = highest.max(factor * s.p90).max(factor * s.threshold);
                layers.push(Layer::Whiskers { points: bar, color, opacity: 0.5, width: 18 });
                layers.push(Layer::Dots {
                    points: vec![(x, factor * s.mean)],
                    color,
                    opacity: 1.0,
                    size: 11,
                });
                if j == 0 {
                    let edge = vec![
                        (k as f64 - 0.42, factor * s.threshold),
                        (k as f64 + 0.42, factor * s.threshold),
                    ];
                    layers.push(Layer::Dashed { points: edge, color: RED, width: 4 });
                }
            }
        }
        for (k, p) in panels.iter().enumerate() {
            let at = (k as f64 - 0.3, 1.12 * highest);
            layers.push(Layer::Word { at, text: p.panel.name.into(), color: GREY });
        }
        Plot {
            x: Axis { caption: "panel", range: (-0.6, panels.len() as f64 - 0.4) },
            y: Axis { caption, range: (0.0, 1.15 * highest) },
            down: false,
            height: 700,
            layers,
        }
        .svg(caption)
    };
    let plots = [
        (
            "orange: true, green: cpcm, blue: paper's chain, dashed: threshold".to_string(),
            bars(|i| i.peak_force_n, 1e-3, "force peak, kN")?,
        ),
        (String::new(), bars(|i| i.irregularity_rms_m, 1e6, "irregularity RMS, µm")?),
    ];
    Ok(grid(&plots, 1, 700, "condition indicators of six panels"))
}
