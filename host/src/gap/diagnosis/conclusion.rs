//! From the effects found to the verdict: final fit, held-out passages, parameters with intervals.

use super::recorder::SATURATION;
use super::{Diagnosis, Session};
use crate::gap::GapError;
use crate::gap::effect::{Effect, Scale, Stage, Stated};
use crate::gap::fit::{Fit, FitOptions, State, fit, replaced, simulate};
use crate::gap::forward::{Detail, Response};
use crate::gap::hammer::{Agreement, BAND_HZ};
use crate::gap::ladder::ladder;
use crate::gap::latent::LatentFit;
use crate::gap::measure::{Gap, Prediction, measure, predictions};
use crate::gap::trains::{depth_sd, tell_apart};
use crate::gap::verdict::{Verdict, verdict};
use crate::gap::where_;
use crate::gap::world::World;
use crate::progress::Progress;

/// Width of the intervals of effects of the panel over what covariance and model error say, so that they hold nine of ten. Twice as
/// wide they held 717 of the 757 in trials of seeds before 45, 95 %; at this width 101 of the 105 of seed 44 instead of 103.
const CALIBRATED: f64 = 1.7;

/// Their width where it is asked whether an effect may be nothing: naming what is not there is worse than missing what is hardly there.
const OPEN: f64 = 2.0;

/// Nothing is surer than this where there is no scan and most of the gap stays: of nine effects named then, on known and training sites
/// without their scans, four were there. That was with a path found together with the ballast; with the present one too few are named
/// there to count.
const MOST_SURE_WITHOUT_SCAN: f64 = 0.5;

/// Held-out passages from which a bootstrap is worth something.
const LEAST_HELD_OUT: usize = 4;

impl Session<'_> {
    pub(super) fn conclude(
        mut self,
        base_world: &World,
        (has_scan, node_gap): (bool, Option<f64>),
        progress: &dyn Progress,
    ) -> Result<Diagnosis, GapError> {
        progress.begin("held-out passages", 3);
        let (mut predicted, mut gap) = self.settle(base_world)?;
        progress.step();
        if self.search_without_withdrawn(&gap, progress)? {
            (predicted, gap) = self.settle(base_world)?;
        }
        if self.split.train == self.split.test {
            self.remarks.push(
                "too few passages to hold any out: gap and part closed are those of passages that the model was fitted to".into(),
            );
        } else if self.split.test.len() < LEAST_HELD_OUT {
            let n = self.split.test.len();
            self.remarks.push(format!(
                "{n} held-out passages are too few for an interval of what is closed: the one stated is too narrow"
            ));
        }
        let after_state = self.state();
        let after_world = after_state.world(&self.base.frame, &self.accepted);
        progress.step();
        let frame = &self.base.frame;
        let held_out = self.held_out(&predicted);
        let residuals = where_::residuals(&predicted, frame, &self.split.test);
        let depends_on = where_::depends_on(&residuals, &self.named);
        let position_m = where_::positions(&predicted, frame.base.crossing.traffic_direction.sign());
        self.ranking.sort_by(|a, b| b.probability.total_cmp(&a.probability));
        let denials = self.denials()?;
        if !self.misdescribed {
            self.remarks.extend(denials.iter().map(|d| d.remark.clone()));
        }
        let verdict = match self.untrusted {
            true => Verdict::Unexplained,
            false => verdict(&gap, &self.named, !denials.is_empty()),
        };
        let may_be_path = !has_scan && !self.untrusted && verdict == Verdict::Unexplained;
        if may_be_path {
            self.doubt_without_scan();
        }
        if verdict != Verdict::NoGap {
            self.describe_alternatives(base_world)?;
        }
        for r in &mut self.ranking {
            let named = self.named.iter().any(|n| n.name == r.name);
            let other =
                self.named.iter().find_map(|n| n.alternative(r.name)).map_or(gap.before, |a| a.gap_after);
            r.gap_after = if named { gap.after } else { other };
        }
        let corrected = if self.named.is_empty() { base_world } else { &after_world };
        let track = self.ask_hammer(base_world, corrected)?;
        let denied = denials
            .iter()
            .find_map(|d| d.stage)
            .or((track == Some(Agreement::Differs)).then_some(Stage::Track))
            .filter(|_| verdict == Verdict::Unexplained && self.named.is_empty());
        let foreign = self.foreign_scan.then_some(Stage::Geometry);
        let stage = {
            let tried = if self.searched { &self.ranking[..] } else { &[] };
            foreign.or(denied).or_else(|| crate::gap::verdict::stage(verdict, &self.named, tried))
        };
        progress.step();
        Ok(Diagnosis {
            verdict,
            searched: self.searched,
            may_be_path: may_be_path && denials.iter().all(|d| d.of_path),
            stage,
            effects: if verdict == Verdict::NoGap { Vec::new() } else { self.named },
            ranking: self.ranking,
            gap,
            depends_on,
            position_m,
            collapse: where_::collapse(&residuals),
            wheels: self.base.variation,
            train_depth: depth_sd(&predicted),
            ladder: ladder(&self.base.frame, &self.split.test, &held_out, has_scan, node_gap)?,
            node_gap,
            predictions: held_out,
            cosines: self.cosines,
            remarks: self.remarks,
            residuals,
            skipped: Vec::new(),
            consequences: None,
            seconds: 0.0,
        })
    }

    /// Fits what was found to all training passages, withdraws what they or the held-out ones deny; predictions and gap with the rest.
    fn settle(&mut self, base_world: &World) -> Result<(Vec<Prediction>, Gap), GapError> {
        self.final_fit()?;
        self.withdraw_what_may_be_nothing()?;
        self.predict(base_world)
    }

    /// What was withdrawn may have stood in for something else: where a gap, or a model that cannot be, is left without it, looks for that
    /// once. Whether anything was found.
    fn search_without_withdrawn(&mut self, gap: &Gap, progress: &dyn Progress) -> Result<bool, GapError> {
        if !self.searched || self.withdrawn.is_empty() {
            return Ok(false);
        }
        let denied = !self.denials()?.is_empty();
        if matches!(verdict(gap, &self.named, denied), Verdict::NoGap | Verdict::Explained) {
            return Ok(false);
        }
        let withdrawn = std::mem::take(&mut self.withdrawn);
        self.common.retain(|e| !withdrawn.contains(&e.name()));
        self.latent.retain(|e| !withdrawn.contains(&e.name()));
        let before = self.named.len();
        self.search(progress)?;
        Ok(self.named.len() > before)
    }

    /// Fits the accepted effects to all training passages.
    fn final_fit(&mut self) -> Result<(), GapError> {
        if self.accepted.is_empty() {
            return Ok(());
        }
        let (frame, train, options) = (&self.base.frame, &self.split.train, FitOptions::default());
        // Those that the search has not seen are where the base model had put them.
        let unseen: Vec<usize> = train.iter().copied().filter(|i| !self.search.contains(i)).collect();
        let state = replaced(frame, &self.accepted, self.state(), (&unseen, Detail::Full));
        let last = fit(frame, &self.accepted, state, train, options)?;
        self.describe(&last);
        self.fit = Some(last);
        Ok(())
    }

    /// Withdraws effects of the panel of which all training passages together leave open whether they are there at all, the last one
    /// found first: the search has seen a part of the passages.
    fn withdraw_what_may_be_nothing(&mut self) -> Result<(), GapError> {
        while let Some(name) = self.open() {
            let why = format!(
                "{name} would explain a part of the passages, but its size, from all of them, is not told from no effect at all: \
                 withdrawn"
            );
            self.deny(name, why)?;
        }
        Ok(())
    }

    /// The last effect of the panel that may be nothing.
    fn open(&self) -> Option<&'static str> {
        let wide = intervals(&self.accepted, self.fit.as_ref()?, OPEN);
        let sizes = self.accepted.iter().zip(&wide);
        let open = |name: &&str| {
            sizes.clone().any(|(effect, sizes)| effect.name() == *name && may_be_nothing(*effect, sizes))
        };
        self.named.iter().map(|named| named.name).rev().find(open)
    }

    /// Predictions of all passages, and the gap of the held-out ones. Effects that make it worse are withdrawn, the last one
    /// found first.
    fn predict(&mut self, base: &World) -> Result<(Vec<Prediction>, Gap), GapError> {
        let all: Vec<usize> = (0..self.base.frame.observed.len()).collect();
        let base_responses = simulate(base, &self.base.frame, &all)?;
        let base = (base, base_responses.as_slice());
        loop {
            let mut predicted = match self.named.is_empty() {
                true => predictions(&self.base.frame, base, base, &[]),
                false => self.corrected(base, (&self.accepted, &self.state()), &all)?,
            };
            tell_apart(&mut predicted, &self.base.frame.observed, &self.base.shapes);
            let gap = measure(&self.held_out(&predicted), !self.named.is_empty());
            let Some(last) = self.named.last().filter(|_| gap.closed_fraction_ci90[1] < 0.0) else {
                return Ok((predicted, gap));
            };
            let name = last.name;
            self.deny(name, withdrawn(name, &gap))?;
        }
    }

    /// Predictions of the base model and of one with effects of the panel, and everything else that is named.
    pub(super) fn corrected(
        &self,
        base: (&World, &[Response]),
        (effects, state): (&[&'static dyn Effect], &State),
        all: &[usize],
    ) -> Result<Vec<Prediction>, GapError> {
        let frame = &self.base.frame;
        let after = state.world(frame, effects);
        let responses = simulate(&after, frame, all)?;
        let latent: Vec<&LatentFit> = self.latent_fits.iter().map(|(_, f)| f).collect();
        Ok(predictions(frame, base, (&after, &responses), &latent))
    }

    /// Withdraws what passages deny that the search has not seen, and says why.
    fn deny(&mut self, name: &'static str, why: String) -> Result<(), GapError> {
        self.remarks.push(why);
        self.withdrawn.push(name);
        self.withdraw(name)
    }

    /// Takes one effect out of the model and out of the verdict.
    pub(super) fn withdraw(&mut self, name: &str) -> Result<(), GapError> {
        self.taken_back(name);
        if let Some(k) = self.latent_fits.iter().position(|(e, _)| e.name() == name) {
            let (_, found) = self.latent_fits.remove(k);
            self.give_back(&found);
            self.refit_variation()?;
        }
        if let Some(k) = self.accepted.iter().position(|e| e.name() == name) {
            self.accepted.remove(k);
            if let Some(fit) = &mut self.fit {
                fit.state.effects.remove(k);
            }
            if self.accepted.is_empty() {
                self.fit = None;
            }
        }
        self.back_to_linear();
        self.final_fit()
    }

    /// Nothing is sure where the path was estimated and most of the gap stays, but that a transducer clips at which values pile up.
    fn doubt_without_scan(&mut self) {
        let sure = self.clips_at_m_s2.map(|_| SATURATION);
        let named = self.named.iter_mut().map(|n| (n.name, &mut n.probability));
        let ranked = self.ranking.iter_mut().map(|r| (r.name, &mut r.probability));
        for (_, probability) in named.chain(ranked).filter(|(name, _)| Some(*name) != sure) {
            *probability = probability.min(MOST_SURE_WITHOUT_SCAN);
        }
        self.remarks.push(
            "without a laser scan the path of the wheels was estimated: what the model leaves may be the path's, and no effect is surer \
             than even; scan the crossing and diagnose again"
                .into(),
        );
    }

    pub(super) fn held_out(&self, predicted: &[Prediction]) -> Vec<Prediction> {
        self.split.test.iter().map(|i| predicted[*i].clone()).collect()
    }

    /// Says how far the models are from the measured receptance; `None` without one.
    fn ask_hammer(&mut self, base: &World, after: &World) -> Result<Option<Agreement>, GapError> {
        let Some(hammer) = self.hammer else { return Ok(None) };
        let (before, with) = (hammer.deviation(base)?, hammer.deviation(after)?);
        let agreement = Agreement::of(before);
        let told = match (agreement, Agreement::of(with)) {
            (Agreement::Agrees, _) => {
                "rails, pads, sleepers and ballast are as modelled; look for the gap elsewhere"
            }
            (_, Agreement::Agrees) => "the effects found account for it",
            (Agreement::Doubtful, _) => "which tells nothing for sure",
            (Agreement::Differs, _) => "something of rails, pads, sleepers or ballast is not as modelled",
        };
        self.remarks.push(format!(
            "hammer: the receptance of the base model is {:.0} % off the measured one between {:.0} and {:.0} Hz (median), {:.0} % with \
             the effects named: {told}",
            100.0 * before,
            BAND_HZ[0],
            BAND_HZ[1],
            100.0 * with
        ));
        Ok(Some(agreement))
    }

    /// Parameters with intervals of the accepted effects.
    fn describe(&mut self, fit: &Fit) {
        for (effect, list) in self.accepted.iter().zip(stated(&self.accepted, fit)) {
            if let Some(named) = self.named.iter_mut().find(|n| n.name == effect.name()) {
                named.parameters = list;
            }
        }
    }
}

/// Parameters with the intervals that are stated, 90 %, of the effects of a fit.
pub(super) fn stated(effects: &[&dyn Effect], fit: &Fit) -> Vec<Vec<Stated>> {
    intervals(effects, fit, CALIBRATED)
}

/// Parameters with intervals that are `width` times as wide as covariance and model error say.
fn intervals(effects: &[&dyn Effect], fit: &Fit, width: f64) -> Vec<Vec<Stated>> {
    let widen = 1.645 * fit.inflation().sqrt();
    let mut at = fit.covariance.nrows() - fit.state.effects.iter().map(Vec::len).sum::<usize>();
    let of_effect = |(effect, coordinates): (&&dyn Effect, &Vec<f64>)| {
        let mut list = Vec::new();
        for (p, c) in effect.parameters().iter().zip(coordinates) {
            let model = p.model_error * if p.scale == Scale::Log { 1.0 } else { c.abs().max(1.0) };
            let half = width * (widen * fit.covariance[(at, at)].max(0.0).sqrt() + model);
            at += 1;
            if !p.nuisance {
                let ends = [p.value(c - half), p.value(c + half)];
                list.push((p.name, p.value(*c), ends[0].min(ends[1]), ends[0].max(ends[1])));
            }
        }
        list
    };
    effects.iter().zip(&fit.state.effects).map(of_effect).collect()
}

/// Whether the intervals of all sizes that tell of an effect hold where there is none.
fn may_be_nothing(effect: &dyn Effect, stated: &[Stated]) -> bool {
    let Some(nought) = effect.nought() else { return false };
    effect.parameters().iter().zip(nought).take(effect.telling()).filter(|(p, _)| !p.nuisance).all(
        |(p, nought)| {
            let size = stated.iter().find(|(name, ..)| *name == p.name);
            size.is_some_and(|(_, _, low, high)| (*low..=*high).contains(&p.value(nought)))
        },
    )
}

/// What is said of an effect with which the held-out passages are predicted worse than by the base model.
fn withdrawn(name: &str, gap: &Gap) -> String {
    format!(
        "{name} would explain the passages used for the search, but the held-out ones are predicted worse with it than by the base \
         model (gap {:.3} instead of {:.3}): withdrawn",
        gap.after, gap.before
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::effects::common;

    /// Whether an effect with these intervals of two sizes may be nothing.
    fn open(name: &'static str, sizes: [(&'static str, [f64; 2]); 2]) -> bool {
        may_be_nothing(common(name).unwrap(), &sizes.map(|(size, [low, high])| (size, 1.0, low, high)))
    }

    /// Intervals as diagnoses of seed 44 stated them.
    #[test]
    fn regress_a_rail_that_only_weighs_otherwise_is_none() {
        let rail =
            |stiffness, mass| open("crossing-rail", [("stiffness_factor", stiffness), ("mass_factor", mass)]);
        // Nothing acts: trial 90.
        assert!(rail([0.845, 1.195], [0.235, 0.704]));
        // Rails: trials 166 and 198, of which the mass is open.
        assert!(!rail([1.23, 1.79], [0.90, 1.51]) && !rail([0.43, 0.60], [0.52, 1.09]));
    }

    /// Support that is lost on one side is lost.
    #[test]
    fn property_either_side_tells_of_lost_support() {
        let loss = |negative, positive| {
            open("support-loss", [("factor_negative_x", negative), ("factor_positive_x", positive)])
        };
        assert!(
            loss([0.8, 1.2], [0.7, 1.1]) && !loss([0.8, 1.2], [0.3, 0.6]) && !loss([0.3, 0.6], [0.8, 1.2])
        );
    }
}
