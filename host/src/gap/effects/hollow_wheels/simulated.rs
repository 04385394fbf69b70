//! Hollow wheels as simulations show them.

use std::sync::{Mutex, PoisonError};

use faer::Mat;
use faer::linalg::solvers::Llt;
use rayon::prelude::*;

use super::Hollow;
use super::bogies::{CASES, Case, Weighed};
use crate::gap::departures::Plain;
use crate::gap::fit::whitened;
use crate::gap::forward::{Detail, Simulator};
use crate::gap::latent::Scene;
use crate::gap::variation::Variation;
use crate::identify::spread_out;
use crate::passage::surface::GRID_M;

/// What wheels differ by that are not hollow. What a model without hollow ones takes it for is inflated by them.
const NATURAL: Variation = Variation {
    noise_m_s2: 0.08,
    load: 0.01,
    side_load: 0.005,
    depth: 0.06,
    shift_m: 0.012,
    own_m: 15e-6,
    own_stock_m: 15e-6,
};
/// What hollow wheels differ by from one another, standard deviations: depth, relative, and shift, metres.
const OWN: (f64, f64) = (0.07, 0.012);
/// Steps of its derivatives: depth factor and metres.
const OWN_STEPS: (f64, f64) = (0.15, 0.01);
/// Depth factors and shifts (metres) looked at first.
const DEPTHS: [f64; 7] = [0.4, 1.4, 1.8, 2.2, 2.6, 3.0, 3.5];
const SHIFTS_M: [f64; 9] = [-0.08, -0.06, -0.04, -0.02, 0.0, 0.02, 0.04, 0.06, 0.08];
/// On so many passages.
const FEW: usize = 6;
/// Steps from the best of them, on all training passages: depth factor and metres.
const STEPS: [(f64, f64); 3] = [(0.2, 0.01), (0.1, 0.005), (0.05, 0.0025)];
/// Steps from there to the mean of wheels that differ from one another.
const REFINED: usize = 3;
/// Most steps of one size.
const MOST_STEPS: usize = 4;
/// Ranges of depth factor, shift (metres) and share.
const DEPTH_RANGE: [f64; 2] = [0.1, 5.0];
const SHIFT_RANGE_M: [f64; 2] = [-0.14, 0.14];
const SHARE_RANGE: [f64; 2] = [0.02, 0.9];

/// Hollow wheels that explain the windows of the training passages best, where `share` of the wheelsets seem to be hollow, and what they add to every window: passage, bogie.
pub(super) fn simulated(scene: &Scene, share: f64) -> Option<(Hollow, Vec<Vec<Vec<f64>>>)> {
    let views = (0..scene.observed.len()).into_par_iter().map(|i| View::of(scene, i));
    let views = views.collect::<Option<Vec<View>>>()?;
    let train: Vec<&View> = scene.train.iter().map(|i| &views[*i]).collect();
    let mut hollow = likeliest(&train, share)?;
    for _ in 0..REFINED {
        hollow = refined(&train, hollow)?;
    }
    if hollow.at_an_end() {
        return None;
    }
    let windows = views.par_iter().map(|view| view.windows(hollow)).collect::<Option<_>>()?;
    Some((hollow, windows))
}

/// The mean of hollow wheels that differ from one another, from what they are thought to be.
fn refined(views: &[&View], hollow: Hollow) -> Option<Hollow> {
    let found = views.par_iter().map(|view| view.of_their_own(hollow)).collect::<Option<Vec<Weighed>>>()?;
    let sum = |of: fn(&Weighed) -> f64| found.iter().map(of).sum::<f64>();
    let count = sum(|w| w.hollow).max(1.0);
    let moved = hollow
        .moved(OWN.0 * hollow.depth_factor * sum(|w| w.own[0]) / count, OWN.1 * sum(|w| w.own[1]) / count);
    Some(Hollow { share: share_of(&found), ..moved }.within())
}

/// Share of the wheelsets that are hollow.
fn share_of(found: &[Weighed]) -> f64 {
    let wheelsets: usize = found.iter().map(|w| 2 * w.added.len()).sum();
    found.iter().map(|w| w.hollow).sum::<f64>() / wheelsets.max(1) as f64
}

fn likeliest(train: &[&View], share: f64) -> Option<Hollow> {
    let few = spread_out(train, FEW);
    let of_depth =
        |depth_factor: f64| SHIFTS_M.map(|shift_m| Hollow { depth_factor, shift_m, share }.within());
    let starts: Vec<Hollow> = DEPTHS.into_iter().flat_map(of_depth).collect();
    let found: Vec<Likely> = starts.into_par_iter().filter_map(|h| Likely::on(&few, h)).collect();
    let start = found.into_iter().max_by(|a, b| a.log_likelihood.total_cmp(&b.log_likelihood))?;
    let mut best = Likely::on(train, start.with_its_share())?;
    for (depth, shift_m) in STEPS {
        for _ in 0..MOST_STEPS {
            let before = best.log_likelihood;
            for (depth, shift_m) in [(depth, 0.0), (-depth, 0.0), (0.0, shift_m), (0.0, -shift_m)] {
                let beside = best.with_its_share().moved(depth, shift_m);
                best = Likely::on(train, beside)
                    .filter(|l| l.log_likelihood > best.log_likelihood)
                    .unwrap_or(best);
            }
            if best.log_likelihood <= before {
                break;
            }
        }
    }
    Some(best.with_its_share())
}

impl Hollow {
    fn within(self) -> Self {
        Self {
            depth_factor: self.depth_factor.clamp(DEPTH_RANGE[0], DEPTH_RANGE[1]),
            shift_m: self.shift_m.clamp(SHIFT_RANGE_M[0], SHIFT_RANGE_M[1]),
            share: self.share.clamp(SHARE_RANGE[0], SHARE_RANGE[1]),
        }
    }

    /// Whether depth or shift are at an end of their range: no wheel's, but of a fit that found no other way (a shift of 0.14 m on one wheelset
    /// of twenty-two, beside waves of wheels that leave the rail).
    fn at_an_end(&self) -> bool {
        let at = |value: f64, range: [f64; 2]| value <= range[0] || value >= range[1];
        at(self.depth_factor, DEPTH_RANGE) || at(self.shift_m, SHIFT_RANGE_M)
    }

    fn moved(self, depth: f64, shift_m: f64) -> Self {
        Self { depth_factor: self.depth_factor + depth, shift_m: self.shift_m + shift_m, ..self }.within()
    }
}

/// How likely hollow wheels are.
#[derive(Clone, Copy)]
struct Likely {
    hollow: Hollow,
    log_likelihood: f64,
    /// Share of the wheelsets that they are found on.
    share: f64,
}

impl Likely {
    fn on(views: &[&View], hollow: Hollow) -> Option<Self> {
        let found = views.par_iter().map(|view| view.weighed(hollow)).collect::<Option<Vec<Weighed>>>()?;
        let log_likelihood = found.iter().map(|w| w.log_likelihood).sum();
        Some(Self { hollow, log_likelihood, share: share_of(&found) })
    }

    fn with_its_share(self) -> Hollow {
        Hollow { share: self.share, ..self.hollow }.within()
    }
}

/// What hollow wheels add to a window in all cases but the first, whitened.
type Added = [Vec<f64>; CASES - 1];

/// A passage as it looks if wheels differ naturally.
struct View<'a> {
    plain: Plain<'a>,
    /// Travel of the front axle at which the front wheelset, and the rear one, meets a path that hollow wheels may have otherwise, metres.
    meets_m: [f64; 2],
    factor: Llt<f64>,
    /// Whitened, one per bogie.
    windows: Vec<Vec<f64>>,
    /// By depth factor and shift: searches come back to where they have been.
    simulated: Mutex<Vec<([f64; 2], Added)>>,
}

impl<'a> View<'a> {
    fn of(scene: &Scene<'a>, passage: usize) -> Option<Self> {
        let (observed, spacing_m) = (&scene.observed[passage], scene.world.crossing.vehicle.axle_spacing_m);
        let first_m = SHIFT_RANGE_M[0] - OWN_STEPS.1 - scene.world.path.half_m - GRID_M;
        let meets_m = [first_m, first_m + spacing_m];
        let plain = Plain::of(observed, scene.world, Detail::Full, meets_m.to_vec()).ok()?;
        let factor = scene.shapes[passage].factor(&NATURAL)?;
        let windows = columns(&white(&factor, &scene.residuals[passage]));
        Some(Self { plain, meets_m, factor, windows, simulated: Mutex::default() })
    }

    /// What the paths of hollow wheelsets add to a window, the first of which is the front (0) or the rear (1) one.
    fn added(&self, hollow: &Simulator, first: usize) -> Option<Vec<f64>> {
        Some(self.plain.in_window(&self.plain.departure(hollow, self.meets_m[first]).ok()?, 0.0))
    }

    /// The front wheelset hollow, the rear one, both.
    fn simulated(&self, h: Hollow) -> Option<Added> {
        let known = || self.simulated.lock().unwrap_or_else(PoisonError::into_inner);
        let place = [h.depth_factor, h.shift_m];
        if let Some((_, added)) = known().iter().find(|(of, _)| *of == place) {
            return Some(added.clone());
        }
        let of = |s: &Simulator, axle: usize| s.with_own_path(axle, h.depth_factor, h.shift_m);
        let front = of(self.plain.simulator(), 0);
        let rear = of(self.plain.simulator(), 1);
        let added = [self.added(&front, 0)?, self.added(&rear, 1)?, self.added(&of(&front, 1), 0)?];
        let added: Added = columns(&white(&self.factor, &added)).try_into().ok()?;
        known().push((place, added.clone()));
        Some(added)
    }

    /// Hollow wheels that are all alike.
    fn weighed(&self, h: Hollow) -> Option<Weighed> {
        let alike = [const { [].as_slice() }; CASES];
        Some(Weighed::of(
            &self.windows,
            &self.cases(h, &Mat::zeros(self.factor.L().nrows(), 0), alike)?,
            h.share,
        ))
    }

    /// Cases with columns of `own`, by their indices.
    fn cases(&self, h: Hollow, own: &Mat<f64>, of_case: [&[usize]; CASES]) -> Option<[Case; CASES]> {
        let mut added = vec![vec![0.0; own.nrows()]];
        added.extend(self.simulated(h)?);
        let list = added.into_iter().zip(of_case).map(|(added, indices)| {
            Case::new(added, Mat::from_fn(own.nrows(), indices.len(), |k, c| own[(k, indices[c])]))
        });
        list.collect::<Vec<_>>().try_into().ok()
    }

    /// Hollow wheels that differ from one another as natural ones do.
    fn of_their_own(&self, h: Hollow) -> Option<Weighed> {
        let own = white(&self.factor, &self.own(h)?);
        let cases = self.cases(h, &own, [&[], &[0, 1], &[2, 3], &[0, 1, 2, 3]])?;
        Some(self.weighed(h)?.again(&self.windows, &cases, h.share))
    }

    /// What they add to the window of every bogie.
    fn windows(&self, h: Hollow) -> Option<Vec<Vec<f64>>> {
        let added = self.of_their_own(h)?.added;
        let added = Mat::from_fn(self.factor.L().nrows(), added.len(), |k, b| added[b][k]);
        Some(columns(&(self.factor.L() * added)))
    }

    /// What a window changes by for a standard deviation of depth and shift of the front, then of the rear hollow wheelset.
    fn own(&self, h: Hollow) -> Option<[Vec<f64>; 4]> {
        let of = |axle: usize, (depth, shift_m): (f64, f64), sd: f64| {
            let beside = |sign: f64| {
                let (depth_factor, shift_m) = (h.depth_factor + sign * depth, h.shift_m + sign * shift_m);
                self.added(&self.plain.simulator().with_own_path(axle, depth_factor, shift_m), axle)
            };
            let size = sd / (2.0 * (depth + shift_m));
            Some(beside(1.0)?.iter().zip(beside(-1.0)?).map(|(a, b)| size * (a - b)).collect())
        };
        let depth = |axle: usize| of(axle, (OWN_STEPS.0, 0.0), OWN.0 * h.depth_factor);
        let shift = |axle: usize| of(axle, (0.0, OWN_STEPS.1), OWN.1);
        Some([depth(0)?, shift(0)?, depth(1)?, shift(1)?])
    }
}

fn white(factor: &Llt<f64>, windows: &[Vec<f64>]) -> Mat<f64> {
    let n = windows.first().map_or(0, Vec::len);
    whitened(factor, &Mat::from_fn(n, windows.len(), |k, c| windows[c][k]))
}

fn columns(of: &Mat<f64>) -> Vec<Vec<f64>> {
    (0..of.ncols()).map(|c| of.col_as_slice(c).to_vec()).collect()
}
