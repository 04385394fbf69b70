//! Simulation of passages, and what was simulated lately: searches come back to where they have been.
//!
//! A fit begins where the one before has ended, passages are moved without the track under them changing, and a round without success
//! is repeated after something else was taken out. A twentieth to a third of all simulations of a diagnosis had been done before.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

use super::Frame;
use crate::gap::GapError;
use crate::gap::data::Observed;
use crate::gap::forward::{Detail, Response, Simulator};
use crate::gap::world::World;

/// Responses of the bogies of some passages for one world.
pub fn simulate(world: &World, frame: &Frame, subset: &[usize]) -> Result<Vec<Response>, GapError> {
    simulate_in(Detail::Full, world, frame, subset)
}

pub(super) fn simulate_in(
    detail: Detail,
    world: &World,
    frame: &Frame,
    subset: &[usize],
) -> Result<Vec<Response>, GapError> {
    let all: Vec<&Observed> = subset.iter().map(|i| &frame.observed[*i]).collect();
    let known = frame.recall.find(world, detail, &all);
    let open: Vec<&Observed> =
        all.iter().zip(&known).filter(|(_, known)| known.is_none()).map(|(o, _)| *o).collect();
    let new = simulate_anew(detail, world, &open)?;
    frame.recall.keep(world, detail, &open, &new);
    let mut new = new.into_iter();
    Ok(known.into_iter().filter_map(|known| known.or_else(|| new.next())).collect())
}

fn simulate_anew(detail: Detail, world: &World, passages: &[&Observed]) -> Result<Vec<Response>, GapError> {
    let mut loads: Vec<f64> = passages.iter().map(|o| o.axle_load_kg).collect();
    loads.sort_by(f64::total_cmp);
    loads.dedup();
    let simulators: Vec<Simulator> =
        loads.iter().map(|l| Simulator::in_detail(world, *l, detail)).collect::<Result<_, _>>()?;
    passages
        .par_iter()
        .map(|o| {
            let k = loads.iter().position(|l| *l == o.axle_load_kg).unwrap_or(0);
            Ok(simulators[k].response(o.speed_m_s)?)
        })
        .collect()
}

/// Values kept, 8 bytes each (160 MiB): some three hundred worlds with a dozen passages each. Where nothing fits, searches come back to
/// what is older than a third of that: 6 % of their time.
const MOST_VALUES: usize = 20 << 20;

/// Responses simulated lately. The same simulation gives the same response, so that no result depends on which are here.
#[derive(Default)]
pub struct Recall(Mutex<Kept>);

#[derive(Default)]
struct Kept {
    worlds: VecDeque<Simulated>,
    values: usize,
}

struct Simulated {
    world: World,
    detail: Detail,
    responses: Vec<(Passing, Response)>,
}

impl Simulated {
    fn values(&self) -> usize {
        self.responses.iter().map(|(_, response)| response.samples()).sum()
    }
}

/// What a simulation takes from a passage: axle load (kg), speed (m/s).
type Passing = (f64, f64);

fn passing(o: &Observed) -> Passing {
    (o.axle_load_kg, o.speed_m_s)
}

impl Recall {
    /// Of every passage the response in `world`, where it is known.
    fn find(&self, world: &World, detail: Detail, passages: &[&Observed]) -> Vec<Option<Response>> {
        let kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        // What differs most often is compared first.
        let same =
            |s: &&Simulated| s.detail == detail && s.world.ballast == world.ballast && s.world == *world;
        let same: Vec<&Simulated> = kept.worlds.iter().filter(same).collect();
        let of = |o: &&Observed| {
            let there = same.iter().flat_map(|s| &s.responses).find(|(of, _)| *of == passing(o))?;
            Some(there.1.clone())
        };
        passages.iter().map(of).collect()
    }

    /// Keeps responses, and forgets the oldest that are too many.
    fn keep(&self, world: &World, detail: Detail, passages: &[&Observed], responses: &[Response]) {
        if passages.is_empty() {
            return;
        }
        let responses = passages.iter().copied().map(passing).zip(responses.iter().cloned()).collect();
        let new = Simulated { world: world.clone(), detail, responses };
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        kept.values += new.values();
        kept.worlds.push_back(new);
        while kept.values > MOST_VALUES {
            let Some(oldest) = kept.worlds.pop_front() else { break };
            kept.values -= oldest.values();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::base::tests::of_reference;

    #[test]
    fn property_what_is_recalled_is_what_is_simulated() {
        let (frame, all) = (of_reference(3).frame, [0, 1, 2]);
        let kept = || frame.recall.0.lock().unwrap().worlds.len();
        let mut world = frame.base.clone();
        world.ballast.p2_n_m2 *= 1.01;
        let (before, first) = (kept(), simulate(&world, &frame, &all[..2]).unwrap());
        assert_eq!(kept(), before + 1, "a world that was not there");
        let again = simulate(&world, &frame, &all).unwrap();
        assert_eq!((&again[..2], kept()), (&first[..], before + 2), "one of three passages was open");
        assert_eq!(simulate(&world, &frame, &all).unwrap(), again);
        assert_eq!(kept(), before + 2, "nothing was open");
        let rough = simulate_in(Detail::Scouting, &world, &frame, &all).unwrap();
        assert_ne!(rough, again, "another detail is another simulation");
        world.sensor.mount = Some((300.0, 0.1));
        assert_ne!(simulate(&world, &frame, &all).unwrap(), again, "another sensor shows something else");
    }

    #[test]
    fn property_the_oldest_are_forgotten() {
        let (frame, recall) = (of_reference(3).frame, Recall::default());
        let passage = &frame.observed[0];
        let worlds: Vec<World> = (0..5)
            .map(|k| {
                let mut world = frame.base.clone();
                world.ballast.p1_n_m2 += f64::from(k);
                world
            })
            .collect();
        let third = Response::of(0.0, 1e-3, vec![0.0; MOST_VALUES / 3]);
        for world in &worlds {
            recall.keep(world, Detail::Full, &[passage], std::slice::from_ref(&third));
            assert!(recall.0.lock().unwrap().values <= MOST_VALUES);
        }
        let there = worlds.iter().map(|w| recall.find(w, Detail::Full, &[passage])[0].is_some());
        assert_eq!(there.collect::<Vec<_>>(), [false, false, true, true, true]);
    }
}
