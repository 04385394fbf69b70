//! Several plots in one SVG, each with its letter.

use super::page::escape;

/// Size of one plot's drawing, device units; as in [`super::plot`].
const WIDTH: usize = 1520;
/// Room for the title of a plot, device units.
const TITLE: usize = 64;

/// Plots of equal height side by side, `columns` in a row, with a title above each.
pub(super) fn grid(plots: &[(String, String)], columns: usize, height: usize, label: &str) -> String {
    let rows = plots.len().div_ceil(columns.max(1));
    let (w, h) = (WIDTH * columns, (height + TITLE) * rows);
    let mut out = format!(
        "<svg role=\"img\" aria-label=\"{}\" viewBox=\"0 0 {w} {h}\" xmlns=\"http://www.w3.org/2000/svg\">\n\
         <rect width=\"{w}\" height=\"{h}\" fill=\"white\"/>\n",
        escape(label)
    );
    for (k, (title, svg)) in plots.iter().enumerate() {
        let (x, y) = (WIDTH * (k % columns), (height + TITLE) * (k / columns));
        let placed = svg.replacen(
            "<svg ",
            &format!("<svg x=\"{x}\" y=\"{}\" width=\"{WIDTH}\" height=\"{height}\" ", y + TITLE),
            1,
        );
        out.push_str(&format!(
            "<text x=\"{}\" y=\"{}\" font-family=\"sans-serif\" font-size=\"44\" font-weight=\"bold\" \
             fill=\"#3c4248\">{}</text>\n{placed}\n",
            x + 150,
            y + 50,
            escape(title)
        ));
    }
    out + "</svg>\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn property_every_plot_has_its_place_and_title() {
        let one = ("a < b".to_string(), "<svg viewBox=\"0 0 1 1\"></svg>".to_string());
        let svg = grid(&[one.clone(), one.clone(), one], 2, 600, "label");
        assert_eq!(svg.matches("<svg ").count(), 4);
        assert!(svg.contains("x=\"1520\" y=\"64\"") && svg.contains("y=\"728\"") && svg.contains("a &lt; b"));
        assert!(svg.contains("viewBox=\"0 0 3040 1328\""));
    }
}
