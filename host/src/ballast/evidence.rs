//! Calibration by evidence.
