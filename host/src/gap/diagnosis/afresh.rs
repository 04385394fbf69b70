//! A base model of recordings from which the steps of their baseline are taken.
//!
//! Steps of several times the signal drive everything astray that is read before they are known: speeds, axle times, ballast. No fit
//! leads back from there, so that all of it is done again without them.

use super::Session;
use crate::gap::GapError;
use crate::gap::base::{Given, PathPrior, base};
use crate::gap::steady::without_traces;
use crate::recording::Site;

impl Session<'_> {
    /// Whether what shifts the baseline is in the model. Where that does not leave the model lost, wheels seem to differ as none do.
    pub(super) fn was_shifted(&self) -> bool {
        self.latent_fits.iter().any(|(_, f)| f.decay_s.is_some())
    }

    /// Reads the recordings and fits the base model again, without the steps found, which are to be looked for again.
    pub(super) fn start_afresh(&mut self, site: &Site, path_prior: &PathPrior) -> Result<(), GapError> {
        let sensor = self.base.frame.base.sensor;
        let mut fresh = base(
            &self.without_steps(site),
            &self.split.train,
            self.search,
            path_prior,
            &Given { cleaned: true, ..Given::recorder(sensor) },
        )?;
        let before = &self.base.frame.observed;
        if fresh.frame.observed.len() != before.len() {
            return Ok(());
        }
        fresh.record_again(before);
        *self.base = fresh;
        for (effect, _) in std::mem::take(&mut self.latent_fits) {
            self.taken_back(effect.name());
        }
        Ok(())
    }

    /// The site without the steps of its baseline.
    pub(super) fn without_steps(&self, site: &Site) -> Site {
        let fits = self.latent_fits.iter().map(|(_, found)| found);
        fits.fold(site.clone(), |site, found| without_traces(&site, &self.base.frame.observed, found))
    }
}
