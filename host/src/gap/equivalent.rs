//! Recordings as they would be on a linear bed under the same wheel forces: what a void or ballast that stiffens adds to them is
//! simulated and taken off.
//!
//! The identification is linear: of a recording over a void it makes forces that are a third wrong. The forward model knows the void.
//! Fitted with it, it says what the sensor shows and which forces act, and the same forces on a linear bed say what the sensor would
//! show there. The difference of the two is what makes the recording other than linear; how the true forces differ from those of the
//! model is left to the identification, to which it is small. Where an effect may have several forms (a void under three sleepers or
//! under five), each is fitted, from a base model of its own: derivatives by the path do not hold from one to the other.

use rayon::prelude::*;

use super::GapError;
use super::base::{Base, Given, PathPrior, base, nominal_world};
use super::data::Observed;
use super::diagnosis::{SEARCH_PASSAGES, thinned, without};
use super::effect::Effect;
use super::estimated_path::with_path;
use super::fit::{State, replaced, settled};
use super::forward::{Detail, Response, Simulator};
use super::measure::missed_by;
use super::world::{Bed, World};
use crate::ballast::BallastParameters;
use crate::progress::Progress;
use crate::recording::Site;
use crate::signal::filtered;

/// A form of an effect by which a bed is not linear, with the coordinates of its parameters at which a fit begins.
pub type Form = (&'static dyn Effect, Vec<f64>);
/// Such an effect in the forms that it may have.
pub type Departure = Vec<Form>;

/// The site with recordings as on a linear bed. Passages in which no train is found stay as they are.
pub fn on_linear_bed(
    site: &Site,
    departures: &[Departure],
    progress: &dyn Progress,
) -> Result<Site, GapError> {
    let added = match added_by(site, departures, progress) {
        Err(GapError::SilentPassages { passage_id }) => {
            added_by(&without(site, &passage_id), departures, progress)?
        }
        added => added?,
    };
    Ok(less(site, &added))
}

/// What the departures add to every recording, by its passage, m/s² at its rate.
fn added_by(
    site: &Site,
    departures: &[Departure],
    progress: &dyn Progress,
) -> Result<Vec<(i32, Vec<f64>)>, GapError> {
    let all: Vec<usize> = (0..site.passages.len()).collect();
    let searched = thinned(&all, SEARCH_PASSAGES);
    let (panel, prior) = with_path(site, &all, progress);
    let forms = combinations(departures);
    progress.begin("model of the bed that is not linear", (forms.len() + WHOLE_TRAINS) as u64);
    let mut best: Option<(Model, &Vec<Form>)> = None;
    for form in &forms {
        let model = modelled(&panel, (form, &searched), &prior)?;
        progress.step();
        if best.as_ref().is_none_or(|(best, _)| model.missed < best.missed) {
            best = Some((model, form));
        }
    }
    let Some((mut model, form)) = best else { return Ok(Vec::new()) };
    for _ in 0..WHOLE_TRAINS {
        let alone = less(&panel, &model.beyond_its_bogies()?);
        let next = modelled(&alone, (form, &searched), &prior)?;
        progress.step();
        if next.missed >= model.missed {
            break;
        }
        model = next;
    }
    // Fits are to the mean of the bogies, whose path is blurred; forces are those of a wheel.
    model.world.path.blur_m = 0.0;
    let bed = Bed { gap_m: Vec::new(), doubling_m: None, ..model.world.bed.clone() };
    let linear = World { bed, ..model.world.clone() };
    progress.begin("recordings as on a linear bed", model.base.frame.observed.len() as u64);
    model.traces(|_, whole, o| {
        progress.step();
        let there = Simulator::new(&linear, o.axle_load_kg)?.with_bogies(&o.bogie_m);
        Ok(vec![(whole.beyond(&there, o.speed_m_s)?, 1.0, true)])
    })
}

/// Fits to recordings from which that is taken what whole trains do beyond their bogies, each with that of the fit before: of the squares
/// missed of the displacement of four sites over voids the first leaves a fifth to three fifths, the second takes 2 to 27 % off those, a
/// third nothing.
const WHOLE_TRAINS: usize = 2;

/// Every choice of one form of each.
fn combinations(departures: &[Departure]) -> Vec<Vec<Form>> {
    departures.iter().fold(vec![Vec::new()], |chosen, departure| {
        let with = |form: &Form| {
            chosen.iter().map(|c| [c.as_slice(), std::slice::from_ref(form)].concat()).collect::<Vec<_>>()
        };
        departure.iter().flat_map(with).collect()
    })
}

/// Bed with the effects where the fit begins.
fn bed_with(site: &Site, form: &[Form]) -> Result<Bed, GapError> {
    let mut world = nominal_world(site, BallastParameters::NOMINAL)?;
    for (effect, coordinates) in form {
        let values: Vec<f64> =
            effect.parameters().iter().zip(coordinates).map(|(p, c)| p.value(*c)).collect();
        effect.apply(&mut world, &values);
    }
    Ok(world.bed)
}

/// The site with a bed that is not linear.
struct Model {
    base: Base,
    world: World,
    /// Where every passage is in it, metres.
    shift_m: Vec<f64>,
    /// Squares of what it misses of the displacement in the passages that it is fitted to, over what was measured: there a bed shows,
    /// and the wrong form misses twice to five times as much; the acceleration is the wheels'.
    missed: f64,
}

/// A response, how many times it counts, and whether it is that of a whole train or of each of its bogies.
type Part = (Response, f64, bool);

fn modelled(
    site: &Site,
    (form, searched): (&[Form], &[usize]),
    prior: &PathPrior,
) -> Result<Model, GapError> {
    let given = Given { bed: bed_with(site, form)?, ..Given::default() };
    let base = base(site, searched, searched, prior, &given)?;
    let frame = &base.frame;
    let (effects, coordinates): (Vec<&dyn Effect>, Vec<Vec<f64>>) = form.iter().cloned().unzip();
    let start = State { effects: coordinates, ..base.fit.state.clone() };
    let found = settled(frame, &effects, start, searched)?;
    let world = found.state.world(frame, &effects);
    let [_, displacement] = missed_by(frame, &world, &[], searched)?;
    let others: Vec<usize> = (0..frame.observed.len()).filter(|i| !searched.contains(i)).collect();
    let shift_m = replaced(frame, &effects, found.state, (&others, Detail::Full)).shift_m;
    Ok(Model { world, shift_m, missed: displacement.all, base })
}

impl Model {
    /// What whole trains make of the sensor beyond the sum of their bogies, which the fits take for it: over such a bed a bogie meets
    /// sleepers that still swing behind the one before.
    fn beyond_its_bogies(&self) -> Result<Vec<(i32, Vec<f64>)>, GapError> {
        self.traces(|one, whole, o| {
            Ok(vec![(whole.response(o.speed_m_s)?, 1.0, true), (one.response(o.speed_m_s)?, -1.0, false)])
        })
    }

    /// Sums of responses in every recording, by its passage, m/s² at its rate; `of` one bogie and the whole train.
    fn traces(
        &self,
        of: impl Fn(&Simulator, &Simulator, &Observed) -> Result<Vec<Part>, GapError> + Sync,
    ) -> Result<Vec<(i32, Vec<f64>)>, GapError> {
        let trace = |(o, shift_m): (&Observed, &f64)| {
            let one = Simulator::new(&self.world, o.axle_load_kg)?;
            let whole = one.with_bogies(&o.bogie_m);
            let (rate_hz, mut sum) = (o.recording.rate_hz, vec![0.0; o.recording.len]);
            let first_s = o.first_axle_s + shift_m / o.speed_m_s;
            let bogies_s: Vec<f64> = o.bogie_s().iter().map(|s| first_s + s).collect();
            for (response, times, of_train) in of(&one, &whole, o)? {
                let starts = if of_train { &bogies_s[..bogies_s.len().min(1)] } else { &bogies_s };
                response.add_train(starts, times, 0.0, 1.0 / rate_hz, &mut sum);
            }
            // The recorder's low-pass is undone in the model's accelerations.
            Ok((o.passage_id, filtered(&sum, rate_hz, |f| one.antialias().response(f))))
        };
        self.base.frame.observed.par_iter().zip(&self.shift_m).map(trace).collect()
    }
}

/// The site with traces taken off its recordings.
fn less(site: &Site, traces: &[(i32, Vec<f64>)]) -> Site {
    let mut out = site.clone();
    for (passage_id, trace) in traces {
        let of_it = out.passages.iter_mut().filter(|p| p.passage_id == *passage_id);
        of_it.flat_map(|p| p.acceleration_m_s2.iter_mut()).zip(trace).for_each(|(a, t)| *a -= *t as f32);
    }
    out
}
