//! Which effects: linear screening of the whole catalogue, joint re-fit of those that pass, forward selection.

use super::GapError;
use super::effect::{Effect, Hints};
use super::fit::{Fit, FitOptions, Frame, Screening, State, fit, replaced, screen};
use super::forward::Detail;
use super::prospect::promising;
use crate::identify::spread_out;
use crate::progress::{Progress, Silent};
use faer::Mat;
use faer::linalg::solvers::Solve as _;
use rayon::prelude::*;

/// One effect tried on top of the accepted ones.
pub struct Tried<'e> {
    /// The effect.
    pub effect: &'e dyn Effect,
    /// Expected gain in log evidence by the linear screening.
    pub screened: f64,
    /// Fit, where the screening was passed.
    pub fit: Option<Fit>,
    /// Where it leads alone, where all were scouted.
    pub valley: Option<Valley>,
}

/// Deepest of the valleys in which an effect has stayed that was scouted from all its starts.
pub struct Valley {
    /// Its bottom, by the few passages that are scouted.
    pub state: State,
    /// Squared misfit per value there.
    pub misfit: f64,
}

/// Candidates that are fitted at most in the first round, and in later ones.
const FITTED: (usize, usize) = (5, 2);
/// The same where all have been scouted.
const FITTED_FROM_AFAR: usize = 3;
/// Log evidence per independent look, of the few passages that are scouted, by which a candidate is beyond doubt worse than the
/// best.
const BEYOND_DOUBT: f64 = 150.0;
/// Part of the way from nought to its start that is left of an effect which stays in a valley of its own.
const STAYED: f64 = 0.5;
/// Least expected gain for a fit; an effect that is worth naming gains several times as much.
const LEAST_GAIN: f64 = 4.0;
/// A candidate is not fitted when its expected gain is below this part of the largest.
const LEAST_SHARE: f64 = 0.15;

/// What a round starts from.
#[derive(Clone, Copy)]
pub struct Standing<'a, 'e> {
    /// Effects in the model already.
    pub accepted: &'a [&'e dyn Effect],
    /// Fit with them.
    pub state: &'a State,
    /// State from which every candidate is scouted, where the model is so far off that its derivatives say little of what
    /// would mend it.
    pub from_afar: Option<&'a State>,
    /// State from which every candidate is scouted as well, where the model agrees with the recordings only as no track is.
    pub afresh: Option<&'a State>,
}

/// Screens and fits candidates on top of what is accepted.
pub fn round<'e>(
    frame: &Frame,
    standing: Standing<'_, 'e>,
    candidates: &[&'e dyn Effect],
    (hints, subset): (&Hints, &[usize]),
    progress: &dyn Progress,
) -> Result<(Vec<Tried<'e>>, Screening), GapError> {
    let Standing { accepted, state, from_afar, afresh } = standing;
    let screening = screen(frame, (accepted, state), candidates, hints, subset)?;
    let mut order: Vec<(usize, f64, usize)> = (0..candidates.len())
        .map(|e| {
            let (gain, start) = best_start(&screening, e, candidates[e]);
            (e, gain, start)
        })
        .collect();
    order.sort_by(|a, b| b.1.total_cmp(&a.1));
    let with =
        |e: usize| -> Vec<&'e dyn Effect> { accepted.iter().copied().chain([candidates[e]]).collect() };
    let (mut fits, valleys) = if let Some(afar) = from_afar {
        fits_from_afar(frame, afar, (&order, &with), (hints, subset), progress)
    } else {
        let largest = order.first().map_or(0.0, |o| o.1);
        let most = if accepted.is_empty() { FITTED.0 } else { FITTED.1 };
        let fits = order
            .iter()
            .enumerate()
            .map(|(rank, (e, gain, start))| {
                let passes = rank < most && *gain > LEAST_GAIN && *gain > LEAST_SHARE * largest;
                let starts = candidates[*e].starts(hints);
                let fit =
                    passes.then(|| candidate(frame, &with(*e), state, &starts, *start, subset)).flatten();
                progress.step();
                fit
            })
            .collect();
        (fits, order.iter().map(|_| None).collect())
    };
    if let Some(afresh) = afresh {
        let (again, _) = fits_from_afar(frame, afresh, (&order, &with), (hints, subset), &Silent);
        prefer_what_mends(&mut fits, again, frame);
    }
    let tried = order
        .into_iter()
        .zip(fits.into_iter().zip(valleys))
        .map(|((e, screened, _), (fit, valley))| Tried { effect: candidates[e], screened, fit, valley })
        .collect();
    Ok((tried, screening))
}

/// Takes over the fits `afresh` of effects that make a track as most are, and fit better. Others do not count: from nominal ballast,
/// weak ballast mass passed for soft pads and a dip in the stock rail, on a bed as odd as before.
fn prefer_what_mends(fits: &mut [Option<Fit>], afresh: Vec<Option<Fit>>, frame: &Frame) {
    for (old, new) in fits.iter_mut().zip(afresh) {
        let better = |new: &Fit| old.as_ref().is_none_or(|old| new.log_evidence > old.log_evidence);
        if let Some(new) = new.filter(|new| new.state.common(frame) && better(new)) {
            *old = Some(new);
        }
    }
}

/// Fits in the order of `order`: every candidate is scouted from all its starts, and the most promising are fitted; the best of
/// them, where it is lost, from all its starts. With them the valleys that were seen.
fn fits_from_afar<'e>(
    frame: &Frame,
    state: &State,
    (order, with): (&[(usize, f64, usize)], &(dyn Fn(usize) -> Vec<&'e dyn Effect> + Sync)),
    (hints, subset): (&Hints, &[usize]),
    progress: &dyn Progress,
) -> (Vec<Option<Fit>>, Vec<Option<Valley>>) {
    let few = few_of(subset);
    let (scouted, valleys): (Vec<Option<Fit>>, Vec<Option<Valley>>) = order
        .par_iter()
        .map(|(e, ..)| {
            let list = with(*e);
            let found = from_far_starts(frame, state, &list, hints, &few, SCOUT);
            let valley = valley(&list, &found);
            progress.step();
            (most_probable(found), valley)
        })
        .unzip();
    let mut best: Vec<usize> = (0..order.len()).filter(|k| scouted[*k].is_some()).collect();
    let evidence = |k: &usize| scouted[*k].as_ref().map_or(f64::NEG_INFINITY, |f| f.log_evidence);
    best.sort_by(|a, b| evidence(b).total_cmp(&evidence(a)));
    best.truncate(FITTED_FROM_AFAR);
    let highest = best.first().map_or(0.0, evidence);
    // Where even the best misses by far, differences say as much less.
    let doubt = best.first().and_then(|k| scouted[*k].as_ref()).map_or(1.0, Fit::inflation);
    best.retain(|k| evidence(k) > highest - BEYOND_DOUBT * doubt);
    let mut fits: Vec<Option<Fit>> = scouted
        .par_iter()
        .zip(order)
        .enumerate()
        .map(|(k, (scouted, (e, ..)))| {
            let start = scouted.as_ref().filter(|_| best.contains(&k))?.state.clone();
            // Only the few that were scouted are in their places yet.
            fit_in_place(frame, &with(*e), start, subset, FitOptions::THOROUGH)
        })
        .collect();
    // Where even the best is lost, the few passages may have chosen the wrong one of its starts.
    let evidence = |k: &usize| fits[*k].as_ref().map_or(f64::NEG_INFINITY, |f| f.log_evidence);
    let best = (0..fits.len()).max_by(|a, b| evidence(a).total_cmp(&evidence(b)));
    if let Some(k) = best.filter(|k| fits[*k].as_ref().is_some_and(Fit::lost)) {
        let again = from_every_start(frame, state, &with(order[k].0), hints, subset);
        fits[k] = fits[k].take().into_iter().chain(again).max_by(by_evidence);
    }
    (fits, valleys)
}

/// The deepest valley in which the last effect of `list` has stayed.
fn valley(list: &[&dyn Effect], found: &[(Vec<f64>, Fit)]) -> Option<Valley> {
    let effect = list.last()?;
    let there = |(start, fit): &&(Vec<f64>, Fit)| {
        fit.state.effects.last().is_some_and(|now| stayed(*effect, start, now))
    };
    let deepest = |a: &&(Vec<f64>, Fit), b: &&(Vec<f64>, Fit)| a.1.inflation().total_cmp(&b.1.inflation());
    let (_, fit) = found.iter().filter(there).min_by(deepest)?;
    Some(Valley { state: fit.state.clone(), misfit: fit.inflation() })
}

/// Whether an effect is still on the way from nought to where it started, and has not fallen back to where there is none.
fn stayed(effect: &dyn Effect, start: &[f64], now: &[f64]) -> bool {
    let Some(nought) = effect.nought() else { return true };
    let (mut along, mut length) = (0.0, 0.0);
    for ((start, now), nought) in start.iter().zip(now).zip(&nought).take(effect.sizes()) {
        along += (start - nought) * (now - nought);
        length += (start - nought).powi(2);
    }
    length > 0.0 && along >= STAYED * length
}

/// Thorough fit that continues the best of shorter ones from all starts of the only effect of `list`, where that does not
/// begin smoothly: its starts lie in different valleys. What is lost beside another effect is rarely worth the time.
fn from_every_start(
    frame: &Frame,
    state: &State,
    list: &[&dyn Effect],
    hints: &Hints,
    subset: &[usize],
) -> Option<Fit> {
    let [effect] = list else { return None };
    if effect.nought().is_some() {
        return None;
    }
    let best = most_probable(from_far_starts(frame, state, list, hints, subset, VALLEY))?;
    fit(frame, list, best.state, subset, FitOptions::THOROUGH).ok()
}

pub(super) fn by_evidence(a: &Fit, b: &Fit) -> std::cmp::Ordering {
    a.log_evidence.total_cmp(&b.log_evidence)
}

/// Fit of the accepted effects and one more, the last of `list`.
fn candidate(
    frame: &Frame,
    list: &[&dyn Effect],
    state: &State,
    all_starts: &[Vec<f64>],
    start: usize,
    subset: &[usize],
) -> Option<Fit> {
    let effect = *list.last()?;
    if effect.nought().is_some() && all_starts.len() == 1 {
        return fit(frame, list, state.with([all_starts[start].clone()]), subset, SMOOTH).ok();
    }
    let nominal = crate::ballast::BallastParameters::NOMINAL.to_vector();
    let mut states = vec![state.clone()];
    if (state.ballast[0] - nominal[0]).abs() > FAR {
        states.push(state.on_nominal_ballast());
    }
    let all: Vec<State> =
        states.iter().flat_map(|s| all_starts.iter().map(|c| s.with([c.clone()]))).collect();
    let few = few_of(subset);
    let scouts = all.into_par_iter().filter_map(|s| fit(frame, list, s, &few, SCOUT).ok());
    let best = scouts.max_by(by_evidence)?;
    fit(frame, list, best.state, subset, FitOptions::THOROUGH).ok()
}

/// Fit from a start with the passages where that predicts them.
pub(super) fn fit_in_place(
    frame: &Frame,
    list: &[&dyn Effect],
    start: State,
    subset: &[usize],
    options: FitOptions,
) -> Option<Fit> {
    fit(frame, list, replaced(frame, list, start, (subset, options.detail)), subset, options).ok()
}

/// Such fits from the promising ones of the far starts of the last effect of `list`, with those starts.
pub(super) fn from_far_starts(
    frame: &Frame,
    state: &State,
    list: &[&dyn Effect],
    hints: &Hints,
    subset: &[usize],
    options: FitOptions,
) -> Vec<(Vec<f64>, Fit)> {
    let starts = list.last().map_or_else(Vec::new, |e| e.far_starts(hints));
    promising(frame, (list, state), starts, (subset, options.detail))
        .into_par_iter()
        .filter_map(|c| {
            let fit = fit_in_place(frame, list, state.with([c.clone()]), subset, options)?;
            Some((c, fit))
        })
        .collect()
}

/// The most probable of fits with their starts.
pub(super) fn most_probable(found: Vec<(Vec<f64>, Fit)>) -> Option<Fit> {
    found.into_iter().map(|(_, fit)| fit).max_by(by_evidence)
}

/// The passages that are scouted.
pub(super) fn few_of(subset: &[usize]) -> Vec<usize> {
    spread_out(subset, SCOUTED)
}

/// Near the base model the first derivatives hold; what is accepted is fitted again.
const SMOOTH: FitOptions =
    FitOptions { steps: 8, renew: 3, tolerance: 0.5, damped: false, detail: Detail::Full };
/// An effect that does not begin smoothly is looked for from all its starts in a few passages first.
pub(super) const SCOUT: FitOptions =
    FitOptions { steps: 6, renew: 3, tolerance: 3.0, damped: false, detail: Detail::Scouting };
const SCOUTED: usize = 3;
/// As many steps with all passages tell which valley is the deepest.
const VALLEY: FitOptions =
    FitOptions { steps: 6, renew: 4, tolerance: 3.0, damped: false, detail: Detail::Full };

/// Outer stiffness this far from nominal (logarithm) is hardly real.
const FAR: f64 = 0.7;

/// Largest expected gain in log evidence of an effect, and the start that promises it.
fn best_start(screening: &Screening, effect: usize, e: &dyn Effect) -> (f64, usize) {
    let own: Vec<usize> =
        (0..screening.directions.len()).filter(|i| screening.directions[*i].effect == effect).collect();
    if e.nought().is_some() {
        return (gain(screening, &own), 0);
    }
    own.iter()
        .map(|i| (gain(screening, &[*i]), screening.directions[*i].start))
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .unwrap_or((f64::NEG_INFINITY, 0))
}

/// Log evidence that directions together would add if the model were linear in them.
pub fn gain(screening: &Screening, directions: &[usize]) -> f64 {
    let q = directions.len();
    let prior = |i: usize| screening.prior_sd[directions[i]].powi(-2);
    let h = Mat::from_fn(q, q, |i, j| {
        screening.information[(directions[i], directions[j])] + if i == j { prior(i) } else { 0.0 }
    });
    let b = Mat::from_fn(q, 1, |i, _| screening.vector[(directions[i], 0)]);
    let Ok(factor) = h.llt(faer::Side::Lower) else { return f64::NEG_INFINITY };
    let solved = factor.solve(&b);
    let l = factor.L();
    (0..q).map(|i| 0.5 * b[(i, 0)] * solved[(i, 0)] - l[(i, i)].ln() + 0.5 * prior(i).ln()).sum()
}
