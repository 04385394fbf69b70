//! Largest value along a curve, refined between the points.

/// Where a parabola through three neighbouring points has its vertex: −0.5 … 0.5 steps from the middle one; 0 when
/// the middle is not the largest.
pub fn vertex(before: f32, middle: f32, after: f32) -> f32 {
    let curvature = before - 2.0 * middle + after;
    if curvature >= 0.0 || !curvature.is_finite() {
        return 0.0;
    }
    (0.5 * (before - after) / curvature).clamp(-0.5, 0.5)
}

/// A peak of a curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peak {
    /// Point of the grid nearest to it.
    pub index: usize,
    /// Distance from that point, in steps of the grid, −0.5 … 0.5; 0 at the ends of the grid.
    pub shift: f32,
    /// Value there.
    pub value: f32,
}

/// Largest value of a curve; `None` for an empty one or when nothing in it is a number.
pub fn largest(curve: &[f32]) -> Option<Peak> {
    let mut best: Option<(usize, f32)> = None;
    for (k, &y) in curve.iter().enumerate() {
        if y.is_finite() && best.is_none_or(|(_, top)| y > top) {
            best = Some((k, y));
        }
    }
    let (index, value) = best?;
    let around = |k: usize| index.checked_sub(k).and_then(|from| curve.get(from..=index + k));
    let Some(&[before, _, after]) = around(1) else { return Some(Peak { index, shift: 0.0, value }) };
    let shift = vertex(before, value, after);
    let refined = match around(2) {
        Some(&[a, b, c, d, e]) => Quartic::through([a, b, c, d, e]).top(shift),
        _ => None,
    };
    let (shift, value) = refined.unwrap_or((shift, value - 0.25 * (before - after) * shift));
    Some(Peak { index, shift, value })
}

/// Enough from a parabola's vertex: the third changes nothing in single precision.
const NEWTON_STEPS: usize = 3;

/// Stirling's polynomial through five equidistant points, about the middle one. A force of 250 Hz has five points of a slow
/// train's grid to a wave; between two of them a parabola through three lacks up to 5 % of it, this 1.5 %.
struct Quartic {
    value: f32,
    /// Central differences: mean first, second, mean third, fourth.
    differences: [f32; 4],
}

impl Quartic {
    fn through([a, b, c, d, e]: [f32; 5]) -> Self {
        let (first, third) = (0.5 * (d - b), 0.5 * (e - a) - (d - b));
        let (second, fourth) = (b - 2.0 * c + d, (a + e) - 4.0 * (b + d) + 6.0 * c);
        Self { value: c, differences: [first, second, third, fourth] }
    }

    fn at(&self, t: f32) -> f32 {
        let [first, second, third, fourth] = self.differences;
        let cubic = t * (t * t - 1.0) / 6.0;
        self.value + t * first + 0.5 * t * t * second + cubic * third + 0.25 * t * cubic * fourth
    }

    /// Where it is largest within half a step of the middle, by Newton's method from `start`, and its value there; `None`
    /// where that is less than in the middle.
    fn top(&self, start: f32) -> Option<(f32, f32)> {
        let [first, second, third, fourth] = self.differences;
        let mut t = start;
        for _ in 0..NEWTON_STEPS {
            let slope = first
                + t * second
                + (3.0 * t * t - 1.0) / 6.0 * third
                + t * (2.0 * t * t - 1.0) / 12.0 * fourth;
            let curvature = second + t * third + (6.0 * t * t - 1.0) / 12.0 * fourth;
            if curvature >= 0.0 {
                return None;
            }
            t = (t - slope / curvature).clamp(-0.5, 0.5);
        }
        let value = self.at(t);
        (value >= self.value).then_some((t, value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn analytic_parabola_is_exact() {
        let curve: [f32; 9] = core::array::from_fn(|k| 100.0 - (k as f32 - 4.3) * (k as f32 - 4.3));
        let peak = largest(&curve).unwrap();
        assert_eq!(peak.index, 4);
        assert!((peak.shift - 0.3).abs() < 1e-5 && (peak.value - 100.0).abs() < 1e-4);
    }

    #[test]
    fn analytic_a_wave_of_eight_points_between_two_of_them() {
        for shift in [0.0, 0.2, 0.49, -0.3] {
            let wave = |k: usize| libm::cosf(core::f32::consts::TAU / 8.0 * (k as f32 - 6.0 - shift));
            let curve: [f32; 13] = core::array::from_fn(wave);
            let peak = largest(&curve).unwrap();
            assert_eq!(peak.index, 6);
            // A parabola: 0.0085 and 0.01.
            assert!((peak.value - 1.0).abs() < 0.0015, "{shift}: {}", peak.value);
            assert!((peak.shift - shift).abs() < 0.003, "{shift}: {}", peak.shift);
        }
    }

    #[test]
    fn property_ends_and_nothing() {
        assert_eq!(largest(&[3.0, 2.0]), Some(Peak { index: 0, shift: 0.0, value: 3.0 }));
        assert_eq!(largest(&[f32::NAN]), None);
        assert_eq!(largest(&[]), None);
    }

    proptest! {
        #[test]
        fn property_no_smaller_than_any_point(curve in proptest::collection::vec(-1e6_f32..1e6, 1..50)) {
            let peak = largest(&curve).unwrap();
            prop_assert!(curve.iter().all(|&y| y <= peak.value));
        }
    }
}
