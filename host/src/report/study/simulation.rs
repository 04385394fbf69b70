//! Force, displacement and irregularity of one bogie on six panels (paper, fig. 15–17); Green's functions (fig. 11, 12).

use plotters::style::RGBColor;

use super::NamedSvg;
use crate::report::ReportError;
use crate::report::grid::grid;
use crate::report::plot::{Axis, BLUE, GREEN, GREY, Layer, ORANGE, Plot, Point, RED, range_of};
use crate::study::kernels::PanelGreens;
use crate::study::simulation::PanelCurves;

const HEIGHT: u32 = 600;

/// A curve in other units.
fn points(x: &[f64], y: &[f64], factor: f64) -> Vec<Point> {
    x.iter().zip(y).map(|(x, y)| (*x, factor * y)).collect()
}

/// Curves over one axis: each with colour, width and whether it is dashed. The last is drawn on top.
fn plot(
    captions: [&str; 2],
    curves: Vec<(Vec<Point>, RGBColor, u32, bool)>,
    x: (f64, f64),
    down: bool,
) -> Result<String, ReportError> {
    let inside = |p: &&Point| p.0 >= x.0 && p.0 <= x.1;
    let values = curves.iter().flat_map(|c| c.0.iter().filter(inside).map(|p| p.1)).collect::<Vec<f64>>();
    let layers = curves
        .into_iter()
        .map(|(points, color, width, dashed)| match dashed {
            true => Layer::Dashed { points, color, width },
            false => Layer::Line { points, color, opacity: 1.0, width },
        })
        .collect();
    Plot {
        x: Axis { caption: captions[0], range: x },
        y: Axis { caption: captions[1], range: range_of(values, 0.05) },
        down,
        height: HEIGHT,
        layers,
    }
    .svg(captions[1])
}

fn ends(x: &[f64]) -> (f64, f64) {
    (x.first().copied().unwrap_or(-1.0), x.last().copied().unwrap_or(1.0))
}

fn six(
    panels: &[PanelCurves],
    label: &str,
    of: impl Fn(&PanelCurves) -> Result<String, ReportError>,
) -> Result<String, ReportError> {
    let plots = panels
        .iter()
        .map(|p| Ok((p.panel.name.to_string(), of(p)?)))
        .collect::<Result<Vec<_>, ReportError>>()?;
    Ok(grid(&plots, 3, HEIGHT as usize, label))
}

/// Figures 15, 16 and 17.
pub fn figures(panels: &[PanelCurves]) -> Result<Vec<NamedSvg>, ReportError> {
    let force = six(panels, "contact force: simulated, by the paper's rule, by evidence", |p| {
        let line = |k: usize| points(&p.position_m, &p.force_n[k], 1e-3);
        let curves = vec![(line(0), ORANGE, 6, false), (line(1), BLUE, 4, true), (line(2), GREEN, 3, false)];
        plot(["position x, m", "contact force, kN"], curves, ends(&p.position_m), false)
    })?;
    let displacement = six(panels, "sleeper displacement: simulated, and by Green's functions", |p| {
        let line = |k: usize| -> Vec<Point> {
            points(&p.travelled_m, &p.displacement_m[k], 1e3).into_iter().step_by(6).collect()
        };
        let curves = vec![(line(0), ORANGE, 6, false), (line(1), GREEN, 4, true), (line(2), BLUE, 3, true)];
        plot(["front wheels behind the nose tip, m", "displacement, mm"], curves, (-5.0, 8.0), true)
    })?;
    let irregularity =
        six(panels, "band-passed irregularity: path, by the paper's rule, by evidence", |p| {
            let line = |k: usize| points(&p.position_m, &p.irregularity_m[k], 1e3);
            let curves =
                vec![(line(0), ORANGE, 6, false), (line(2), BLUE, 4, true), (line(3), GREEN, 3, false)];
            plot(["position x, m", "irregularity, mm"], curves, ends(&p.position_m), true)
        })?;
    Ok(vec![
        ("study-crossings-force".into(), force),
        ("study-crossings-displacement".into(), displacement),
        ("study-crossings-irregularity".into(), irregularity),
    ])
}

/// Figures 11 (first panel, every node) and 12 (all panels, between nodes).
pub fn greens(panels: &[PanelGreens]) -> Result<Vec<NamedSvg>, ReportError> {
    let top = panels.iter().map(PanelGreens::over_sensor).fold(0.0, f64::max);
    let mut plots = Vec::new();
    for p in panels {
        let one = curves(&p.time_s, &p.interpolated, 1.8, (-0.1 * top, 1.05 * top))?;
        plots.push((p.panel.name.to_string(), one));
    }
    let mut out = Vec::new();
    if let Some(first) = panels.first() {
        let high = first.over_sensor();
        let nodes = curves(&first.time_s, &first.nodes, 10.0, (-0.15 * high, 1.05 * high))?;
        out.push(("study-crossings-greens-nodes".into(), nodes));
    }
    let label = "Green's functions from the rail to the sensor on six panels";
    out.push(("study-crossings-greens".into(), grid(&plots, 3, HEIGHT as usize, label)));
    Ok(out)
}

/// Responses over time, dark near the sensor and light `far_m` away.
fn curves(
    time_s: &[f64],
    responses: &[(f64, Vec<f64>)],
    far_m: f64,
    (low, high): (f64, f64),
) -> Result<String, ReportError> {
    let mut order: Vec<&(f64, Vec<f64>)> = responses.iter().collect();
    order.sort_by(|a, b| b.0.abs().total_cmp(&a.0.abs()));
    let mut layers: Vec<Layer> = order
        .into_iter()
        .map(|(distance, g)| Layer::Line {
            points: time_s.iter().zip(g).step_by(2).map(|(t, v)| (1e3 * t, 1e9 * v)).collect(),
            color: shade((distance.abs() / far_m).min(1.0)),
            opacity: 1.0,
            width: 4,
        })
        .collect();
    layers.push(Layer::Dashed { points: vec![(0.0, 0.0), (100.0, 0.0)], color: GREY, width: 2 });
    Plot {
        x: Axis { caption: "time, ms", range: (0.0, 60.0) },
        y: Axis { caption: "response, nm/(N s)", range: (1e9 * low, 1e9 * high) },
        down: false,
        height: HEIGHT,
        layers,
    }
    .svg("Green's functions over time")
}

/// Red over the sensor, blue in between, light grey far away.
fn shade(far: f64) -> RGBColor {
    let mix = |a: RGBColor, b: RGBColor, t: f64| {
        let f = |a: u8, b: u8| (f64::from(a) + (f64::from(b) - f64::from(a)) * t) as u8;
        RGBColor(f(a.0, b.0), f(a.1, b.1), f(a.2, b.2))
    };
    match far < 0.3 {
        true => mix(RED, BLUE, far / 0.3),
        false => mix(BLUE, RGBColor(222, 228, 234), (far - 0.3) / 0.7),
    }
}
