//! Two effects at once, where neither alone mends the model.
//!
//! Beside a strong effect another one looks like nothing: ballast that moves with the sleepers, on a panel with a dip in its stock rail,
//! leaves the model as lost as it was, and so does the dip without that ballast. Each is therefore looked for in the valleys where the
//! other one leads, however lost the model is there.

use rayon::prelude::*;

use super::effect::{Effect, Hints};
use super::fit::{Fit, FitOptions, Frame};
use super::select::{SCOUT, Tried, by_evidence, few_of, fit_in_place, from_far_starts, most_probable};

/// Valleys from which a second effect is looked for, one of every effect at most.
const VALLEYS: usize = 4;
/// Squared misfit per value, of the few passages that are scouted, below which no other pair is looked for: most that are there leave
/// 1 to 2 after the scouts' few steps.
const PROMISING: f64 = 3.0;

/// The pair of effects that misses the scouted passages by the least, and its fit to all of `subset`, if the model is not lost with it
/// any more. `lost` is the fit without them, `alone` what each of them does from there.
pub fn together<'e>(
    frame: &Frame,
    lost: &Fit,
    alone: &[Tried<'e>],
    hints: &Hints,
    subset: &[usize],
) -> Option<([&'e dyn Effect; 2], Fit)> {
    let few = few_of(subset);
    let mut best: Option<([&'e dyn Effect; 2], Fit)> = None;
    for (first, valley) in deepest(frame, lost, alone, subset) {
        let state = valley.state.on_the_scan();
        let others = alone.par_iter().map(|t| t.effect).filter(|e| e.name() != first.name());
        let scouted = others
            .filter_map(|e| {
                let pair = [first, e];
                Some((pair, most_probable(from_far_starts(frame, &state, &pair, hints, &few, SCOUT))?))
            })
            .max_by(|a, b| by_evidence(&a.1, &b.1));
        let found = best.into_iter().chain(scouted);
        best = found.min_by(|a, b| a.1.inflation().total_cmp(&b.1.inflation()));
        if best.as_ref().is_some_and(|(_, fit)| fit.inflation() < PROMISING) {
            break;
        }
    }
    let (pair, scouted) = best?;
    let fit = fit_in_place(frame, &pair, scouted.state, subset, FitOptions::THOROUGH)?;
    (!fit.lost()).then_some((pair, fit))
}

/// The deepest valleys of single effects, as far as they are deeper than where the model is lost, each fitted to all passages.
fn deepest<'e>(
    frame: &Frame,
    lost: &Fit,
    alone: &[Tried<'e>],
    subset: &[usize],
) -> Vec<(&'e dyn Effect, Fit)> {
    let mut valleys: Vec<_> = alone.iter().filter_map(|t| Some((t.effect, t.valley.as_ref()?))).collect();
    valleys.sort_by(|a, b| a.1.misfit.total_cmp(&b.1.misfit));
    valleys.truncate(VALLEYS);
    let mut fits: Vec<(&'e dyn Effect, Fit)> = valleys
        .into_par_iter()
        .filter_map(|(e, valley)| {
            let start = valley.state.clone();
            Some((e, fit_in_place(frame, &[e], start, subset, FitOptions::THOROUGH)?))
        })
        .filter(|(_, fit)| fit.inflation() < lost.inflation())
        .collect();
    fits.sort_by(|a, b| a.1.inflation().total_cmp(&b.1.inflation()));
    fits
}
