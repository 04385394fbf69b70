//! What crossing.toml may be wrong by, and how far the results follow.

use crate::analysis::{Analysis, Budget, Consequence, Outcome, Tolerance};

use super::ReportError;
use super::page::{Figure, Key, escape};
use super::plot::{Axis, BLUE, GREY, INK, Layer, ORANGE, Plot, Point, trimmed};
use super::tables;

/// Entries in the figure: those with the largest consequences.
const SHOWN: usize = 10;

/// Sentence, figure and table; empty where nobody asked.
pub(super) fn html(analysis: &Analysis) -> Result<String, ReportError> {
    let Some(budget) = &analysis.budget else { return Ok(String::new()) };
    Ok(format!(
        "<h2>If crossing.toml is wrong</h2>\n<p>{}</p>\n{}{}{}",
        sentence(analysis, budget),
        figure(budget)?.html(),
        table(budget),
        noticed(budget)
    ))
}

fn sentence(analysis: &Analysis, budget: &Budget) -> String {
    let (i, total) = (&analysis.indicators, budget.total());
    let force = budget.peak_force_n(&i.peak_force_n).map(|f| 1e-3 * f);
    let rms = budget.irregularity_rms_m(&i.irregularity_rms_m).map(|z| 1e6 * z);
    format!(
        "All intervals on this page are of the panel as crossing.toml describes it. With what that may be wrong by (tolerances.csv, as ± in nine \
         of ten cases) the mean force peak is {:.1}\u{2013}{:.1} kN and the mean irregularity {:.1}\u{2013}{:.1} µm RMS (90 %): ±{:.1} % and ±{:.1} % \
         come of the description alone; of the ballast ±{:.0} % elsewhere and ±{:.0} % under the crossing.{}",
        force[0],
        force[1],
        rms[0],
        rms[1],
        100.0 * total.force_peak,
        100.0 * total.irregularity_rms,
        100.0 * total.p1,
        100.0 * total.p2,
        drawn(budget),
    )
}

fn drawn(budget: &Budget) -> String {
    let Some(drawn) = &budget.drawn else { return String::new() };
    format!(
        " Those are of {} descriptions that are wrong by all at once, at random, {}.",
        drawn.count,
        drawn.of_which()
    )
}

/// Change of the mean force peak, a pair of bars per entry.
fn figure(budget: &Budget) -> Result<Figure, ReportError> {
    let shown = &budget.consequences[..budget.consequences.len().min(SHOWN)];
    let percent = |outcome: &Outcome| outcome.change.map_or(0.0, |c| 100.0 * c.force_peak);
    let ends = shown.iter().flat_map(|c| [&c.smaller, &c.larger]).map(percent);
    let far = ends.fold(0.1_f64, |far, v| far.max(v.abs()));
    let left = -2.4 * far;
    let mut layers =
        vec![Layer::Dashed { points: vec![(0.0, -0.6), (0.0, shown.len() as f64)], color: GREY, width: 2 }];
    for (row, c) in shown.iter().rev().enumerate() {
        let y = row as f64;
        let bar = |outcome: &Outcome, y: f64, color| Layer::Line {
            points: [(0.0, y), (percent(outcome), y)].map(Point::from).to_vec(),
            color,
            opacity: 1.0,
            width: 18,
        };
        layers.extend([
            bar(&c.larger, y + 0.19, BLUE),
            bar(&c.smaller, y - 0.19, ORANGE),
            Layer::Word { at: (left, y + 0.25), text: c.tolerance.entry.clone(), color: INK },
        ]);
    }
    let plot = Plot {
        x: Axis { caption: "change of the mean force peak, %", range: (1.01 * left, 1.1 * far) },
        y: Axis { caption: "", range: (-0.7, shown.len() as f64) },
        down: false,
        height: 160 + 64 * shown.len() as u32,
        layers,
    };
    Ok(Figure {
        title: "What the force peaks owe to crossing.toml".into(),
        caption: "Each entry changed by its tolerance, or by as much of it as goes unnoticed, and the site analysed anew; what is on top is worth measuring \
             first.".into(),
        keys: vec![Key::line("entry larger", BLUE), Key::line("entry smaller", ORANGE)],
        svg: plot.svg("change of the mean force peak with each entry of crossing.toml changed by its tolerance")?,
    })
}

fn table(budget: &Budget) -> String {
    let rows: Vec<Vec<String>> = budget.consequences.iter().map(row).collect();
    let head = [
        "entry",
        "tolerance",
        "force peak, %",
        "irregularity, %",
        "ballast elsewhere, %",
        "under the crossing, %",
    ];
    tables::plain(&head, &rows, |_| false)
}

/// Changes with the entry smaller and larger.
fn row(c: &Consequence) -> Vec<String> {
    let both = [&c.smaller, &c.larger];
    let change = |o: &Outcome, k: usize| match o.change {
        Some(c) => signed(format!("{:+.1}", 100.0 * [c.force_peak, c.irregularity_rms, c.p1, c.p2][k])),
        None => "\u{2013}".into(),
    };
    let t = &c.tolerance;
    let mut row = vec![t.entry.clone(), signed(format!("{} ± {}", short(t.value), short(t.plus_minus)))];
    row.extend((0..4).map(|k| both.map(|o| change(o, k)).join(", ")));
    row
}

/// What the analysis says of errors of a whole tolerance; empty where it says nothing.
fn noticed(budget: &Budget) -> String {
    let of = |sign: &str, t: &Tolerance, outcome: &Outcome| {
        let words = outcome.noticed.as_ref()?;
        let counts = match outcome.change {
            Some(_) => format!("{sign}{} goes unnoticed and counts", short(outcome.by.abs())),
            None => "so is an eighth of it, and nothing counts".into(),
        };
        let line = format!("{}, {sign}{}: {words}; {counts}.", t.entry, short(t.plus_minus));
        Some(format!("<li>{}</li>\n", escape(&line)))
    };
    let both = |c: &Consequence| [of("\u{2212}", &c.tolerance, &c.smaller), of("+", &c.tolerance, &c.larger)];
    let items: String = budget.consequences.iter().flat_map(both).flatten().collect();
    match items.is_empty() {
        true => String::new(),
        false => {
            format!("<p>Of errors as large as the tolerance the analysis notices:</p>\n<ul>\n{items}</ul>\n")
        }
    }
}

/// With a true minus sign.
fn signed(number: String) -> String {
    number.replace('-', "\u{2212}")
}

/// Four digits.
fn short(value: f64) -> String {
    match value == 0.0 || (1e-3..1e5).contains(&value.abs()) {
        true => trimmed(&format!("{value:.3}")),
        false => format!("{value:.3e}"),
    }
}
