//! The diagnosis of a site: base model, search for effects, verdict, and what is left of the gap on held-out passages.

use std::time::Instant;

use faer::Mat;

use super::GapError;
use super::base::{Base, PathPrior, base, fit_variation};
use super::consistency::Strangers;
use super::effect::{Effect, Hints, Scale, Stage};
use super::effects::{COMMON, LATENT};
use super::fit::{Fit, FitOptions, OPERATOR_SD, State, fit, simulate, whitened};
use super::forward::Response;
use super::latent::{Latent, LatentFit, Scene};
use super::measure::{Gap, Prediction, measure, predictions};
use super::node_stage::{NOTABLE, node_gap};
use super::select::{Tried, gain, round};
use super::split::{Split, split};
use super::verdict::{Verdict, verdict};
use crate::progress::Progress;
use crate::recording::Site;

/// Choices of a diagnosis.
#[derive(Clone, Debug, Default)]
pub struct DiagnoseOptions {
    /// Say where, not which.
    pub quick: bool,
    /// Effects that are left out of the catalogue.
    pub exclude: Vec<String>,
}

/// One effect in the verdict.
#[derive(Clone, Debug)]
pub struct Named {
    /// Name in the contract.
    pub name: &'static str,
    /// Place in the chain.
    pub stage: Stage,
    /// Probability that it acts, given the catalogue.
    pub probability: f64,
    /// Name, value, 90 % interval.
    pub parameters: Vec<(&'static str, f64, f64, f64)>,
    /// Effects that the recordings cannot tell from it.
    pub indistinguishable_from: Vec<&'static str>,
    /// What it took off the residual of the training passages, RMS: of the acceleration relative to the wheels' scatter, or
    /// half of that of the displacement relative to what is left, whichever is more.
    pub gained: f64,
}

/// An effect that was tried.
#[derive(Clone, Debug)]
pub struct Ranked {
    /// Name in the contract.
    pub name: &'static str,
    /// Place in the chain.
    pub stage: Stage,
    /// Probability.
    pub probability: f64,
    /// Gain in log evidence per independent look in the round in which it did best.
    pub gain: f64,
    /// Gap on the held-out passages with everything named, for a named effect; that of the base model for the others.
    pub gap_after: f64,
}

/// Result of a diagnosis.
#[derive(Clone, Debug)]
pub struct Diagnosis {
    /// The verdict.
    pub verdict: Verdict,
    /// Effects in the order of their discovery.
    pub effects: Vec<Named>,
    /// All effects of the catalogue.
    pub ranking: Vec<Ranked>,
    /// Gap on the held-out passages.
    pub gap: Gap,
    /// Stage of the chain that the gap points to.
    pub stage: Option<Stage>,
    /// What the residual of the base model varies with.
    pub depends_on: Vec<&'static str>,
    /// Positions x of the front axle at which the base model is off, metres.
    pub position_m: Vec<[f64; 2]>,
    /// Error that the node's codes, arithmetic and decimation alone make, RMS relative to the signal.
    pub node_gap: Option<f64>,
    /// Predictions of the held-out passages.
    pub predictions: Vec<Prediction>,
    /// Cosines between the directions of effects after the base model has taken its share.
    pub cosines: Vec<(&'static str, &'static str, f64)>,
    /// What could not be told, and why.
    pub remarks: Vec<String>,
    /// Residuals of the base model for figures: speed, temperature, travel of the front axle, values.
    pub residuals: Vec<Residual>,
    /// Passages left out by the reader.
    pub skipped: usize,
    /// What including the effects changes in the results, where it was asked for.
    pub consequences: Option<super::consequences::Consequences>,
    /// Time taken, s; not part of any result file.
    pub seconds: f64,
}

/// Residual of the base model for one passage, mean over its bogies.
#[derive(Clone, Debug)]
pub struct Residual {
    /// As in the recordings.
    pub passage_id: i32,
    /// m/s.
    pub speed_m_s: f64,
    /// °C.
    pub temperature_c: f64,
    /// Position x of the front axle, metres.
    pub position_m: Vec<f64>,
    /// Base model, m/s².
    pub before: Vec<f64>,
    /// Corrected model, m/s².
    pub after: Vec<f64>,
    /// Factor by which the base model's mean window would fit best, less 1.
    pub scale_error: f64,
    /// Held out.
    pub held_out: bool,
}

/// Most effects in a verdict.
const MOST_EFFECTS: usize = 3;
/// Gain in log evidence per independent look below which an effect is not named. Reference recordings with room for an
/// effect reach 12, the weakest known effect 30: `docs/diagnosis.md`.
const LEAST_GAIN: f64 = 20.0;
/// Share of the misfit (weighted squares) that an effect must explain: 0.023 against 0.037 there.
const LEAST_SHARE: f64 = 0.03;
/// How far the base model must be above the scatter of the wheels, in quadrature, for an effect of the panel to be looked
/// for. One reference recording, at 0.09, has nothing to explain, but a structured error with a high gain; the weakest
/// known effect is at 0.21.
const LEAST_EXCESS: f64 = 0.15;
/// Energy of an effect of single wheels or recordings relative to their scatter.
const LATENT_SHARE: f64 = 0.1;
/// What an effect must take off the residual, RMS relative to the wheels' scatter: the first one named, and further ones,
/// which may only mend the description of the first.
const LEAST_GAINED: (f64, f64) = (0.15, 0.3);
/// An effect of single recordings also counts when it explains this part of the residual's displacement: slow shifts have no
/// energy worth mentioning in the acceleration.
const DISPLACEMENT_SHARE: f64 = 0.5;
/// Candidates within this of the best are not told apart.
const SAME_GAIN: f64 = 4.0;
/// Standard deviation of the path around the scan and of the stock rail, metres: as the reference recordings have it.
const PATH_PRIOR: PathPrior = PathPrior { inside_m: 10e-6, outside_m: 20e-6, stock_m: 15e-6 };
/// Passages used for the search; all training passages for the final fit.
const SEARCH_PASSAGES: usize = 12;

/// Passages needed to look for an effect.
const LEAST_PASSAGES: usize = 4;
/// A scan is another crossing's when more than this part of the residual's energy is common to all wheels, when the path
/// that fits instead differs from it by this part of its own energy, and when that leaves less than this of the common part.
const FOREIGN_SCAN: (f64, f64, f64) = (0.7, 0.3, 0.5);

/// Squared misfit per value of the model that clips too, above which no further effect is looked for.
const CLIPPED_MISFIT: f64 = 4.0;

/// Diagnoses a site.
pub fn diagnose(
    site: &Site,
    options: &DiagnoseOptions,
    progress: &dyn Progress,
) -> Result<Diagnosis, GapError> {
    let clock = Instant::now();
    progress.begin("base model", 1);
    let split = split(site);
    let search = thinned(&split.train, SEARCH_PASSAGES);
    let mut base = base(site, &split.train, &search, &PATH_PRIOR, None)?;
    progress.step();
    let before = base.fit.state.world(&base.frame, &[]);
    // Flat tops are seen without any model, and nothing else can be learnt before they are in it.
    let clips = super::effects::saturation::flat_top_m_s2(site)
        .filter(|_| !options.quick && !options.exclude.iter().any(|e| e == "saturation"));
    if clips.is_some() {
        base = super::base::base(site, &split.train, &search, &PATH_PRIOR, clips)?;
    }
    let mut session = Session::new(site, options, &split, &search, &mut base);
    let mut searched = !options.quick;
    if let Some(range_m_s2) = clips {
        session.saturated(range_m_s2);
        // What clipping has destroyed cannot be searched.
        if session.inflation(&session.base.fit) > CLIPPED_MISFIT {
            session.remarks.push(
                "the recordings clip so much that nothing else can be told from them; use a sensor with a larger range".into(),
            );
            searched = false;
        }
    }
    searched &= session.trustworthy(site, &before);
    if searched {
        session.search(progress)?;
    }
    let mut out = session.conclude(&before, progress)?;
    out.skipped = site.skipped.len();
    out.node_gap = node_gap(site);
    if let Some(gap) = out.node_gap.filter(|g| *g > NOTABLE) {
        out.remarks.push(format!(
            "the node's own sampling and arithmetic would change the signal by {:.1} %; see whether its range fits",
            100.0 * gap
        ));
    }
    out.seconds = clock.elapsed().as_secs_f64();
    Ok(out)
}

/// Evenly spread part of a list.
fn thinned(list: &[usize], most: usize) -> Vec<usize> {
    if list.len() <= most {
        return list.to_vec();
    }
    (0..most).map(|k| list[k * list.len() / most]).collect()
}

/// State of a search.
struct Session<'a> {
    split: &'a Split,
    search: &'a [usize],
    base: &'a mut Base,
    hints: Hints,
    common: Vec<&'static dyn Effect>,
    latent: Vec<&'static dyn Latent>,
    accepted: Vec<&'static dyn Effect>,
    fit: Option<Fit>,
    latent_fits: Vec<(&'static dyn Latent, LatentFit)>,
    named: Vec<Named>,
    ranking: Vec<Ranked>,
    cosines: Vec<(&'static str, &'static str, f64)>,
    remarks: Vec<String>,
    foreign_scan: bool,
    /// The recordings or the scan cannot be what they are said to be: no gap of theirs means anything.
    untrusted: bool,
    /// How far the current model's residual is above the scatter of the wheels (in squares, relative), and that scatter.
    scatter: (f64, f64),
}

/// A latent effect, what it found, and the part of the displacement's residual that this explains.
type Explored = (&'static dyn Latent, Option<LatentFit>, f64);

/// Part of the displacement's residual of the training passages that an effect explains.
fn displacement_share(scene: &Scene, found: &LatentFit) -> f64 {
    let (mut before, mut after) = (0.0, 0.0);
    for i in scene.train {
        let residual = &scene.traces[*i].residual;
        let left: Vec<f64> = residual.iter().zip(&found.traces[*i]).map(|(r, f)| r - f).collect();
        let energy = |a: &[f64]| super::measure::displacement(a).iter().map(|d| d * d).sum::<f64>();
        (before, after) = (before + energy(residual), after + energy(&left));
    }
    1.0 - after / before.max(f64::MIN_POSITIVE)
}

/// A model before the last effect.
struct Confirmed {
    squares: [f64; 3],
    named: usize,
    accepted: usize,
    fit: Option<Fit>,
}

/// One candidate of a round.
struct Candidate {
    name: &'static str,
    stage: Stage,
    gain: f64,
    misfit_gain: f64,
    full: bool,
}

impl<'a> Session<'a> {
    fn new(
        site: &Site,
        options: &DiagnoseOptions,
        split: &'a Split,
        search: &'a [usize],
        base: &'a mut Base,
    ) -> Self {
        let left_in = |name: &str| !options.exclude.iter().any(|e| e == name);
        let largest_m_s2 = base.frame.observed.iter().map(|o| o.recording.max_m_s2).fold(0.0, f64::max);
        let mut session = Self {
            split,
            search,
            hints: Hints { largest_m_s2 },
            common: COMMON.iter().copied().filter(|e| left_in(e.name())).collect(),
            latent: LATENT.iter().copied().filter(|e| left_in(e.name())).collect(),
            accepted: Vec::new(),
            fit: None,
            latent_fits: Vec::new(),
            named: Vec::new(),
            ranking: Vec::new(),
            cosines: Vec::new(),
            remarks: Vec::new(),
            foreign_scan: false,
            untrusted: false,
            scatter: (0.0, 0.0),
            base,
        };
        session.remark_on(site);
        session
    }

    /// The transducer clips; this is known before any search.
    fn saturated(&mut self, range_m_s2: f64) {
        let parameters = vec![("range_m_s2", range_m_s2, 0.97 * range_m_s2, 1.03 * range_m_s2)];
        let (name, stage) = ("saturation", Stage::Sensor);
        self.named.push(Named {
            name,
            stage,
            probability: MOST_SURE,
            parameters,
            indistinguishable_from: Vec::new(),
            gained: f64::NAN,
        });
        self.ranking.push(Ranked {
            name,
            stage,
            probability: MOST_SURE,
            gain: f64::INFINITY,
            gap_after: f64::NAN,
        });
    }

    /// What the site does not allow to tell.
    fn remark_on(&mut self, site: &Site) {
        let spread = |v: Vec<f64>| {
            let (l, h) =
                v.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(*x), h.max(*x)));
            h - l
        };
        let observed = &self.base.frame.observed;
        let mut say = |text: &str| self.remarks.push(text.into());
        if observed.len() < 6 {
            say(
                "few passages: effects that vary from train to train cannot be told from chance; record at least 12",
            );
        }
        if site.scan.is_none() {
            say(
                "no laser scan: load, unsprung mass and depth of the crossing trade against each other; a scan separates them",
            );
        }
        if observed.iter().all(|o| o.operator_m_s.is_none()) {
            say(
                "no speeds from the operator: a clock error of less than 1 % cannot be told from ballast; state the speeds",
            );
        }
        if observed.len() > 1 && spread(observed.iter().map(|o| o.temperature_c).collect()) < 5.0 {
            say(
                "constant temperature: a sensitivity that depends on it cannot be seen; record on days that differ by 10 K",
            );
        }
        let v: Vec<f64> = observed.iter().map(|o| o.speed_m_s).collect();
        if observed.len() > 1 && spread(v.clone()) < 0.05 * crate::signal::mean(&v) {
            say(
                "constant speed: what is fixed in time cannot be told from what is fixed along the track; record other speeds",
            );
        }
        if observed.len() > 1 && spread(observed.iter().map(|o| o.axle_load_kg).collect()) < 100.0 {
            say(
                "one axle load: voids, axle load and stiffness are told apart by their shape only; a lighter train would separate them",
            );
        }
    }

    /// Whether there is enough, and one crossing only, to look for effects in. What is wrong is said.
    fn trustworthy(&mut self, site: &Site, before: &super::world::World) -> bool {
        let observed = &self.base.frame.observed;
        if observed.len() < LEAST_PASSAGES {
            self.remarks.push(format!(
                "{} passages: no effect is looked for, chance would name one; record at least {LEAST_PASSAGES}",
                observed.len()
            ));
            return false;
        }
        let strangers = Strangers::among(observed);
        if strangers.matter() {
            self.untrusted = true;
            self.remarks.push(format!(
                "passages {:?} do not resemble the others: recordings of more than one crossing, direction or sensor position; \
                 sort them, no effect is looked for",
                strangers.passage_id
            ));
            return false;
        }
        if site.scan.is_none() && observed.iter().all(|o| o.operator_m_s.is_none()) {
            self.remarks.push(
                "neither a laser scan nor speeds: path, load and clock take over from one another; no effect is looked for, add \
                 one of the two"
                    .into(),
            );
            return false;
        }
        if site.scan.is_some() && self.scan_is_foreign(site, before) {
            self.remarks.push(
                "the laser scan does not belong to these recordings: without it they are predicted far better, over another \
                 path; scan again, no effect is looked for"
                    .into(),
            );
            (self.foreign_scan, self.untrusted) = (true, true);
            return false;
        }
        true
    }

    /// Whether another path than the scan's predicts the recordings far better.
    fn scan_is_foreign(&self, site: &Site, before: &super::world::World) -> bool {
        let excess = |b: &Base| -> Option<f64> {
            let world = b.fit.state.world(&b.frame, &[]);
            let responses = simulate(&world, &b.frame, self.search).ok()?;
            let residuals: Vec<Vec<Vec<f64>>> = self
                .search
                .iter()
                .zip(&responses)
                .map(|(i, r)| {
                    let o = &b.frame.observed[*i];
                    o.window_residuals(r, 1.0, o.lag(r, 1.0, ALIGN_M / o.speed_m_s))
                })
                .collect();
            let ratio = |w: &Vec<Vec<f64>>| {
                let k = w.len() as f64;
                let all: f64 = w.iter().flatten().map(|v| v * v).sum();
                let mean: f64 = super::data::mean_of(w).iter().map(|v| v * v).sum();
                k * mean / all.max(f64::MIN_POSITIVE)
            };
            Some(crate::signal::quantile(&residuals.iter().map(ratio).collect::<Vec<_>>(), 0.5))
        };
        let with = excess(self.base).unwrap_or(0.0);
        if with < FOREIGN_SCAN.0 {
            return false;
        }
        let mut bare = site.clone();
        bare.scan = None;
        let Ok(free) = base(&bare, self.search, self.search, &PATH_PRIOR, None) else { return false };
        let world = free.fit.state.world(&free.frame, &[]);
        let (mut off, mut own) = (0.0, 0.0);
        for k in -40..=40 {
            let x = 0.3 + 0.01 * f64::from(k);
            let (a, b) = (before.path.scan.at(x), world.path.at(crate::track::Side::Crossing, x));
            off += (a - b).powi(2);
            own += a * a;
        }
        off > FOREIGN_SCAN.1 * own && excess(&free).is_some_and(|without| without < FOREIGN_SCAN.2 * with)
    }

    fn state(&self) -> State {
        self.fit.as_ref().map_or_else(|| self.base.fit.state.clone(), |f| f.state.clone())
    }

    /// Squared misfit per value, at least 1: how far the model is from explaining the mean windows.
    fn inflation(&self, fit: &Fit) -> f64 {
        let (sum, n) = fit.passages.iter().fold((0.0, 0.0), |(s, n), p| {
            let r = p.residual.col_as_slice(0);
            (s + r.iter().map(|v| v * v).sum::<f64>(), n + r.len() as f64)
        });
        (sum / n).max(1.0)
    }

    fn search(&mut self, progress: &dyn Progress) -> Result<(), GapError> {
        for number in self.named.len()..MOST_EFFECTS {
            progress.begin(&format!("effects, round {}", number + 1), 2);
            let earlier = Confirmed {
                squares: self.current_squares()?,
                named: self.named.len(),
                accepted: self.accepted.len(),
                fit: self.fit.clone(),
            };
            if !self.one_round(number, &earlier, progress)? {
                break;
            }
        }
        Ok(())
    }

    /// Tries everything on top of what is accepted; accepts the best if it is good enough.
    fn one_round(
        &mut self,
        number: usize,
        earlier: &Confirmed,
        progress: &dyn Progress,
    ) -> Result<bool, GapError> {
        let mut latent = self.explore()?;
        progress.step();
        let names: Vec<&str> = self.named.iter().map(|n| n.name).collect();
        let candidates: Vec<&'static dyn Effect> =
            self.common.iter().copied().filter(|e| !names.contains(&e.name())).collect();
        let state = self.state();
        let reference =
            fit(&self.base.frame, &self.accepted, state.clone(), self.search, FitOptions::THOROUGH)?;
        let (mut tried, screening) = round(
            &self.base.frame,
            (&self.accepted, &reference.state),
            &candidates,
            &self.hints,
            self.search,
        )?;
        if self.cosines.is_empty() {
            self.cosines = cosines(&screening, &candidates);
        }
        progress.step();
        let mut list = self.candidates(&tried, &reference, &latent);
        let misfit: f64 = reference.passages.iter().map(|p| squares(&p.residual)).sum();
        for c in &mut list {
            c.gain = if self.worth_naming(c, number, misfit) { c.gain } else { c.gain.min(0.5 * LEAST_GAIN) };
        }
        list.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        self.rank(&list);
        // The best that also takes something off the residual.
        for k in 0..list.len() {
            if list[k].gain <= LEAST_GAIN {
                break;
            }
            // What was taken back is no alternative any more.
            self.rank(&list[k..]);
            self.accept(&list[k..], &mut tried, &mut latent)?;
            if self.confirm(earlier)? {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Whether an effect explains enough to be named.
    fn worth_naming(&self, c: &Candidate, number: usize, misfit: f64) -> bool {
        // A model as good as the scatter of the wheels has nothing to explain, unless the gain comes from elsewhere.
        let excess = self.scatter.0.max(0.0).sqrt();
        let room = excess > LEAST_EXCESS || c.misfit_gain.is_infinite() || c.stage == Stage::Timing;
        // What the first effect's description leaves must not be taken for a second one.
        let (least_gain, least_share) =
            if number == 0 { (LEAST_GAIN, LEAST_SHARE) } else { (2.0 * LEAST_GAIN, 2.5 * LEAST_SHARE) };
        c.full && room && c.gain > least_gain && 2.0 * c.misfit_gain > least_share * misfit
    }

    fn candidates(&self, tried: &[Tried<'static>], reference: &Fit, latent: &[Explored]) -> Vec<Candidate> {
        // The best fit of the round tells how much of the misfit is left to chance.
        let inflation = tried
            .iter()
            .filter_map(|t| t.fit.as_ref())
            .map(|f| self.inflation(f))
            .fold(self.inflation(reference), f64::min);
        let common = tried.iter().map(|t| {
            let (gain, full) = match &t.fit {
                // A strength at the end of its range is no strength but a fit that found no other way.
                Some(f) => (
                    f.log_evidence - reference.log_evidence,
                    inside_ranges(t.effect, f) && large_enough(t.effect, f) && self.borne_out(t.effect, f),
                ),
                None => (t.screened.min(LEAST_GAIN), false),
            };
            let misfit_gain = t.fit.as_ref().map_or(0.0, |f| f.log_posterior - reference.log_posterior);
            Candidate {
                name: t.effect.name(),
                stage: t.effect.stage(),
                gain: gain / inflation,
                misfit_gain,
                full,
            }
        });
        let latent = latent.iter().map(|(e, f, moved)| {
            let share = f.as_ref().map_or(0.0, |f| self.share_of(f));
            let full = share > LATENT_SHARE || *moved > DISPLACEMENT_SHARE;
            let gain = f.as_ref().map_or(0.0, |f| f.gain) / LATENT_INFLATION;
            let gain = if full { gain } else { gain.min(0.5 * LEAST_GAIN) };
            Candidate { name: e.name(), stage: e.stage(), gain, misfit_gain: f64::INFINITY, full }
        });
        common.chain(latent).collect()
    }

    /// Whether what was recorded beside the acceleration bears an effect out: the operator's speeds a wrong clock, the
    /// temperatures a gain that follows them.
    fn borne_out(&self, effect: &dyn Effect, found: &Fit) -> bool {
        let observed = &self.base.frame.observed;
        let Some(coordinates) = found.state.effects.last() else { return true };
        match effect.name() {
            "clock-error" => {
                let relative = effect.parameters()[0].value(coordinates[0]);
                let ratios: Vec<f64> =
                    observed.iter().filter_map(|o| o.operator_m_s.map(|v| v / o.speed_m_s - 1.0)).collect();
                let sd = OPERATOR_SD / (ratios.len().max(1) as f64).sqrt();
                ratios.is_empty() || (crate::signal::mean(&ratios) - relative).abs() < CLOCK_SPREAD * sd
            }
            "gain-temperature" => {
                let train = &self.split.train;
                let of =
                    |value: &dyn Fn(usize) -> f64| -> Vec<f64> { train.iter().map(|i| value(*i)).collect() };
                let scales = of(&|i| self.scale_of(i));
                let temperatures = of(&|i| observed[i].temperature_c);
                let speeds = of(&|i| observed[i].speed_m_s);
                chance(&scales, &temperatures, &speeds) < MOST_CHANCE
            }
            _ => true,
        }
    }

    /// Factor by which the base model's mean window fits a passage best, given how wheels differ.
    fn scale_of(&self, index: usize) -> f64 {
        let frame = &self.base.frame;
        let world = self.base.fit.state.world(frame, &[]);
        let o = &frame.observed[index];
        let Ok(responses) = simulate(&world, frame, &[index]) else { return 1.0 };
        let late_s = self.base.fit.state.shift_m[index] / o.speed_m_s;
        let predicted = o.predicted_mean(&responses[0], 1.0, late_s);
        let columns = Mat::from_fn(o.mean.len(), 2, |k, c| if c == 0 { o.mean[k] } else { predicted[k] });
        let white = whitened(&frame.factors[index], &columns);
        let (mean, predicted) = (white.col_as_slice(0), white.col_as_slice(1));
        let product = |b: &[f64]| predicted.iter().zip(b).map(|(p, b)| p * b).sum::<f64>();
        product(mean) / product(predicted).max(f64::MIN_POSITIVE)
    }

    /// Energy that an effect adds to the windows, relative to that of the wheels' scatter and of the noise.
    fn share_of(&self, found: &LatentFit) -> f64 {
        let sum = |w: &Vec<Vec<f64>>| w.iter().flatten().map(|v| v * v).sum::<f64>();
        let own: f64 = self.split.train.iter().map(|i| sum(&found.windows[*i])).sum();
        own / self.scatter.1.max(f64::MIN_POSITIVE)
    }

    /// Squares of what differs between the bogies of the training passages, and the median over passages of how far the
    /// whole residual is above that, relative, in squares.
    fn squares_of(&self, residuals: &[Vec<Vec<f64>>]) -> (f64, f64) {
        let mut own_sum = 0.0;
        let mut above = Vec::new();
        for i in &self.split.train {
            let windows = &residuals[*i];
            let k = windows.len() as f64;
            let all: f64 = windows.iter().flatten().map(|v| v * v).sum();
            let mean: f64 = super::data::mean_of(windows).iter().map(|v| v * v).sum();
            let own = (all - k * mean) * k / (k - 1.0).max(1.0);
            own_sum += own;
            above.push(all / own.max(f64::MIN_POSITIVE) - 1.0);
        }
        (crate::signal::quantile(&above, 0.5), own_sum)
    }

    fn explore(&mut self) -> Result<Vec<Explored>, GapError> {
        let state = self.state();
        let world = state.world(&self.base.frame, &self.accepted);
        let all: Vec<usize> = (0..self.base.frame.observed.len()).collect();
        let responses = simulate(&world, &self.base.frame, &all)?;
        let late = self.late(&state, &responses, world.sensor);
        let frame = &self.base.frame;
        let scene = Scene::new(
            &world,
            &frame.observed,
            &frame.responses,
            &self.base.shapes,
            &self.base.variation,
            &responses,
            &late,
            &self.split.train,
        );
        let known: Vec<&str> = self.named.iter().map(|n| n.name).collect();
        let found = self
            .latent
            .iter()
            .filter(|e| !known.contains(&e.name()))
            .map(|e| (*e, e.explore(&scene)))
            .map(|(e, f)| {
                let moved = f.as_ref().map_or(0.0, |f| displacement_share(&scene, f));
                (e, f, moved)
            })
            .collect();
        self.scatter = self.squares_of(&scene.residuals);
        Ok(found)
    }

    /// Position errors in time: fitted for training passages, by correlation for the others.
    fn late(&self, state: &State, responses: &[Response], sensor: super::world::SensorModel) -> Vec<f64> {
        self.base
            .frame
            .observed
            .iter()
            .enumerate()
            .map(|(i, o)| match self.search.contains(&i) {
                true => state.shift_m[i] / o.speed_m_s,
                false => o.lag(&responses[i], sensor.gain_at(o.temperature_c), ALIGN_M / o.speed_m_s),
            })
            .collect()
    }

    /// Takes the first of a list into the model.
    fn accept(
        &mut self,
        list: &[Candidate],
        tried: &mut [Tried<'static>],
        latent: &mut Vec<Explored>,
    ) -> Result<(), GapError> {
        let best = &list[0];
        let name = best.name;
        let same = list[1..]
            .iter()
            .filter(|c| c.full && best.gain - c.gain < SAME_GAIN + 0.01 * best.gain)
            .map(|c| c.name)
            .collect();
        let probability = self.ranking.iter().find(|r| r.name == name).map_or(MOST_SURE, |r| r.probability);
        let mut named = Named {
            name,
            stage: best.stage,
            probability,
            parameters: Vec::new(),
            indistinguishable_from: same,
            gained: f64::NAN,
        };
        if let Some(t) = tried.iter_mut().find(|t| t.effect.name() == name) {
            self.accepted.push(t.effect);
            self.fit = t.fit.take();
        } else if let Some((effect, Some(found))) =
            latent.drain(..).map(|(e, f, _)| (e, f)).find(|(e, _)| e.name() == name)
        {
            named.parameters = found.parameters.clone();
            for (o, part) in self.base.frame.observed.iter_mut().zip(&found.windows) {
                o.remove(part);
            }
            self.latent_fits.push((effect, found));
            self.refit_variation()?;
        }
        self.named.push(named);
        Ok(())
    }

    /// Squares of the residual of the training passages with the current model, relative to the signal: acceleration and
    /// displacement, and the acceleration's part that differs from bogie to bogie.
    fn current_squares(&self) -> Result<[f64; 3], GapError> {
        let frame = &self.base.frame;
        let world = self.state().world(frame, &self.accepted);
        let train = &self.split.train;
        let responses = simulate(&world, frame, train)?;
        let latent: Vec<&LatentFit> = self.latent_fits.iter().map(|(_, f)| f).collect();
        let mut sums = [0.0; 3];
        for (i, r) in train.iter().zip(&responses) {
            let p = super::measure::prediction(frame, *i, (&world, r), &latent);
            let parts = super::measure::residual_squares(&p);
            sums.iter_mut().zip(parts).for_each(|(s, v)| *s += v / train.len() as f64);
        }
        Ok(sums)
    }

    /// Whether the effect accepted last takes enough off the residual; if not, it is taken back.
    fn confirm(&mut self, earlier: &Confirmed) -> Result<bool, GapError> {
        let [acceleration, displacement, own] = self.current_squares()?;
        let Some(last) = self.named.last_mut() else { return Ok(true) };
        let part = |before: f64, now: f64, floor: f64| {
            ((before - now).max(0.0) / floor.max(f64::MIN_POSITIVE)).sqrt()
        };
        // The displacement has no floor of its own; half of what it gains counts.
        last.gained = part(earlier.squares[0], acceleration, own)
            .max(0.5 * part(earlier.squares[1], displacement, displacement));
        // The operator's speeds speak for a wrong clock, not the residual; effects of single wheels have their own rule.
        let least = if earlier.named == 0 { LEAST_GAINED.0 } else { LEAST_GAINED.1 };
        if last.gained >= least || last.stage == Stage::Timing || self.accepted.len() == earlier.accepted {
            return Ok(true);
        }
        let name = last.name;
        self.named.pop();
        self.accepted.pop();
        self.fit.clone_from(&earlier.fit);
        for r in self.ranking.iter_mut().filter(|r| r.name == name) {
            r.probability = r.probability.min(0.5 * (1.0 - r.probability).max(0.1));
        }
        Ok(false)
    }

    /// Once wheels are known to differ by an effect, their natural variation is what remains.
    fn refit_variation(&mut self) -> Result<(), GapError> {
        let state = self.state();
        fit_variation(self.base, &self.accepted, &state, self.search)?;
        let options = FitOptions::default();
        if self.accepted.is_empty() {
            self.base.fit = fit(&self.base.frame, &[], state, self.search, options)?;
        } else {
            self.fit = Some(fit(&self.base.frame, &self.accepted, state, self.search, options)?);
        }
        Ok(())
    }

    /// Probabilities of a round; an effect keeps its best.
    fn rank(&mut self, list: &[Candidate]) {
        let top = list.iter().map(|c| c.gain).fold(LEAST_GAIN, f64::max);
        let weight = |g: f64| ((g - top) / PROBABILITY_SCALE).exp();
        // Without a sufficient gain nothing acts.
        let total: f64 = list.iter().map(|c| weight(c.gain)).sum::<f64>() + weight(LEAST_GAIN);
        for c in list {
            let probability = (weight(c.gain) / total).min(MOST_SURE);
            let entry =
                Ranked { name: c.name, stage: c.stage, probability, gain: c.gain, gap_after: f64::NAN };
            match self.ranking.iter_mut().find(|r| r.name == c.name) {
                Some(r) if r.probability >= probability => {}
                Some(r) => *r = entry,
                None => self.ranking.push(entry),
            }
        }
    }

    fn conclude(
        mut self,
        base_world: &super::world::World,
        progress: &dyn Progress,
    ) -> Result<Diagnosis, GapError> {
        progress.begin("held-out passages", 3);
        if !self.accepted.is_empty() {
            let state = self.state();
            let last =
                fit(&self.base.frame, &self.accepted, state, &self.split.train, FitOptions::default())?;
            self.describe(&last);
            self.fit = Some(last);
        }
        progress.step();
        let frame = &self.base.frame;
        let all: Vec<usize> = (0..frame.observed.len()).collect();
        let after_state = self.state();
        let after_world = after_state.world(frame, &self.accepted);
        let base_responses = simulate(base_world, frame, &all)?;
        let after_responses = simulate(&after_world, frame, &all)?;
        progress.step();
        let latent: Vec<&LatentFit> = self.latent_fits.iter().map(|(_, f)| f).collect();
        let base = (base_world, base_responses.as_slice());
        let mut predicted = predictions(frame, base, (&after_world, &after_responses), &latent);
        let held_out = |predicted: &[Prediction]| -> Vec<Prediction> {
            self.split.test.iter().map(|i| predicted[*i].clone()).collect()
        };
        let mut gap = measure(&held_out(&predicted), !self.named.is_empty());
        if !self.named.is_empty() && gap.closed_fraction_ci90[1] < 0.0 {
            self.remarks.push(withdrawn(&self.named, &gap));
            for r in self.ranking.iter_mut().filter(|r| self.named.iter().any(|n| n.name == r.name)) {
                r.probability = r.probability.min(1.0 - MOST_SURE);
            }
            self.named.clear();
            predicted = predictions(frame, base, base, &[]);
            gap = measure(&held_out(&predicted), false);
        }
        let held_out = held_out(&predicted);
        let residuals = super::where_::residuals(&predicted, frame, &self.split.test);
        let depends_on = super::where_::depends_on(&residuals, &self.named);
        let position_m = super::where_::positions(&predicted);
        self.ranking.sort_by(|a, b| b.probability.total_cmp(&a.probability));
        for r in &mut self.ranking {
            let named = self.named.iter().any(|n| n.name == r.name);
            r.gap_after = if named { gap.after } else { gap.before };
        }
        let verdict = if self.untrusted { Verdict::Unexplained } else { verdict(&gap, &self.named) };
        let stage = match self.foreign_scan {
            true => Some(Stage::Geometry),
            false => super::verdict::stage(verdict, &self.named, &self.ranking),
        };
        progress.step();
        Ok(Diagnosis {
            verdict,
            stage,
            effects: if verdict == Verdict::NoGap { Vec::new() } else { self.named },
            ranking: self.ranking,
            gap,
            depends_on,
            position_m,
            node_gap: None,
            predictions: held_out,
            cosines: self.cosines,
            remarks: self.remarks,
            residuals,
            skipped: 0,
            consequences: None,
            seconds: 0.0,
        })
    }

    /// Parameters with intervals of the accepted effects.
    fn describe(&mut self, fit: &Fit) {
        let widen = 1.645 * self.inflation(fit).sqrt();
        let mut at = 3;
        for (effect, coordinates) in self.accepted.iter().zip(&fit.state.effects) {
            let mut list = Vec::new();
            for (p, c) in effect.parameters().iter().zip(coordinates) {
                let model = MODEL_ERROR * if p.scale == Scale::Log { 1.0 } else { c.abs().max(1.0) };
                let half = widen * fit.covariance[(at, at)].max(0.0).sqrt() + model;
                at += 1;
                if !p.nuisance {
                    let ends = [p.value(c - half), p.value(c + half)];
                    list.push((p.name, p.value(*c), ends[0].min(ends[1]), ends[0].max(ends[1])));
                }
            }
            if let Some(named) = self.named.iter_mut().find(|n| n.name == effect.name()) {
                named.parameters = list;
            }
        }
    }
}

/// What is said of effects that predict the held-out passages worse than the base model does.
fn withdrawn(named: &[Named], gap: &Gap) -> String {
    let names: Vec<&str> = named.iter().map(|n| n.name).collect();
    format!(
        "{} would explain the passages used for the search, but predict the held-out ones worse (gap {:.3} instead of {:.3}): \
         withdrawn",
        names.join(" and "),
        gap.after,
        gap.before
    )
}

/// Search for the axle times of held-out passages, metres.
const ALIGN_M: f64 = 0.15;
/// Wheelsets of a train meet the same rail: their deviations are not as independent as the covariance says.
const LATENT_INFLATION: f64 = 2.0;
/// Evidence counts this much less than it says when it becomes a probability (calibrated on simulated trials).
const PROBABILITY_SCALE: f64 = 4.0;
/// Nothing is surer than this: no run of trials has been long enough to show a higher frequency.
const MOST_SURE: f64 = 0.95;
/// Parameters are not known better than this, relative or in units of the coordinate: what the forward model leaves out.
const MODEL_ERROR: f64 = 0.06;

/// A wrong clock must agree with the operator's speeds within this many standard deviations of their mean.
const CLOCK_SPREAD: f64 = 4.0;
/// Probability that temperatures shuffled among the passages would go with their scale as well, above which a gain does not
/// follow the temperature: trains differ by chance.
const MOST_CHANCE: f64 = 0.01;
const SHUFFLES: usize = 999;

/// How often shuffled `x` go with `y` at least as well as `x` do, both freed of what goes with `z`.
fn chance(y: &[f64], x: &[f64], z: &[f64]) -> f64 {
    let centred = |v: &[f64]| -> Vec<f64> {
        let mean = crate::signal::mean(v);
        v.iter().map(|a| a - mean).collect()
    };
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let z = centred(z);
    let freed = |v: &[f64]| -> Vec<f64> {
        let v = centred(v);
        let slope = dot(&v, &z) / dot(&z, &z).max(f64::MIN_POSITIVE);
        v.iter().zip(&z).map(|(a, b)| a - slope * b).collect()
    };
    let (y, mut x) = (freed(y), freed(x));
    let found = dot(&x, &y).abs();
    let mut random = crate::passage::random::Random::new(1, 1);
    let mut as_good = 0;
    for _ in 0..SHUFFLES {
        for i in (1..x.len()).rev() {
            x.swap(i, (random.unit() * (i + 1) as f64) as usize % (i + 1));
        }
        as_good += usize::from(dot(&x, &y).abs() >= found);
    }
    (as_good + 1) as f64 / (SHUFFLES + 1) as f64
}

/// Whether the last effect of a fit is larger than what the forward model's own errors can pass for.
fn large_enough(effect: &dyn Effect, fit: &Fit) -> bool {
    let (Some(coordinates), Some(nought)) = (fit.state.effects.last(), effect.nought()) else { return true };
    let parameters = effect.parameters().iter().zip(coordinates.iter().zip(&nought));
    let mut asked = parameters.filter(|(p, _)| p.least > 0.0).peekable();
    asked.peek().is_none() || asked.any(|(p, (c, n))| (c - n).abs() >= p.least)
}

/// Whether the last effect of a fit is away from the ends of its ranges.
fn inside_ranges(effect: &dyn Effect, fit: &Fit) -> bool {
    let Some(coordinates) = fit.state.effects.last() else { return true };
    effect
        .parameters()
        .iter()
        .zip(coordinates)
        .filter(|(p, _)| !p.nuisance)
        .all(|(p, c)| *c > p.range[0] + 1e-9 && *c < p.range[1] - 1e-9)
}

fn squares(m: &faer::Mat<f64>) -> f64 {
    m.col_as_slice(0).iter().map(|v| v * v).sum()
}

/// Cosines between the best directions of all pairs of effects.
fn cosines(
    screening: &super::fit::Screening,
    candidates: &[&'static dyn Effect],
) -> Vec<(&'static str, &'static str, f64)> {
    let best = |e: usize| {
        (0..screening.directions.len())
            .filter(|i| screening.directions[*i].effect == e)
            .max_by(|a, b| gain(screening, &[*a]).total_cmp(&gain(screening, &[*b])))
    };
    let h = &screening.information;
    let mut out = Vec::new();
    for a in 0..candidates.len() {
        for b in a + 1..candidates.len() {
            if let (Some(i), Some(j)) = (best(a), best(b)) {
                let cosine = h[(i, j)] / (h[(i, i)] * h[(j, j)]).sqrt().max(f64::MIN_POSITIVE);
                out.push((candidates[a].name(), candidates[b].name(), cosine));
            }
        }
    }
    out
}
