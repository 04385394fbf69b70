//! Tables of the report.

use std::collections::BTreeSet;

use crate::analysis::{Analysis, WheelsetResult};
use crate::recording::Skipped;

use super::page::escape;

/// A table of plain cells; columns that are `text` stand left and may wrap.
pub(super) fn plain(head: &[impl AsRef<str>], rows: &[Vec<String>], text: impl Fn(usize) -> bool) -> String {
    let class = |k: usize| if text(k) { " class=\"text\"" } else { "" };
    let cell = |tag: &str, (k, c): (usize, &str)| format!("<{tag}{}>{}</{tag}>", class(k), escape(c));
    let head: String = head.iter().enumerate().map(|(k, h)| cell("th", (k, h.as_ref()))).collect();
    let cells =
        |row: &Vec<String>| row.iter().enumerate().map(|(k, c)| cell("td", (k, c))).collect::<String>();
    let rows: String = rows.iter().map(|row| format!("<tr>{}</tr>\n", cells(row))).collect();
    format!(
        "<div class=\"scroll\"><table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{rows}</tbody></table></div>\n"
    )
}

/// Passages left out, each with its reason; empty when there are none.
pub(super) fn skipped(skipped: &[Skipped]) -> String {
    if skipped.is_empty() {
        return String::new();
    }
    let row = |s: &Skipped| {
        let id = s.passage_id.map_or("?".into(), |id| id.to_string());
        vec![id, s.row.to_string(), s.reason.clone()]
    };
    let rows: Vec<Vec<String>> = skipped.iter().map(row).collect();
    format!(
        "<h2>Passages left out</h2>\n{}",
        plain(&["passage", "row (from 0)", "reason"], &rows, |k| k == 2)
    )
}

/// Force peak of every wheelset: one row per passage, one column per wheelset.
pub(super) fn peaks(analysis: &Analysis) -> String {
    let wheelsets: BTreeSet<usize> =
        analysis.passages.iter().flat_map(|p| &p.wheelsets).map(|w| w.wheelset).collect();
    let head: String = wheelsets.iter().map(|w| format!("<th>{w}</th>")).collect();
    let threshold = analysis.indicators.peak_force_n.threshold;
    let mut rows = String::new();
    for p in &analysis.passages {
        let cell = |k: &usize| match p.wheelsets.iter().find(|w| w.wheelset == *k) {
            Some(w) => peak_cell(w, threshold),
            None => "<td></td>".into(),
        };
        let cells: String = wheelsets.iter().map(cell).collect();
        rows.push_str(&format!(
            "<tr><th>{}</th><td>{}</td><td>{:.0}</td>{cells}</tr>\n",
            p.passage_id,
            known(3.6 * p.speed_m_s),
            p.temperature_c
        ));
    }
    format!(
        "<div class=\"scroll\"><table>\n<caption>Peak contact force in kN, with half the width of its 90 % interval, per \
         wheelset (0 is the first axle). Red: above the threshold. Asterisk: flagged, see below.</caption>\n\
         <thead><tr><th>passage</th><th>speed<br><small>km/h</small></th><th>temp.<br><small>°C</small></th>{head}\
         </tr></thead>\n<tbody>\n{rows}</tbody></table></div>\n"
    )
}

/// With one decimal; a dash where there is no number.
fn known(value: f64) -> String {
    if value.is_finite() { format!("{value:.1}") } else { "\u{2013}".into() }
}

fn peak_cell(w: &WheelsetResult, threshold: f64) -> String {
    let peak = w.peak_force_n;
    let class = if peak.value > threshold { " class=\"over\"" } else { "" };
    let mark = if w.flags.is_empty() { "" } else { "*" };
    let half = 0.5e-3 * (peak.upper - peak.lower);
    format!("<td{class}>{:.0}{mark} <small>±{half:.0}</small></td>", 1e-3 * peak.value)
}

/// Flags by kind, with the passages and wheelsets they concern; empty when there are none.
pub(super) fn flags(analysis: &Analysis) -> String {
    let all = || analysis.passages.iter().flat_map(|p| p.wheelsets.iter().map(move |w| (p.passage_id, w)));
    let names: BTreeSet<&str> = all().flat_map(|(_, w)| w.flags.iter().map(String::as_str)).collect();
    if names.is_empty() {
        return String::new();
    }
    let row = |name: &&str| {
        let hits: Vec<(i32, usize)> = all()
            .filter(|(_, w)| w.flags.iter().any(|f| f == name))
            .map(|(id, w)| (id, w.wheelset))
            .collect();
        let passages: BTreeSet<i32> = hits.iter().map(|h| h.0).collect();
        let list: Vec<String> = passages.iter().map(i32::to_string).collect();
        format!(
            "<tr><td class=\"text\">{}</td><td>{}</td><td class=\"text\">{}</td></tr>\n",
            escape(name),
            hits.len(),
            list.join(", ")
        )
    };
    let rows: String = names.iter().map(row).collect();
    format!(
        "<div class=\"scroll\"><table>\n<caption>Limits of the method that results touch.</caption>\n<thead><tr>\
         <th class=\"text\">flag</th><th>wheelsets</th><th class=\"text\">in passages</th></tr>\
         </thead>\n<tbody>\n{rows}</tbody></table></div>\n"
    )
}
