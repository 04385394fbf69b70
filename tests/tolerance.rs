//! Tolerances of the whole-system tests, with their reasons.
#![allow(dead_code, reason = "each test file uses its own part")]

/// Speed of a field recording against the truth, relative, median of a site. Three times what was measured; the
/// force estimate needs 1e-3.
pub const SPEED_MEDIAN: f64 = 3e-4;
/// The same for the worst recording.
pub const SPEED_LARGEST: f64 = 1e-3;
/// Speed against the operator's, relative: his is within 1 %, plus our own error.
pub const SPEED_OPERATOR: f64 = 1.05e-2;
