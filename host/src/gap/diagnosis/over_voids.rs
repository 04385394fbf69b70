//! A base model over voids, once they are found.
//!
//! They are found in the first form of the catalogue, by derivatives of a track without them, and with a train as the sum of its bogies.
//! None of that holds over a bed that opens, and what it leaves passes for further effects: a mount, flats, another rail. So the base
//! model is fitted again over each form of voids ([`OpenBed`]), and everything else is looked for on top of the best.

use super::Session;
use crate::gap::GapError;
use crate::gap::base::Form;
use crate::gap::data::{Observed, RATE_HZ};
use crate::gap::effect::{ActsOn, Advice, Effect, Stage};
use crate::gap::effects::{forms, in_form};
use crate::gap::included::Inclusion;
use crate::gap::latent::{Latent, LatentFit, Scene};
use crate::gap::measure::Missed;
use crate::gap::open_bed::{OpenBed, Task, Trace};
use crate::progress::Progress;

impl Session<'_> {
    /// Fits the base model anew once an effect of the panel is found that may have several forms, and takes back the one over a linear
    /// bed when that effect has been taken back. Whether the base model is another one now.
    pub(super) fn follow_the_bed(&mut self, progress: &dyn Progress) -> Result<bool, GapError> {
        match self.of_many_forms() {
            Some(k) if !self.voids_formed => self.form(k, progress),
            None => Ok(self.back_to_linear()),
            Some(_) => Ok(false),
        }
    }

    /// Which of the effects in the model may have several forms.
    fn of_many_forms(&self) -> Option<usize> {
        self.accepted.iter().position(|e| forms(e.name()).len() > 1)
    }

    fn form(&mut self, k: usize, progress: &dyn Progress) -> Result<bool, GapError> {
        let (site, prior) = self.panel;
        let found = self.state().effects;
        let with = |form: &'static dyn Effect| -> Vec<Form> {
            let mut all: Vec<Form> = self.accepted.iter().copied().zip(found.iter().cloned()).collect();
            all[k] = (form, in_form(form, &found[k]));
            all
        };
        let choices: Vec<Vec<Form>> = forms(self.accepted[k].name()).into_iter().map(with).collect();
        let sensor = self.base.frame.base.sensor;
        let site = &self.without_steps(site);
        let task = Task { site, searched: self.search, prior, sensor, refits: 1 };
        let Some(model) = OpenBed::fitted(task, &choices, progress)? else { return Ok(false) };
        let both = |[acceleration, displacement]: [Missed; 2]| acceleration.all + displacement.all;
        if both(model.missed) >= both(self.missed()?) {
            self.voids_formed = true;
            return Ok(false);
        }
        // Something else acts, by which wheels are misjudged over the voids: it is looked for first, where they are not yet.
        if model.base.variation.beyond_linear() && !self.base.variation.beyond_linear() {
            return Ok(false);
        }
        self.voids_formed = true;
        self.take_over(model)?;
        self.back_to_linear();
        Ok(true)
    }

    /// Goes on from a model over voids. What single wheels and recordings add was judged by another one, and is looked for again.
    fn take_over(&mut self, model: OpenBed) -> Result<(), GapError> {
        let OpenBed { mut base, effects, fit, beyond, .. } = model;
        base.record_again(&self.base.frame.observed);
        let latent = std::mem::take(&mut self.latent_fits);
        for (effect, found) in &latent {
            self.give_back(found);
            self.taken_back(effect.name());
        }
        self.linear = Some(std::mem::replace(self.base, base));
        (self.accepted, self.fit) = (effects, Some(fit));
        let added = added(&self.base.frame.observed, &beyond);
        self.take_out(&WholeTrains, added);
        self.prune()
    }

    /// Puts the base model over a linear bed in the place of one over voids that have been taken back, and forgets what was found over
    /// them. Whether there was one.
    pub(super) fn back_to_linear(&mut self) -> bool {
        let taken_back = self.linear.is_some() && self.of_many_forms().is_none();
        if taken_back {
            self.forget_search();
        }
        taken_back
    }
}

/// What whole trains do beyond the sum of their bogies, as a part of the recordings.
struct WholeTrains;

impl Latent for WholeTrains {
    fn name(&self) -> &'static str {
        "whole-trains"
    }

    fn stage(&self) -> Stage {
        Stage::Track
    }

    fn advice(&self) -> Advice {
        Advice { what: "trains are more than the sum of their bogies", action: "Nothing to do." }
    }

    fn inclusion(&self) -> Inclusion {
        Inclusion::NEEDLESS
    }

    fn acts_on(&self) -> ActsOn {
        ActsOn::Recordings
    }

    fn explore(&self, _scene: &Scene) -> Option<LatentFit> {
        None
    }
}

fn added(observed: &[Observed], beyond: &[Trace]) -> LatentFit {
    let of = |o: &Observed, first_s: f64, count: usize| {
        let trace = beyond.iter().find(|t| t.passage_id == o.passage_id);
        trace.map_or_else(|| vec![0.0; count], |t| t.at(first_s, 1.0 / RATE_HZ, count))
    };
    let windows = |o: &Observed| -> Vec<Vec<f64>> {
        let start_s = |bogie_s: f64| o.first_axle_s + bogie_s + o.first_s;
        o.bogie_s().into_iter().map(|bogie_s| of(o, start_s(bogie_s), o.mean.len())).collect()
    };
    let whole = |o: &Observed| {
        let (start_s, recorded) = o.trace();
        of(o, start_s, recorded.len())
    };
    LatentFit {
        gain: 0.0,
        parameters: Vec::new(),
        apart: false,
        wheel_share: None,
        decay_s: None,
        windows: observed.iter().map(windows).collect(),
        traces: observed.iter().map(whole).collect(),
    }
}
