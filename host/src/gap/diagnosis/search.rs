//! Search for effects: rounds of screening, fits, acceptance and confirmation.

use super::plausible::{inside_ranges, large_enough};
use super::{LEAST_GAIN, MOST_SURE, Named, Ranked, Session};
use crate::gap::GapError;
use crate::gap::base::fit_variation;
use crate::gap::data::{energies, own_energy};
use crate::gap::effect::{ActsOn, Effect, Stage};
use crate::gap::fit::{Fit, FitOptions, Frame, State, fit, settled, simulate};
use crate::gap::forward::Response;
use crate::gap::latent::{Latent, LatentFit, Scene};
use crate::gap::measure::{self, ALIGN_M};
use crate::gap::select::{Standing, Tried, gain, round};
use crate::gap::world::SensorModel;
use crate::progress::Progress;

/// Most effects in a verdict.
const MOST_EFFECTS: usize = 3;
/// Share of the misfit (weighted squares) that an effect must explain: 0.023 on reference-1, between 0.025 and 0.03 for the
/// weakest known effect.
const LEAST_SHARE: f64 = 0.025;
/// How far the base model must be above the scatter of the wheels, in quadrature, for an effect of the panel to be looked
/// for. One reference recording, at 0.09, has nothing to explain, but a structured error with a high gain; the weakest
/// known effect is at 0.21.
const LEAST_EXCESS: f64 = 0.15;
/// Energy of an effect of single wheels or recordings relative to their scatter: the first one, and further ones. Less is asked of
/// what is heard while no train is near, which no scatter can pass for.
const LATENT_SHARE: (f64, f64) = (0.1, 0.15);
pub(super) const APART_SHARE: f64 = 0.01;
/// Factor by which further effects must gain more than the first one.
const FURTHER: f64 = 1.25;
/// What an effect must take off the residual, RMS relative to the wheels' scatter: the first one named, and further ones,
/// which may only mend the description of the first.
const LEAST_GAINED: (f64, f64) = (0.15, 0.2);
/// An effect of single recordings also counts when it explains this part of the residual's displacement: slow shifts have no
/// energy worth mentioning in the acceleration.
const DISPLACEMENT_SHARE: f64 = 0.5;
/// What explains this part of it, and of whose energy the bogies of a train share no more than this, is as sure as what shows without
/// trains: no panel does that.
const ERRATIC: (f64, f64) = (0.9, 0.3);
/// Least difference in gain by which candidates are told apart.
const SAME_GAIN: f64 = 4.0;
/// Wheelsets of a train meet the same rail: their deviations are not as independent as the covariance says.
const LATENT_INFLATION: f64 = 2.0;
/// Evidence counts this much less than it says when it becomes a probability (calibrated on simulated trials).
pub(super) const PROBABILITY_SCALE: f64 = 4.0;

/// Gain in log posterior per independent look, nats, with which an effect counts although it takes nothing off the residual,
/// because the path had taken it over: the first one named, and further ones. Reference recordings reach 180.
const RELIEVED: (f64, f64) = (250.0, 400.0);
/// Largest part of the energy of an effect of single wheels, or of shocks, that all bogies of a train may share: as much as half of
/// the wheels give.
const MOST_SHARED: f64 = 0.65;

/// Part of what a model misses beyond its covariance that an effect takes away when it is there, though clipping leaves more than it
/// should: a mount that takes the transducer to its range takes nine tenths.
const MENDED: f64 = 0.8;
/// Share of the wheels above which a defect is no single wheels': flats on 95 of 100 wheels, the end of the range, were what a
/// fit over voids made of their scatter.
const MOST_WHEELS: f64 = 0.9;

const ADRIFT: &str = "wheels differ over this panel by more than the model can follow: sizes are rough, and whether something else acts cannot be \
                      told before this is mended";

/// A latent effect, what it found, and the part of the displacement's residual that this explains.
pub(super) type Explored = (&'static dyn Latent, Option<LatentFit>, f64);

/// A model before the last effect.
struct Confirmed {
    squares: [f64; 3],
    described: usize,
    accepted: usize,
    fit: Option<Fit>,
}

/// One candidate of a round.
pub(super) struct Candidate {
    pub(super) name: &'static str,
    stage: Stage,
    pub(super) gain: f64,
    misfit_gain: f64,
    /// The same per independent look.
    relief: f64,
    /// Makes a model plausible that agrees with the recordings only as no track is.
    mends: bool,
    pub(super) full: bool,
    acts_on: ActsOn,
    /// Shows while no train is near.
    apart: bool,
}

impl Session<'_> {
    pub(super) fn search(&mut self, progress: &dyn Progress) -> Result<(), GapError> {
        for number in self.named.len()..MOST_EFFECTS {
            progress.begin(&format!("effects, round {}", number + 1), 2);
            if !self.one_round(progress)? {
                break;
            }
            if self.adrift() {
                self.remarks.push(ADRIFT.into());
                break;
            }
        }
        Ok(())
    }

    /// Takes what shows while no train is near into the model, which need not be right for that.
    pub(super) fn search_apart(&mut self) -> Result<(), GapError> {
        while self.named.len() < MOST_EFFECTS {
            let mut latent = self.explore()?;
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

    /// Takes an effect into the model with which that misses the recordings by no more than `most` (squares, per value), or by far
    /// less than before; none that leaves more.
    pub(super) fn search_what_mends(&mut self, most: f64, progress: &dyn Progress) -> Result<(), GapError> {
        progress.begin("effects that mend the model", 2);
        let mended = self.misfit() - MENDED * (self.misfit() - 1.0);
        if !self.one_round(progress)? {
            return Ok(());
        }
        if !self.accepted.is_empty() {
            // From afar, one fit does not get there.
            self.fit = Some(settled(&self.base.frame, &self.accepted, self.state(), self.search)?);
        }
        if self.misfit() <= most.max(mended) {
            return Ok(());
        }
        if let Some(name) = self.named.last().map(|n| n.name) {
            self.withdraw(name)?;
            self.renew_derivatives()?;
        }
        Ok(())
    }

    /// Whether wheels differ in ways that the model does not know, with an effect of the panel in it: what is looked for on top would
    /// mend the description of that effect.
    fn adrift(&self) -> bool {
        !self.accepted.is_empty() && self.base.variation.beyond_linear()
    }

    /// Tries everything on top of what is accepted; accepts the best if it is good enough.
    fn one_round(&mut self, progress: &dyn Progress) -> Result<bool, GapError> {
        let earlier = &Confirmed {
            squares: self.current_squares()?,
            described: self.described(),
            accepted: self.accepted.len(),
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
        let names: Vec<&str> = self.named.iter().map(|n| n.name).collect();
        let candidates: Vec<&'static dyn Effect> =
            self.common.iter().copied().filter(|e| !names.contains(&e.name())).collect();
        let lost = reference.lost();
        let from_afar = if lost && self.accepted.is_empty() {
            Some(reference.state.on_nominal_ballast())
        } else {
            let astray = lost || reference.state.strained(&self.base.frame);
            astray.then(|| reference.state.on_the_scan())
        };
        let look = |from_afar: Option<&State>| {
            let standing = Standing { accepted: &self.accepted, state: &reference.state, from_afar };
            round(&self.base.frame, standing, &candidates, &self.hints, self.search)
        };
        let (mut tried, screening) = look(from_afar.as_ref())?;
        if !lost && reference.state.odd_bed() {
            let (afresh, _) = look(Some(&reference.state.on_nominal_ballast()))?;
            prefer_what_mends(&mut tried, afresh, &self.base.frame);
        }
        if self.cosines.is_empty() {
            self.cosines = cosines(&screening, &candidates);
        }
        progress.step();
        let mut list = self.candidates(&tried, &reference, &latent)?;
        let misfit: f64 = reference.passages.iter().map(|p| squares(&p.residual)).sum();
        let rings = self.rings(&reference.state);
        for c in &mut list {
            let of_ringing = rings && c.acts_on == ActsOn::Wheels;
            if of_ringing || !self.worth_naming(c, earlier.described, misfit) {
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
                    if lost || (self.of_wheels() > 0 && list[k].stage != Stage::Sensor) {
                        self.relinearise()?;
                    }
                    self.review_wheels()?;
                }
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Effects of single wheels in the model.
    fn of_wheels(&self) -> usize {
        self.latent_fits.iter().filter(|(e, _)| e.acts_on() == ActsOn::Wheels).count()
    }

    /// Effects in the model whose description may leave something that passes for a further one: not what only the recorder does.
    fn described(&self) -> usize {
        self.accepted.len() + self.of_wheels()
    }

    /// Whether an effect explains enough to be named on top of `described` others.
    fn worth_naming(&self, c: &Candidate, described: usize, misfit: f64) -> bool {
        // A model as good as the scatter of the wheels has nothing to explain, unless the gain comes from elsewhere.
        let excess = self.scatter.0.max(0.0).sqrt();
        let room = excess > LEAST_EXCESS || c.relief > asked(RELIEVED, described) || c.mends;
        // What the first effect's description leaves must not be taken for a second one.
        let least_gain = asked((LEAST_GAIN, FURTHER * LEAST_GAIN), described);
        c.full && room && c.gain > least_gain && 2.0 * c.misfit_gain > LEAST_SHARE * misfit
    }

    pub(super) fn candidates(
        &self,
        tried: &[Tried<'static>],
        reference: &Fit,
        latent: &[Explored],
    ) -> Result<Vec<Candidate>, GapError> {
        // The best fit of the round tells how much of the misfit is left to chance.
        let inflation = tried
            .iter()
            .filter_map(|t| t.fit.as_ref())
            .map(Fit::inflation)
            .fold(reference.inflation(), f64::min);
        let heard = self.heard(tried, reference)?;
        let astray = reference.state.implausible(&self.base.frame);
        let common = tried.iter().zip(heard).map(|(t, heard)| {
            let (gain, full) = match &t.fit {
                // A strength at the end of its range is no strength but a fit that found no other way.
                Some(f) => (
                    f.log_evidence - reference.log_evidence,
                    inside_ranges(t.effect, f)
                        && large_enough(t.effect, f, self.accepted.len(), inflation)
                        && self.borne_out(t.effect)
                        // What the hammer denies as firmly as an effect must show itself is not there.
                        && heard > -LEAST_GAIN,
                ),
                None => (t.screened.min(LEAST_GAIN), false),
            };
            let misfit_gain = t.fit.as_ref().map_or(0.0, |f| f.log_posterior - reference.log_posterior);
            Candidate {
                name: t.effect.name(),
                stage: t.effect.stage(),
                gain: gain / inflation + heard,
                misfit_gain,
                relief: misfit_gain / inflation + heard,
                mends: astray && t.fit.as_ref().is_some_and(|f| f.state.common(&self.base.frame)),
                full,
                acts_on: ActsOn::Panel,
                apart: false,
            }
        });
        let latent = latent.iter().map(|(e, f, moved)| {
            let share = f.as_ref().map_or(0.0, |f| self.share_of(f));
            let of_wheels = e.acts_on() == ActsOn::Wheels;
            let erratic =
                |f: &LatentFit| *moved > ERRATIC.0 && self.shared_by_bogies(f) < ERRATIC.1 && !of_wheels;
            let apart = f.as_ref().is_some_and(|f| f.apart || erratic(f));
            let least = if apart { APART_SHARE } else { asked(LATENT_SHARE, self.described()) };
            let full = (share > least || *moved > DISPLACEMENT_SHARE)
                && !f.as_ref().is_some_and(|f| {
                    let of_each = of_wheels || (f.decay_s.is_some() && !apart);
                    of_each && self.shared_by_bogies(f) > MOST_SHARED
                })
                && !f.as_ref().is_some_and(everywhere);
            // What a lost model leaves over is no wheel's; elsewhere the mean says nothing of single wheels, and the model nothing
            // of what shows without trains. Where wheels differ as no sound ones do, some have a defect.
            let doubt = match reference.lost() && !apart {
                true => LATENT_INFLATION * inflation,
                false if of_wheels && self.base.variation.unnatural().is_some() => 1.0,
                false => LATENT_INFLATION,
            };
            let gain = f.as_ref().map_or(0.0, |f| f.gain) / doubt;
            let gain = if full { gain } else { gain.min(0.5 * LEAST_GAIN) };
            Candidate {
                name: e.name(),
                stage: e.stage(),
                gain,
                misfit_gain: f64::INFINITY,
                relief: f64::INFINITY,
                mends: false,
                full,
                acts_on: e.acts_on(),
                apart,
            }
        });
        Ok(common.chain(latent).collect())
    }

    /// Whether a mount rings on so that what wheels do by nature does not describe how they differ: waves at its frequency would pass
    /// for those of wheels.
    fn rings(&self, state: &State) -> bool {
        let sensor = &self.base.frame.base.crossing.sensor;
        let mount = state.world(&self.base.frame, &self.accepted).sensor.mount;
        mount.is_some() && self.base.variation.noisy(sensor)
    }

    /// Gain of every fit in the log likelihood of the measured receptance; nought without one.
    fn heard(&self, tried: &[Tried<'static>], reference: &Fit) -> Result<Vec<f64>, GapError> {
        let Some(hammer) = self.hammer else { return Ok(vec![0.0; tried.len()]) };
        let of = |state: &State, effects: &[&'static dyn Effect]| {
            hammer.log_likelihood(&state.world(&self.base.frame, effects))
        };
        let before = of(&reference.state, &self.accepted)?;
        tried
            .iter()
            .map(|t| {
                let Some(fit) = &t.fit else { return Ok(0.0) };
                Ok(of(&fit.state, &[self.accepted.as_slice(), &[t.effect]].concat())? - before)
            })
            .collect()
    }

    pub(super) fn explore(&mut self) -> Result<Vec<Explored>, GapError> {
        let state = self.state();
        let world = state.world(&self.base.frame, &self.accepted);
        let all: Vec<usize> = (0..self.base.frame.observed.len()).collect();
        let responses = simulate(&world, &self.base.frame, &all)?;
        let late = self.late(&state, &responses, world.sensor);
        let frame = &self.base.frame;
        let scene = Scene::new(
            &world,
            &frame.observed,
            &frame.responses,
            &self.base.shapes,
            &self.base.variation,
            &responses,
            &late,
            &self.split.train,
        );
        let known: Vec<&str> = self.named.iter().map(|n| n.name).collect();
        let found = self
            .latent
            .iter()
            .filter(|e| !known.contains(&e.name()))
            .map(|e| (*e, e.explore(&scene)))
            .map(|(e, f)| {
                let moved = f.as_ref().map_or(0.0, |f| displacement_share(&scene, f));
                (e, f, moved)
            })
            .collect();
        self.scatter = self.squares_of(&scene.residuals);
        Ok(found)
    }

    /// Position errors in time: fitted for training passages, by correlation for the others.
    fn late(&self, state: &State, responses: &[Response], sensor: SensorModel) -> Vec<f64> {
        self.base
            .frame
            .observed
            .iter()
            .enumerate()
            .map(|(i, o)| match self.search.contains(&i) {
                true => state.shift_m[i] / o.speed_m_s,
                false => o.lag(&responses[i], sensor.gain_at(o.temperature_c), ALIGN_M),
            })
            .collect()
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
        let probability = self.ranking.iter().find(|r| r.name == name).map_or(MOST_SURE, |r| r.probability);
        let mut named = Named {
            name,
            stage: best.stage,
            probability,
            parameters: Vec::new(),
            indistinguishable_from: same,
            gained: f64::NAN,
        };
        if let Some(t) = tried.iter_mut().find(|t| t.effect.name() == name) {
            self.accepted.push(t.effect);
            self.fit = t.fit.take();
        } else if let Some((effect, Some(found))) =
            latent.drain(..).map(|(e, f, _)| (e, f)).find(|(e, _)| e.name() == name)
        {
            named.parameters = found.parameters.clone();
            self.take_out(effect, found);
            self.refit_variation()?;
        }
        self.named.push(named);
        Ok(())
    }

    /// Squares of the residual of the training passages with the current model, relative to the signal: acceleration and
    /// displacement, and the acceleration's part that differs from bogie to bogie.
    pub(super) fn current_squares(&self) -> Result<[f64; 3], GapError> {
        let frame = &self.base.frame;
        let world = self.state().world(frame, &self.accepted);
        let train = &self.split.train;
        let responses = simulate(&world, frame, train)?;
        let latent: Vec<&LatentFit> = self.latent_fits.iter().map(|(_, f)| f).collect();
        let mut sums = [0.0; 3];
        for (i, r) in train.iter().zip(&responses) {
            let p = measure::prediction(frame, *i, (&world, r), &latent);
            let parts = measure::residual_squares(&p);
            sums.iter_mut().zip(parts).for_each(|(s, v)| *s += v / train.len() as f64);
        }
        Ok(sums)
    }

    /// Whether the effect accepted last takes enough off the residual; if not, it is taken back.
    fn confirm(&mut self, earlier: &Confirmed, c: &Candidate) -> Result<bool, GapError> {
        let [acceleration, displacement, own] = self.current_squares()?;
        let Some(last) = self.named.last_mut() else { return Ok(true) };
        let part = |before: f64, now: f64, floor: f64| {
            ((before - now).max(0.0) / floor.max(f64::MIN_POSITIVE)).sqrt()
        };
        // The displacement has no floor of its own; half of what it gains counts.
        last.gained = part(earlier.squares[0], acceleration, own)
            .max(0.5 * part(earlier.squares[1], displacement, displacement));
        // Effects of single wheels have their own rule.
        if last.gained >= asked(LEAST_GAINED, earlier.described)
            || self.accepted.len() == earlier.accepted
            || c.relief > asked(RELIEVED, earlier.described)
            || c.mends
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
        } else {
            self.fit = Some(fit(&self.base.frame, &self.accepted, state, self.search, options)?);
        }
        Ok(())
    }

    /// Probabilities of a round; an effect keeps its best.
    fn rank(&mut self, list: &[Candidate]) {
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

    /// Energy that an effect adds to the windows, relative to that of the wheels' scatter and of the noise.
    fn share_of(&self, found: &LatentFit) -> f64 {
        let sum = |w: &Vec<Vec<f64>>| w.iter().flatten().map(|v| v * v).sum::<f64>();
        let own: f64 = self.split.train.iter().map(|i| sum(&found.windows[*i])).sum();
        own / self.scatter.1.max(f64::MIN_POSITIVE)
    }

    /// Part of the energy that an effect adds to the windows which is the same for all bogies of a train: no single wheel's.
    fn shared_by_bogies(&self, found: &LatentFit) -> f64 {
        let parts = self.split.train.iter().map(|i| energies(&found.windows[*i]));
        let (all, shared) = parts.fold((0.0, 0.0), |(a, s), (all, shared)| (a + all, s + shared));
        shared / all.max(f64::MIN_POSITIVE)
    }

    /// Squares of what differs between the bogies of the training passages, and the median over passages of how far the
    /// whole residual is above that, relative, in squares.
    fn squares_of(&self, residuals: &[Vec<Vec<f64>>]) -> (f64, f64) {
        let mut own_sum = 0.0;
        let mut above = Vec::new();
        for i in &self.split.train {
            let windows = &residuals[*i];
            let inside = energies(windows);
            let own = own_energy(inside, windows.len());
            own_sum += own;
            above.push(inside.0 / own.max(f64::MIN_POSITIVE) - 1.0);
        }
        (crate::signal::quantile(&above, 0.5), own_sum)
    }
}

/// Whether a defect is on so many wheels that it stands in for something that all of them meet.
fn everywhere(found: &LatentFit) -> bool {
    found.wheel_share.is_some_and(|share| share > MOST_WHEELS)
}

/// Takes over the fits `afresh` from nominal ballast, where ballast had become a bed that is none, of effects that make it one and
/// fit better. Others do not count: from there, weak ballast mass passed for soft pads and a dip in the stock rail, on a bed as
/// odd as before.
fn prefer_what_mends(tried: &mut [Tried], afresh: Vec<Tried>, frame: &Frame) {
    let evidence = |t: &Tried| t.fit.as_ref().map_or(f64::NEG_INFINITY, |f| f.log_evidence);
    for new in afresh {
        let mends = new.fit.as_ref().is_some_and(|f| f.state.common(frame));
        let old = tried.iter_mut().find(|t| t.effect.name() == new.effect.name());
        if let Some(old) = old.filter(|old| mends && evidence(&new) > evidence(old)) {
            old.fit = new.fit;
        }
    }
}

/// What differs between wheels is no panel's doing, but changes their mean, which an effect of the panel can follow: its gain
/// says nothing until the wheels are in the model.
fn put_wheels_first(list: &mut [Candidate]) {
    put_first(list, |c| c.acts_on == ActsOn::Wheels, |c| c.acts_on == ActsOn::Panel);
}

/// What shows without trains needs no model, and spoils every fit as long as it is in the windows.
fn put_apart_first(list: &mut [Candidate]) {
    put_first(list, |c| c.apart, |c| !c.apart);
}

/// Lowers the gains of `later` candidates clearly below the best of those that come `first` and qualify.
fn put_first(list: &mut [Candidate], first: fn(&Candidate) -> bool, later: fn(&Candidate) -> bool) {
    let qualifies = |c: &&Candidate| c.full && c.gain > LEAST_GAIN && first(c);
    let Some(best) = list.iter().filter(qualifies).map(|c| c.gain).max_by(f64::total_cmp) else { return };
    for c in list.iter_mut().filter(|c| later(c)) {
        c.gain = c.gain.min(best - 2.0 * same_gain(best));
    }
}

/// Candidates whose gains are within this of the best are not told apart.
fn same_gain(best: f64) -> f64 {
    SAME_GAIN + 0.01 * best
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

/// What is asked of the first effect, or of one on top of `described` others.
fn asked((first, further): (f64, f64), described: usize) -> f64 {
    if described == 0 { first } else { further }
}

fn squares(m: &faer::Mat<f64>) -> f64 {
    m.col_as_slice(0).iter().map(|v| v * v).sum()
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
