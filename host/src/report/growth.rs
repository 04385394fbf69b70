//! Figure of how cost grows.

use super::ReportError;
use super::plot::{Axis, BLUE, GREY, Layer, Plot, Point};
use crate::bench::growth::Curve;

/// CPU time over the number of what was doubled, both as powers of two of the first point, beside proportional growth.
pub fn figure(curve: &Curve) -> Result<String, ReportError> {
    let Some(&(n0, t0)) = curve.points.first() else { return Ok(String::new()) };
    let doublings = |(n, t): &Point| ((n / n0).log2(), (t / t0).log2());
    let measured: Vec<Point> = curve.points.iter().map(doublings).collect();
    let last = measured.iter().fold(1.0_f64, |m, p| m.max(p.0));
    let highest = measured.iter().fold(last, |m, p| m.max(p.1));
    let words = measured.iter().zip(&curve.points).map(|(at, (n, t))| Layer::Word {
        at: (at.0 + 0.02 * last, at.1 - 0.03 * highest),
        text: format!("{n:.0}: {t:.3} s"),
        color: BLUE,
    });
    let x_caption = format!("doublings of the {}, from {n0:.0}", curve.of);
    let mut layers = vec![
        Layer::Dashed { points: vec![(0.0, 0.0), (last, last)], color: GREY, width: 3 },
        Layer::Word { at: (0.3 * last, 0.46 * last), text: "proportional".into(), color: GREY },
        Layer::Line { points: measured.clone(), color: BLUE, opacity: 1.0, width: 4 },
        Layer::Dots { points: measured.clone(), color: BLUE, opacity: 1.0, size: 8 },
    ];
    layers.extend(words);
    Plot {
        x: Axis { caption: &x_caption, range: (-0.1 * last, 1.25 * last) },
        y: Axis { caption: "doublings of CPU time", range: (-0.1 * highest, 1.15 * highest) },
        down: false,
        height: 760,
        layers,
    }
    .svg(&format!("CPU time of {} over the number of {}", curve.what, curve.of))
}
