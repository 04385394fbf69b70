//! Helpers shared by the whole-system tests.

pub mod compare;
pub mod diagnosed;
pub mod elf;
pub mod flaky_line;
pub mod program;
pub mod rows;
pub mod sample;
pub mod synthetic_kernel;
pub mod tolerance;
