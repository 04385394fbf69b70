//! Largest value along a curve, with parabolic refinement between the points.

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
    let neighbours = index.checked_sub(1).and_then(|k| curve.get(k)).zip(curve.get(index + 1));
    let Some((&before, &after)) = neighbours else { return Some(Peak { index, shift: 0.0, value }) };
    let shift = vertex(before, value, after);
    Some(Peak { index, shift, value: value - 0.25 * (before - after) * shift })
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
