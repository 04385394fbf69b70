//! Helpers shared by the whole-system tests.

pub mod program;
pub mod sample;
pub mod synthetic_kernel;
pub mod tolerance;
