//! One plot: axes and layers of lines, bands and marks, drawn to SVG.
//!
//! All sizes are in device units at twice the size at which the page shows them, because the backend rounds every
//! coordinate to a whole unit.

use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;

use super::ReportError;

/// Width of every plot, device units.
const WIDTH: u32 = 1520;
const FONT: &str = "sans-serif";
const LABEL_SIZE: u32 = 34;
pub(super) const INK: RGBColor = RGBColor(60, 66, 72);
const GRID: RGBColor = RGBColor(226, 230, 234);

pub(super) const BLUE: RGBColor = RGBColor(27, 94, 165);
pub(super) const ORANGE: RGBColor = RGBColor(214, 103, 12);
pub(super) const GREEN: RGBColor = RGBColor(34, 125, 82);
pub(super) const RED: RGBColor = RGBColor(188, 45, 45);
pub(super) const GREY: RGBColor = RGBColor(128, 135, 142);

/// A point of a plot in the units of its axes.
pub(super) type Point = (f64, f64);

/// What a plot shows, drawn in the order given.
pub(super) enum Layer {
    /// A line; points that are not finite are left out.
    Line { points: Vec<Point>, color: RGBColor, opacity: f64, width: u32 },
    /// A broken line.
    Dashed { points: Vec<Point>, color: RGBColor, width: u32 },
    /// The area between a lower and an upper line: (x, lower, upper).
    Band { points: Vec<(f64, f64, f64)>, color: RGBColor, opacity: f64 },
    /// Filled circles.
    Dots { points: Vec<Point>, color: RGBColor, opacity: f64, size: u32 },
    /// Vertical bars from lower to upper: (x, lower, upper).
    Whiskers { points: Vec<(f64, f64, f64)>, color: RGBColor, opacity: f64, width: u32 },
    /// A word at a point, to the right of it and above.
    Word { at: Point, text: String, color: RGBColor },
}

/// One axis: caption with unit, ends. A y axis without a caption is not drawn.
#[derive(Clone, Copy)]
pub(super) struct Axis<'a> {
    pub(super) caption: &'a str,
    pub(super) range: (f64, f64),
}

/// A plot. With `down`, y grows downwards, as the track bends.
pub(super) struct Plot<'a> {
    pub(super) x: Axis<'a>,
    pub(super) y: Axis<'a>,
    pub(super) down: bool,
    pub(super) height: u32,
    pub(super) layers: Vec<Layer>,
}

type Chart<'a> = ChartContext<'a, SVGBackend<'a>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// Ends of an axis that shows all `values` with a margin; never empty, never infinite.
pub(super) fn range_of(values: impl IntoIterator<Item = f64>, margin: f64) -> (f64, f64) {
    let finite = values.into_iter().filter(|v| v.is_finite());
    let (low, high) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    if low > high {
        return (0.0, 1.0);
    }
    let span = (high - low).max(1e-9 * high.abs().max(low.abs())).max(1e-12);
    (low - margin * span, high + margin * span)
}

impl Plot<'_> {
    /// Draws the plot; `label` describes it to those who cannot see it.
    pub(super) fn svg(&self, label: &str) -> Result<String, ReportError> {
        let mut svg = String::new();
        {
            let root = SVGBackend::with_string(&mut svg, (WIDTH, self.height)).into_drawing_area();
            let mut chart = self.chart(&root)?;
            for layer in &self.layers {
                self.paint(&mut chart, layer)?;
            }
            root.present().map_err(ReportError::draw)?;
        }
        let size = format!("<svg width=\"{WIDTH}\" height=\"{}\"", self.height);
        Ok(svg.replacen(
            &size,
            &format!("<svg role=\"img\" aria-label=\"{}\"", super::page::escape(label)),
            1,
        ))
    }

    fn chart<'a>(
        &self,
        root: &DrawingArea<SVGBackend<'a>, plotters::coord::Shift>,
    ) -> Result<Chart<'a>, ReportError> {
        let (x, y) = (self.x.range, self.y_range());
        let mut chart = ChartBuilder::on(root)
            .margin_top(18)
            .margin_right(36)
            .margin_bottom(6)
            .x_label_area_size(104)
            .y_label_area_size(if self.y.caption.is_empty() { 36 } else { 138 })
            .build_cartesian_2d(x.0..x.1, y.0..y.1)
            .map_err(ReportError::draw)?;
        let text = (FONT, LABEL_SIZE).into_font().color(&INK);
        let sign = if self.down { -1.0 } else { 1.0 };
        let mut mesh = chart.configure_mesh();
        if self.y.caption.is_empty() {
            mesh.disable_y_axis().disable_y_mesh();
        }
        mesh.x_desc(self.x.caption)
            .y_desc(self.y.caption)
            .axis_desc_style(text.clone())
            .label_style(text)
            .light_line_style(TRANSPARENT)
            .bold_line_style(GRID.stroke_width(2))
            .axis_style(INK.stroke_width(2))
            .x_labels(9)
            .y_labels(7)
            .x_label_formatter(&|v| tick(*v, x.1 - x.0))
            .y_label_formatter(&|v| tick(sign * v, y.1 - y.0))
            .draw()
            .map_err(ReportError::draw)?;
        Ok(chart)
    }

    fn y_range(&self) -> (f64, f64) {
        let (low, high) = self.y.range;
        if self.down { (-high, -low) } else { (low, high) }
    }

    /// Into drawing coordinates; `None` outside the x axis and where a value is missing. Values beyond the y axis
    /// are drawn at its end: far ones would overflow the whole units of the backend.
    fn place(&self, (x, y): Point) -> Option<Point> {
        let inside = x >= self.x.range.0 && x <= self.x.range.1 && y.is_finite();
        let y = y.clamp(self.y.range.0, self.y.range.1);
        inside.then_some((x, if self.down { -y } else { y }))
    }

    fn places(&self, points: &[Point]) -> Vec<Point> {
        points.iter().filter_map(|&p| self.place(p)).collect()
    }

    fn paint(&self, chart: &mut Chart, layer: &Layer) -> Result<(), ReportError> {
        match layer {
            Layer::Line { points, color, opacity, width } => {
                let style = color.mix(*opacity).stroke_width(*width);
                chart.draw_series([PathElement::new(self.places(points), style)])
            }
            Layer::Dashed { points, color, width } => {
                let style = color.stroke_width(*width);
                chart.draw_series(DashedLineSeries::new(self.places(points), 16, 10, style))
            }
            Layer::Band { points, color, opacity } => {
                let outline = self.outline(points);
                chart.draw_series([Polygon::new(outline, color.mix(*opacity).filled())])
            }
            Layer::Dots { points, color, opacity, size } => {
                let style = color.mix(*opacity).filled();
                chart.draw_series(self.places(points).into_iter().map(|p| Circle::new(p, *size, style)))
            }
            Layer::Whiskers { points, color, opacity, width } => {
                let style = color.mix(*opacity).stroke_width(*width);
                let bars = points.iter().filter_map(|&(x, low, high)| {
                    Some(PathElement::new(vec![self.place((x, low))?, self.place((x, high))?], style))
                });
                chart.draw_series(bars)
            }
            Layer::Word { at, text, color } => {
                let font = (FONT, LABEL_SIZE).into_font().color(color);
                chart.draw_series(self.place(*at).map(|p| Text::new(text.clone(), p, font)))
            }
        }
        .map(|_| ())
        .map_err(ReportError::draw)
    }

    fn outline(&self, points: &[(f64, f64, f64)]) -> Vec<Point> {
        let edge = |k: fn(&(f64, f64, f64)) -> f64| {
            points.iter().filter_map(move |p| self.place((p.0, k(p)))).collect::<Vec<_>>()
        };
        let (mut low, high) = (edge(|p| p.1), edge(|p| p.2));
        low.extend(high.into_iter().rev());
        low
    }
}

/// A tick label on an axis of length `span`: no trailing zeros, no negative zero, a true minus sign, powers of ten
/// where decimals would not fit.
fn tick(value: f64, span: f64) -> String {
    if value.abs() < 1e-6 * span {
        return "0".into();
    }
    if (0.01..1e6).contains(&span) {
        return trimmed(&format!("{value:.4}"));
    }
    let text = format!("{value:.3e}");
    let (digits, power) = text.split_once('e').unwrap_or((&text, "0"));
    let power: String = power.chars().map(superscript).collect();
    format!("{}·10{power}", trimmed(digits))
}

pub(super) fn trimmed(decimal: &str) -> String {
    decimal.trim_end_matches('0').trim_end_matches('.').replace('-', "\u{2212}")
}

fn superscript(c: char) -> char {
    const DIGITS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    c.to_digit(10).map_or('⁻', |d| DIGITS[d as usize])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn analytic_tick_labels() {
        let labels = [-0.00001, 0.5, -20.0, 100.0].map(|v| tick(v, 120.0));
        assert_eq!(labels, ["0", "0.5", "\u{2212}20", "100"]);
        assert_eq!([0.0, -2.5e-9].map(|v| tick(v, 1e-8)), ["0", "\u{2212}2.5·10⁻⁹"]);
        assert_eq!(tick(2e12, 3e12), "2·10¹²");
    }

    proptest! {
        #[test]
        fn property_any_numbers_give_a_plot(
            values in proptest::collection::vec((proptest::num::f64::ANY, proptest::num::f64::ANY), 0..20),
        ) {
            let x = range_of(values.iter().map(|p| p.0).filter(|v| v.abs() < 1e12), 0.0);
            let y = range_of(values.iter().map(|p| p.1).filter(|v| v.abs() < 1e12), 0.05);
            let plot = Plot {
                x: Axis { caption: "x, m", range: x },
                y: Axis { caption: "y, m", range: y },
                down: true,
                height: 600,
                layers: vec![
                    Layer::Line { points: values.clone(), color: BLUE, opacity: 1.0, width: 3 },
                    Layer::Dashed { points: values.clone(), color: BLUE, width: 3 },
                    Layer::Dots { points: values, color: RED, opacity: 0.5, size: 8 },
                ],
            };
            prop_assert!(plot.svg("any").is_ok());
        }
    }
}
