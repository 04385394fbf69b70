//! Simulations that cannot be run, each with the number that is at fault.

/// Why a passage cannot be simulated.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)]
pub enum SimulationError {
    #[error("time step {dt_s} s is outside {min_s} … {max_s} s; 1e-4 s is usual")]
    TimeStep { dt_s: f64, min_s: f64, max_s: f64 },

    #[error(
        "integration parameter theta = {theta} is outside 0.5 … 1; below 0.5 the scheme is unstable, 0.5 is \
         Newmark's average acceleration"
    )]
    Theta { theta: f64 },

    #[error("{supports} ballast supports for {sleepers} sleepers; give one per sleeper")]
    Supports { supports: usize, sleepers: usize },

    #[error("{what} = {value}{} is outside {min} … {max}{}", spaced(.unit), spaced(.unit))]
    OutOfRange { what: &'static str, value: f64, min: f64, max: f64, unit: &'static str },

    #[error("the {what} matrix of {place} is not positive definite; check masses and stiffnesses")]
    Singular { what: &'static str, place: String },

    #[error("a static start needs linear ballast, but sleeper {sleeper} has a gap or stiffens")]
    StaticStart { sleeper: usize },

    #[error("the train has {axles} axles on {wheels} wheels; every axle needs two wheels")]
    Wheels { axles: usize, wheels: usize },

    #[error("path {path} of wheel {wheel} does not exist; the crossing has {paths} paths")]
    Path { path: usize, wheel: usize, paths: usize },

    #[error(
        "axles {before_m} m and then {after_m} m behind the first: the units of a train come front to rear, one behind the other"
    )]
    Order { before_m: f64, after_m: f64 },

    #[error("the simulation left the finite numbers {time_s:.4} s after its start; halve the time step")]
    Diverged { time_s: f64 },
}

/// A unit behind a blank; nothing where there is none.
fn spaced(unit: &str) -> String {
    if unit.is_empty() { String::new() } else { format!(" {unit}") }
}

/// Refuses a value outside its range, NaN included.
pub(crate) fn in_range(
    what: &'static str,
    value: f64,
    [min, max]: [f64; 2],
    unit: &'static str,
) -> Result<(), SimulationError> {
    if value >= min && value <= max {
        Ok(())
    } else {
        Err(SimulationError::OutOfRange { what, value, min, max, unit })
    }
}
