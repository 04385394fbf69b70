//! A base model of recordings from which the steps of their baseline are taken.
//!
//! Steps of several times the signal drive everything astray that is read before they are known: speeds, axle times, ballast. No fit
//! leads back from there, so that all of it is done again without them.

use super::Session;
use crate::gap::GapError;
use crate::gap::base::{Given, PathPrior, base};
use crate::gap::data::{Observed, RATE_HZ};
use crate::recording::{Passage, Site};
use crate::signal::between;

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
        let mut clean = site.clone();
        for (i, o) in self.base.frame.observed.iter().enumerate() {
            for p in clean.passages.iter_mut().filter(|p| p.passage_id == o.passage_id) {
                for (_, found) in &self.latent_fits {
                    if let Some(decay_s) = found.decay_s {
                        take_off(p, o, (&found.traces[i], decay_s));
                    }
                }
            }
        }
        clean
    }
}

/// Takes a trace off a recording, its first value off what is before, and what decays behind it.
fn take_off(passage: &mut Passage, o: &Observed, (trace, decay_s): (&[f64], f64)) {
    let [first, .., last] = trace else { return };
    let (start_s, end) = (o.trace_start_s(), (trace.len() - 1) as f64);
    for (k, sample) in passage.acceleration_m_s2.iter_mut().enumerate() {
        let p = (k as f64 / passage.sample_rate_hz - start_s) * RATE_HZ;
        let value = match between(trace, p) {
            Some(value) => value,
            None if p < 0.0 => *first,
            None => first + (last - first) * (-(p - end) / (RATE_HZ * decay_s)).exp(),
        };
        *sample -= value as f32;
    }
}
