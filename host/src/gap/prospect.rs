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

/// Whether an effect has so many far starts that they are looked at before fits begin there.
pub(super) fn many_starts(effect: &dyn Effect, hints: &Hints) -> bool {
    effect.far_starts(hints).len() > MOST
}

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
    let of_many: Vec<&'e dyn Effect> = effects.iter().copied().filter(|e| many_starts(*e, hints)).collect();
    let starts_of = |e: &&'e dyn Effect| e.far_starts(hints);
    let pairs: Vec<Pair<'e>> = of_many
        .iter()
        .flat_map(|of_many| {
            let others = effects.iter().filter(|e| e.name() != of_many.name());
            others.flat_map(move |e| {
                let both = starts_of(e)
                    .into_iter()
                    .flat_map(move |a| starts_of(of_many).into_iter().map(move |b| [a.clone(), b]));
                both.map(move |starts| ([*e, *of_many], starts))
            })
        })
        .collect();
    let looked_at = pairs.into_par_iter().filter_map(|(pair, starts)| {
        let there = state.with(starts.clone());
        let linear = there.world(frame, &pair).bed.is_linear();
        linear.then(|| (cost_in_place(frame, &pair, &there, passages), (pair, starts)))
    });
    apart(looked_at.collect(), |(better, a), (pair, b)| {
        better[0].name() == pair[0].name() && same_valley(pair[1], &a[1], &b[1])
    })
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
