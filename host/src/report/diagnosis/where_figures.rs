//! Where the gap is: residuals along the track, over frequency, in position against time, and against what varies between
//! passages.

use plotters::style::RGBColor;

use super::super::ReportError;
use super::super::page::{Figure, Key};
use super::super::plot::{Axis, BLUE, GREEN, GREY, Layer, ORANGE, Plot, Point, RED, range_of};
use crate::gap::data::RATE_HZ;
use crate::gap::diagnosis::{Diagnosis, Residual};
use crate::gap::forward::BAND_HZ;
use crate::signal::{mean, rfft, rfft_frequencies_hz, rms};

/// All figures that these recordings have something to show in.
pub(super) fn all(d: &Diagnosis) -> Result<Vec<Figure>, ReportError> {
    let mut out = vec![residual_map(d)?, frequency_map(d)?];
    if let Some([position, time]) = d.collapse {
        let (track, clock) = ("along the track", "in time");
        let in_time = |r: &Residual| direction(r) / r.speed_m_s;
        out.push(laid_over(d, (track, "x of the front axle, m"), position, &|_| 1.0)?);
        out.push(laid_over(d, (clock, "time after the front axle is at x = 0, s"), time, &in_time)?);
    }
    let residual = [("speed, m/s", SPEED), ("largest displacement, mm", DEFLECTION), ("axle load, t", LOAD)];
    for (caption, of) in residual {
        if varies(d, of) {
            out.push(against(d, caption, of)?);
        }
    }
    if varies(d, |r| r.temperature_c) {
        out.push(scale_against_temperature(d)?);
    }
    out.push(bogies(d)?);
    Ok(out)
}

/// Sign of the travel along x.
fn direction(r: &Residual) -> f64 {
    match r.position_m.as_slice() {
        [first, .., last] => (last - first).signum(),
        _ => 1.0,
    }
}

type Covariate = fn(&Residual) -> f64;

const SPEED: Covariate = |r| r.speed_m_s;
const DEFLECTION: Covariate = |r| 1e3 * r.deflection_m;
const LOAD: Covariate = |r| 1e-3 * r.axle_load_kg;

/// Whether a covariate tells passages apart.
fn varies(d: &Diagnosis, of: Covariate) -> bool {
    let first = d.residuals.first().map_or(0.0, of);
    d.residuals.iter().any(|r| (of(r) - first).abs() > 1e-3 * first.abs())
}

fn by_speed(d: &Diagnosis) -> Vec<&Residual> {
    let mut rows: Vec<&Residual> = d.residuals.iter().collect();
    rows.sort_by(|a, b| a.speed_m_s.total_cmp(&b.speed_m_s));
    rows
}

/// The models that are drawn: without an effect in it, the corrected model is the base model.
fn drawn(d: &Diagnosis) -> usize {
    if d.effects.is_empty() { 1 } else { 2 }
}

fn keys_of(d: &Diagnosis, key: fn(&'static str, RGBColor) -> Key) -> Vec<Key> {
    let both = [key("base model", ORANGE), key("corrected model", BLUE)];
    both.into_iter().take(drawn(d)).collect()
}

/// Residual along the track, one line per passage, ordered by speed.
fn residual_map(d: &Diagnosis) -> Result<Figure, ReportError> {
    let rows = by_speed(d);
    let largest = rows.iter().flat_map(|r| r.before.iter().map(|v| v.abs())).fold(1e-9, f64::max);
    let line = |k: usize, r: &Residual, values: &[f64]| -> Vec<Point> {
        r.position_m.iter().zip(values).map(|(x, v)| (*x, k as f64 + 1.0 + v / largest)).collect()
    };
    let mut layers = Vec::new();
    for (k, r) in rows.iter().enumerate() {
        for (values, color) in [(&r.before, ORANGE), (&r.after, BLUE)].into_iter().take(drawn(d)) {
            layers.push(Layer::Line { points: line(k, r, values), color, opacity: 0.9, width: 2 });
        }
    }
    let svg = Plot {
        x: Axis {
            caption: "x of the front axle, m",
            range: range_of(rows.iter().flat_map(|r| r.position_m.iter().copied()), 0.0),
        },
        y: Axis { caption: "passage, slowest at the bottom", range: (0.0, rows.len() as f64 + 1.0) },
        down: false,
        height: 900,
        layers,
    }
    .svg("Residual of every passage along the track")?;
    Ok(Figure {
        title: "Residual along the track".into(),
        caption: format!(
            "Mean over the bogies of a train; one unit is {largest:.1} m/s². Features above one another are fixed to the track, \
             features that lean are fixed in time."
        ),
        keys: keys_of(d, Key::line),
        svg,
    })
}

/// Width of a bin of the frequency map, Hz.
const BIN_HZ: f64 = 10.0;
/// Rows that the highest ridge reaches over.
const OVERLAP: f64 = 2.5;

/// RMS in bins of frequency: bin centres, Hz, and values.
fn spectrum(values: &[f64]) -> Vec<Point> {
    let n = values.len().next_power_of_two();
    let mut padded = values.to_vec();
    padded.resize(n, 0.0);
    let bins = (BAND_HZ[0] / BIN_HZ) as usize;
    let mut energy = vec![0.0; bins];
    for (v, f) in rfft(&padded).iter().zip(rfft_frequencies_hz(n, RATE_HZ)) {
        if let Some(e) = energy.get_mut((f / BIN_HZ) as usize) {
            *e += 2.0 * v.norm_sqr() / (n as f64 * values.len().max(1) as f64);
        }
    }
    energy.iter().enumerate().map(|(k, e)| ((k as f64 + 0.5) * BIN_HZ, e.sqrt())).collect()
}

/// Residual over frequency, one line per passage, ordered by speed.
fn frequency_map(d: &Diagnosis) -> Result<Figure, ReportError> {
    let rows: Vec<[Vec<Point>; 2]> =
        by_speed(d).into_iter().map(|r| [spectrum(&r.before), spectrum(&r.after)]).collect();
    let largest = rows.iter().flatten().flatten().map(|p| p.1).fold(1e-9, f64::max);
    let mut layers = Vec::new();
    for (k, row) in rows.iter().enumerate() {
        for (points, color) in row.iter().zip([ORANGE, BLUE]).take(drawn(d)) {
            let points = points.iter().map(|(f, v)| (*f, k as f64 + 1.0 + OVERLAP * v / largest)).collect();
            layers.push(Layer::Line { points, color, opacity: 0.9, width: 2 });
        }
    }
    let title = "Residual over frequency";
    let svg = Plot {
        x: Axis { caption: "frequency, Hz", range: (0.0, BAND_HZ[0]) },
        y: Axis {
            caption: "passage, slowest at the bottom",
            range: (0.0, rows.len() as f64 + 1.0 + OVERLAP),
        },
        down: false,
        height: 900,
        layers,
    }
    .svg(title)?;
    Ok(Figure {
        title: title.into(),
        caption: format!(
            "Mean over the bogies of a train, RMS in bins of {BIN_HZ:.0} Hz; one unit is {:.2} m/s². Ridges that stand \
             upright are resonances or tones, ridges that lean have a wavelength.",
            largest / OVERLAP
        ),
        keys: keys_of(d, Key::line),
        svg,
    })
}

/// Residuals of the base model over one another, over the position times `scale`.
fn laid_over(
    d: &Diagnosis,
    (how, axis): (&str, &str),
    share: f64,
    scale: &dyn Fn(&Residual) -> f64,
) -> Result<Figure, ReportError> {
    let lines: Vec<Vec<Point>> = d
        .residuals
        .iter()
        .map(|r| r.position_m.iter().map(|x| x * scale(r)).zip(r.before.iter().copied()).collect())
        .collect();
    let layers = lines
        .iter()
        .map(|points| Layer::Line { points: points.clone(), color: GREY, opacity: 0.5, width: 2 })
        .collect();
    let title = format!("Residuals laid over one another {how}");
    let svg = Plot {
        x: Axis { caption: axis, range: range_of(lines.iter().flatten().map(|p| p.0), 0.0) },
        y: Axis { caption: "residual, m/s²", range: range_of(lines.iter().flatten().map(|p| p.1), 0.05) },
        down: false,
        height: 520,
        layers,
    }
    .svg(&title)?;
    Ok(Figure {
        title,
        caption: format!(
            "Base model, all passages: {:.0} % of the energy is common to them. What is fixed to the track collapses along it, \
             what the recorder makes collapses in time.",
            100.0 * share
        ),
        keys: vec![Key::line("one passage", GREY)],
        svg,
    })
}

fn dots(points: &[Point], color: RGBColor) -> Layer {
    Layer::Dots { points: points.to_vec(), color, opacity: 0.8, size: 9 }
}

/// Size of the residual against a covariate.
fn against(d: &Diagnosis, caption: &'static str, of: Covariate) -> Result<Figure, ReportError> {
    let before: Vec<Point> = d.residuals.iter().map(|r| (of(r), rms(&r.before))).collect();
    let after: Vec<Point> = d.residuals.iter().map(|r| (of(r), rms(&r.after))).collect();
    let title = format!("Residual against {}", caption.split(',').next().unwrap_or(caption));
    let svg = Plot {
        x: Axis { caption, range: range_of(before.iter().map(|p| p.0), 0.05) },
        y: Axis {
            caption: "residual RMS, m/s²",
            range: range_of(before.iter().chain(&after).map(|p| p.1).chain([0.0]), 0.05),
        },
        down: false,
        height: 560,
        layers: [dots(&before, ORANGE), dots(&after, BLUE)].into_iter().take(drawn(d)).collect(),
    }
    .svg(&title)?;
    Ok(Figure {
        title,
        caption: "One point per passage, mean over its bogies.".into(),
        keys: keys_of(d, Key::dot),
        svg,
    })
}

fn scale_against_temperature(d: &Diagnosis) -> Result<Figure, ReportError> {
    let scale: Vec<Point> = d.residuals.iter().map(|r| (r.temperature_c, 100.0 * r.scale_error)).collect();
    let x = range_of(scale.iter().map(|p| p.0), 0.05);
    let zero = Layer::Line { points: vec![(x.0, 0.0), (x.1, 0.0)], color: GREEN, opacity: 0.6, width: 2 };
    let title = "Scale of the recordings against temperature";
    let svg = Plot {
        x: Axis { caption: "temperature, °C", range: x },
        y: Axis {
            caption: "measured over predicted, less 1, %",
            range: range_of(scale.iter().map(|p| p.1).chain([0.0]), 0.1),
        },
        down: false,
        height: 560,
        layers: vec![zero, dots(&scale, RED)],
    }
    .svg(title)?;
    Ok(Figure {
        title: title.into(),
        caption: "One point per passage.".into(),
        keys: vec![Key::dot("base model", RED)],
        svg,
    })
}

/// Spread over the bogies of the trains.
fn bogies(d: &Diagnosis) -> Result<Figure, ReportError> {
    let count = d.residuals.iter().map(|r| r.bogies_m_s2.len()).max().unwrap_or(0);
    let points = |which: usize, aside: f64| -> Vec<Point> {
        let of_train = |r: &Residual| -> Vec<Point> {
            r.bogies_m_s2.iter().enumerate().map(|(k, v)| (k as f64 + 1.0 + aside, v[which])).collect()
        };
        d.residuals.iter().flat_map(of_train).collect()
    };
    let (before, after) = (points(0, -0.1), points(1, 0.1));
    let means: Vec<Point> = (0..count)
        .map(|k| {
            let of: Vec<f64> =
                d.residuals.iter().filter_map(|r| r.bogies_m_s2.get(k)).map(|v| v[1]).collect();
            (k as f64 + 1.0, mean(&of))
        })
        .collect();
    let (color, key) = match drawn(d) {
        1 => (ORANGE, "mean"),
        _ => (BLUE, "mean of the corrected model"),
    };
    let mut layers: Vec<Layer> =
        [dots(&before, ORANGE), dots(&after, BLUE)].into_iter().take(drawn(d)).collect();
    layers.push(Layer::Line { points: means, color, opacity: 1.0, width: 3 });
    let title = "Spread over the bogies of a train";
    let svg = Plot {
        x: Axis { caption: "bogie, front of the train first", range: (0.5, count.max(1) as f64 + 0.5) },
        y: Axis {
            caption: "residual RMS, m/s²",
            range: range_of(before.iter().chain(&after).map(|p| p.1).chain([0.0]), 0.05),
        },
        down: false,
        height: 560,
        layers,
    }
    .svg(title)?;
    let mut keys = keys_of(d, Key::dot);
    keys.push(Key::line(key, color));
    Ok(Figure {
        title: title.into(),
        caption: "One point per bogie, that is two wheelsets, and passage. Points far above their column are single wheels.".into(),
        keys,
        svg,
    })
}
