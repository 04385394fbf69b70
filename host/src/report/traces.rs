//! Passages of different speed on common axes: distance instead of time, statistics over passages.

use crate::analysis::{PassageResult, WheelsetResult};
use crate::signal::{mean, quantile};

use super::plot::Point;

/// A trace over the distance that the train has run since its first axle was at x = 0, metres.
pub(super) fn over_distance(passage: &PassageResult, trace: &[f64]) -> Vec<Point> {
    let start = passage.axle_times_s.first().copied().unwrap_or(0.0);
    let at = |i: usize| (i as f64 / passage.trace_rate_hz - start) * passage.speed_m_s;
    trace.iter().enumerate().map(|(i, &v)| (at(i), v)).collect()
}

/// Distance between the first and the last axle, metres.
pub(super) fn train_length_m(passages: &[PassageResult]) -> f64 {
    let length = |p: &PassageResult| match (p.axle_times_s.first(), p.axle_times_s.last()) {
        (Some(first), Some(last)) => (last - first) * p.speed_m_s,
        _ => 0.0,
    };
    passages.iter().map(length).filter(|l| l.is_finite()).fold(0.0, f64::max)
}

/// Distances at which the axles follow the first one, metres (of the first passage).
pub(super) fn axle_distances_m(passages: &[PassageResult]) -> Vec<f64> {
    let Some(p) = passages.first() else { return Vec::new() };
    let start = p.axle_times_s.first().copied().unwrap_or(0.0);
    p.axle_times_s.iter().map(|t| (t - start) * p.speed_m_s).collect()
}

/// Thins a trace out to the smallest and largest value of each of `columns` columns, so that every peak stays.
pub(super) fn thin(points: &[Point], range: (f64, f64), columns: usize) -> Vec<Point> {
    let inside: Vec<Point> = points.iter().copied().filter(|p| p.0 >= range.0 && p.0 <= range.1).collect();
    if inside.len() <= 2 * columns {
        return inside;
    }
    let extremes = |chunk: &[Point]| {
        let low = chunk.iter().copied().min_by(|a, b| a.1.total_cmp(&b.1));
        let high = chunk.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1));
        let mut both: Vec<Point> = low.into_iter().chain(high).collect();
        both.sort_by(|a, b| a.0.total_cmp(&b.0));
        both
    };
    inside.chunks(inside.len().div_ceil(columns)).flat_map(extremes).collect()
}

/// Value of a trace at `x` by linear interpolation; NaN outside.
pub(super) fn value_at(points: &[Point], x: f64) -> f64 {
    let k = points.partition_point(|p| p.0 < x);
    if k == 0 || k >= points.len() {
        return if points.get(k).is_some_and(|p| p.0 == x) { points[k].1 } else { f64::NAN };
    }
    let ((x0, y0), (x1, y1)) = (points[k - 1], points[k]);
    if x1 > x0 { y0 + (y1 - y0) * (x - x0) / (x1 - x0) } else { y1 }
}

/// Mean and middle 80 % at one place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Spread {
    pub(super) x: f64,
    pub(super) mean: f64,
    pub(super) p10: f64,
    pub(super) p90: f64,
}

/// Statistics over several traces on the grid `x`; places without a value are left out.
pub(super) fn spread(traces: &[Vec<Point>], x: impl Iterator<Item = f64>) -> Vec<Spread> {
    x.filter_map(|x| {
        let values: Vec<f64> = traces.iter().map(|t| value_at(t, x)).filter(|v| v.is_finite()).collect();
        let known = !values.is_empty();
        known.then(|| Spread {
            x,
            mean: mean(&values),
            p10: quantile(&values, 0.1),
            p90: quantile(&values, 0.9),
        })
    })
    .collect()
}

/// All wheelsets of all passages.
pub(super) fn wheelsets(passages: &[PassageResult]) -> impl Iterator<Item = &WheelsetResult> {
    passages.iter().flat_map(|p| &p.wheelsets)
}

/// A vector on the grid of a wheelset, in other units.
pub(super) fn on_grid(wheelset: &WheelsetResult, values: &[f64], factor: f64) -> Vec<Point> {
    wheelset.position_m.iter().zip(values).map(|(&x, &v)| (x, factor * v)).collect()
}

/// Ends of that grid, metres.
pub(super) fn grid_ends_m(passages: &[PassageResult]) -> (f64, f64) {
    let grid = grid_m(passages);
    (grid.first().copied().unwrap_or(-1.0), grid.last().copied().unwrap_or(1.0))
}

/// Middle 80 % as a band.
pub(super) fn band(spread: &[Spread]) -> Vec<(f64, f64, f64)> {
    spread.iter().map(|s| (s.x, s.p10, s.p90)).collect()
}

/// Mean as a line.
pub(super) fn means(spread: &[Spread]) -> Vec<Point> {
    spread.iter().map(|s| (s.x, s.mean)).collect()
}

/// The grid that the first wheelset uses, metres.
pub(super) fn grid_m(passages: &[PassageResult]) -> &[f64] {
    wheelsets(passages).next().map_or(&[], |w| &w.position_m)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn property_thinning_keeps_the_peaks() {
        let points: Vec<Point> =
            (0..10_000).map(|i| (f64::from(i), f64::from((i * 7919) % 10_007))).collect();
        let thinned = thin(&points, (0.0, 10_000.0), 100);
        let peak = |p: &[Point]| p.iter().map(|p| p.1).fold(0.0, f64::max);
        assert_eq!(peak(&points), peak(&thinned));
        assert!(thinned.len() <= 200);
    }

    #[test]
    fn analytic_interpolation() {
        let line = [(0.0, 0.0), (1.0, 2.0), (2.0, 2.0)];
        assert_eq!(value_at(&line, 0.25), 0.5);
        assert_eq!(value_at(&line, 0.0), 0.0);
        assert!(value_at(&line, 2.5).is_nan());
    }
}
