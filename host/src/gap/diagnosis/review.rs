//! Effects named earlier, looked at again once another one is in the model.

use super::plausible::large_enough;
use super::{LEAST_GAIN, MOST_SURE, Session};
use crate::gap::GapError;
use crate::gap::base::relinearise;
use crate::gap::effect::ActsOn;
use crate::gap::fit::settled;
use crate::gap::latent::{Latent, LatentFit};
use crate::signal::dot;

/// An effect of wheels is the one of before when what it adds to the windows correlates with what it added by more than this.
const THE_SAME: f64 = 0.5;

impl Session<'_> {
    /// Takes back earlier effects of the panel that the model no longer needs: what is found first may only have stood in for
    /// what is found later.
    pub(super) fn prune(&mut self) -> Result<(), GapError> {
        let mut k = 0;
        while k + 1 < self.accepted.len() {
            let Some(now) = self.fit.as_ref() else { return Ok(()) };
            let (mut fewer, mut state) = (self.accepted.clone(), now.state.clone());
            let name = fewer.remove(k).name();
            state.effects.remove(k);
            let without = settled(&self.base.frame, &fewer, state, self.search)?;
            let gain = (now.log_evidence - without.log_evidence) / now.inflation();
            if gain > LEAST_GAIN && large_enough(self.accepted[k], (now, k), now.inflation(), gain) {
                k += 1;
                continue;
            }
            (self.accepted, self.fit) = (fewer, Some(without));
            self.taken_back(name);
        }
        Ok(())
    }

    /// After an effect of the panel: what was found around the model without it, linearised `anew` where that was another track.
    pub(super) fn look_again(&mut self, anew: bool) -> Result<(), GapError> {
        if anew {
            self.relinearise()?;
        }
        self.review_wheels()
    }

    /// Linearises anew around an effect of the panel without which the model was lost: derivatives by the path, and what wheels do by
    /// nature, were those of another track. Over a bed that is not linear no derivative holds far enough: around a void, wheels' scatter
    /// passed for flats.
    fn relinearise(&mut self) -> Result<(), GapError> {
        let state = self.state();
        if !state.world(&self.base.frame, &self.accepted).bed.is_linear() {
            return Ok(());
        }
        self.renew_derivatives()?;
        self.fit = Some(settled(&self.base.frame, &self.accepted, state, self.search)?);
        Ok(())
    }

    /// Derivatives by the path, and what wheels do by nature, of the current model.
    pub(super) fn renew_derivatives(&mut self) -> Result<(), GapError> {
        let state = self.state();
        relinearise(self.base, &self.accepted, &state, self.search)
    }

    /// Looks for effects of wheels again, with the effect of the panel that was found after them in the model: wheels scatter
    /// otherwise over a panel that the model did not know, and what they were thought to have may be that.
    fn review_wheels(&mut self) -> Result<(), GapError> {
        let of_wheels = |(e, _): &(&'static dyn Latent, LatentFit)| e.acts_on() == ActsOn::Wheels;
        let (earlier, kept): (Vec<_>, Vec<_>) =
            std::mem::take(&mut self.latent_fits).into_iter().partition(of_wheels);
        self.latent_fits = kept;
        if earlier.is_empty() {
            return Ok(());
        }
        let names: Vec<&str> = earlier.iter().map(|(e, _)| e.name()).collect();
        earlier.iter().for_each(|(_, found)| self.give_back(found));
        let named = self.named.clone();
        self.named.retain(|n| !names.contains(&n.name));
        self.refit_variation()?;
        let mut found = self.explore()?;
        let Some(reference) = &self.fit else { return Ok(()) };
        let list = self.candidates(&[], reference, &found)?;
        self.named = named;
        for (effect, before) in earlier {
            let name = effect.name();
            let there = list.iter().any(|c| c.name == name && c.full && c.gain > LEAST_GAIN);
            let again = found.iter_mut().find(|(e, ..)| e.name() == name).and_then(|(_, f, _)| f.take());
            let Some(fit) = again.filter(|f| there && likeness(f, &before) > THE_SAME) else {
                self.taken_back(name);
                continue;
            };
            self.described_anew(effect, fit);
        }
        if self.latent_fits.is_empty() { Ok(()) } else { self.refit_variation() }
    }

    /// Describes wheels that all show the same again, with what the panel is once they are known: they were found over what their mean
    /// had made of it.
    pub(super) fn describe_again(&mut self) -> Result<(), GapError> {
        let Some(k) = self.latent_fits.iter().position(|(e, _)| e.alike()) else { return Ok(()) };
        let (effect, before) = self.latent_fits.remove(k);
        self.give_back(&before);
        let again = self.explore_those(|e| e.name() == effect.name())?.pop().and_then(|(_, found, _)| found);
        let found = again.filter(|f| likeness(f, &before) > THE_SAME).unwrap_or(before);
        match self.too_few(effect, &found) {
            true => self.taken_back(effect.name()),
            false => self.described_anew(effect, found),
        }
        self.refit_variation()
    }

    /// Takes what a named effect of wheels is now found to add off the windows.
    fn described_anew(&mut self, effect: &'static dyn Latent, found: LatentFit) {
        for named in self.named.iter_mut().filter(|n| n.name == effect.name()) {
            named.parameters.clone_from(&found.parameters);
        }
        self.take_out(effect, found);
    }

    /// Takes back all that the search has named, and the base model over voids, if that is one.
    pub(super) fn forget_search(&mut self) {
        let latent = std::mem::take(&mut self.latent_fits);
        latent.iter().for_each(|(_, found)| self.give_back(found));
        let accepted = std::mem::take(&mut self.accepted);
        let names = accepted.iter().map(|e| e.name()).chain(latent.iter().map(|(e, _)| e.name()));
        names.for_each(|name| self.taken_back(name));
        self.fit = None;
        if let Some(linear) = self.linear.take() {
            *self.base = linear;
        }
    }

    /// Takes what an effect of wheels or recordings adds off the windows.
    pub(super) fn take_out(&mut self, effect: &'static dyn Latent, found: LatentFit) {
        for (o, part) in self.base.frame.observed.iter_mut().zip(&found.windows) {
            o.remove(part);
        }
        self.latent_fits.push((effect, found));
    }

    /// Puts what an effect of wheels or recordings was thought to add back into the windows.
    pub(super) fn give_back(&mut self, found: &LatentFit) {
        for (o, part) in self.base.frame.observed.iter_mut().zip(&found.windows) {
            o.restore(part);
        }
    }

    /// An effect is not named any more.
    pub(super) fn taken_back(&mut self, name: &str) {
        self.named.retain(|n| n.name != name);
        for r in self.ranking.iter_mut().filter(|r| r.name == name) {
            r.probability = r.probability.min(1.0 - MOST_SURE);
        }
    }
}

/// Correlation of what two fits add to the windows.
fn likeness(a: &LatentFit, b: &LatentFit) -> f64 {
    let all = |f: &LatentFit| -> Vec<f64> { f.windows.iter().flatten().flatten().copied().collect() };
    let (a, b) = (all(a), all(b));
    dot(&a, &b) / (dot(&a, &a) * dot(&b, &b)).sqrt().max(f64::MIN_POSITIVE)
}
