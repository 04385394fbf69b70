//! Hollow-worn wheels: some wheels take a deeper (or shallower) path through the transition, and another place for it.
//!
//! A hollow tread is carried over by the wing rail for longer and drops farther (paper, section 3.2: two of its seventeen
//! scanned profiles are outliers). Every wheel has a depth and a shift of its own; natural ones scatter about one mean, hollow
//! ones form a group beside it. So the depth and shift that each wheelset shows, by the linear response, are compared with one
//! Gaussian, with two Gaussians of the same mean, and with two groups. A wheel that leaves the rail, or meets the transition some
//! centimetres elsewhere, is not linear in either: what the second group is, and what it adds to the recordings, is told by simulated
//! wheels.

mod bogies;
mod groups;
mod own;
mod simulated;

use rayon::prelude::*;

use self::groups::grouped;
use self::own::{Own, own};
use self::simulated::simulated;
use crate::gap::effect::{Advice, Stage};
use crate::gap::latent::{Latent, LatentFit, Scene};

/// See the module.
pub struct HollowWheels;

/// Least number of wheelsets that groups are looked for in.
const LEAST_WHEELSETS: usize = 24;

/// What hollow wheels have in common.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Hollow {
    /// Depth of their path, relative to that of the others.
    depth_factor: f64,
    /// How much later in x they meet it, metres.
    shift_m: f64,
    /// Share of the wheelsets that are hollow.
    share: f64,
}

impl Latent for HollowWheels {
    fn name(&self) -> &'static str {
        "hollow-wheels"
    }

    fn stage(&self) -> Stage {
        Stage::Vehicle
    }

    fn advice(&self) -> Advice {
        Advice {
            what: "some wheels are worn hollow",
            action: "Nothing to repair on the panel. Tell the vehicles' owner: have the treads of these trains measured.",
        }
    }

    fn alike(&self) -> bool {
        true
    }

    fn explore(&self, scene: &Scene) -> Option<LatentFit> {
        let learnt: Vec<Own> = scene.train.par_iter().flat_map_iter(|i| own(scene, *i)).collect();
        if learnt.len() < LEAST_WHEELSETS {
            return None;
        }
        let (gain, two) = grouped(&learnt)?;
        let (hollow, windows) = simulated(scene, two.share)?;
        Some(LatentFit {
            apart: false,
            gain,
            parameters: two.parameters(learnt.len(), hollow),
            decay_s: None,
            wheel_share: Some(hollow.share),
            traces: scene.spread(&windows),
            windows,
        })
    }
}
