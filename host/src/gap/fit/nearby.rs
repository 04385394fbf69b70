//! Responses of a world that differs little from one that is simulated already: the difference is simulated at a few speeds, and
//! interpolated over the others at the same places of the train. A derivative needs no more, and costs a third.

use rayon::prelude::*;

use super::Frame;
use super::recall::simulate_in;
use crate::gap::GapError;
use crate::gap::data::Observed;
use crate::gap::forward::{Detail, Response};
use crate::gap::world::World;

/// Largest step between speeds at which a difference is simulated, in their logarithm: sites whose speeds spread by ±10 % have four.
const STEP: f64 = 0.07;
/// The same where valleys are only looked for: two.
const SCOUTING_STEP: f64 = 0.21;
/// Speeds between which a difference is interpolated.
const POINTS: usize = 4;

/// Passages at whose speeds differences are simulated, and how the others follow from them.
pub(super) struct Nearby<'a> {
    frame: &'a Frame,
    subset: &'a [usize],
    detail: Detail,
    /// Of every passage of the subset: weights of the passages that stand for it, by their places in the subset. A passage that is
    /// simulated stands for itself alone.
    weights: Vec<Vec<(usize, f64)>>,
}

impl<'a> Nearby<'a> {
    /// For the passages of `subset`.
    pub(super) fn of(frame: &'a Frame, subset: &'a [usize], detail: Detail) -> Self {
        let step = match detail {
            Detail::Full => STEP,
            Detail::Scouting => SCOUTING_STEP,
        };
        let observed: Vec<&Observed> = subset.iter().map(|i| &frame.observed[*i]).collect();
        let weights = (0..subset.len()).map(|p| {
            let alike: Vec<usize> =
                (0..subset.len()).filter(|k| observed[*k].axle_load_kg == observed[p].axle_load_kg).collect();
            let place = |k: usize| observed[k].speed_m_s.ln();
            weights(&spread(&alike, &place, step), p, &place)
        });
        Self { frame, subset, detail, weights: weights.collect() }
    }

    /// Responses of all passages in `world`, given those `here` in one that differs little.
    pub(super) fn responses(&self, world: &World, here: &[Response]) -> Result<Vec<Response>, GapError> {
        // Over a bed that is not linear sleepers meet it elsewhere at every speed.
        if !world.bed.is_linear() {
            return simulate_in(self.detail, world, self.frame, self.subset);
        }
        let simulated: Vec<usize> =
            (0..self.subset.len()).filter(|p| self.weights[*p] == [(*p, 1.0)]).collect();
        let chosen: Vec<usize> = simulated.iter().map(|p| self.subset[*p]).collect();
        let mut there: Vec<Option<Response>> = vec![None; self.subset.len()];
        for (p, response) in simulated.iter().zip(simulate_in(self.detail, world, self.frame, &chosen)?) {
            there[*p] = Some(response);
        }
        let speed = |p: usize| self.frame.observed[self.subset[p]].speed_m_s;
        Ok((0..self.subset.len())
            .into_par_iter()
            .map(|p| match &there[p] {
                Some(response) => response.clone(),
                None => here[p].with(|t| {
                    let part = |(n, weight): &(usize, f64)| {
                        let at = t * speed(p) / speed(*n);
                        there[*n].as_ref().map_or(0.0, |there| weight * (there.at(at) - here[*n].at(at)))
                    };
                    self.weights[p].iter().map(part).sum()
                }),
            })
            .collect())
    }
}

/// Of `alike`, those nearest to evenly spread places from the first to the last; all where no step is longer for fewer.
fn spread(alike: &[usize], place: &dyn Fn(usize) -> f64, step: f64) -> Vec<usize> {
    let (first, last) = alike
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), k| (l.min(place(*k)), h.max(place(*k))));
    let steps = ((last - first) / step).ceil().max(1.0) as usize;
    if steps + 1 >= alike.len() {
        return alike.to_vec();
    }
    let nearest = |to: f64| {
        let off = |k: &&usize| (place(**k) - to).abs();
        alike.iter().min_by(|a, b| off(a).total_cmp(&off(b))).copied()
    };
    let mut out: Vec<usize> =
        (0..=steps).filter_map(|s| nearest(first + (last - first) * s as f64 / steps as f64)).collect();
    out.dedup();
    out
}

/// Lagrange weights of the nodes next to a passage.
fn weights(nodes: &[usize], passage: usize, place: &dyn Fn(usize) -> f64) -> Vec<(usize, f64)> {
    if nodes.contains(&passage) {
        return vec![(passage, 1.0)];
    }
    let here = place(passage);
    let mut near = nodes.to_vec();
    near.sort_by(|a, b| (place(*a) - here).abs().total_cmp(&(place(*b) - here).abs()));
    near.truncate(POINTS);
    let weight = |n: usize| {
        let others = near.iter().filter(|m| **m != n);
        others.map(|m| (here - place(*m)) / (place(n) - place(*m))).product()
    };
    near.iter().map(|n| (*n, weight(*n))).collect()
}

#[cfg(test)]
mod tests {
    use super::super::simulate;
    use super::*;
    use crate::gap::base::tests::of_reference;

    /// Part of a difference that interpolation over the speeds of a site may lose, RMS in the band: Gauss-Newton steps then miss their
    /// aim by as much, and the next one makes up for it.
    const LOST: f64 = 0.02;

    #[test]
    fn property_differences_are_those_simulated_at_every_speed() {
        let base = of_reference(usize::MAX);
        let (frame, world) = (&base.frame, &base.frame.base);
        let all: Vec<usize> = (0..frame.observed.len()).collect();
        let nearby = Nearby::of(frame, &all, Detail::Full);
        let simulated = nearby.weights.iter().filter(|w| w.len() == 1).count();
        assert!((3..=5).contains(&simulated), "{simulated} of {} are simulated", all.len());
        let here = simulate(world, frame, &all).unwrap();
        let (mut softer, mut heavier) = (world.clone(), world.clone());
        softer.ballast.p2_n_m2 *= 0.96;
        heavier.wheels.unsprung *= 1.1;
        for (what, moved) in [("ballast", softer), ("wheelsets", heavier)] {
            let (exact, near) =
                (simulate(&moved, frame, &all).unwrap(), nearby.responses(&moved, &here).unwrap());
            let (mut off, mut all_of_it) = (0.0, 0.0);
            for (k, o) in frame.observed.iter().enumerate() {
                let mean = |r: &Response| o.predicted_mean(r, 1.0, 0.0);
                for ((e, n), h) in mean(&exact[k]).iter().zip(mean(&near[k])).zip(mean(&here[k])) {
                    off += (e - n).powi(2);
                    all_of_it += (e - h).powi(2);
                }
            }
            let lost = f64::sqrt(off / all_of_it);
            println!("{what}: {:.2} % of the difference is lost", 100.0 * lost);
            assert!(lost < LOST, "{what}: {lost}");
        }
    }
}
