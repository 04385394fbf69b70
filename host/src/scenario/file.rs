//! Scenario files.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::effects::Effects;
use crate::passage::SimulationError;
use crate::recording::files::{read_text, toml_table};
use crate::recording::{Crossing, RecordingError, read_crossing_file};

/// What the operator believes and what is true.
#[derive(Clone, Debug, PartialEq)]
pub struct Scenario {
    /// Nominal description, written to the site as it is.
    pub crossing: Crossing,
    /// The truth.
    pub simulation: Simulation,
}

/// `[simulation]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Simulation {
    /// Same seed, same site, bit for bit.
    pub seed: u64,
    /// Number of recorded passages.
    pub passages: usize,
    /// Mean speed, m/s.
    pub speed_m_s: f64,
    /// Speeds are uniform within ± this part of the mean.
    #[serde(default = "tenth")]
    pub speed_spread: f64,
    /// Standard deviation of the operator's speed, relative; limited to 1 %. Absent: the operator has no speed.
    #[serde(default)]
    pub operator_speed_error: Option<f64>,
    /// Mean and half range of the temperature at the sensor, °C.
    #[serde(default = "temperature")]
    pub temperature_c: [f64; 2],
    /// True ballast.
    pub ballast: BallastTruthInput,
    /// True path through the crossing.
    pub geometry: Geometry,
    /// Roughness of both rails.
    #[serde(default)]
    pub roughness: Roughness,
    /// How wheels differ.
    #[serde(default)]
    pub wheels: WheelVariation,
    /// Numerics.
    #[serde(default)]
    pub solver: Solver,
    /// Deviations from the nominal description.
    #[serde(default)]
    pub effects: Effects,
}

fn tenth() -> f64 {
    0.1
}

fn temperature() -> [f64; 2] {
    [10.0, 15.0]
}

/// Three-parameter distribution around the crossing sleeper (paper, fig. 7).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BallastTruthInput {
    /// Outer stiffness, N/m².
    pub p1_n_m2: f64,
    /// Under the crossing sleeper, N/m².
    pub p2_n_m2: f64,
    /// Shape.
    pub p3: f64,
}

/// Path of a nominal wheel: descent along the wing rail, ascent on the nose, wear.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Geometry {
    /// Scan to use instead of the formula (`position_m,irregularity_m`), relative to the scenario file.
    pub scan: Option<PathBuf>,
    /// Deepest point of the dip between wing rail and nose, m.
    pub dip_m: f64,
    /// Where the wheel passes from one to the other, m.
    pub transition_x_m: f64,
    /// Length of the descent towards the transition, m.
    pub wing_length_m: f64,
    /// Length of the ascent, m.
    pub nose_length_m: f64,
    /// Depth falls off as (1 − distance/length)^exponent.
    pub exponent: f64,
    /// Wear of the nose behind the transition, m.
    pub wear_m: f64,
    /// Length of the worn part, m.
    pub wear_length_m: f64,
    /// Extent of the written scan, m.
    pub scan_m: [f64; 2],
    /// Noise of the written scan, m rms.
    pub scan_noise_m: f64,
}

impl Default for Geometry {
    fn default() -> Self {
        Self {
            scan: None,
            dip_m: 1.2e-3,
            transition_x_m: 0.3,
            wing_length_m: 0.7,
            nose_length_m: 0.8,
            exponent: 2.0,
            wear_m: 0.1e-3,
            wear_length_m: 0.4,
            scan_m: [-0.9, 1.5],
            scan_noise_m: 3e-6,
        }
    }
}

/// Random roughness with a power-law spectrum between two wavelengths.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Roughness {
    /// m rms.
    pub rms_m: f64,
    /// m.
    pub longest_m: f64,
    /// m.
    pub shortest_m: f64,
    /// Power spectral density ∝ wavenumber^−exponent.
    pub exponent: f64,
}

impl Default for Roughness {
    /// A few micrometres, as on ground plain line.
    fn default() -> Self {
        Self { rms_m: 10e-6, longest_m: 2.0, shortest_m: 0.04, exponent: 2.0 }
    }
}

/// Standard deviations from wheel to wheel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WheelVariation {
    /// Static force of a wheelset, relative.
    pub load: f64,
    /// Difference between the two wheels of a wheelset, relative to their mean.
    pub side_load: f64,
    /// Depth of the path, relative.
    pub depth: f64,
    /// Shift of the path, m.
    pub shift_m: f64,
}

impl Default for WheelVariation {
    fn default() -> Self {
        Self { load: 0.01, side_load: 0.005, depth: 0.05, shift_m: 0.02 }
    }
}

/// Numerics of the simulation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Solver {
    /// s.
    pub dt_s: f64,
    /// ½ is Newmark's average acceleration; up to 1 damps numerically.
    pub theta: f64,
    /// m.
    pub rail_step_m: f64,
    /// m.
    pub sleeper_step_m: f64,
    /// Modes of a sleeper beside its static shapes.
    pub sleeper_modes: usize,
    /// Simulate only this many sleepers on either side of the crossing sleeper.
    pub sleepers_each_side: Option<usize>,
}

impl Default for Solver {
    fn default() -> Self {
        let mesh = crate::track::Mesh::default();
        Self {
            dt_s: 1e-4,
            theta: 0.5,
            rail_step_m: mesh.rail_step_m,
            sleeper_step_m: mesh.sleeper_step_m,
            sleeper_modes: crate::passage::SLEEPER_MODES,
            sleepers_each_side: None,
        }
    }
}

/// Why a scenario cannot be read or simulated.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum ScenarioError {
    #[error(transparent)]
    Recording(#[from] RecordingError),

    #[error("{file} has no [simulation] table; add one as in docs/examples/site.toml")]
    NoSimulation { file: PathBuf },

    #[error("{file}: [simulation] {key}: {reason}")]
    Key { file: PathBuf, key: String, reason: String },

    #[error(transparent)]
    Simulation(#[from] SimulationError),
}

#[derive(Deserialize)]
struct Wrapper {
    simulation: Simulation,
}

/// Reads a scenario; a scan it names is looked up beside it.
pub fn read_scenario(file: &Path) -> Result<Scenario, ScenarioError> {
    let crossing = read_crossing_file(file)?;
    let table = toml_table(file, &read_text(file)?)?;
    if !table.contains_key("simulation") {
        return Err(ScenarioError::NoSimulation { file: file.into() });
    }
    let Wrapper { mut simulation } = serde_path_to_error::deserialize(table).map_err(|e| {
        let key = e.path().to_string().trim_start_matches("simulation.").to_string();
        ScenarioError::Key { file: file.into(), key, reason: e.into_inner().to_string().trim_end().into() }
    })?;
    if let Some(scan) = &simulation.geometry.scan {
        simulation.geometry.scan = Some(file.parent().unwrap_or(Path::new(".")).join(scan));
    }
    Ok(Scenario { crossing, simulation })
}
