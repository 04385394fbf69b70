//! Two effects at once, where neither alone mends the model.
//!
//! Beside a strong effect another one looks like nothing: ballast that moves with the sleepers, on a panel with a dip in its stock rail,
//! leaves the model as lost as it was, and so does the dip without that ballast. Each is therefore looked for in the valleys where the
//! other one leads, however lost the model is there. Where wheels jump off the dip neither leads anywhere: dips of all places are then
//! looked at beside everything else.

use rayon::prelude::*;

use super::effect::{Effect, Hints};
use super::fit::{Fit, FitOptions, Frame, State};
use super::prospect::promising_pairs;
use super::select::{SCOUT, Tried, by_evidence, few_of, fit_in_place, from_far_starts, most_probable};

/// Valleys from which a second effect is looked for, one of every effect at most.
const VALLEYS: usize = 4;
/// Squared misfit per value, of the few passages that are scouted, below which no other pair is looked for: most that are there leave
/// 1 to 2 after the scouts' few steps.
const PROMISING: f64 = 3.0;
/// Most fits that begin again. Beside 777 kg/m of ballast a dip of 2.9 mm left 4.5 times the expected misfit, 1.5 the second time.
const FREED: usize = 3;

/// Two effects and a fit with them.
type Found<'e> = ([&'e dyn Effect; 2], Fit);

/// The pair of effects that misses the scouted passages by the least, and its fit to all of `subset`, if the model is not lost with it
/// any more. `lost` is the fit without them, `alone` what each of them does from there.
pub fn together<'e>(
    frame: &Frame,
    lost: &Fit,
    alone: &[Tried<'e>],
    hints: &Hints,
    subset: &[usize],
) -> Option<Found<'e>> {
    let few = few_of(subset);
    let effects: Vec<&'e dyn Effect> = alone.iter().map(|t| t.effect).collect();
    let from_valleys = deepest(frame, lost, alone, subset)
        .into_iter()
        .map(|(first, valley)| beside(frame, (first, &valley.state.on_the_scan()), &effects, hints, &few));
    let nominal = lost.state.on_nominal_ballast();
    let from_starts = std::iter::once_with(|| at_once(frame, &nominal, &effects, hints, &few));
    let mut best: Option<Found<'e>> = None;
    for scouted in from_valleys.chain(from_starts) {
        best = best.into_iter().chain(scouted).min_by(by_misfit);
        if best.as_ref().is_some_and(|(_, fit)| fit.inflation() < PROMISING) {
            break;
        }
    }
    let (pair, scouted) = best?;
    let fit = freed(frame, &pair, scouted.state, subset)?;
    (!fit.lost()).then_some((pair, fit))
}

/// A fit, begun again on the scan and on nominal ballast as long as that helps: on the way path and ballast take over what the pair does
/// in the end.
fn freed(frame: &Frame, pair: &[&dyn Effect], start: State, subset: &[usize]) -> Option<Fit> {
    let fitted = |start: State| fit_in_place(frame, pair, start, subset, FitOptions::THOROUGH);
    let on_the_scan = start.on_the_scan();
    let mut best = fitted(start)?;
    if best.lost() {
        best = [Some(best), fitted(on_the_scan)].into_iter().flatten().max_by(by_evidence)?;
    }
    for _ in 0..FREED {
        if !best.lost() && best.state.common(frame) {
            break;
        }
        match fitted(best.state.on_nominal_ballast()) {
            Some(again) if again.log_posterior > best.log_posterior => best = again,
            _ => break,
        }
    }
    Some(best)
}

fn by_misfit(a: &Found, b: &Found) -> std::cmp::Ordering {
    a.1.inflation().total_cmp(&b.1.inflation())
}

fn by_probability(a: &Found, b: &Found) -> std::cmp::Ordering {
    by_evidence(&a.1, &b.1)
}

/// A second effect, scouted from the valley of a first one.
fn beside<'e>(
    frame: &Frame,
    (first, valley): (&'e dyn Effect, &State),
    effects: &[&'e dyn Effect],
    hints: &Hints,
    few: &[usize],
) -> Option<Found<'e>> {
    effects
        .par_iter()
        .filter(|e| e.name() != first.name())
        .filter_map(|e| {
            let pair = [first, *e];
            Some((pair, most_probable(from_far_starts(frame, valley, &pair, hints, few, SCOUT))?))
        })
        .max_by(by_probability)
}

/// Both scouted from where both start, where that agrees best as it is.
fn at_once<'e>(
    frame: &Frame,
    state: &State,
    effects: &[&'e dyn Effect],
    hints: &Hints,
    few: &[usize],
) -> Option<Found<'e>> {
    // One passage tells the best of thousands.
    let one: Vec<usize> = few.get(few.len() / 2).copied().into_iter().collect();
    promising_pairs(frame, state, effects, hints, (&one, SCOUT.detail))
        .into_par_iter()
        .filter_map(|(pair, starts)| {
            Some((pair, fit_in_place(frame, &pair, state.with(starts), few, SCOUT)?))
        })
        .max_by(by_probability)
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
