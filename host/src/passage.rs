//! Simulation of one train passage: bogies of a whole train over two rails on sleepers and ballast, in contact with the
//! rails or not (paper, section 3).
//!
//! The paper condenses its track by Craig-Bampton; here the sleepers are reduced to a few modes plus the static shapes of
//! their rail seats ([`basis`]), the rails keep all their degrees of freedom, and the effective matrix of the implicit
//! time step is factorised once ([`stepper`]). Wheels touch the rails by Hertz's law and may leave them ([`contact`]).
//!
//! A simulation is: [`TrackModel`] → [`Stepper`] (both reusable for every passage over the same track) → [`run`] with a
//! [`Train`], the running surfaces and a [`Journey`] → [`PassageRecord`] → [`sensor`] chain → recording.

pub mod basis;
mod beds;
mod chain;
pub mod contact;
mod effective;
mod error;
mod influence;
pub mod model;
pub mod random;
mod rails;
mod run;
pub mod sensor;
mod sleepers;
pub mod stepper;
pub mod support;
pub mod surface;
pub mod unit;
mod vectors;

pub use error::SimulationError;
pub use model::{RailPoint, SLEEPER_MODES, TrackModel};
pub use run::{ContactTrace, Journey, LEAD_IN_M, PassageRecord, Start, Underway, driven, halt, resume, run};
pub use stepper::{Stepper, TimeStep};
pub use support::{Support, SupportLaw};
pub use surface::{OutOfRoundness, Profile, RunningSurface, WheelFlat};
pub use unit::{Bogie, Train, VehicleUnit, Wheel};

pub(crate) use error::in_range;
