//! What was simulated lately: searches come back to where they have been.
//!
//! A fit begins where the one before has ended, passages are moved without the track under them changing, and a round without success
//! is repeated after something else was taken out. A twentieth to a third of all simulations of a diagnosis had been done before.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

use crate::gap::data::Observed;
use crate::gap::forward::{Detail, Response};
use crate::gap::world::World;

/// Values kept, 8 bytes each: some hundred worlds with a dozen passages each.
const MOST_VALUES: usize = 6 << 20;

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
    pub(super) fn find(
        &self,
        world: &World,
        detail: Detail,
        passages: &[&Observed],
    ) -> Vec<Option<Response>> {
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
    pub(super) fn keep(&self, world: &World, detail: Detail, passages: &[&Observed], responses: &[Response]) {
        if passages.is_empty() {
            return;
        }
        let responses = passages.iter().map(|o| passing(o)).zip(responses.iter().cloned()).collect();
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
