//! Effects that the recordings cannot tell from one that is named: how large each would be in its place, and what gap it would leave.
//!
//! Who has measured the cant, or weighed the trains, knows which of them it is, and takes that one.

use super::Session;
use super::conclusion::stated;
use crate::gap::GapError;
use crate::gap::effect::{Effect, Stated};
use crate::gap::fit::{FitOptions, fit, simulate};
use crate::gap::measure::measure;
use crate::gap::trains::tell_apart;
use crate::gap::world::World;

/// An effect in the place of one that is named.
#[derive(Clone, Debug)]
pub struct Alternative {
    /// Name in the contract.
    pub name: &'static str,
    /// Of its sizes.
    pub parameters: Vec<Stated>,
    /// Gap on the held-out passages with it and everything else that is named.
    pub gap_after: f64,
}

impl Session<'_> {
    /// Sizes the effects of the panel from which named ones cannot be told.
    pub(super) fn describe_alternatives(&mut self, base: &World) -> Result<(), GapError> {
        for n in 0..self.named.len() {
            let Some(place) = self.accepted.iter().position(|e| e.name() == self.named[n].name) else {
                continue;
            };
            let same = &self.named[n].indistinguishable_from;
            let others: Vec<&'static dyn Effect> =
                self.common.iter().copied().filter(|e| same.contains(&e.name())).collect();
            for other in others {
                let alternative = self.in_its_place(place, other, base)?;
                self.named[n].alternatives.extend(alternative);
            }
        }
        Ok(())
    }

    /// All training passages with another effect in the place of an accepted one; `None` where no start of its own leads anywhere.
    fn in_its_place(
        &self,
        place: usize,
        other: &'static dyn Effect,
        base: &World,
    ) -> Result<Option<Alternative>, GapError> {
        let frame = &self.base.frame;
        let mut effects = self.accepted.clone();
        effects[place] = other;
        let from = |start: Vec<f64>| {
            let mut state = self.state();
            state.effects[place] = start;
            fit(frame, &effects, state, &self.split.train, FitOptions::default()).ok()
        };
        let fits = other.starts(&self.hints).into_iter().filter_map(from);
        let Some(best) = fits.max_by(|a, b| a.log_posterior.total_cmp(&b.log_posterior)) else {
            return Ok(None);
        };
        let all: Vec<usize> = (0..frame.observed.len()).collect();
        let base_responses = simulate(base, frame, &all)?;
        let mut predicted = self.corrected((base, &base_responses), (&effects, &best.state), &all)?;
        tell_apart(&mut predicted, &frame.observed, &self.base.shapes);
        Ok(Some(Alternative {
            name: other.name(),
            parameters: stated(&effects, &best).swap_remove(place),
            gap_after: measure(&self.held_out(&predicted), true).after,
        }))
    }
}
