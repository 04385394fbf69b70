//! Which effects: linear screening of the whole catalogue, joint re-fit of those that pass, forward selection.

use super::GapError;
use super::effect::{Effect, Hints};
use super::fit::{Fit, FitOptions, Frame, Screening, State, fit, screen};
use faer::Mat;
use faer::linalg::solvers::Solve as _;

/// One effect tried on top of the accepted ones.
pub struct Tried<'e> {
    /// The effect.
    pub effect: &'e dyn Effect,
    /// Expected gain in log evidence by the linear screening.
    pub screened: f64,
    /// Fit, where the screening was passed.
    pub fit: Option<Fit>,
}

/// Candidates that are fitted at most in the first round, and in later ones.
const FITTED: (usize, usize) = (5, 2);
/// Least expected gain for a fit; an effect that is worth naming gains several times as much.
const LEAST_GAIN: f64 = 4.0;
/// A candidate is not fitted when its expected gain is below this part of the largest.
const LEAST_SHARE: f64 = 0.15;

/// Screens and fits all candidates on top of `accepted`.
pub fn round<'e>(
    frame: &Frame,
    (accepted, state): (&[&'e dyn Effect], &State),
    candidates: &[&'e dyn Effect],
    hints: &Hints,
    subset: &[usize],
) -> Result<(Vec<Tried<'e>>, Screening), GapError> {
    let screening = screen(frame, (accepted, state), candidates, hints, subset)?;
    let mut order: Vec<(usize, f64, usize)> = (0..candidates.len())
        .map(|e| {
            let (gain, start) = best_start(&screening, e, candidates[e]);
            (e, gain, start)
        })
        .collect();
    order.sort_by(|a, b| b.1.total_cmp(&a.1));
    let largest = order.first().map_or(0.0, |o| o.1);
    let mut tried = Vec::new();
    for (rank, (e, gain, start)) in order.into_iter().enumerate() {
        let effect = candidates[e];
        let most = if accepted.is_empty() { FITTED.0 } else { FITTED.1 };
        let passes = rank < most && gain > LEAST_GAIN && gain > LEAST_SHARE * largest;
        let fit = if passes {
            let mut list: Vec<&dyn Effect> = accepted.to_vec();
            list.push(effect);
            candidate(frame, &list, state, &effect.starts(hints), start, subset)
        } else {
            None
        };
        tried.push(Tried { effect, screened: gain, fit });
    }
    Ok((tried, screening))
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
    let with = |state: &State, coordinates: &Vec<f64>| {
        let mut from = state.clone();
        from.effects.push(coordinates.clone());
        from
    };
    if effect.nought().is_some() && all_starts.len() == 1 {
        return fit(frame, list, with(state, &all_starts[start]), subset, SMOOTH).ok();
    }
    let few: Vec<usize> = subset.iter().copied().step_by(subset.len().div_ceil(SCOUTED).max(1)).collect();
    let scouts: Vec<State> = states(state)
        .iter()
        .flat_map(|s| all_starts.iter().map(|c| with(s, c)).collect::<Vec<_>>())
        .collect();
    let best = scouts
        .into_iter()
        .filter_map(|s| fit(frame, list, s, &few, SCOUT).ok())
        .max_by(|a, b| a.log_evidence.total_cmp(&b.log_evidence))?;
    fit(frame, list, best.state, subset, FitOptions::THOROUGH).ok()
}

/// Near the base model the first derivatives hold; what is accepted is fitted again.
const SMOOTH: FitOptions = FitOptions { steps: 8, renew: 3, tolerance: 0.5 };
/// An effect that does not begin smoothly is looked for from all its starts in a few passages first.
const SCOUT: FitOptions = FitOptions { steps: 5, renew: 5, tolerance: 3.0 };
const SCOUTED: usize = 3;
/// States from which the fit of an effect that does not begin smoothly starts: the base model's, which such an effect may
/// have driven far away, and nominal ballast with the scan.
fn states(state: &State) -> Vec<State> {
    let nominal = crate::ballast::BallastParameters::NOMINAL;
    let mut all = vec![state.clone()];
    if (state.ballast[0] - nominal.p1_n_m2.ln()).abs() > FAR {
        let mut fresh = state.clone();
        fresh.ballast = nominal.to_vector();
        fresh.deviation_m.fill(0.0);
        all.push(fresh);
    }
    all
}

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
