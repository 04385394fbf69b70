//! Contact force from acceleration, with intervals (paper, section 4.2, eq. 9-12, and beyond).
//!
//! The main method is the linear-Gaussian estimate in the acceleration domain: the unknown force deviations f − Q of
//! all wheels of an axle group have a Gaussian prior, the sensor noise is white, and the recorder is part of the
//! forward model. Posterior mean and covariance are closed forms, and the mean is linear in the recording:
//! f̂ = b + K a with fixed K, b and fixed interval widths. The same K is what the node applies.

pub mod displacement;
mod deviations;
mod estimator;
pub mod hierarchy;
pub mod hyper;
mod prior;
mod prior_root;
mod profile;
pub mod train;
mod wheel;

pub use estimator::{AxleGain, Estimator, GroupGeometry, InverseError};
pub use prior::{Beyond, Prior, Spread};
pub use profile::{CommonProfile, PositionGrid, ProfileGrids, WheelClass};
pub use wheel::{Excitation, Running, TrackModel};
