//! Wheel flats: a chord ground into the tread by a locked wheel, depth ℓ²/(8R) (domain: fresh flat, rounded by rolling).
//!
//! The wheel drops into it once per turn, anywhere along the track, so the burst is tied neither to the nose nor to other
//! wheels: that tells it from everything that belongs to the panel, and its shortness from a wave around the wheel. Both
//! wheels of a wheelset lock together. A flat is shorter than the waves in the band, so at first only its area ℓ³/(16R) is looked
//! for, by the linear response; a wheel does not follow a long one, so what that finds is told by simulated flats, and its
//! length with it. Lengths from 20 mm (nothing shows below) to 100 mm (out of service at 60 mm in most rule books).

mod bursts;

use std::sync::Arc;

use self::bursts::{Bursts, LENGTHS_M, factors_of_lengths, length_of};
use super::around_wheels::{Found, sizeable};
use crate::gap::effect::{Advice, Stage};
use crate::gap::included::Inclusion;
use crate::gap::latent::{Latent, LatentFit, Scene};

/// See the module.
pub struct WheelFlat;

/// Simulations, each of flats as long as the last ones say.
const ROUNDS: usize = 2;
/// Largest part of the flats that meet the rail inside the crossing, half of a wheel's turn: what wheels of a model that lacks pads and
/// ballast mass differ by there passed for flats of 15 mm.
const MOST_INSIDE: f64 = 0.75;
/// Cost of choosing area and share, nats.
const CHOICE: f64 = 6.0;
/// What is not in the model with the flats, and their shape, let the length not be known better than this, relative: simulated ones came
/// out 3 % short to 5 % long on seven sites of trials, and 23 % short beside a mount.
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

    /// Every wheel's force is estimated anyway.
    fn inclusion(&self) -> Inclusion {
        Inclusion::NEEDLESS
    }

    fn explore(&self, scene: &Scene) -> Option<LatentFit> {
        let found = Flats::linear(scene)?;
        let broad = Found::of(scene, Bursts::broad(scene).around);
        let besides = broad.map_or(0.0, |b| b.score.max(0.0)) + CHOICE;
        if found.found.score <= besides || !sizeable(scene, |passage| found.found.energy(passage)) {
            return None;
        }
        let Flats { bursts, found } = found.simulated(scene)?;
        let curve = factors_of_lengths(scene, &bursts)?;
        let at = |factor: f64| length_of(&curve, factor);
        if at(found.factor) < LENGTHS_M[0] || found.part_at(&bursts.inside_crossing(scene)) > MOST_INSIDE {
            return None;
        }
        let (lower, upper) = found.interval();
        let (windows, traces) = scene.around_wheels(found.windows());
        let (length_m, share) = (at(found.factor), found.share);
        Some(LatentFit {
            apart: false,
            gain: found.score - besides,
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
struct Flats {
    bursts: Bursts,
    found: Found,
}

impl Flats {
    fn linear(scene: &Scene) -> Option<Self> {
        let bursts = Bursts::linear(scene);
        let found = Found::of(scene, Arc::clone(&bursts.around))?;
        Some(Self { bursts, found })
    }

    /// By simulated flats, as long as these seem to be, where those explain more. Over beds that open they would be as dear as a
    /// diagnosis.
    fn simulated(mut self, scene: &Scene) -> Option<Self> {
        if !scene.world.bed.is_linear() {
            return Some(self);
        }
        for _ in 0..ROUNDS {
            let length_m = length_of(&factors_of_lengths(scene, &self.bursts)?, self.found.factor);
            let length_m = length_m.clamp(LENGTHS_M[0], LENGTHS_M[LENGTHS_M.len() - 1]);
            let bursts = Bursts::simulated(scene, length_m)?;
            match Found::described(scene, &bursts.around).filter(|found| found.score > self.found.score) {
                Some(found) => self = Self { bursts, found },
                None => break,
            }
        }
        self.found.around = self.bursts.completed(scene)?;
        Some(self)
    }
}
