//! Sites that do not exist: a site description plus what really happens there, simulated into a site directory with truth.
//!
//! A scenario file is a `crossing.toml` (what the operator believes) with a `[simulation]` table (what is true).

pub mod effects;
mod file;
mod generate;
mod geometry;
mod limits;

pub use effects::Effects;
pub use file::{
    BallastTruthInput, Geometry, Roughness, Scenario, ScenarioError, Simulation, Solver, WheelVariation,
    read_scenario,
};
pub use generate::{SimulatedSite, simulate};
pub use geometry::{crossing_path, roughness};
