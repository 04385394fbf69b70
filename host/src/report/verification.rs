//! Page and table of `verify`.

use crate::verification::{Case, Curves, Table, Verification};

use super::page::{self, Figure, Key, escape};
use super::plot::{Axis, BLUE, Layer, ORANGE, Plot, range_of};
use super::{ReportError, tables, text::padded};

/// The page: a table of all checks, then the curves.
pub fn html(verification: &Verification) -> Result<String, ReportError> {
    let failures = verification.failures();
    let (class, verdict) = match failures {
        0 => ("healthy", "All checks passed".to_string()),
        n => ("damaged", format!("{n} of {} checks failed", verification.cases.len())),
    };
    let rows: String = verification.cases.iter().map(row).collect();
    let mut body = format!(
        "<h1>Verification</h1>\n<p class=\"sub\">cpcm {} against closed forms, other programs and the paper</p>\n\
         <section class=\"headline {class}\"><p class=\"verdict\">{verdict}</p></section>\n<h2>Checks</h2>\n\
         <div class=\"scroll\"><table>\n<thead><tr><th class=\"text\">check</th>\
         <th class=\"text\">source</th><th>expected</th><th>found</th><th>unit</th><th>error</th>\
         <th>allowed</th></tr></thead>\n<tbody>\n{rows}</tbody></table></div>\n",
        env!("CARGO_PKG_VERSION")
    );
    body.extend(verification.tables.iter().map(table_html));
    for case in &verification.cases {
        if let Some(curves) = &case.curves {
            body.push_str(&figure(case, curves)?.html());
        }
    }
    Ok(page::document("cpcm verification", &body))
}

fn row(case: &Case) -> String {
    let class = if case.passed() { "" } else { " class=\"over\"" };
    format!(
        "<tr><td class=\"text\">{}</td><td class=\"text\">{}</td><td>{:.6e}</td><td>{:.6e}</td><td>{}</td>\
         <td{class}>{}</td><td>{}</td></tr>\n",
        escape(&case.name),
        escape(&case.source),
        case.expected,
        case.found,
        escape(case.unit),
        percent(case.error()),
        percent(case.tolerance)
    )
}

pub(super) fn table_html(table: &Table) -> String {
    format!(
        "<h2>{}</h2>\n<p>{}</p>\n{}",
        escape(&table.title),
        escape(&table.note),
        tables::plain(&table.columns, &table.rows, |k| k == 0)
    )
}

/// A study for the terminal: columns as wide as their widest cell.
pub fn table_text(table: &Table) -> String {
    let width = |i: usize| {
        let cells = table.rows.iter().filter_map(|r| r.get(i)).chain(table.columns.get(i));
        cells.map(|c| c.chars().count()).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..table.columns.len()).map(width).collect();
    let line = |cells: &Vec<String>| {
        let text: Vec<String> = cells.iter().zip(&widths).map(|(c, w)| padded(c, *w)).collect();
        format!("{}\n", text.join("  ").trim_end())
    };
    let rows: String = table.rows.iter().map(line).collect();
    format!("\n{}\n{}\n{}{rows}", table.title, table.note, line(&table.columns))
}

fn percent(value: f64) -> String {
    let value = 100.0 * value;
    if value != 0.0 && value.abs() < 1e-3 { format!("{value:.1e} %") } else { format!("{value:.3} %") }
}

fn figure(case: &Case, curves: &Curves) -> Result<Figure, ReportError> {
    let line = |y: &[f64]| curves.x.iter().copied().zip(y.iter().copied()).collect::<Vec<_>>();
    let layers = vec![
        Layer::Line { points: line(&curves.expected), color: ORANGE, opacity: 1.0, width: 6 },
        Layer::Dashed { points: line(&curves.found), color: BLUE, width: 4 },
    ];
    let values = curves.expected.iter().chain(&curves.found).copied();
    let plot = Plot {
        x: Axis { caption: curves.x_caption, range: range_of(curves.x.iter().copied(), 0.0) },
        y: Axis { caption: curves.y_caption, range: range_of(values, 0.06) },
        down: false,
        height: 640,
        layers,
    };
    Ok(Figure {
        title: case.name.clone(),
        caption: format!("Expected: {}.", case.source),
        keys: vec![Key::line("expected", ORANGE), Key::dashed("cpcm", BLUE)],
        svg: plot.svg(&case.name)?,
    })
}

/// One line per check, for the terminal.
pub fn table(verification: &Verification) -> String {
    let name = verification.cases.iter().map(|c| c.name.chars().count()).max().unwrap_or(5).max(5);
    let mut text = format!(
        "{}  {:>13}  {:>13}  {:<8}  {:>10}  {:>10}\n",
        padded("check", name),
        "expected",
        "found",
        "unit",
        "error",
        "allowed"
    );
    for case in &verification.cases {
        text.push_str(&format!(
            "{}  {:>13.6e}  {:>13.6e}  {}  {:>10}  {:>10}{}\n",
            padded(&case.name, name),
            case.expected,
            case.found,
            padded(case.unit, 8),
            percent(case.error()),
            percent(case.tolerance),
            if case.passed() { "" } else { "  FAILED" }
        ));
    }
    text.extend(verification.tables.iter().map(table_text));
    text
}

/// The table as CSV.
pub fn csv(verification: &Verification) -> String {
    let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
    let mut text = String::from("check,source,unit,expected,found,relative_error,tolerance,passed\n");
    for c in &verification.cases {
        text.push_str(&format!(
            "{},{},{},{},{},{},{},{}\n",
            quoted(&c.name),
            quoted(&c.source),
            quoted(c.unit),
            c.expected,
            c.found,
            c.error(),
            c.tolerance,
            c.passed()
        ));
    }
    text
}
