//! Railway crossing panel condition monitoring.

pub mod recording;
pub mod signal;
pub mod reconstruct;
pub mod section;
pub mod beam;
pub mod track;
pub mod vehicle;
pub mod ballast;
pub mod greens;
pub mod interaction;
pub mod inverse;
pub mod identify;
pub mod forces;
pub mod irregularity;
pub mod indicator;
pub mod kernel;
pub mod node_client;
pub mod node_sim;
pub mod analysis;
pub mod pipeline;
pub mod progress;
pub mod scoring;
pub mod verification;
pub mod results;
pub mod report;
pub mod cmd;
