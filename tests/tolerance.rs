//! Tolerances of the whole-system tests, each with its reason.

/// Values that pass through a float64 column are the same bits.
pub const EXACT: f64 = 0.0;

/// Relative; values that pass through a float32 column once: half a unit in the last place of 24 bits.
pub const FLOAT32_COLUMN: f64 = 6e-8;
