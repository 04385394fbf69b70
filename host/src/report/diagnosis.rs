//! The page of a diagnosis.

mod where_figures;

use super::ReportError;
use super::page::{self, Figure, Key, escape};
use super::plot::{Axis, BLUE, GREY, Layer, ORANGE, Plot, Point, range_of};
use super::tables;
use crate::gap::consequences::Change;
use crate::gap::diagnosis::{Diagnosis, Named};
use crate::gap::effect::Stated;
use crate::gap::measure::Prediction;
use crate::gap::verdict::{Verdict, closed};

/// The page as one HTML document.
pub fn html(site: &str, d: &Diagnosis) -> Result<String, ReportError> {
    let mut body = headline(site, d);
    body.push_str(&effects(d));
    body.push_str(&actions(d));
    body.push_str(&consequences(d));
    body.push_str(&remarks(d));
    body.push_str(&tables::skipped(&d.skipped));
    body.push_str(&bands(d));
    body.push_str(&wheels(d));
    body.push_str(&ladder(d));
    let mut figures = where_figures::all(d)?;
    if let Some(p) = d.predictions.first() {
        figures.insert(0, trace(p, !d.effects.is_empty())?);
    }
    body.push_str("<h2>Figures</h2>\n");
    body.extend(figures.iter().map(Figure::html));
    body.push_str(&ranking(d));
    body.push_str(&identifiability(d));
    body.push_str(&format!(
        "<footer>cpcm {}. Gaps are RMS ratios of measured less predicted to measured, mean of acceleration and \
         displacement in squares, on passages used for nothing else. All numbers: diagnosis.json, \
         predictions.parquet.</footer>\n",
        env!("CARGO_PKG_VERSION")
    ));
    Ok(page::document(&format!("{site} \u{2013} sim-to-real gap"), &body))
}

fn actions(d: &Diagnosis) -> String {
    if d.effects.is_empty() {
        return String::new();
    }
    let item = |e: &Named| {
        let action = d.recommended_action(e);
        action.map(|a| format!("<li><strong>{}:</strong> {}</li>\n", escape(e.name), escape(&a)))
    };
    let items: String = d.effects.iter().filter_map(item).collect();
    match items.is_empty() {
        true => "<h2>What to do</h2>\n<p>Nothing yet: most of the gap is unexplained, and something else may be behind it. See the notes \
                 below.</p>\n"
            .into(),
        false => format!("<h2>What to do</h2>\n<ul>\n{items}</ul>\n"),
    }
}

/// The verdict in words.
pub fn sentence(d: &Diagnosis) -> String {
    let names: Vec<String> =
        d.effects.iter().map(|e| [&[e.name], &e.indistinguishable_from[..]].concat().join(" or ")).collect();
    match d.verdict {
        Verdict::NoGap => "No gap: the model predicts these recordings as well as their noise allows.".into(),
        Verdict::Explained => format!("Explained by {}.", names.join(" and ")),
        Verdict::PartlyExplained => {
            format!("Partly explained by {}; the rest of the gap is not.", names.join(" and "))
        }
        Verdict::Unexplained if d.may_be_path => {
            "What the model leaves may be the path, which was estimated for want of a laser scan: see the notes.".into()
        }
        Verdict::Unexplained if !d.searched && closed(&d.gap) => {
            "The gap is hardly larger than what differs from bogie to bogie, but something speaks against the model: see the notes."
                .into()
        }
        Verdict::Unexplained if !d.searched => "There is a gap; no effect was looked for: see the notes.".into(),
        Verdict::Unexplained if closed(&d.gap) => {
            "The gap is hardly larger than what differs from bogie to bogie, but something acts that nothing in the catalogue explains: see \
             the notes."
                .into()
        }
        Verdict::Unexplained => "There is a gap that nothing in the catalogue explains.".into(),
    }
}

fn headline(site: &str, d: &Diagnosis) -> String {
    let closed = closed_in_words(d).map_or(String::new(), |c| format!("; closed {c}"));
    format!(
        "<h1>{}</h1>\n<p><strong>{}</strong></p>\n<p>Gap {}{closed}.</p>\n",
        escape(site),
        sentence(d),
        gap_in_words(d)
    )
}

/// The gap; before and after only where an effect is in the model.
pub fn gap_in_words(d: &Diagnosis) -> String {
    let g = &d.gap;
    match d.effects.is_empty() {
        true => format!("{:.3}, noise floor {:.3}", g.before, g.noise_floor),
        false => format!("{:.3} before, {:.3} after, noise floor {:.3}", g.before, g.after, g.noise_floor),
    }
}

/// How far the effects close it, where there are any.
pub fn closed_in_words(d: &Diagnosis) -> Option<String> {
    let [closed, low, high] =
        [d.gap.closed_fraction, d.gap.closed_fraction_ci90[0], d.gap.closed_fraction_ci90[1]]
            .map(|c| 100.0 * c);
    (!d.effects.is_empty()).then(|| format!("{closed:.0} % (90 %: {low:.0} \u{2026} {high:.0} %)"))
}

/// Columns whose first cell is no number hold text.
fn table(head: &[&str], rows: &[Vec<String>]) -> String {
    let number = |c: &String| c.starts_with(|c: char| c.is_ascii_digit() || "+-".contains(c));
    tables::plain(head, rows, |k| rows.first().and_then(|r| r.get(k)).is_some_and(|c| !number(c)))
}

/// Three significant digits.
pub fn significant(value: f64) -> String {
    let magnitude = value.abs().log10().floor();
    match (-3.0..6.0).contains(&magnitude) {
        true => format!("{value:.*}", (2.0 - magnitude).max(0.0) as usize),
        false if value == 0.0 => "0".into(),
        false => format!("{value:.2e}"),
    }
}

fn in_words(sizes: &[Stated]) -> String {
    let size = |(n, v, l, u): &Stated| {
        format!("{n} {} ({} \u{2026} {})", significant(*v), significant(*l), significant(*u))
    };
    sizes.iter().map(size).collect::<Vec<_>>().join("; ")
}

fn effects(d: &Diagnosis) -> String {
    if d.effects.is_empty() {
        return String::new();
    }
    let rows: Vec<Vec<String>> = d
        .effects
        .iter()
        .map(|e| {
            let same = e.indistinguishable_from.iter().map(|same| {
                let sizes = e.alternative(same).map(|a| in_words(&a.parameters));
                sizes.map_or((*same).into(), |sizes| format!("{same} of {sizes}"))
            });
            vec![
                format!("{}: {}", e.name, e.meaning()),
                format!("{:.2}", e.probability),
                in_words(&e.parameters),
                same.collect::<Vec<_>>().join(", "),
            ]
        })
        .collect();
    format!(
        "<h2>Which</h2>\n{}",
        table(&["effect", "probability", "parameters (90 %)", "cannot be told from"], &rows)
    )
}

fn consequences(d: &Diagnosis) -> String {
    let Some(c) = &d.consequences else { return String::new() };
    let row = |(name, change): (&str, Change)| {
        let moved = 100.0 * (change.with / change.without - 1.0);
        let value = |v: f64| format!("{v:.1}");
        vec![name.into(), value(change.without), value(change.with), format!("{moved:+.1} %")]
    };
    let rows = c.rows().map(row);
    format!(
        "<h2>What it changes</h2>\n{}",
        table(&["result", "without", "with the effects", "change"], &rows)
    )
}

fn remarks(d: &Diagnosis) -> String {
    if d.remarks.is_empty() {
        return String::new();
    }
    let items: String = d.remarks.iter().map(|r| format!("<li>{}</li>\n", escape(r))).collect();
    format!("<h2>Notes</h2>\n<ul>\n{items}</ul>\n")
}

fn bands(d: &Diagnosis) -> String {
    let rows: Vec<Vec<String>> = d
        .gap
        .bands
        .iter()
        .map(|b| {
            vec![
                b.name.into(),
                format!("{:.0} \u{2026} {:.0} Hz", b.range_hz[0], b.range_hz[1]),
                format!("{:.3}", b.gap[0]),
                format!("{:.3}", b.gap[1]),
                format!("{:.3}", b.gap[2]),
            ]
        })
        .collect();
    format!("<h2>Where</h2>\n{}", table(&["band", "range", "before", "after", "noise floor"], &rows))
}

/// How wheels differ.
fn wheels(d: &Diagnosis) -> String {
    let w = &d.wheels;
    let percent = |v: f64| format!("{:.1} %", 100.0 * v);
    let rows = [
        vec!["load".into(), percent(w.load)],
        vec!["load, crossing against stock rail".into(), percent(w.side_load)],
        vec!["depth of the path over the crossing".into(), percent(w.depth)],
        vec!["the same, trains as a whole".into(), percent(d.train_depth)],
        vec!["place where the crossing is met".into(), format!("{:.0} mm", 1e3 * w.shift_m)],
        vec!["path of their own".into(), format!("{:.0} \u{b5}m", 1e6 * w.own_m)],
    ];
    format!("<h2>How wheels differ</h2>\n{}", table(&["in", "standard deviation"], &rows))
}

/// The substitution ladder.
fn ladder(d: &Diagnosis) -> String {
    let rows: Vec<Vec<String>> = d
        .ladder
        .iter()
        .map(|r| {
            let displacement = r.displacement.map_or(String::new(), |v| format!("{v:.3}"));
            vec![r.model.into(), format!("{:.3}", r.acceleration), displacement]
        })
        .collect();
    format!(
        "<h2>Stage by stage</h2>\n<p>Stage after stage put in the place of what the drawing says; residual of the held-out passages, RMS relative to the \
         signal.</p>\n{}",
        table(&["substituted", "acceleration", "displacement"], &rows)
    )
}

fn ranking(d: &Diagnosis) -> String {
    if d.ranking.is_empty() {
        return String::new();
    }
    let rows: Vec<Vec<String>> = d
        .ranking
        .iter()
        .map(|r| {
            // What is known of the recorder has no gain.
            let gain = if r.gain.is_finite() { format!("{:.1}", r.gain) } else { "-".into() };
            vec![r.name.into(), format!("{:.3}", r.probability), gain]
        })
        .collect();
    format!("<h2>All effects</h2>\n{}", table(&["effect", "probability", "gain in log evidence"], &rows))
}

/// Pairs whose directions are nearly the same.
const ALIKE: f64 = 0.8;

fn identifiability(d: &Diagnosis) -> String {
    let rows: Vec<Vec<String>> = d
        .cosines
        .iter()
        .filter(|(_, _, c)| c.abs() > ALIKE)
        .map(|(a, b, c)| vec![(*a).into(), (*b).into(), format!("{c:.2}")])
        .collect();
    if rows.is_empty() {
        return String::new();
    }
    format!(
        "<h2>Effects that look alike here</h2>\n<p>Cosine between the directions in which two effects move these recordings, \
         after the base model has taken its share.</p>\n{}",
        table(&["effect", "effect", "cosine"], &rows)
    )
}

/// First held-out passage: measured, base model, and the corrected one where there is one.
fn trace(p: &Prediction, corrected: bool) -> Result<Figure, ReportError> {
    let (starts, len) = &p.windows;
    let from = starts.first().copied().unwrap_or(0);
    let to = (from + len).min(p.acceleration[0].len());
    let line = |values: &[f64]| -> Vec<Point> {
        (from..to).map(|k| ((k - from) as f64 / crate::gap::data::RATE_HZ, values[k])).collect()
    };
    let lines = p.acceleration.each_ref().map(|a| line(a));
    let mut layers = vec![
        Layer::Line { points: lines[0].clone(), color: GREY, opacity: 1.0, width: 6 },
        Layer::Line { points: lines[1].clone(), color: ORANGE, opacity: 1.0, width: 3 },
    ];
    let mut keys = vec![Key::line("measured", GREY), Key::line("base model", ORANGE)];
    if corrected {
        layers.push(Layer::Line { points: lines[2].clone(), color: BLUE, opacity: 1.0, width: 3 });
        keys.push(Key::line("corrected model", BLUE));
    }
    let svg = Plot {
        x: Axis { caption: "time, s", range: range_of(lines[0].iter().map(|p| p.0), 0.0) },
        y: Axis {
            caption: "acceleration, m/s²", range: range_of(lines.iter().flatten().map(|p| p.1), 0.05)
        },
        down: false,
        height: 620,
        layers,
    }
    .svg("First bogie of a held-out passage, measured and predicted")?;
    Ok(Figure {
        title: format!("First bogie of passage {}", p.passage_id),
        caption: "A passage that nothing was learnt from; of it only speed and axle times are used.".into(),
        keys,
        svg,
    })
}
