//! Recordings as they would be on a linear bed under the same wheel forces: what a void or ballast that stiffens adds to them is
//! simulated and taken off.
//!
//! The identification is linear: of a recording over a void it makes forces that are a third wrong. The forward model knows the void.
//! Fitted with it ([`open_bed`](super::open_bed)), it says what the sensor shows and which forces act, and the same forces on a linear
//! bed say what the sensor would show there. The difference of the two is what makes the recording other than linear; how the true
//! forces differ from those of the model is left to the identification, to which it is small.

use super::GapError;
use super::base::Form;
use super::diagnosis::{SEARCH_PASSAGES, thinned, without};
use super::estimated_path::with_path;
use super::forward::Simulator;
use super::open_bed::{OpenBed, Task, less};
use super::world::{Bed, SensorModel, World};
use crate::progress::Progress;
use crate::recording::Site;

/// An effect by which a bed is not linear, in the forms that it may have.
pub type Departure = Vec<Form>;

/// Forces want what whole trains do as closely as it can be had: [`Task::refits`].
const REFITS: usize = 2;

/// The site with recordings as on a linear bed. Passages in which no train is found stay as they are.
pub fn on_linear_bed(
    site: &Site,
    departures: &[Departure],
    progress: &dyn Progress,
) -> Result<Site, GapError> {
    let corrected = corrected_where_trains_are(site, |site| without_bed(site, departures, progress))?;
    Ok(corrected.unwrap_or_else(|| site.clone()))
}

/// A correction, if there is one to be made, of recordings that must have a train in each; passages in which none is found stay as they are.
pub(super) fn corrected_where_trains_are(
    site: &Site,
    corrected: impl Fn(&Site) -> Result<Option<Site>, GapError>,
) -> Result<Option<Site>, GapError> {
    match corrected(site) {
        Err(GapError::SilentPassages { passage_id }) => {
            let Some(found) = corrected(&without(site, &passage_id))? else { return Ok(None) };
            let mut out = site.clone();
            for p in &mut out.passages {
                let same = found.passages.iter().find(|f| f.passage_id == p.passage_id);
                same.into_iter().for_each(|same| *p = same.clone());
            }
            Ok(Some(out))
        }
        found => found,
    }
}

/// The same of recordings that have a train in each.
fn without_bed(
    site: &Site,
    departures: &[Departure],
    progress: &dyn Progress,
) -> Result<Option<Site>, GapError> {
    let all: Vec<usize> = (0..site.passages.len()).collect();
    let searched = thinned(&all, SEARCH_PASSAGES);
    let (panel, prior) = with_path(site, &all, progress);
    let task = Task {
        site: &panel,
        searched: &searched,
        prior: &prior,
        sensor: SensorModel::default(),
        refits: REFITS,
    };
    let Some(mut model) = OpenBed::fitted(task, &combinations(departures), progress)? else {
        return Ok(None);
    };
    // Fits are to the mean of the bogies, whose path is blurred; forces are those of a wheel.
    model.world.path.blur_m = 0.0;
    let bed = Bed { gap_m: Vec::new(), doubling_m: None, ..model.world.bed.clone() };
    let linear = World { bed, ..model.world.clone() };
    progress.begin("recordings as on a linear bed", model.base.frame.observed.len() as u64);
    let added = model.traces(|_, whole, o| {
        progress.step();
        let there = Simulator::new(&linear, o.axle_load_kg)?.with_bogies(&o.bogie_m);
        Ok(vec![(whole.beyond(&there, o.speed_m_s)?, 1.0, true)])
    })?;
    Ok(Some(less(site, &added)))
}

/// Every choice of one form of each.
fn combinations(departures: &[Departure]) -> Vec<Vec<Form>> {
    departures.iter().fold(vec![Vec::new()], |chosen, departure| {
        let with = |form: &Form| {
            chosen.iter().map(|c| [c.as_slice(), std::slice::from_ref(form)].concat()).collect::<Vec<_>>()
        };
        departure.iter().flat_map(with).collect()
    })
}
