//! Natural cubic spline through given points.

/// Piecewise cubic with continuous second derivative and zero curvature at both ends.
#[derive(Clone, Debug)]
pub struct CubicSpline {
    x: Vec<f64>,
    y: Vec<f64>,
    /// Second derivatives at the knots.
    curvature: Vec<f64>,
}

impl CubicSpline {
    /// Through points with strictly ascending `x`; `None` when there are fewer than two, the lengths differ or the
    /// abscissae do not ascend.
    pub fn new(x: &[f64], y: &[f64]) -> Option<Self> {
        if x.len() < 2
            || x.len() != y.len()
            || x.windows(2).any(|w| w[1].partial_cmp(&w[0]) != Some(std::cmp::Ordering::Greater))
        {
            return None;
        }
        Some(Self { x: x.to_vec(), y: y.to_vec(), curvature: natural_curvature(x, y) })
    }

    /// Zero everywhere.
    pub fn zero() -> Self {
        Self { x: vec![0.0, 1.0], y: vec![0.0; 2], curvature: vec![0.0; 2] }
    }

    /// Value at `x`; the end cubics are continued linearly outside, so nothing explodes there.
    pub fn at(&self, x: f64) -> f64 {
        let last = self.x.len() - 1;
        if x <= self.x[0] {
            return self.y[0] + self.slope(0, 0.0) * (x - self.x[0]);
        }
        if x >= self.x[last] {
            return self.y[last] + self.slope(last - 1, 1.0) * (x - self.x[last]);
        }
        let i = self.x.partition_point(|knot| *knot <= x).clamp(1, last) - 1;
        let h = self.x[i + 1] - self.x[i];
        let (a, b) = ((self.x[i + 1] - x) / h, (x - self.x[i]) / h);
        a * self.y[i]
            + b * self.y[i + 1]
            + ((a * a * a - a) * self.curvature[i] + (b * b * b - b) * self.curvature[i + 1]) * h * h / 6.0
    }

    /// First derivative in interval `i` at the relative position 0 or 1.
    fn slope(&self, i: usize, b: f64) -> f64 {
        let h = self.x[i + 1] - self.x[i];
        let a = 1.0 - b;
        (self.y[i + 1] - self.y[i]) / h
            + h / 6.0
                * ((1.0 - 3.0 * a * a) * self.curvature[i] + (3.0 * b * b - 1.0) * self.curvature[i + 1])
    }
}

/// Thomas algorithm on the usual tridiagonal system for the knots' second derivatives.
fn natural_curvature(x: &[f64], y: &[f64]) -> Vec<f64> {
    let n = x.len();
    let mut curvature = vec![0.0; n];
    let mut upper = vec![0.0; n];
    for i in 1..n - 1 {
        let (h0, h1) = (x[i] - x[i - 1], x[i + 1] - x[i]);
        let rhs = 6.0 * ((y[i + 1] - y[i]) / h1 - (y[i] - y[i - 1]) / h0);
        let pivot = 2.0 * (h0 + h1) - h0 * upper[i - 1];
        upper[i] = h1 / pivot;
        curvature[i] = (rhs - h0 * curvature[i - 1]) / pivot;
    }
    for i in (1..n - 1).rev() {
        curvature[i] -= upper[i] * curvature[i + 1];
    }
    curvature
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_a_straight_line_is_reproduced_also_outside() {
        let spline = CubicSpline::new(&[0.0, 1.0, 3.0], &[1.0, 3.0, 7.0]).unwrap();
        for x in [-2.0, 0.5, 2.0, 5.0] {
            assert!((spline.at(x) - (1.0 + 2.0 * x)).abs() < 1e-12);
        }
    }

    #[test]
    fn property_error_of_a_sine_falls_with_the_fourth_power_of_the_step() {
        let error = |n: usize| {
            let x: Vec<f64> = (0..=n).map(|i| i as f64 * std::f64::consts::TAU / n as f64).collect();
            let spline = CubicSpline::new(&x, &x.iter().map(|v| v.sin()).collect::<Vec<_>>()).unwrap();
            (0..1000).map(|i| i as f64 * 0.00628).map(|v| (spline.at(v) - v.sin()).abs()).fold(0.0, f64::max)
        };
        let order = (error(20) / error(40)).log2();
        assert!((3.6..4.4).contains(&order), "order {order}");
    }

    #[test]
    fn property_bad_knots_are_refused() {
        assert!(CubicSpline::new(&[0.0], &[1.0]).is_none());
        assert!(CubicSpline::new(&[0.0, 0.0], &[1.0, 1.0]).is_none());
        assert!(CubicSpline::new(&[0.0, f64::NAN], &[1.0, 1.0]).is_none());
    }
}
