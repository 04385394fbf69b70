//! Lists of numbers beside one another.

/// Largest relative difference of two lists of one length. `f64::max` would drop what is no number, and `zip` what only one of them has.
pub fn largest_difference(found: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let differences = found.iter().zip(expected).map(|(a, b)| (a / b - 1.0).abs());
    differences.reduce(|a, b| if a.is_nan() || a > b { a } else { b }).expect("something to compare")
}
