//! Studies of the paper repeated with this program: what they need, what they find beside what the paper says.
//!
//! Six panels ([`panels`]) stand for those of the paper; a study returns tables, and curves that [`crate::report::study`]
//! draws.

pub mod bogie;
pub mod lowpass;
pub mod panels;

use crate::passage::SimulationError;

/// Why a study cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// Simulation of a bogie.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
}
