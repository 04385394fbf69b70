//! The path under the wheels as cubic B-splines on both rails.

use crate::track::Side;

/// Equidistant knots on the two rails within ± `half_m`; the coefficients of the crossing rail come first.
#[derive(Clone, Debug, PartialEq)]
pub struct PathSplines {
    half_m: f64,
    step_m: [f64; 2],
    count: [usize; 2],
    /// Coefficients, metres.
    pub coefficient_m: Vec<f64>,
}

impl PathSplines {
    /// Level rails with about the given spacings.
    pub fn level(half_m: f64, [crossing_step_m, stock_step_m]: [f64; 2]) -> Self {
        let parts = [crossing_step_m, stock_step_m].map(|s| (2.0 * half_m / s).round().max(1.0));
        let count = parts.map(|p| p as usize + 1);
        Self {
            half_m,
            step_m: parts.map(|p| 2.0 * half_m / p),
            count,
            coefficient_m: vec![0.0; count[0] + count[1]],
        }
    }

    /// Rail and position of every coefficient, metres.
    pub fn knots(&self) -> Vec<(Side, f64)> {
        let of = |rail: usize, side: Side| {
            (0..self.count[rail]).map(move |i| (side, -self.half_m + i as f64 * self.step_m[rail]))
        };
        of(0, Side::Crossing).chain(of(1, Side::Stock)).collect()
    }

    /// Distance of neighbouring knots on a rail, metres.
    pub fn step_m(&self, side: Side) -> f64 {
        self.step_m[usize::from(side == Side::Stock)]
    }

    /// Number of coefficients.
    pub fn len(&self) -> usize {
        self.coefficient_m.len()
    }

    /// Never: both rails have knots.
    pub fn is_empty(&self) -> bool {
        self.coefficient_m.is_empty()
    }

    /// Depth at `x_m`, metres; zero outside.
    pub fn at(&self, side: Side, x_m: f64) -> f64 {
        let rail = usize::from(side == Side::Stock);
        let p = (x_m + self.half_m) / self.step_m[rail];
        if !(p >= 0.0 && p <= (self.count[rail] - 1) as f64) {
            return 0.0;
        }
        let (i, t) = (p.floor() as i64, p.fract());
        let u = 1.0 - t;
        let values = [
            u * u * u / 6.0,
            (3.0 * t * t * t - 6.0 * t * t + 4.0) / 6.0,
            (3.0 * u * u * u - 6.0 * u * u + 4.0) / 6.0,
            t * t * t / 6.0,
        ];
        let first = if rail == 0 { 0 } else { self.count[0] };
        (0..4)
            .filter_map(|k| usize::try_from(i - 1 + k as i64).ok().map(|j| (j, values[k])))
            .filter(|(j, _)| *j < self.count[rail])
            .map(|(j, value)| value * self.coefficient_m[first + j])
            .sum()
    }
}

/// Matérn-5/2 correlation at a distance in correlation lengths.
pub fn matern(distance: f64) -> f64 {
    let r = 5f64.sqrt() * distance;
    (1.0 + r + r * r / 3.0) * (-r).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_splines_add_up_to_one_inside() {
        let mut path = PathSplines::level(1.0, [0.1, 0.25]);
        path.coefficient_m.fill(1.0);
        for side in [Side::Crossing, Side::Stock] {
            for x in [-0.7, 0.0, 0.333, 0.71] {
                assert!((path.at(side, x) - 1.0).abs() < 1e-12);
            }
            assert_eq!(path.at(side, 1.2), 0.0);
        }
    }
}
