//! Why recordings and model differ: the sim-to-real gap and its diagnosis.

pub mod base;
pub mod clipping;
pub mod consequences;
pub mod consistency;
pub mod corrected;
pub mod data;
mod departures;
pub mod diagnosis;
pub mod effect;
pub mod effects;
mod envelopes;
pub mod equivalent;
pub mod estimated_path;
pub mod fit;
pub mod forward;
pub mod hammer;
pub mod included;
pub mod ladder;
pub mod latent;
pub mod linear;
pub mod measure;
pub mod node_stage;
pub mod open_bed;
mod prospect;
pub mod receptance;
pub mod results;
pub mod select;
pub mod splines;
pub mod split;
mod steady;
pub mod together;
pub mod trains;
pub mod trial;
pub mod variation;
pub mod verdict;
pub mod where_;
pub mod world;

use crate::passage::SimulationError;

/// Why a site cannot be diagnosed.
#[derive(Debug, thiserror::Error)]
pub enum GapError {
    /// The forward simulation refuses the assumed site.
    #[error("the forward simulation failed: {0}")]
    Simulation(#[from] SimulationError),
    /// A system of equations without solution.
    #[error("{what} has no unique solution; check speeds, loads and scan of the site")]
    Singular {
        /// Which one.
        what: &'static str,
    },
    /// Recordings sampled too slowly for the band of the comparison.
    #[error(
        "passage {passage_id}: sampling rate {rate_hz} Hz; the diagnosis needs {least_hz} Hz at least; record at 4000 Hz"
    )]
    SampleRate {
        /// Which recording.
        passage_id: i32,
        /// As stated, Hz.
        rate_hz: f64,
        /// Least rate, Hz.
        least_hz: f64,
    },
    /// A receptance that no track has.
    #[error(
        "the hammer's receptance is {ratio:.3} times that of the track as described, as no track is: force must be in N, acceleration in \
         m/s² and the receptance in m/N"
    )]
    HammerScale {
        /// Measured over modelled, median over the frequencies.
        ratio: f64,
    },
    /// Hammer hits beyond the rails.
    #[error("hammer hits at x = {x_m} m; the rails reach from {} to {} m", ends_m[0], ends_m[1])]
    HammerOutside {
        /// Place of the hits, metres.
        x_m: f64,
        /// Ends of the rails, metres.
        ends_m: [f64; 2],
    },
    /// No train in any recording.
    #[error("no passage with a train in it is left; the recordings are silent")]
    Silent,
    /// No train in some recordings.
    #[error("no train found in passages {passage_id:?}: leave them out")]
    SilentPassages {
        /// Which ones.
        passage_id: Vec<i32>,
    },
}
