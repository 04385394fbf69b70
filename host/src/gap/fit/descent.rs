//! Steps of a fit down the posterior, and where they end.

use super::normal::{Normal, Step};
use super::{Evaluation, FitOptions, Frame, State, moved};
use crate::gap::GapError;
use crate::gap::effect::Effect;

/// A step that promises more than this, nats, and more than this part of the cost, and lowers nothing however short, was misled by
/// derivatives that hold nearby only.
const PROMISING: (f64, f64) = (20.0, 5e-3);
/// A fit ends where a step gains less than this part of its cost.
const CONVERGED: f64 = 1e-3;
/// A step that promises less than this, nats, is the last. With the tolerance of the fit in its place, strong effects that are left out of
/// the catalogue ended in other models.
const NOTHING: f64 = 0.1;
/// Lengths of straight steps.
const LENGTHS: [f64; 3] = [1.0, 0.35, 0.1];
/// Damping of the steps tried then, relative to the curvature along each unknown: of the path, of the others. The path's derivatives
/// are those of the site's first world, and the first to mislead.
const DAMPING: [[f64; 2]; 5] = [[1e9, 0.0], [0.3, 0.3], [3.0, 3.0], [30.0, 30.0], [300.0, 300.0]];

/// Descent of one fit.
pub(super) struct Descent<'a> {
    pub(super) frame: &'a Frame,
    pub(super) effects: &'a [&'a dyn Effect],
    pub(super) subset: &'a [usize],
    pub(super) options: FitOptions,
    /// Which of [`DAMPING`] the last step needed, if it succeeded with one.
    pub(super) damped: Option<usize>,
}

/// Where a step has led.
pub(super) struct Stride {
    /// State of lower cost, if there is one.
    pub(super) next: Option<(State, Evaluation)>,
    /// Whether no step gains anything, if the derivatives hold.
    pub(super) converged: bool,
}

impl Descent<'_> {
    /// Gain that ends a fit, nats.
    pub(super) fn tolerance(&self, cost: f64) -> f64 {
        self.options.tolerance.max(CONVERGED * cost)
    }

    /// First of ever shorter steps that lowers the cost and, where the straight ones are misled, of ever steeper ones (Marquardt 1963).
    ///
    /// On beds that are not linear small steps lead on where derivatives promise nothing, and short ones where the step before had to be
    /// damped: known-voided-sleepers was missed by more than with them.
    pub(super) fn stride(
        &mut self,
        here: (&State, &Evaluation),
        normal: &Normal,
    ) -> Result<Stride, GapError> {
        let straight = normal.step([0.0; 2])?;
        let promised = normal.promised(&straight);
        let linear_bed = here.1.linear_bed;
        let converged = linear_bed && promised <= NOTHING;
        let misled = self.options.damped && promised >= PROMISING.0.max(PROMISING.1 * here.1.cost);
        let before = self.damped.take().filter(|_| linear_bed && misled);
        let next = match before {
            None if converged => self.shorter(here, &straight, 0..1),
            None => self
                .shorter(here, &straight, 0..LENGTHS.len())
                .or_else(|| misled.then(|| self.steeper(here, normal, 0..DAMPING.len())).flatten()),
            // After a step that had to be damped the next one needs about as much.
            Some(before) => self
                .shorter(here, &straight, 0..1)
                .or_else(|| self.steeper(here, normal, before.saturating_sub(1)..DAMPING.len()))
                .or_else(|| self.shorter(here, &straight, 1..LENGTHS.len()))
                .or_else(|| self.steeper(here, normal, 0..before.saturating_sub(1))),
        };
        Ok(Stride { next, converged })
    }

    fn shorter(
        &self,
        here: (&State, &Evaluation),
        straight: &Step,
        mut lengths: std::ops::Range<usize>,
    ) -> Option<(State, Evaluation)> {
        lengths.find_map(|k| self.lower(here, straight, LENGTHS[k]))
    }

    fn steeper(
        &mut self,
        here: (&State, &Evaluation),
        normal: &Normal,
        mut damping: std::ops::Range<usize>,
    ) -> Option<(State, Evaluation)> {
        let (k, next) =
            damping.find_map(|k| Some((k, self.lower(here, &normal.step(DAMPING[k]).ok()?, LENGTHS[0])?)))?;
        self.damped = Some(k);
        Some(next)
    }

    /// The state after a step of this length, if its cost is lower.
    fn lower(
        &self,
        (state, here): (&State, &Evaluation),
        step: &Step,
        length: f64,
    ) -> Option<(State, Evaluation)> {
        let candidate = moved(self.frame, self.effects, state, step, length, self.subset);
        let evaluation =
            Evaluation::new(self.frame, self.effects, &candidate, (self.subset, here.detail)).ok()?;
        (evaluation.cost < here.cost).then_some((candidate, evaluation))
    }
}
