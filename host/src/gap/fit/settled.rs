//! A fit that does not end where a strained path has led it.

use super::priors::path_strain;
use super::{Fit, FitOptions, Frame, State, fit};
use crate::ballast::BallastParameters;
use crate::gap::GapError;
use crate::gap::effect::Effect;

/// Squares of the path's deviation per knot in units of its prior, crossing and stock side, above which the path has taken
/// over what an effect does, and its derivatives say little of that effect. Simulated sites without any effect have up to 3.7
/// and 0.03, the reference recordings 8.3 and 0.07.
const STRAINED: [f64; 2] = [4.0, 0.3];

/// The same above which no scan is that wrong: reference-3, over which wheels lose contact, has 8.3.
const UNTENABLE: [f64; 2] = [10.0, 0.6];

impl State {
    /// The same with the scan as it is.
    pub fn on_the_scan(&self) -> Self {
        Self { deviation_m: vec![0.0; self.deviation_m.len()], ..self.clone() }
    }

    /// The same on nominal ballast, with the scan as it is: where a base model that an effect has driven far away may not lead
    /// back to.
    pub fn on_nominal_ballast(&self) -> Self {
        Self { ballast: BallastParameters::NOMINAL.to_vector(), ..self.on_the_scan() }
    }

    /// Whether the path departs from the scan farther than scans do.
    pub fn strained(&self, frame: &Frame) -> bool {
        self.path_above(frame, STRAINED)
    }

    /// Whether it departs so far that something else must act.
    pub fn untenable(&self, frame: &Frame) -> bool {
        self.path_above(frame, UNTENABLE)
    }

    fn path_above(&self, frame: &Frame, most: [f64; 2]) -> bool {
        path_strain(frame, self).iter().zip(most).any(|(s, most)| *s > most)
    }
}

/// Thorough fit from `start` and, where that strains the path or leaves much, from the scan as it is; the more probable of
/// the two.
pub fn settled(
    frame: &Frame,
    effects: &[&dyn Effect],
    start: State,
    subset: &[usize],
) -> Result<Fit, GapError> {
    let first = fit(frame, effects, start, subset, FitOptions::THOROUGH)?;
    if !first.lost() && !first.state.strained(frame) {
        return Ok(first);
    }
    let again = fit(frame, effects, first.state.on_the_scan(), subset, FitOptions::THOROUGH)?;
    Ok(if again.log_posterior > first.log_posterior { again } else { first })
}
