//! Two effects of the panel that are found at once, where no single one leads out of a lost model.

use super::candidates::Candidate;
use super::{LEAST_GAIN, Session};
use crate::gap::GapError;
use crate::gap::effect::Effect;
use crate::gap::fit::Fit;
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
        let found = together(frame, reference, tried, &self.hints, self.search);
        progress.step();
        let Some((pair, fit)) = found else { return Ok(false) };
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
        self.look_again(true)?;
        Ok(true)
    }

    /// Whether a pair is on a track as there are, each effect of it sizeable, and nothing that the hammer denies.
    fn tenable(&self, pair: &[&'static dyn Effect; 2], fit: &Fit, reference: &Fit) -> Result<bool, GapError> {
        let sizeable =
            pair.iter().enumerate().all(|(k, e)| self.sizeable(*e, (fit, k), fit.inflation(), 0.0));
        if !sizeable || fit.state.implausible(&self.base.frame) {
            return Ok(false);
        }
        Ok(self.heard_of(&fit.state, pair)? - self.heard_of(&reference.state, &[])? > -LEAST_GAIN)
    }
}
