//! What an effect of the catalogue is.

use super::included::Inclusion;
use super::world::World;

/// Where in the chain an effect sits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
#[allow(missing_docs)]
pub enum Stage {
    Sensor,
    Timing,
    Track,
    Geometry,
    Vehicle,
    Identification,
    Node,
}

/// An effect in the words of whoever looks after the track.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Advice {
    /// What is not as it should be.
    pub what: &'static str,
    /// What to do about it.
    pub action: &'static str,
}

/// How a parameter is searched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Scale {
    /// The coordinate is the value in units of [`Parameter::unit_size`].
    Linear,
    /// The coordinate is the natural logarithm of the value over [`Parameter::unit_size`].
    Log,
    /// The value is [`Parameter::unit_size`] over the coordinate.
    Inverse,
}

/// One physical parameter of an effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameter {
    /// Name with unit, as in the results.
    pub name: &'static str,
    /// Linear or logarithmic.
    pub scale: Scale,
    /// Value of coordinate 1 (linear) or 0 (logarithmic).
    pub unit_size: f64,
    /// Prior of the coordinate: mean, standard deviation.
    pub prior: (f64, f64),
    /// Range of the coordinate.
    pub range: [f64; 2],
    /// Step for numerical derivatives, coordinate.
    pub step: f64,
    /// Least distance of the coordinate from where there is no effect: the forward model's own errors (mesh, step, damping)
    /// can pass for less. Nought where they cannot.
    pub least: f64,
    /// Error that the forward model's simplifications make: of the coordinate, relative to it where it is linear and above 1.
    pub model_error: f64,
    /// Not of interest by itself: it only lets the effect take its form.
    pub nuisance: bool,
}

impl Parameter {
    /// Value at a coordinate.
    pub fn value(&self, coordinate: f64) -> f64 {
        match self.scale {
            Scale::Linear => self.unit_size * coordinate,
            Scale::Log => self.unit_size * coordinate.exp(),
            Scale::Inverse => self.unit_size / coordinate.max(1e-9),
        }
    }

    /// Coordinate of a value, within the range.
    pub fn coordinate(&self, value: f64) -> f64 {
        let coordinate = match self.scale {
            Scale::Linear => value / self.unit_size,
            Scale::Log => (value / self.unit_size).ln(),
            Scale::Inverse => self.unit_size / value,
        };
        coordinate.clamp(self.range[0], self.range[1])
    }
}

/// Name of a parameter with its unit, value, ends of the 90 % interval.
pub type Stated = (&'static str, f64, f64, f64);

/// What an effect acts on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ActsOn {
    /// All passages alike.
    Panel,
    /// Single wheels.
    Wheels,
    /// Single recordings.
    Recordings,
}

/// What is recorded beside the acceleration and must bear an effect out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Witness {
    /// Nothing.
    None,
    /// Speeds stated by the operator; where there are any, they alone tell.
    OperatorSpeeds,
    /// Temperatures go with the size of the signal.
    Temperatures,
}

/// What the recordings say directly, to start a search well.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Hints {
    /// Largest |acceleration| in any recording, m/s².
    pub largest_m_s2: f64,
    /// What the recorder itself may have put on top of that, m/s²: interference, and steps of the baseline.
    pub on_top_m_s2: f64,
}

/// Error of most coordinates.
pub const MODEL_ERROR: f64 = 0.06;
/// Distance of a far start from nought, prior standard deviations.
const FAR_START: f64 = 1.5;

/// An effect that the forward simulation can show: a small change of the world.
pub trait Effect: Sync + Send {
    /// Name in the contract.
    fn name(&self) -> &'static str;
    /// Place in the chain.
    fn stage(&self) -> Stage;
    /// What it means, and what to do about it.
    fn advice(&self) -> Advice;
    /// What `--with-effects` does with it.
    fn inclusion(&self) -> Inclusion;
    /// Parameters, in the order of `values`.
    fn parameters(&self) -> &'static [Parameter];
    /// Coordinates from which the search starts: nought, where there is no effect, unless the way from there leads elsewhere.
    fn starts(&self, _hints: &Hints) -> Vec<Vec<f64>> {
        self.nought().into_iter().collect()
    }
    /// Coordinates from which it is looked for where the base model has gone far astray: also on both sides of nought.
    fn far_starts(&self, hints: &Hints) -> Vec<Vec<f64>> {
        let mut starts = self.starts(hints);
        let Some(nought) = self.nought() else { return starts };
        for (k, p) in self.parameters().iter().enumerate().take(self.sizes()) {
            for sign in [-1.0, 1.0] {
                let mut far = nought.clone();
                far[k] = (far[k] + sign * FAR_START * p.prior.1).clamp(p.range[0], p.range[1]);
                if !starts.contains(&far) {
                    starts.push(far);
                }
            }
        }
        starts
    }
    /// Coordinates at which there is no effect, where the path from there is smooth.
    fn nought(&self) -> Option<Vec<f64>> {
        None
    }
    /// How many of its parameters, from the first on, are sizes: nought where there is no effect.
    fn sizes(&self) -> usize {
        1
    }
    /// How many of its sizes, from the first on, tell that it is there; the others come with them.
    fn telling(&self) -> usize {
        self.sizes()
    }
    /// What must bear it out.
    fn witness(&self) -> Witness {
        Witness::None
    }
    /// Whether recordings of which this is known can come about at all with these values.
    fn possible(&self, _values: &[f64], _hints: &Hints) -> bool {
        true
    }
    /// Whether its parameters change the motion; a gain does not.
    fn simulated(&self) -> bool {
        true
    }
    /// Puts the effect into the world.
    fn apply(&self, world: &mut World, values: &[f64]);
}
