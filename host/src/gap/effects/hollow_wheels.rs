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
use crate::gap::included::Inclusion;
use crate::gap::latent::{Latent, LatentFit, Scene, borne_out};

/// See the module.
pub struct HollowWheels;

/// Least number of wheelsets that groups are looked for in.
const LEAST_WHEELSETS: usize = 24;

/// Least part of what simulated hollow wheels make bogies differ by that is found in the recordings: with less than half of it they differ
/// by more without these wheels than with them. 0.93 and more on seven sites with hollow wheels, 0.18 at most where clipping or a void
/// were what the linear response took for two groups.
const LEAST_BORNE_OUT: f64 = 0.5;

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

    /// Every wheel's force is estimated anyway.
    fn inclusion(&self) -> Inclusion {
        Inclusion::NEEDLESS
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
        if differences_borne_out(scene, &windows) < LEAST_BORNE_OUT {
            return None;
        }
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

/// How much of what hollow wheels make bogies of a train differ by is found in the recordings of the training passages: 1 where all is, half
/// where the bogies differ as much without it.
fn differences_borne_out(scene: &Scene, windows: &[Vec<Vec<f64>>]) -> f64 {
    let of = |i: &usize| {
        let differ = |list: &[Vec<f64>]| -> Vec<f64> {
            let of_sample = |k: usize| list.iter().map(|w| w[k]).sum::<f64>() / list.len() as f64;
            let mean: Vec<f64> = (0..list.first().map_or(0, Vec::len)).map(of_sample).collect();
            list.iter().flat_map(|w| w.iter().zip(&mean).map(|(w, m)| w - m)).collect()
        };
        (differ(&scene.residuals[*i]), differ(&windows[*i]))
    };
    let passages: Vec<(Vec<f64>, Vec<f64>)> = scene.train.iter().map(of).collect();
    borne_out(passages.iter().map(|(recorded, added)| (recorded, added)))
}
