//! Railway crossing panel condition monitoring.

pub mod analysis;
pub mod ballast;
pub mod beam;
pub mod cmd;
pub mod forces;
pub mod greens;
pub mod identify;
pub mod indicator;
pub mod inverse;
pub mod irregularity;
pub mod kernel;
pub mod node_sim;
pub mod passage;
pub mod pipeline;
pub mod progress;
pub mod reconstruct;
pub mod recording;
pub mod report;
pub mod results;
pub mod scenario;
pub mod scoring;
pub mod section;
pub mod signal;
pub mod track;
pub mod vehicle;
pub mod verification;
