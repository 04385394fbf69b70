//! Railway crossing panel condition monitoring.

pub mod analysis;
pub mod recording;
