//! Recordings as they would be on a linear bed under the same wheel forces: what a void or ballast that stiffens adds to them is
//! simulated and taken off.
//!
//! The identification is linear: of a recording over a void it makes forces that are a third wrong. The forward model knows the void.
//! Fitted with it, it says what the sensor shows and which forces act, and the same forces on a linear bed say what the sensor would
//! show there. The difference of the two is what makes the recording other than linear; how the true forces differ from those of the
//! model is left to the identification, to which it is small.

use rayon::prelude::*;

use super::GapError;
use super::base::{Base, Given, base, nominal_world};
use super::diagnosis::{SEARCH_PASSAGES, thinned, without};
use super::effect::Effect;
use super::estimated_path::with_path;
use super::fit::{State, replaced, settled};
use super::forward::{Detail, Simulator};
use super::world::{Bed, World};
use crate::ballast::BallastParameters;
use crate::progress::Progress;
use crate::recording::{Passage, Site};
use crate::signal::filtered;

/// Effects by which a bed is not linear, with the coordinates of their parameters at which a fit begins.
pub type Departures<'e> = [(&'e dyn Effect, Vec<f64>)];

/// The site with recordings as on a linear bed. Passages in which no train is found stay as they are.
pub fn on_linear_bed(
    site: &Site,
    departures: &Departures,
    progress: &dyn Progress,
) -> Result<Site, GapError> {
    let added = match added_by(site, departures, progress) {
        Err(GapError::SilentPassages { passage_id }) => {
            added_by(&without(site, &passage_id), departures, progress)?
        }
        added => added?,
    };
    let mut out = site.clone();
    for (passage_id, added) in added {
        out.passages.iter_mut().filter(|p| p.passage_id == passage_id).for_each(|p| take_off(p, &added));
    }
    Ok(out)
}

/// What the departures add to every recording, by its passage, m/s² at its rate.
fn added_by(
    site: &Site,
    departures: &Departures,
    progress: &dyn Progress,
) -> Result<Vec<(i32, Vec<f64>)>, GapError> {
    let all: Vec<usize> = (0..site.passages.len()).collect();
    let searched = thinned(&all, SEARCH_PASSAGES);
    let (panel, prior) = with_path(site, &all, progress);
    progress.begin("model of the bed that is not linear", 1);
    let given = Given { bed: bed_with(&panel, departures)?, ..Given::default() };
    let base = base(&panel, &searched, &searched, &prior, &given)?;
    let (world, shift_m) = fitted(&base, departures, &searched)?;
    progress.step();
    progress.begin("recordings as on a linear bed", base.frame.observed.len() as u64);
    let linear =
        World { bed: Bed { gap_m: Vec::new(), doubling_m: None, ..world.bed.clone() }, ..world.clone() };
    (0..base.frame.observed.len())
        .into_par_iter()
        .map(|i| {
            progress.step();
            let o = &base.frame.observed[i];
            let of = |world: &World| Simulator::new(world, o.axle_load_kg);
            let simulator = of(&world)?;
            let beyond = simulator.beyond(&of(&linear)?, o.speed_m_s)?;
            let first_s = o.first_axle_s + shift_m[i] / o.speed_m_s;
            let bogies_s: Vec<f64> = o.bogie_s().iter().map(|s| first_s + s).collect();
            let mut added = vec![0.0; o.recording.len];
            beyond.add_train(&bogies_s, 1.0, 0.0, 1.0 / o.recording.rate_hz, &mut added);
            // The recorder's low-pass is undone in the model's accelerations.
            Ok((o.passage_id, filtered(&added, o.recording.rate_hz, |f| simulator.antialias().response(f))))
        })
        .collect()
}

/// Bed with the effects where the fit begins.
fn bed_with(site: &Site, departures: &Departures) -> Result<Bed, GapError> {
    let mut world = nominal_world(site, BallastParameters::NOMINAL)?;
    for (effect, coordinates) in departures {
        let values: Vec<f64> =
            effect.parameters().iter().zip(coordinates).map(|(p, c)| p.value(*c)).collect();
        effect.apply(&mut world, &values);
    }
    Ok(world.bed)
}

/// World with the effects, and where every passage is in it, metres.
fn fitted(base: &Base, departures: &Departures, searched: &[usize]) -> Result<(World, Vec<f64>), GapError> {
    let frame = &base.frame;
    let (effects, coordinates): (Vec<&dyn Effect>, Vec<Vec<f64>>) = departures.iter().cloned().unzip();
    let start = State { effects: coordinates, ..base.fit.state.clone() };
    let found = settled(frame, &effects, start, searched)?;
    let world = found.state.world(frame, &effects);
    let others: Vec<usize> = (0..frame.observed.len()).filter(|i| !searched.contains(i)).collect();
    Ok((world, replaced(frame, &effects, found.state, (&others, Detail::Full)).shift_m))
}

fn take_off(passage: &mut Passage, added_m_s2: &[f64]) {
    passage.acceleration_m_s2.iter_mut().zip(added_m_s2).for_each(|(a, added)| *a -= *added as f32);
}
