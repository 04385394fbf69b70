//! Search for effects: rounds of screening, fits, acceptance and confirmation. What counts is in `candidates`.

use super::candidates::{Candidate, Explored, asked, put_apart_first, put_wheels_first, same_gain};
use super::{LEAST_GAIN, MOST_SURE, Named, Ranked, Session};
use crate::gap::GapError;
use crate::gap::base::fit_variation;
use crate::gap::effect::{ActsOn, Effect, Stage};
use crate::gap::fit::{Fit, FitOptions, Whitened, fit, settled};
use crate::gap::latent::{Latent, LatentFit, Scene};
use crate::gap::measure::{self, Missed};
use crate::gap::select::{Standing, Tried, fit_in_place, gain, round};
use crate::progress::Progress;

/// Most effects in a verdict.
const MOST_EFFECTS: usize = 3;
/// Effects of the panel with which a model that is still lost is left alone: a third one only follows what they miss, and to look for
/// it takes a third of the time of such a site.
const MOST_LOST_WITH: usize = 2;
/// What an effect must take off the residual, RMS relative to the wheels' scatter: the first one named, and further ones,
/// which may only mend the description of the first.
const LEAST_GAINED: (f64, f64) = (0.15, 0.2);
/// Evidence counts this much less than it says when it becomes a probability (calibrated on simulated trials).
pub(super) const PROBABILITY_SCALE: f64 = 4.0;

/// Part of what a model misses beyond its covariance that an effect takes away when it is there, though clipping leaves more than it
/// should: a mount that takes the transducer to its range takes nine tenths.
const MENDED: f64 = 0.8;
const ADRIFT: &str = "wheels differ over this panel by more than the model can follow: sizes are rough, and what else acts cannot be told before \
                      this is mended, unless it is the recorder's and strong";

/// A model before the last effect.
pub(super) struct Confirmed {
    /// Of the acceleration and of the displacement.
    pub(super) missed: [Missed; 2],
    pub(super) described: usize,
    accepted: usize,
    /// See [`Session::adrift`].
    adrift: bool,
    fit: Option<Fit>,
}

impl Session<'_> {
    pub(super) fn search(&mut self, progress: &dyn Progress) -> Result<(), GapError> {
        self.searched = true;
        let mut rounds = MOST_EFFECTS - self.named.len().min(MOST_EFFECTS);
        // A round can take two effects.
        while rounds > 0 && self.named.len() < MOST_EFFECTS {
            rounds -= 1;
            progress.begin(&format!("effects, round {}", self.named.len() + 1), self.steps_of_round());
            if !self.one_round(progress)? {
                break;
            }
            if self.follow_the_bed(progress)? {
                // Everything else is looked for again.
                rounds = MOST_EFFECTS - self.named.len().min(MOST_EFFECTS);
            }
        }
        self.describe_again()?;
        if (self.adrift() || self.worn()) && self.remarks.iter().all(|r| r != ADRIFT) {
            self.remarks.push(ADRIFT.into());
        }
        Ok(())
    }

    /// Takes what shows while no train is near into the model, which need not be right for that.
    pub(super) fn search_apart(&mut self) -> Result<(), GapError> {
        while self.named.len() < MOST_EFFECTS {
            // No single wheel is heard without a train.
            let not_named = self.not_named();
            let wanted = |e: &dyn Latent| e.acts_on() == ActsOn::Recordings && not_named(e);
            let mut latent = self.explore_those(wanted)?;
            let reference = self.base.fit.clone();
            let mut list = self.candidates(&[], &reference, &latent)?;
            list.retain(|c| c.apart && c.full && c.gain > LEAST_GAIN);
            list.sort_by(|a, b| b.gain.total_cmp(&a.gain));
            if list.is_empty() {
                break;
            }
            self.rank(&list);
            self.accept(&list, &mut [], &mut latent)?;
        }
        Ok(())
    }

    /// Takes an effect into the model with which that is not lost, as little as with clipping alone, or misses the recordings by far less
    /// than before.
    pub(super) fn search_what_mends(&mut self, progress: &dyn Progress) -> Result<(), GapError> {
        progress.begin("effects that mend the model", self.steps_of_round());
        let mended = self.misfit() - MENDED * (self.misfit() - 1.0);
        if !self.one_round(progress)? {
            return Ok(());
        }
        if !self.accepted.is_empty() {
            // From afar, one fit does not get there.
            self.fit = Some(settled(&self.base.frame, &self.accepted, self.state(), self.search)?);
        }
        if !self.current().lost() || self.misfit() <= mended {
            return Ok(());
        }
        if let Some(name) = self.named.last().map(|n| n.name) {
            self.withdraw(name)?;
            self.renew_derivatives()?;
        }
        Ok(())
    }

    /// Whether wheels differ in ways that the model does not know, with an effect of the panel in it: what is looked for on top would
    /// mend the description of that effect, but for wheels with which they do no longer. What the recorder does describes no panel.
    fn adrift(&self) -> bool {
        self.accepted.iter().any(|e| !matches!(e.stage(), Stage::Sensor | Stage::Timing))
            && self.base.variation.beyond_linear()
    }

    /// Whether wheels run at depths that sound ones do not, and none of their effects is in the model: what their mean does would pass
    /// for the panel's.
    fn worn(&self) -> bool {
        self.of_wheels() == 0 && self.base.variation.worn()
    }

    /// Tries everything on top of what is accepted; accepts the best if it is good enough.
    fn one_round(&mut self, progress: &dyn Progress) -> Result<bool, GapError> {
        let earlier = &Confirmed {
            missed: self.missed()?,
            described: self.described(),
            accepted: self.accepted.len(),
            adrift: self.adrift(),
            fit: self.fit.clone(),
        };
        let frame = &self.base.frame;
        let reference = if self.accepted.is_empty() {
            // The base model has settled already.
            fit(frame, &[], self.state(), self.search, FitOptions::THOROUGH)?
        } else {
            let settled = settled(frame, &self.accepted, self.state(), self.search)?;
            self.fit = Some(settled.clone());
            settled
        };
        let mut latent = self.explore()?;
        progress.step();
        let lost = reference.lost();
        let mut tried = match lost && self.accepted.len() >= MOST_LOST_WITH {
            true => Vec::new(),
            false => self.fit_common(&reference, progress)?,
        };
        let mut list = self.candidates(&tried, &reference, &latent)?;
        let astray = lost && tried.iter().filter_map(|t| t.fit.as_ref()).all(Fit::lost);
        if astray
            && self.accepted.is_empty()
            && self.accept_together(&mut list, &tried, &reference, progress)?
        {
            return Ok(true);
        }
        let misfit: f64 = reference.passages.iter().map(Whitened::squares).sum();
        let worn = self.worn();
        for c in &mut list {
            let of_description = earlier.adrift && !c.beside_the_wheels() && !c.alike;
            let of_mean = worn && c.acts_on == ActsOn::Panel && !c.by_far();
            if of_description || of_mean || !self.worth_naming(c, earlier, misfit) {
                c.gain = c.gain.min(0.5 * LEAST_GAIN);
            }
        }
        if !lost {
            put_wheels_first(&mut list);
        }
        put_apart_first(&mut list);
        list.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        // The best that also takes something off the residual.
        for k in 0..list.len() {
            // What was taken back is no alternative any more.
            self.rank(&list[k..]);
            if list[k].gain <= LEAST_GAIN {
                break;
            }
            self.accept(&list[k..], &mut tried, &mut latent)?;
            if self.confirm(earlier, &list[k])? {
                self.prune()?;
                if list[k].acts_on == ActsOn::Panel {
                    // What single wheels do to a window depends on the panel, too, but hardly on the recorder.
                    self.look_again(lost || (self.of_wheels() > 0 && list[k].stage != Stage::Sensor))?;
                }
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Effects of the panel that are not named yet.
    fn left(&self) -> Vec<&'static dyn Effect> {
        let named = |e: &&dyn Effect| self.named.iter().any(|n| n.name == e.name());
        self.common.iter().copied().filter(|e| !named(e)).collect()
    }

    /// Effects of wheels and recordings are one step of the progress, each of the panel is one.
    fn steps_of_round(&self) -> u64 {
        1 + self.left().len() as u64
    }

    /// Fits every effect of the panel that is not named yet on top of a fit.
    fn fit_common(
        &mut self,
        reference: &Fit,
        progress: &dyn Progress,
    ) -> Result<Vec<Tried<'static>>, GapError> {
        let frame = &self.base.frame;
        let candidates = self.left();
        let state = &reference.state;
        let lost = reference.lost();
        let nominal = state.on_nominal_ballast();
        let on_the_scan = state.on_the_scan();
        let from_afar = match lost && self.accepted.is_empty() {
            true => Some(&nominal),
            false => (lost || state.strained(frame)).then_some(&on_the_scan),
        };
        let afresh = (!lost && state.odd_bed()).then_some(&nominal);
        let standing = Standing { accepted: &self.accepted, state, from_afar, afresh };
        let (tried, screening) = round(frame, standing, &candidates, (&self.hints, self.search), progress)?;
        if self.cosines.is_empty() {
            self.cosines = cosines(&screening, &candidates);
        }
        Ok(tried)
    }

    /// Effects of single wheels in the model.
    pub(super) fn of_wheels(&self) -> usize {
        self.latent_fits.iter().filter(|(e, _)| e.acts_on() == ActsOn::Wheels).count()
    }

    /// Effects in the model whose description may leave something that passes for a further one: not what only the recorder does.
    pub(super) fn described(&self) -> usize {
        self.accepted.len() + self.of_wheels()
    }

    /// Whether a mount rings on so that what wheels do by nature does not describe how they differ: waves at its frequency would pass
    /// for those of wheels.
    pub(super) fn rings(&self) -> bool {
        let sensor = &self.base.frame.base.crossing.sensor;
        let mount = self.state().world(&self.base.frame, &self.accepted).sensor.mount;
        mount.is_some() && self.base.variation.noisy(sensor)
    }

    /// Looks for effects of single wheels or recordings that are not named yet.
    pub(super) fn explore(&mut self) -> Result<Vec<Explored>, GapError> {
        self.explore_those(self.not_named())
    }

    /// Tells effects that are not named yet.
    fn not_named(&self) -> impl Fn(&dyn Latent) -> bool + use<> {
        let named: Vec<&'static str> = self.named.iter().map(|n| n.name).collect();
        move |e| !named.contains(&e.name())
    }

    /// Looks for those that are wanted.
    pub(super) fn explore_those(
        &mut self,
        wanted: impl Fn(&dyn Latent) -> bool,
    ) -> Result<Vec<Explored>, GapError> {
        let state = self.state();
        let world = state.world(&self.base.frame, &self.accepted);
        let scene = Scene::of(self.base, &world, (&state, self.search), &self.split.train)?;
        let found = self
            .latent
            .iter()
            .filter(|e| wanted(**e))
            .map(|e| (*e, e.explore(&scene)))
            .map(|(e, f)| {
                let moved = f.as_ref().map_or(0.0, |f| displacement_share(&scene, f));
                (e, f, moved)
            })
            .collect();
        self.scatter = (scene.excess(), scene.scatter());
        Ok(found)
    }

    /// Takes the first of a list into the model.
    fn accept(
        &mut self,
        list: &[Candidate],
        tried: &mut [Tried<'static>],
        latent: &mut Vec<Explored>,
    ) -> Result<(), GapError> {
        let best = &list[0];
        let name = best.name;
        let same = list[1..]
            .iter()
            .filter(|c| c.full && best.gain - c.gain < same_gain(best.gain))
            .map(|c| c.name)
            .collect();
        let mut named = Named { indistinguishable_from: same, ..self.newly_named(name, best.stage) };
        if let Some(t) = tried.iter_mut().find(|t| t.effect.name() == name) {
            self.accepted.push(t.effect);
            self.fit = t.fit.take();
        } else if let Some((effect, Some(found))) = latent
            .iter()
            .position(|(e, ..)| e.name() == name)
            .map(|k| latent.swap_remove(k))
            .map(|(e, f, _)| (e, f))
        {
            named.parameters = found.parameters.clone();
            self.take_out(effect, found);
            self.refit_variation()?;
        }
        self.named.push(named);
        // Over a bed that opens, wheels are misjudged until the panel is known without them.
        if best.alike && !self.state().world(&self.base.frame, &self.accepted).bed.is_linear() {
            self.describe_again()?;
        }
        Ok(())
    }

    /// An effect that is named as surely as it is ranked.
    pub(super) fn newly_named(&self, name: &'static str, stage: Stage) -> Named {
        let ranked = self.ranking.iter().find(|r| r.name == name);
        Named {
            name,
            stage,
            probability: ranked.map_or(MOST_SURE, |r| r.probability),
            parameters: Vec::new(),
            indistinguishable_from: Vec::new(),
            alternatives: Vec::new(),
            gained: f64::NAN,
        }
    }

    /// What the current model misses of the training passages, `[acceleration, displacement]`.
    pub(super) fn missed(&self) -> Result<[Missed; 2], GapError> {
        let frame = &self.base.frame;
        let world = self.state().world(frame, &self.accepted);
        let latent: Vec<&LatentFit> = self.latent_fits.iter().map(|(_, f)| f).collect();
        measure::missed_by(frame, &world, &latent, &self.split.train)
    }

    /// Whether the effect accepted last takes enough off the residual, or wheels are not adrift any more with it; if not, it is taken
    /// back.
    fn confirm(&mut self, earlier: &Confirmed, c: &Candidate) -> Result<bool, GapError> {
        if c.alike && earlier.adrift && self.adrift() {
            self.withdraw(c.name)?;
            return Ok(false);
        }
        let [acceleration, displacement] = self.missed()?;
        let Some(last) = self.named.last_mut() else { return Ok(true) };
        let part = |before: f64, now: f64, floor: f64| {
            ((before - now).max(0.0) / floor.max(f64::MIN_POSITIVE)).sqrt()
        };
        // The displacement has no floor of its own; half of what it gains counts.
        last.gained = part(earlier.missed[0].all, acceleration.all, acceleration.own)
            .max(0.5 * part(earlier.missed[1].all, displacement.all, displacement.all));
        // Effects of single wheels have their own rule.
        if last.gained >= asked(LEAST_GAINED, earlier.described)
            || self.accepted.len() == earlier.accepted
            || c.relieves(earlier.described)
        {
            return Ok(true);
        }
        let name = last.name;
        self.named.pop();
        self.accepted.pop();
        self.fit.clone_from(&earlier.fit);
        for r in self.ranking.iter_mut().filter(|r| r.name == name) {
            r.probability = r.probability.min(0.5 * (1.0 - r.probability).max(0.1));
        }
        Ok(false)
    }

    /// Once wheels are known to differ by an effect, their natural variation is what remains.
    pub(super) fn refit_variation(&mut self) -> Result<(), GapError> {
        let state = self.state();
        fit_variation(self.base, &self.accepted, &state, self.search)?;
        let options = FitOptions::default();
        if self.accepted.is_empty() {
            self.base.fit = fit(&self.base.frame, &[], state, self.search, options)?;
            self.find_back()?;
        } else {
            self.fit = Some(fit(&self.base.frame, &self.accepted, state, self.search, options)?);
        }
        Ok(())
    }

    /// A base model that is lost where something has been taken out of the windows may have been led astray by that, and does not find
    /// back by itself: it is fitted again from nominal ballast.
    fn find_back(&mut self) -> Result<(), GapError> {
        if !self.base.fit.lost() {
            return Ok(());
        }
        let start = self.base.fit.state.on_nominal_ballast();
        let again = fit_in_place(&self.base.frame, &[], start, self.search, FitOptions::THOROUGH);
        let Some(again) = again.filter(|a| a.log_posterior > self.base.fit.log_posterior) else {
            return Ok(());
        };
        fit_variation(self.base, &[], &again.state, self.search)?;
        self.base.fit = fit(&self.base.frame, &[], again.state, self.search, FitOptions::default())?;
        Ok(())
    }

    /// Probabilities of a round; an effect keeps its best.
    pub(super) fn rank(&mut self, list: &[Candidate]) {
        let top = list.iter().map(|c| c.gain).fold(LEAST_GAIN, f64::max);
        let weight = |g: f64| ((g - top) / PROBABILITY_SCALE).exp();
        // Without a sufficient gain nothing acts.
        let total: f64 = list.iter().map(|c| weight(c.gain)).sum::<f64>() + weight(LEAST_GAIN);
        for c in list {
            let probability = (weight(c.gain) / total).min(MOST_SURE);
            let entry =
                Ranked { name: c.name, stage: c.stage, probability, gain: c.gain, gap_after: f64::NAN };
            match self.ranking.iter_mut().find(|r| r.name == c.name) {
                Some(r) if r.probability >= probability => {}
                Some(r) => *r = entry,
                None => self.ranking.push(entry),
            }
        }
    }
}

/// Part of the displacement's residual of the training passages that an effect explains.
fn displacement_share(scene: &Scene, found: &LatentFit) -> f64 {
    let (mut before, mut after) = (0.0, 0.0);
    for i in scene.train {
        let residual = &scene.traces[*i].residual;
        let left: Vec<f64> = residual.iter().zip(&found.traces[*i]).map(|(r, f)| r - f).collect();
        let energy = |a: &[f64]| measure::displacement(a).iter().map(|d| d * d).sum::<f64>();
        (before, after) = (before + energy(residual), after + energy(&left));
    }
    1.0 - after / before.max(f64::MIN_POSITIVE)
}

/// Cosines between the best directions of all pairs of effects.
fn cosines(
    screening: &crate::gap::fit::Screening,
    candidates: &[&'static dyn Effect],
) -> Vec<(&'static str, &'static str, f64)> {
    let best = |e: usize| {
        (0..screening.directions.len())
            .filter(|i| screening.directions[*i].effect == e)
            .max_by(|a, b| gain(screening, &[*a]).total_cmp(&gain(screening, &[*b])))
    };
    let h = &screening.information;
    let mut out = Vec::new();
    for a in 0..candidates.len() {
        for b in a + 1..candidates.len() {
            if let (Some(i), Some(j)) = (best(a), best(b)) {
                let cosine = h[(i, j)] / (h[(i, i)] * h[(j, j)]).sqrt().max(f64::MIN_POSITIVE);
                out.push((candidates[a].name(), candidates[b].name(), cosine));
            }
        }
    }
    out
}
