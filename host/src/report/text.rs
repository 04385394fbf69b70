//! Plain-text tables for the terminal.

use crate::analysis::Interval;
use crate::signal::quantile;

/// Force peak of one wheelset from different sources, newtons.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PeakComparison {
    /// Passage in the recording file.
    pub passage_id: i32,
    /// 0 is the first axle of the train.
    pub wheelset: usize,
    /// Host, with its 90 % interval.
    pub host_n: Interval,
    /// Node, where it has reported the passage.
    pub node_n: Option<f64>,
    /// Truth, where it is known.
    pub truth_n: Option<f64>,
}

/// One line per wheelset: host with interval, node, truth, and how far host and node are from the truth.
pub fn peak_table(rows: &[PeakComparison]) -> String {
    let mut text = String::from(
        "passage wheelset     host kN   90 % interval    node kN   truth kN   host err   node err\n",
    );
    for row in rows {
        let kn = |v: Option<f64>| v.map_or("-".into(), |v| format!("{:.1}", 1e-3 * v));
        let error = |v: Option<f64>| match (v, row.truth_n) {
            (Some(v), Some(truth)) if truth > 0.0 => format!("{:+.1} %", 100.0 * (v / truth - 1.0)),
            _ => "-".into(),
        };
        let host = row.host_n;
        let interval = format!("{:.1} \u{2026} {:.1}", 1e-3 * host.lower, 1e-3 * host.upper);
        text.push_str(&format!(
            "{:>7} {:>8} {:>11} {:>15} {:>10} {:>10} {:>10} {:>10}\n",
            row.passage_id,
            row.wheelset,
            kn(Some(host.value)),
            interval,
            kn(row.node_n),
            kn(row.truth_n),
            error(Some(host.value)),
            error(row.node_n)
        ));
    }
    text
}

/// Median and 90th percentile of the errors against the truth, one line for the host, one for the node.
pub fn peak_summary(rows: &[PeakComparison]) -> String {
    let line = |name: &str, value: fn(&PeakComparison) -> Option<f64>| {
        let error = |row: &PeakComparison| Some(100.0 * (value(row)? / row.truth_n? - 1.0).abs());
        let errors: Vec<f64> = rows.iter().filter_map(error).collect();
        if errors.is_empty() {
            return format!("{name}: no peaks to compare\n");
        }
        format!(
            "{name}: {} peaks, error against the truth: median {:.2} %, 90th percentile {:.2} %\n",
            errors.len(),
            quantile(&errors, 0.5),
            quantile(&errors, 0.9)
        )
    };
    let covered = rows
        .iter()
        .filter(|r| r.truth_n.is_some_and(|truth| r.host_n.lower <= truth && truth <= r.host_n.upper));
    let known = rows.iter().filter(|r| r.truth_n.is_some()).count();
    format!(
        "{}{}{} of {known} true peaks lie inside the 90 % interval of the host\n",
        line("host", |r| Some(r.host_n.value)),
        line("node", |r| r.node_n),
        covered.count()
    )
}

/// Text filled up with blanks to `width` characters.
pub(super) fn padded(text: &str, width: usize) -> String {
    let missing = width.saturating_sub(text.chars().count());
    format!("{text}{}", " ".repeat(missing))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_errors_relative_to_the_truth() {
        let host_n = Interval { value: 101e3, lower: 99e3, upper: 103e3 };
        let row = PeakComparison { passage_id: 3, wheelset: 7, host_n, node_n: None, truth_n: Some(100e3) };
        let text = peak_table(&[row]);
        let words: Vec<&str> = text.lines().last().unwrap().split_whitespace().collect();
        assert_eq!(words, ["3", "7", "101.0", "99.0", "\u{2026}", "103.0", "-", "100.0", "+1.0", "%", "-"]);
    }
}
