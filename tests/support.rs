//! Helpers shared by the whole-system tests.

pub mod sample;
pub mod tolerance;
