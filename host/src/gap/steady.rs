//! Recordings without the steps of their baseline: what shocks to the sensor add is found as the diagnosis finds it, and taken off.
//!
//! Steps drive astray what is read before they are known: axle times, ballast. So they are looked for again, by a base model of what the
//! recordings are without those found before, until that finds no more of them.

use super::GapError;
use super::base::{Base, Form, Given, base};
use super::data::{Observed, RATE_HZ};
use super::diagnosis::{SEARCH_PASSAGES, thinned};
use super::effects::bias_step::BiasStep;
use super::equivalent::corrected_where_trains_are;
use super::estimated_path::with_path;
use super::fit::State;
use super::latent::{Latent as _, LatentFit, Scene};
use crate::progress::Progress;
use crate::recording::{Passage, Site};
use crate::signal::between;

/// Most rounds; of steps of one to ten m/s² the third or fourth finds what the one before has found.
const ROUNDS: usize = 6;
/// A round goes on where the one before has added this part to the gain in log evidence.
const GROWN: f64 = 0.01;

/// The site without the steps of its baseline, over beds with the effects of `forms`; `None` where there are none. Passages in which no
/// train is found stay as they are.
pub fn without_steps(site: &Site, forms: &[Form], progress: &dyn Progress) -> Result<Option<Site>, GapError> {
    corrected_where_trains_are(site, |site| steady(site, forms, progress))
}

/// The same of recordings that have a train in each.
fn steady(site: &Site, forms: &[Form], progress: &dyn Progress) -> Result<Option<Site>, GapError> {
    let all: Vec<usize> = (0..site.passages.len()).collect();
    let fitted = thinned(&all, SEARCH_PASSAGES);
    let (panel, prior) = with_path(site, &all, progress);
    let (mut clean, mut as_read, mut gain) = (None, None, 0.0);
    progress.begin("steps of the baseline", ROUNDS as u64);
    for _ in 0..ROUNDS {
        // Lost among steps, a model over such a bed is farther off than one over a linear bed.
        let forms = if clean.is_some() { forms } else { &[] };
        let given = Given { effects: forms.to_vec(), cleaned: clean.is_some(), ..Given::default() };
        let mut base = base(clean.as_ref().unwrap_or(&panel), &fitted, &fitted, &prior, &given)?;
        base.record_again(as_read.get_or_insert_with(|| base.frame.observed.clone()));
        let found = steps_of(&base, forms, &fitted)?;
        progress.step();
        let Some(found) = found else { break };
        clean = Some(without_traces(&panel, &base.frame.observed, &found));
        if found.gain < (1.0 + GROWN) * gain {
            break;
        }
        gain = found.gain;
    }
    Ok(clean.map(|clean| Site { scan: site.scan.clone(), ..clean }))
}

/// Steps in all recordings by a base model that was fitted to some of them.
fn steps_of(base: &Base, forms: &[Form], fitted: &[usize]) -> Result<Option<LatentFit>, GapError> {
    let frame = &base.frame;
    let (effects, coordinates): (Vec<_>, Vec<_>) = forms.iter().cloned().unzip();
    let state = State { effects: coordinates, ..base.fit.state.clone() };
    let world = state.world(frame, &effects);
    let all: Vec<usize> = (0..frame.observed.len()).collect();
    let scene = Scene::of(base, &world, (&state, fitted), &all)?;
    Ok(BiasStep.explore(&scene))
}

/// A site without the steps that an effect of the recordings adds to them, if it does.
pub(super) fn without_traces(site: &Site, observed: &[Observed], found: &LatentFit) -> Site {
    let mut clean = site.clone();
    let Some(decay_s) = found.decay_s else { return clean };
    for (o, trace) in observed.iter().zip(&found.traces) {
        for p in clean.passages.iter_mut().filter(|p| p.passage_id == o.passage_id) {
            take_off(p, o, (trace, decay_s));
        }
    }
    clean
}

/// Takes a trace off a recording, its first value off what is before, and what decays behind it.
fn take_off(passage: &mut Passage, o: &Observed, (trace, decay_s): (&[f64], f64)) {
    let [first, .., last] = trace else { return };
    let (start_s, end) = (o.trace_start_s(), (trace.len() - 1) as f64);
    for (k, sample) in passage.acceleration_m_s2.iter_mut().enumerate() {
        let p = (k as f64 / passage.sample_rate_hz - start_s) * RATE_HZ;
        let value = match between(trace, p) {
            Some(value) => value,
            None if p < 0.0 => *first,
            None => first + (last - first) * (-(p - end) / (RATE_HZ * decay_s)).exp(),
        };
        *sample -= value as f32;
    }
}
