//! What recordings say of the damping of the ballast, beside what crossing.toml says.

use super::evidence::EvidenceFit;

/// Standard deviations of the logarithm of the damping from which on recordings contradict the one described, where a calibration without it
/// has more evidence: sites as described are within 1.4 (19 recorded and simulated ones), and what effects do has less.
const DENIED: f64 = 2.0;
/// The same, to first order around the one described, from which on it is worth a calibration of its own: that sees about half of a large error.
const WORTH_A_LOOK: f64 = 1.5;
/// How far off it must be, in its logarithm, for a diagnosis to find it with the ballast: effects that its base model does not hold pass for
/// less, heavier wheelsets for -0.18, load transfer for -0.10.
const FAR_OFF: f64 = 0.25;
/// What the model itself has wrong of its logarithm: on 16 simulated panels of other builds it is found 1.6 % too high in the mean, on the
/// reference recordings 1 to 6 %.
pub(super) const MODEL_DAMPING_SD: f64 = 0.03;

/// The same where recordings contradict the damping described: then the description is wrong, and it may be something else that passes for
/// damping. On 18 descriptions of reference-1 and -2 that were wrong in every entry by usual tolerances, and of which the damping alone was
/// noticed, the one found was wrong by 0.24 (RMS of the logarithm).
const CONTRADICTED_SD: f64 = 0.24;

/// What recordings say of the damping of the ballast.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Damping {
    /// Logarithm of the most probable one over the one described.
    pub off: f64,
    /// Its standard deviation.
    pub sd: f64,
    /// No calibration has failed to bear it out.
    doubted: bool,
}

impl Damping {
    /// `sd`: by noise; the model's own error comes on top.
    pub fn new(off: f64, sd: f64) -> Self {
        Self { off, sd: sd.hypot(MODEL_DAMPING_SD), doubted: true }
    }

    /// As the calibration `free` finds it, which has it unknown, and has `gained` so much evidence. No doubt is left where that is none: what
    /// the model does not hold, as a sensor that clips, has then passed for damping.
    pub fn borne_out(self, free: &EvidenceFit, gained: f64) -> Self {
        if gained <= 0.0 {
            return Self { doubted: false, ..self };
        }
        let last = free.covariance.nrows() - 1;
        let sd = free.covariance[(last, last)].max(0.0).sqrt();
        Self { off: free.parameters.damping_factor.ln(), sd, doubted: true }
    }

    /// The same where it is found elsewhere, as well told.
    pub fn at(self, off: f64) -> Self {
        Self { off, ..self }
    }

    /// Whether it is to be found by a calibration.
    pub fn is_worth_a_look(&self) -> bool {
        self.off.abs() > WORTH_A_LOOK * self.sd
    }

    /// Whether recordings contradict the one described.
    pub fn is_denied(&self) -> bool {
        self.doubted && self.off.abs() > DENIED * self.sd
    }

    /// Whether it may be far off, to first order.
    pub fn seems_far_off(&self) -> bool {
        self.is_denied() && self.off.abs() > 0.5 * FAR_OFF
    }

    /// Whether it is so far off that no effect passes for it.
    pub fn is_far_off(&self) -> bool {
        self.is_denied() && self.off.abs() > FAR_OFF
    }
}

impl EvidenceFit {
    /// With the damping found as uncertain as it is where it is used instead of the one described. What the recordings say of it, all else
    /// being right, stays as certain.
    pub fn contradicting_the_description(mut self) -> Self {
        let last = self.covariance.nrows() - 1;
        self.covariance[(last, last)] += CONTRADICTED_SD.powi(2);
        self
    }
}
