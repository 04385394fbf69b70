//! Two effects of the panel that are found at once, where no single one leads out of a lost model.

use super::candidates::Candidate;
use super::plausible::{inside_ranges, large_enough};
use super::{LEAST_GAIN, Session};
use crate::gap::GapError;
use crate::gap::effect::Effect;
use crate::gap::fit::{Fit, State};
use crate::gap::select::Tried;
use crate::gap::together::together;
use crate::progress::Progress;

impl Session<'_> {
    /// Takes the best pair of effects into a lost model that no effect alone mends; none where that leads to no track that is.
    pub(super) fn accept_together(
        &mut self,
        list: &mut [Candidate],
        tried: &[Tried<'static>],
        reference: &Fit,
        progress: &dyn Progress,
    ) -> Result<bool, GapError> {
        progress.begin("effects, two at once", 1);
        let frame = &self.base.frame;
        let Some((pair, fit)) = together(frame, reference, tried, &self.hints, self.search) else {
            progress.step();
            return Ok(false);
        };
        progress.step();
        if !self.tenable(&pair, &fit, reference)? {
            return Ok(false);
        }
        let gain = (fit.log_evidence - reference.log_evidence) / reference.inflation();
        // One is no alternative to the other.
        for effect in pair {
            for c in list.iter_mut() {
                c.gain = if c.name == effect.name() { gain } else { c.gain.min(0.5 * LEAST_GAIN) };
            }
            self.rank(list);
            let named = self.newly_named(effect.name(), effect.stage());
            self.named.push(named);
        }
        self.accepted = pair.to_vec();
        self.fit = Some(fit);
        self.prune()?;
        self.relinearise()?;
        self.review_wheels()?;
        Ok(true)
    }

    /// Whether a pair is on a track as there are, each effect of it sizeable, and nothing that the hammer denies.
    fn tenable(&self, pair: &[&'static dyn Effect; 2], fit: &Fit, reference: &Fit) -> Result<bool, GapError> {
        let frame = &self.base.frame;
        let sizeable = pair.iter().enumerate().all(|(k, e)| {
            self.borne_out(*e) && inside_ranges(*e, fit, k) && large_enough(*e, fit, k, fit.inflation())
        });
        if !sizeable || fit.state.implausible(frame) {
            return Ok(false);
        }
        let Some(hammer) = self.hammer else { return Ok(true) };
        let heard = |state: &State, effects: &[&'static dyn Effect]| {
            hammer.log_likelihood(&state.world(frame, effects))
        };
        Ok(heard(&fit.state, pair)? - heard(&reference.state, &[])? > -LEAST_GAIN)
    }
}
