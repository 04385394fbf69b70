//! Models over beds that are not linear: which form such an effect has, and what whole trains do there.
//!
//! Where an effect may have several forms (a void under three sleepers or under five), each is fitted, from a base model of its own:
//! derivatives by the path do not hold from one to the other. The fits take a train for the sum of its bogies. Over a bed that opens it is
//! not: a bogie meets sleepers that still swing behind the one before, and what whole trains make of the sensor beyond that sum is
//! simulated and taken off the recordings that are fitted.

use rayon::prelude::*;

use super::GapError;
use super::base::{Base, Form, Given, PathPrior, base};
use super::data::Observed;
use super::diagnosis::thinned;
use super::effect::Effect;
use super::fit::{Fit, Frame, State, replaced, settled};
use super::forward::{Detail, Response, Simulator};
use super::measure::{Missed, missed_by};
use super::world::{SensorModel, World};
use crate::progress::Progress;
use crate::recording::Site;
use crate::signal::{AntiAlias, filtered};

/// Passages that tell the form: of five and more the wrong one misses 1.7 to 6 times as much on four sites.
const FORM_PASSAGES: usize = 6;

/// What a model over such a bed is fitted to.
#[derive(Clone, Copy)]
pub struct Task<'a> {
    /// Recordings, and the panel as it is described.
    pub site: &'a Site,
    /// Passages that are fitted, among all of the site.
    pub searched: &'a [usize],
    /// Prior of the path.
    pub prior: &'a PathPrior,
    /// What is known of the recorder.
    pub sensor: SensorModel,
    /// Most fits to recordings from which that is taken what whole trains do beyond their bogies, each with that of the fit before: of
    /// the squares missed of the displacement of four sites over voids the first leaves a fifth to three fifths, the second takes 2 to
    /// 27 % off those, a third nothing.
    pub refits: usize,
}

/// A site with a bed that is not linear.
pub struct OpenBed {
    /// Base model over the bed at which the fit began.
    pub base: Base,
    /// The effects, in the form that agrees best.
    pub effects: Vec<&'static dyn Effect>,
    /// Their fit.
    pub fit: Fit,
    /// The model.
    pub world: World,
    /// Where every passage is in it, metres.
    pub shift_m: Vec<f64>,
    /// What it misses of the passages that it is fitted to, `[acceleration, displacement]`.
    pub missed: [Missed; 2],
    /// What was taken off the recordings before the fit, because whole trains do it beyond the sum of their bogies.
    pub beyond: Vec<Trace>,
}

/// What is added to the recording of a passage.
pub struct Trace {
    /// As in the recordings.
    pub passage_id: i32,
    parts: Vec<Part>,
    /// Recorder times at which a train begins, and its bogies, s.
    starts_s: [Vec<f64>; 2],
}

/// A response, how many times it counts, and whether it is that of a whole train or of each of its bogies.
pub type Part = (Response, f64, bool);

impl Trace {
    /// Values at `count` recorder times from `first_s` on, in steps, s; m/s².
    pub fn at(&self, first_s: f64, step_s: f64, count: usize) -> Vec<f64> {
        let mut sum = vec![0.0; count];
        for (response, times, of_train) in &self.parts {
            response.add_train(&self.starts_s[usize::from(!of_train)], *times, first_s, step_s, &mut sum);
        }
        sum
    }
}

impl OpenBed {
    /// Fits the choice of forms that agrees best, and fits it again without what whole trains do; `None` where there is none to choose.
    pub fn fitted(
        task: Task,
        forms: &[Vec<Form>],
        progress: &dyn Progress,
    ) -> Result<Option<Self>, GapError> {
        progress.begin("model of the bed that is not linear", (forms.len() + 1 + task.refits) as u64);
        let Some((form, model)) = best_form(task, forms, progress)? else { return Ok(None) };
        let mut model = model.map_or_else(|| Self::of(task, form), Ok)?;
        progress.step();
        for _ in 0..task.refits {
            let beyond = model.beyond_its_bogies()?;
            let alone = less(task.site, &beyond);
            let next = Self { beyond, ..Self::of(Task { site: &alone, ..task }, form)? };
            progress.step();
            if next.misfit() >= model.misfit() {
                break;
            }
            model = next;
        }
        Ok(Some(model))
    }

    fn of(task: Task, form: &[Form]) -> Result<Self, GapError> {
        let Task { site, searched, prior, sensor, .. } = task;
        let base = base(
            site,
            searched,
            searched,
            prior,
            &Given { effects: form.to_vec(), ..Given::recorder(sensor) },
        )?;
        let frame = &base.frame;
        let (effects, coordinates): (Vec<&'static dyn Effect>, Vec<Vec<f64>>) = form.iter().cloned().unzip();
        let start = State { effects: coordinates, ..base.fit.state.clone() };
        let fit = on_a_bed_as_there_are(frame, &effects, start, searched)?;
        let world = fit.state.world(frame, &effects);
        let missed = missed_by(frame, &world, &[], searched)?;
        let others: Vec<usize> = (0..frame.observed.len()).filter(|i| !searched.contains(i)).collect();
        let shift_m = replaced(frame, &effects, fit.state.clone(), (&others, Detail::Full)).shift_m;
        Ok(Self { effects, fit, world, shift_m, missed, beyond: Vec::new(), base })
    }

    /// Squares of what it misses of the displacement: there a bed and its form show; the acceleration is the wheels'.
    fn misfit(&self) -> f64 {
        self.missed[1].all
    }

    /// What whole trains make of the sensor beyond the sum of their bogies.
    fn beyond_its_bogies(&self) -> Result<Vec<Trace>, GapError> {
        self.traces(|one, whole, o| {
            Ok(vec![(whole.response(o.speed_m_s)?, 1.0, true), (one.response(o.speed_m_s)?, -1.0, false)])
        })
    }

    /// Sums of responses in every recording; `of` one bogie and the whole train.
    pub fn traces(
        &self,
        of: impl Fn(&Simulator, &Simulator, &Observed) -> Result<Vec<Part>, GapError> + Sync,
    ) -> Result<Vec<Trace>, GapError> {
        let trace = |(o, shift_m): (&Observed, &f64)| {
            let one = Simulator::new(&self.world, o.axle_load_kg)?;
            let whole = one.with_bogies(&o.bogie_m);
            let first_s = o.first_axle_s + shift_m / o.speed_m_s;
            let bogies_s: Vec<f64> = o.bogie_s().iter().map(|s| first_s + s).collect();
            let train_s = bogies_s[..bogies_s.len().min(1)].to_vec();
            let parts = of(&one, &whole, o)?;
            Ok(Trace { passage_id: o.passage_id, parts, starts_s: [train_s, bogies_s] })
        };
        self.base.frame.observed.par_iter().zip(&self.shift_m).map(trace).collect()
    }
}

/// The choice of forms with which a few passages are missed by least, and its model where those are all that are searched.
fn best_form<'f>(
    task: Task,
    forms: &'f [Vec<Form>],
    progress: &dyn Progress,
) -> Result<Option<(&'f Vec<Form>, Option<OpenBed>)>, GapError> {
    let [first, others @ ..] = forms else { return Ok(None) };
    if others.is_empty() {
        return Ok(Some((first, None)));
    }
    let few = thinned(task.searched, FORM_PASSAGES);
    let are_all = few.len() == task.searched.len();
    let site = task.site.with_passages(few.iter().map(|i| task.site.passages[*i].clone()).collect());
    let of_few: Vec<usize> = (0..few.len()).collect();
    let task = if are_all { task } else { Task { site: &site, searched: &of_few, ..task } };
    let mut best: Option<(f64, &Vec<Form>, Option<OpenBed>)> = None;
    for form in forms {
        let model = OpenBed::of(task, form)?;
        let misfit = model.misfit();
        progress.step();
        if best.as_ref().is_none_or(|(least, ..)| misfit < *least) {
            // A model keeps what it has simulated; one of a few passages is of no use any more.
            best = Some((misfit, form, are_all.then_some(model)));
        }
    }
    Ok(best.map(|(_, form, model)| (form, model)))
}

/// A site without what is added to its recordings.
pub fn less(site: &Site, traces: &[Trace]) -> Site {
    let sensor = &site.crossing.sensor;
    let antialias = AntiAlias::new(sensor.antialias_order, sensor.antialias_hz);
    let mut out = site.clone();
    for p in &mut out.passages {
        let (rate_hz, count) = (p.sample_rate_hz, p.acceleration_m_s2.len());
        for trace in traces.iter().filter(|t| t.passage_id == p.passage_id) {
            // The recorder's low-pass is undone in the model's accelerations.
            let added = filtered(&trace.at(0.0, 1.0 / rate_hz, count), rate_hz, |f| antialias.response(f));
            p.acceleration_m_s2.iter_mut().zip(added).for_each(|(a, t)| *a -= t as f32);
        }
    }
    out
}

/// Fit from `start` and, where that ends on ballast as hardly any is, from nominal ballast; the more probable of the two.
fn on_a_bed_as_there_are(
    frame: &Frame,
    effects: &[&dyn Effect],
    start: State,
    searched: &[usize],
) -> Result<Fit, GapError> {
    let nominal = start.on_nominal_ballast();
    let first = settled(frame, effects, start, searched)?;
    if !first.state.odd_bed() {
        return Ok(first);
    }
    let again = settled(frame, effects, nominal, searched)?;
    Ok(if again.log_posterior > first.log_posterior { again } else { first })
}
