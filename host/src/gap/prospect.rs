//! Where to look for an effect that has many starts, alone or beside another one: a look at each costs one simulation, a fit from there
//! some fifty.

use rayon::prelude::*;

use super::effect::{Effect, Hints};
use super::fit::{Frame, State, cost_in_place};
use super::forward::Detail;

/// Starts from which fits begin at most.
const MOST: usize = 8;
/// Starts nearer to a better one than this in all that is no size lie in its valley, standard deviations of the prior: dips 0.18 m apart.
const SAME_VALLEY: f64 = 0.15;

/// The starts of the last effect of `list` that agree best with the passages of `subset` as they are, none in the valley of a better
/// one; all of them where they are few. `state` is without that effect.
pub(super) fn promising(
    frame: &Frame,
    (list, state): (&[&dyn Effect], &State),
    starts: Vec<Vec<f64>>,
    passages: (&[usize], Detail),
) -> Vec<Vec<f64>> {
    let Some(effect) = list.last().filter(|_| starts.len() > MOST) else { return starts };
    let looked_at = starts.into_par_iter().map(|start| {
        let there = state.with([start.clone()]);
        (cost_in_place(frame, list, &there, passages), start)
    });
    apart(looked_at.collect(), |better, start| same_valley(*effect, better, start))
}

/// Two effects, and where both start.
pub(super) type Pair<'e> = ([&'e dyn Effect; 2], [Vec<f64>; 2]);

/// The pairs that agree best with the passages as they are: any of `effects` and one of many starts. `state` is without both. Beds that are
/// not linear are left out: over them a look is as dear as a fit.
pub(super) fn promising_pairs<'e>(
    frame: &Frame,
    state: &State,
    effects: &[&'e dyn Effect],
    hints: &Hints,
    passages: (&[usize], Detail),
) -> Vec<Pair<'e>> {
    let of_many = effects.iter().copied().filter(|e| e.far_starts(hints).len() > MOST);
    let pairs: Vec<Pair<'e>> = of_many.flat_map(|e| pairs_with(e, effects, hints)).collect();
    let looked_at = pairs.into_par_iter().filter_map(|(pair, starts)| {
        let there = state.with(starts.clone());
        let linear = there.world(frame, &pair).bed.is_linear();
        linear.then(|| (cost_in_place(frame, &pair, &there, passages), (pair, starts)))
    });
    apart(looked_at.collect(), |(better, a), (pair, b)| {
        better[0].name() == pair[0].name() && same_valley(pair[1], &a[1], &b[1])
    })
}

/// All starts of an effect beside those of all others; where another is nought there is no pair.
fn pairs_with<'e>(of_many: &'e dyn Effect, effects: &[&'e dyn Effect], hints: &Hints) -> Vec<Pair<'e>> {
    let places = of_many.far_starts(hints);
    let mut out = Vec::new();
    for other in effects.iter().copied().filter(|e| e.name() != of_many.name()) {
        let starts = other.far_starts(hints);
        for start in starts.iter().filter(|start| other.nought().as_ref() != Some(*start)) {
            out.extend(places.iter().map(|place| ([other, of_many], [start.clone(), place.clone()])));
        }
    }
    out
}

/// The cheapest first, without those that lie in the valley of a better one; as many as are worth fits.
fn apart<S>(mut looked_at: Vec<(f64, S)>, same_valley: impl Fn(&S, &S) -> bool) -> Vec<S> {
    looked_at.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut chosen: Vec<S> = Vec::new();
    for (_, start) in looked_at {
        if chosen.len() < MOST && !chosen.iter().any(|better| same_valley(better, &start)) {
            chosen.push(start);
        }
    }
    chosen
}

fn same_valley(effect: &dyn Effect, a: &[f64], b: &[f64]) -> bool {
    let mut others = effect.parameters().iter().zip(a.iter().zip(b)).skip(effect.sizes());
    others.all(|(p, (a, b))| (a - b).abs() < SAME_VALLEY * p.prior.1)
}
