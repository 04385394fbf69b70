//! Railway crossing panel condition monitoring.

pub mod analysis;
pub mod ballast;
pub mod beam;
pub mod greens;
pub mod inverse;
pub mod reconstruct;
pub mod recording;
pub mod report;
pub mod results;
pub mod section;
pub mod signal;
pub mod track;
pub mod vehicle;
