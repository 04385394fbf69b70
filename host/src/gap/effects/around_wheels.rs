//! Defects that a wheelset meets the rail with once per turn or more often, at a place around it that is anyone's guess: what the windows
//! show for them, front and rear wheelset of a bogie weighed together.

mod shown;

use std::sync::Arc;

use rayon::prelude::*;

use self::shown::{OfBogie, Seen, Shown, seen};
use crate::gap::latent::{SHARES, Scene};
use crate::gap::variation::Variation;
use crate::signal::dot;

/// Parts of what wheels differ by in their own path that are left once the defects are known, tried one after the other as long as the next
/// is more probable.
const OWN_PARTS: [f64; 5] = [1.0, 0.5, 0.25, 0.1, 0.04];

/// See [`sizeable`].
const LEAST_SHARE: f64 = 0.03;

/// Factors are ascending by less than a sixth: of so many one is tried first.
const COARSE: usize = 4;

/// What a defect of unit size adds to the windows of a passage, m/s²: front and rear wheelset, place around it, sample.
pub type Added = [Vec<Vec<f64>>; 2];

/// A defect of unit size at every place around the wheel.
#[derive(Clone)]
pub struct Around {
    /// In every passage; without places where it is not known.
    pub windows: Vec<Added>,
    /// Factors of the unit size that are tried: first, ratio, number.
    pub factors: (f64, f64, usize),
    /// Places that say nothing.
    pub mute: Vec<bool>,
}

impl Around {
    /// Factors that are tried.
    pub fn factors(&self) -> impl Iterator<Item = f64> {
        let (first, ratio, number) = self.factors;
        (0..number).map(move |i| first * ratio.powi(i as i32))
    }

    /// What is simulated with, in some passages.
    pub fn simulate(&mut self, passages: &[usize], of: impl Fn(usize) -> Option<Added> + Sync) -> Option<()> {
        let found: Vec<Added> = passages.par_iter().map(|i| of(*i)).collect::<Option<_>>()?;
        for (passage, windows) in passages.iter().zip(found) {
            self.windows[*passage] = windows;
        }
        Some(())
    }
}

/// Defects that explain the most.
pub struct Found {
    /// Of unit size.
    pub around: Arc<Around>,
    seen: Vec<Seen>,
    /// Of the training passages.
    shown: Vec<OfBogie>,
    /// Log likelihood ratio to wheels that differ by as much as they seem to.
    pub score: f64,
    /// Of the unit size.
    pub factor: f64,
    /// Of the wheelsets that have it.
    pub share: f64,
}

impl Found {
    /// Where wheels differ in their own path by as much as they seem to.
    pub fn of(scene: &Scene, around: Arc<Around>) -> Option<Self> {
        Self::beside(scene, around, 1.0)
    }

    /// Where they may differ by less, because what they have is known.
    pub fn described(scene: &Scene, around: &Arc<Around>) -> Option<Self> {
        let likely = |found: &Self| scene.train.iter().map(|i| found.seen[*i].log_likelihood()).sum::<f64>();
        let mut best = Self::of(scene, Arc::clone(around))?;
        let plain = likely(&best);
        for part in &OWN_PARTS[1..] {
            let found = Self::beside(scene, Arc::clone(around), *part)?;
            let score = found.score + likely(&found) - plain;
            if score <= best.score {
                break;
            }
            best = Self { score, ..found };
        }
        Some(best)
    }

    /// Where they differ in it by `part` of that.
    fn beside(scene: &Scene, around: Arc<Around>, part: f64) -> Option<Self> {
        let v = &scene.variation;
        let seen = seen(scene, &Variation { own_m: part * v.own_m, own_stock_m: part * v.own_stock_m, ..*v });
        let of_train = |i: &usize| seen[*i].shown(&around.windows[*i], &around.mute);
        let shown: Vec<Vec<OfBogie>> = scene.train.par_iter().map(of_train).collect();
        let shown: Vec<OfBogie> = shown.into_iter().flatten().collect();
        let (score, factor, share) = best(&shown, &around.factors().collect::<Vec<_>>())?;
        Some(Self { around, seen, shown, score, factor, share })
    }

    /// Energy that they are expected to add to the window of a bogie of a passage, (m/s²)².
    pub fn energy(&self, passage: usize) -> f64 {
        let of_axle =
            |places: &Vec<Vec<f64>>| places.iter().map(|w| dot(w, w)).sum::<f64>() / places.len() as f64;
        let of_bogie: f64 = self.around.windows[passage].iter().map(of_axle).sum();
        self.share * self.factor * self.factor * of_bogie
    }

    /// Part of the defects, as probable as they are, that are at marked places.
    pub fn part_at(&self, marked: &[bool]) -> f64 {
        let mut found = [0.0, 0.0];
        for bogie in &self.shown {
            self.parts(bogie, |_, place, part| found[usize::from(marked[place])] += part);
        }
        found[1] / (found[0] + found[1]).max(f64::MIN_POSITIVE)
    }

    /// Calls with wheelset, place and probability of every defect of a bogie.
    fn parts(&self, bogie: &OfBogie, mut call: impl FnMut(usize, usize, f64)) {
        let mut of = |axle: usize, shown: &Shown, probability: f64| {
            let places = shown.places(self.factor).into_iter().enumerate();
            places.for_each(|(place, weight)| call(axle, place, probability * weight));
        };
        let ([_, front, rear, both], _) = OfBogie::posterior(bogie.gains(self.factor), self.share);
        let (first, second) = bogie.one_after_another(self.factor);
        let alone = [front, rear];
        of(first, &bogie.axles[first], alone[first] + both);
        of(1 - first, &bogie.axles[1 - first], alone[1 - first]);
        of(1 - first, &second, both);
    }

    /// Posterior mean of what defects add to the windows: passage, bogie, sample.
    pub fn windows(&self) -> Vec<Vec<Vec<f64>>> {
        (0..self.seen.len()).into_par_iter().map(|i| self.of_passage(i)).collect()
    }

    fn of_passage(&self, passage: usize) -> Vec<Vec<f64>> {
        let added = &self.around.windows[passage];
        let nowhere = vec![false; added[0].len()];
        let shown = self.seen[passage].shown(added, &nowhere);
        shown.iter().map(|bogie| self.window(bogie, added)).collect()
    }

    fn window(&self, bogie: &OfBogie, added: &Added) -> Vec<f64> {
        let mut out = vec![0.0; added[0][0].len()];
        self.parts(bogie, |axle, place, part| {
            let one = &added[axle][place];
            out.iter_mut().zip(one).for_each(|(o, b)| *o += part * self.factor * b);
        });
        out
    }

    /// Factors within a 90 % interval of the likelihood.
    pub fn interval(&self) -> (f64, f64) {
        let likely =
            |f: f64| -> f64 { self.shown.iter().map(|s| OfBogie::posterior(s.gains(f), self.share).1).sum() };
        let highest = likely(self.factor);
        let edge = |step: f64| {
            let mut factor = self.factor;
            for _ in 0..80 {
                factor *= step;
                if likely(factor) < highest - 1.35 {
                    break;
                }
            }
            factor
        };
        (edge(1.0 / 1.01), edge(1.01))
    }
}

/// Whether defects that by the linear response add this energy to the window of a bogie of a passage, (m/s²)², can be worth naming:
/// simulated flats have up to three times the energy, waves less, and a tenth of what wheels differ by anyway is asked.
pub fn sizeable(scene: &Scene, energy: impl Fn(usize) -> f64) -> bool {
    let of_passage = |i: &usize| scene.residuals[*i].len() as f64 * energy(*i);
    scene.train.iter().map(of_passage).sum::<f64>() > LEAST_SHARE * scene.scatter()
}

/// Best score with its factor and share: of every [`COARSE`]th factor, and of those around the best one.
fn best(shown: &[OfBogie], factors: &[f64]) -> Option<(f64, f64, f64)> {
    let of_factor = |factor: f64| {
        let gains: Vec<[f64; 3]> = shown.iter().map(|s| s.gains(factor)).collect();
        let likely = |share: f64| gains.iter().map(|g| OfBogie::posterior(*g, share).1).sum::<f64>();
        let of_share = SHARES.map(|share| (likely(share), factor, share));
        of_share.into_iter().max_by(|a, b| a.0.total_cmp(&b.0))
    };
    let best_of = |indices: Vec<usize>| {
        let all = indices.into_par_iter().filter_map(|i| Some((i, of_factor(factors[i])?)));
        all.max_by(|a, b| a.1.0.total_cmp(&b.1.0))
    };
    let (index, _) = best_of((0..factors.len()).step_by(COARSE).collect())?;
    let around = index.saturating_sub(COARSE - 1)..factors.len().min(index + COARSE);
    best_of(around.collect()).map(|(_, top)| top)
}
