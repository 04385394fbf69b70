//! Tables in Markdown.

/// Head, rule and rows.
pub fn rows<H: AsRef<str>>(columns: &[H], rows: &[Vec<String>]) -> String {
    let line = |cells: Vec<&str>| format!("| {} |\n", cells.join(" | "));
    let head = line(columns.iter().map(AsRef::as_ref).collect());
    let rule = line(columns.iter().map(|_| "---").collect());
    let rows: String = rows.iter().map(|r| line(r.iter().map(String::as_str).collect())).collect();
    format!("{head}{rule}{rows}")
}

#[cfg(test)]
mod tests {
    #[test]
    fn analytic_head_rule_and_row() {
        let text = super::rows(&["a", "b"], &[vec!["1".into(), "2".into()]]);
        assert_eq!(text, "| a | b |\n| --- | --- |\n| 1 | 2 |\n");
    }
}
