//! Studies of the paper repeated with this program: what they need, what they find beside what the paper says.
//!
//! Six panels ([`panels`]) stand for those of the paper; a study returns tables, and curves that [`crate::report::study`]
//! draws.

pub mod assumptions;
pub mod bogie;
pub mod kernels;
pub mod lowpass;
pub mod panels;
pub mod samples;
pub mod simulation;

use crate::inverse::displacement::DisplacementError;
use crate::passage::SimulationError;
use crate::scenario::ScenarioError;
use crate::verification::VerifyError;

/// Why a study cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// Simulation of a bogie.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
    /// Force from displacement.
    #[error(transparent)]
    Displacement(#[from] DisplacementError),
    /// Simulation of a site.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// Analysis of a simulated site.
    #[error(transparent)]
    Verify(#[from] VerifyError),
    /// The scan of a simulated path cannot be written.
    #[error("cannot write a temporary scan: {0}")]
    Scan(#[from] std::io::Error),
    /// A simulation left nothing to work on.
    #[error("the {0} is empty")]
    Empty(&'static str),
}
