//! Wheel flats: a chord ground into the tread by a locked wheel, depth ℓ²/(8R) (domain: fresh flat, rounded by rolling).
//!
//! The wheel drops into it once per turn, anywhere along the track, so the burst is tied neither to the nose nor to other
//! wheels: that tells it from everything that belongs to the panel, and its shortness from a wave around the wheel. Both
//! wheels of a wheelset lock together. A flat is shorter than the waves in the band, so at first only its area ℓ³/(16R) is looked
//! for, by the linear response; a wheel does not follow a long one, so what that finds is told by simulated flats, and its
//! length with it. Lengths from 20 mm (nothing shows below) to 100 mm (out of service at 60 mm in most rule books).

mod bursts;
mod shown;

use std::sync::Arc;

use rayon::prelude::*;

use self::bursts::{Bursts, LENGTHS_M, factors_of_lengths, length_of};
use self::shown::{OfBogie, Seen, Shown, seen};
use crate::gap::effect::{Advice, Stage};
use crate::gap::latent::{Latent, LatentFit, SHARES, Scene};
use crate::gap::variation::Variation;

/// See the module.
pub struct WheelFlat;

/// Parts of what wheels differ by in their own path that are left once flats are known.
const OWN_PARTS: [f64; 3] = [1.0, 0.5, 0.25];
/// Simulations, each of flats as long as the last ones say.
const ROUNDS: usize = 2;
/// Largest part of the flats that meet the rail inside the crossing, half of a wheel's turn: what wheels of a model that lacks pads and
/// ballast mass differ by there passed for flats of 15 mm.
const MOST_INSIDE: f64 = 0.75;
/// Cost of choosing area and share, nats.
const CHOICE: f64 = 6.0;
/// What is not in the model with the flats, and their shape, let the length not be known better than this, relative: simulated ones came
/// out 3 % short to 5 % long on four sites of trials, and 21 % short beside a mount.
const LENGTH_ERROR: f64 = 0.18;

impl Latent for WheelFlat {
    fn name(&self) -> &'static str {
        "wheel-flat"
    }

    fn stage(&self) -> Stage {
        Stage::Vehicle
    }

    fn advice(&self) -> Advice {
        Advice {
            what: "some wheels have flats",
            action: "Nothing to repair on the panel. Tell the vehicles' owner: have these wheels inspected and turned.",
        }
    }

    fn explore(&self, scene: &Scene) -> Option<LatentFit> {
        let found = Found::of(scene, Arc::new(Bursts::linear(scene)), 1.0)?;
        let broad = Found::of(scene, Arc::new(Bursts::broad(scene)), 1.0);
        let broad = broad.map_or(0.0, |b| b.score.max(0.0));
        if found.score - broad - CHOICE <= 0.0 {
            return None;
        }
        let found = found.simulated(scene)?;
        let net = found.score - broad - CHOICE;
        let curve = factors_of_lengths(scene, &found.bursts)?;
        let at = |factor: f64| length_of(&curve, factor);
        if at(found.factor) < LENGTHS_M[0] || found.inside_crossing(scene) > MOST_INSIDE {
            return None;
        }
        let (lower, upper) = found.interval();
        let windows: Vec<Vec<Vec<f64>>> =
            (0..scene.observed.len()).into_par_iter().map(|i| found.windows(i)).collect();
        let (windows, traces) = scene.around_wheels(windows);
        let (length_m, share) = (at(found.factor), found.share);
        Some(LatentFit {
            apart: false,
            gain: net,
            parameters: vec![
                (
                    "length_m",
                    length_m,
                    at(lower).min((1.0 - LENGTH_ERROR) * length_m),
                    at(upper).max((1.0 + LENGTH_ERROR) * length_m),
                ),
                ("share", share, share * 0.7, (share * 1.3).min(1.0)),
            ],
            decay_s: None,
            wheel_share: Some(share),
            windows,
            traces,
        })
    }
}

/// Flats that explain the most.
struct Found {
    bursts: Arc<Bursts>,
    seen: Vec<Seen>,
    /// Of the training passages.
    shown: Vec<OfBogie>,
    /// Log likelihood ratio to wheels that differ by as much as they seem to.
    score: f64,
    factor: f64,
    share: f64,
}

impl Found {
    /// Where wheels differ in their own path by `part` of what they seem to.
    fn of(scene: &Scene, bursts: Arc<Bursts>, part: f64) -> Option<Self> {
        let v = &scene.variation;
        let seen = seen(scene, &Variation { own_m: part * v.own_m, own_stock_m: part * v.own_stock_m, ..*v });
        let mute = bursts.mute(scene);
        let of_train = |i: &usize| seen[*i].shown(&bursts.windows[*i], &mute);
        let shown: Vec<Vec<OfBogie>> = scene.train.par_iter().map(of_train).collect();
        let shown: Vec<OfBogie> = shown.into_iter().flatten().collect();
        let (score, factor, share) = best(&shown, &bursts.factors())?;
        Some(Self { bursts, seen, shown, score, factor, share })
    }

    /// By simulated flats, as long as these seem to be, where those explain more. Over beds that open they would be as dear as a
    /// diagnosis.
    fn simulated(mut self, scene: &Scene) -> Option<Self> {
        if !scene.world.bed.is_linear() {
            return Some(self);
        }
        let of_train = |seen: &[Seen]| scene.train.iter().map(|i| seen[*i].log_likelihood()).sum::<f64>();
        let plain = of_train(&self.seen);
        for _ in 0..ROUNDS {
            let length_m = length_of(&factors_of_lengths(scene, &self.bursts)?, self.factor);
            let length_m = length_m.clamp(LENGTHS_M[0], LENGTHS_M[LENGTHS_M.len() - 1]);
            let bursts = Arc::new(Bursts::simulated(scene, length_m)?);
            let found = OWN_PARTS.iter().filter_map(|part| {
                let found = Self::of(scene, Arc::clone(&bursts), *part)?;
                let score = found.score + of_train(&found.seen) - plain;
                Some(Self { score, ..found })
            });
            match found.max_by(|a, b| a.score.total_cmp(&b.score)).filter(|best| best.score > self.score) {
                Some(better) => self = better,
                None => break,
            }
        }
        Arc::make_mut(&mut self.bursts).complete(scene)?;
        Some(self)
    }

    /// Part of the simulated flats that meet the rail inside the crossing.
    fn inside_crossing(&self, scene: &Scene) -> f64 {
        let inside = self.bursts.inside_crossing(scene);
        let mut found = [0.0, 0.0];
        for bogie in &self.shown {
            self.parts(bogie, |_, place, part| found[usize::from(inside[place])] += part);
        }
        found[1] / (found[0] + found[1]).max(f64::MIN_POSITIVE)
    }

    /// Calls with axle, place and probability of every flat of a bogie.
    fn parts(&self, bogie: &OfBogie, mut flat: impl FnMut(usize, usize, f64)) {
        let mut of = |axle: usize, shown: &Shown, probability: f64| {
            let places = shown.places(self.factor).into_iter().enumerate();
            places.for_each(|(place, weight)| flat(axle, place, probability * weight));
        };
        let ([_, front, rear, both], _) = OfBogie::posterior(bogie.gains(self.factor), self.share);
        let (first, second) = bogie.one_after_another(self.factor);
        let alone = [front, rear];
        of(first, &bogie.axles[first], alone[first] + both);
        of(1 - first, &bogie.axles[1 - first], alone[1 - first]);
        of(1 - first, &second, both);
    }

    /// Posterior mean of what flats add to the windows of a passage.
    fn windows(&self, passage: usize) -> Vec<Vec<f64>> {
        let bursts = &self.bursts.windows[passage];
        let nowhere = vec![false; bursts[0].len()];
        let shown = self.seen[passage].shown(bursts, &nowhere);
        shown.iter().map(|bogie| self.window(bogie, bursts)).collect()
    }

    fn window(&self, bogie: &OfBogie, bursts: &[Vec<Vec<f64>>; 2]) -> Vec<f64> {
        let mut out = vec![0.0; bursts[0][0].len()];
        self.parts(bogie, |axle, place, part| {
            let burst = &bursts[axle][place];
            out.iter_mut().zip(burst).for_each(|(o, b)| *o += part * self.factor * b);
        });
        out
    }

    /// Factors within a 90 % interval of the likelihood.
    fn interval(&self) -> (f64, f64) {
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

/// Best score with its factor and share.
fn best(shown: &[OfBogie], factors: &[f64]) -> Option<(f64, f64, f64)> {
    let of_factor = |factor: &f64| {
        let gains: Vec<[f64; 3]> = shown.iter().map(|s| s.gains(*factor)).collect();
        let likely = |share: f64| gains.iter().map(|g| OfBogie::posterior(*g, share).1).sum::<f64>();
        let of_share = SHARES.map(|share| (likely(share), *factor, share));
        of_share.into_iter().max_by(|a, b| a.0.total_cmp(&b.0))
    };
    factors.par_iter().filter_map(of_factor).max_by(|a, b| a.0.total_cmp(&b.0))
}
