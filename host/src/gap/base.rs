//! The base model of a site: what `analyse` assumes, fitted to the training passages.

use faer::Mat;
use rayon::prelude::*;

use super::GapError;
use super::data::{Observed, window_m};
use super::effect::Effect;
use super::envelopes::ahead_m;
use super::fit::{Fit, FitOptions, Frame, Recall, State, damping, fit, settled, values};
use super::forward::{Detail, Response, Simulator, sleepers_on};
use super::linear::{BogieResponses, Linear};
use super::splines::{PathSplines, matern};
use super::variation::{OwnIrregularity, Shapes, Variation, estimate, scatter};
use super::world::{Bed, Path, SensorModel, Wheels, World};
use crate::ballast::BallastParameters;
use crate::ballast::evidence::Unknown;
use crate::ballast::quasi_static::QuasiStatic;
use crate::passage::Profile;
use crate::reconstruct::{ABOUT, FARTHEST_HIT_M, Recording, SPEEDS_M_S, SpeedSearch, comb, estimate_speed};
use crate::recording::{Crossing, LEAST_RATE_HZ, Site};
use crate::track::{Mesh, Side, Track};
use crate::vehicle::{AxlePattern, static_wheel_force_n};

/// The estimated path covers this far on both sides of x = 0, metres.
const HALF_M: f64 = 3.4;
/// Spacing of its splines on the two rails, metres.
const STEP_M: [f64; 2] = [0.055, 0.11];
/// Trains slower than this want finer splines, m/s: at 250 Hz, theirs are shorter waves.
const SLOW_M_S: f64 = 30.0;
/// Trains slower than this feel waves so short, m/s, that wheels differ by more of them than the model holds: hollow wheels were named on
/// sites of 20 to 23 m/s without any effect, none on those of 24 m/s and more.
pub const LEAST_SPEED_M_S: f64 = 22.0;
/// Speed at which a wave of 250 Hz has 3.3 splines at the usual spacing, m/s; as many at any speed below [`SLOW_M_S`].
const SPACED_FOR_M_S: f64 = 45.0;
/// A scan is continued to zero over this length, metres.
const SCAN_FADE_M: f64 = 0.3;
/// Correlation length of the path's deviation, metres.
const CORRELATION_M: f64 = 0.15;

/// Prior standard deviation of the path's deviation, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathPrior {
    /// Inside the scan.
    pub inside_m: f64,
    /// Elsewhere on the crossing side.
    pub outside_m: f64,
    /// Stock rail.
    pub stock_m: f64,
}

/// Base model with everything that the fits of effects reuse.
pub struct Base {
    /// Frame of the fits.
    pub frame: Frame,
    /// Fit without effects.
    pub fit: Fit,
    /// Wheel-to-wheel variation.
    pub variation: Variation,
    /// Shapes of the covariances, per passage.
    pub shapes: Vec<Shapes>,
    /// Window, metres of travel.
    pub window_m: (f64, f64),
}

impl Base {
    /// Puts the recordings of other readings of the same passages in the place of those that it was fitted to, from which something had
    /// been taken.
    pub fn record_again(&mut self, as_read: &[Observed]) {
        for (new, old) in self.frame.observed.iter_mut().zip(as_read) {
            new.recording = old.recording.clone();
            new.cut(self.window_m);
        }
    }
}

/// The speed of the envelope is right within half of this, relative (field recordings); the next maximum of the coherent stack is
/// farther away.
const BY_ENVELOPE: f64 = 0.008;
/// Band of the first scan for a speed, Hz: the envelope has told neighbouring maxima apart, and steps of the baseline have moved speeds
/// by two percent from 3 Hz on.
const STACKED_HZ: [f64; 2] = [20.0, 60.0];

/// Where the windows of a site's bogies lie, as [`window_m`] gives it.
pub fn window_of(crossing: &Crossing) -> (f64, f64) {
    let sensor_along_m = crossing.traffic_direction.sign() * crossing.sensor_x_m();
    window_m(&AxlePattern::of_vehicle(&crossing.vehicle), sensor_along_m, crossing.vehicle.axle_spacing_m)
}

/// Reads the recordings.
pub fn observe(site: &Site) -> Result<Vec<Observed>, GapError> {
    check_rates(site)?;
    let crossing = &site.crossing;
    let pattern = AxlePattern::of_vehicle(&crossing.vehicle);
    let track = Track::of_crossing(crossing, Mesh::default());
    let direction = crossing.traffic_direction.sign();
    let found: Vec<(usize, Recording, f64, f64)> = site
        .passages
        .par_iter()
        .enumerate()
        .filter_map(|(i, p)| {
            let recording = Recording::new(p, &crossing.sensor);
            let likely = p.speed_m_s.map_or(SPEEDS_M_S, |v| [(1.0 - ABOUT) * v, (1.0 + ABOUT) * v]);
            let (about, hit_s) = comb(&recording, &pattern, likely)?;
            let search = SpeedSearch {
                range_m_s: [(1.0 - BY_ENVELOPE) * about, (1.0 + BY_ENVELOPE) * about],
                first_band_hz: STACKED_HZ,
                ..SpeedSearch::default()
            };
            estimate_speed(&recording, &pattern, search).map(|v| (i, recording, v, hit_s))
        })
        .collect();
    if found.is_empty() {
        return Err(GapError::Silent);
    }
    let force = |i: usize| static_wheel_force_n(site.passages[i].axle_load_kg, crossing.vehicle.gravity_m_s2);
    let inputs: Vec<(&Recording, f64, f64)> = found.iter().map(|(i, r, v, _)| (r, *v, force(*i))).collect();
    let first_axle_s =
        QuasiStatic::new(&track, direction, &pattern, &inputs).align(&BallastParameters::NOMINAL);
    let window = window_of(crossing);
    Ok(found
        .into_iter()
        .zip(first_axle_s)
        .map(|((i, recording, speed_m_s, hit_s), deflected_s)| {
            let p = &site.passages[i];
            // Clipping shifts the baseline, and the deflection may then be found a whole car away.
            let astray = (deflected_s - hit_s).abs() * speed_m_s > FARTHEST_HIT_M;
            let first_axle_s = if astray { hit_s } else { deflected_s };
            let mut observed = Observed {
                passage_id: p.passage_id,
                recording,
                speed_m_s,
                operator_m_s: p.speed_m_s,
                temperature_c: p.temperature_c,
                axle_load_kg: p.axle_load_kg,
                first_axle_s,
                bogie_m: pattern.offset_m.iter().step_by(2).copied().collect(),
                windows: Vec::new(),
                mean: Vec::new(),
                first_s: 0.0,
            };
            observed.cut(window);
            observed.line_up(window);
            observed
        })
        .collect())
}

/// A site that was not read from files may be of any rate.
fn check_rates(site: &Site) -> Result<(), GapError> {
    match site.passages.iter().find(|p| !(LEAST_RATE_HZ..).contains(&p.sample_rate_hz)) {
        Some(p) => {
            let (passage_id, rate_hz) = (p.passage_id, p.sample_rate_hz);
            Err(GapError::SampleRate { passage_id, rate_hz, least_hz: LEAST_RATE_HZ })
        }
        None => Ok(()),
    }
}

/// Spacing of the path's splines. With the usual one, sites without any effect whose trains run at 25 or 30 m/s were said to have
/// hollow wheels or a defect in the stock rail; with half of it at 25 m/s they have no gap. Trains of 33 m/s, of which the slowest have
/// 2.2 splines per wave, want no more.
fn path_steps_m(observed: &[Observed]) -> [f64; 2] {
    let slowest = observed.iter().map(|o| o.speed_m_s).fold(f64::INFINITY, f64::min);
    let finer = if slowest < SLOW_M_S { slowest.max(LEAST_SPEED_M_S) / SPACED_FOR_M_S } else { 1.0 };
    STEP_M.map(|step| step * finer)
}

/// World as the operator describes it.
pub fn nominal_world(site: &Site, ballast: BallastParameters) -> Result<World, GapError> {
    let scan = match &site.scan {
        Some(s) => Profile::of_scan(&s.position_m, &s.irregularity_m, SCAN_FADE_M)?,
        None => Profile::level(),
    };
    Ok(World {
        crossing: site.crossing.clone(),
        ballast,
        bed: Bed::default(),
        wheels: Wheels { load: [site.crossing.track.load_factor(); 2], ..Wheels::default() },
        path: Path {
            scan,
            deviation: PathSplines::level(HALF_M, STEP_M),
            half_m: HALF_M,
            blur_m: 0.0,
            stock_dip: None,
        },
        sensor: SensorModel::default(),
        sleepers: sleepers_on(&site.crossing, &ballast),
    })
}

/// Factor of the prior covariance of the path's deviation.
pub fn path_root(site: &Site, grids: &PathSplines, prior: &PathPrior) -> Result<Mat<f64>, GapError> {
    let ends = site.scan.as_ref().map(|s| (s.position_m[0], s.position_m[s.position_m.len() - 1]));
    let sd = |side: Side, x: f64| match (side, ends) {
        (Side::Stock, _) => prior.stock_m,
        (Side::Crossing, Some((a, b))) if x >= a && x <= b => prior.inside_m,
        // Where the scan is cut off, its continuation is a guess.
        (Side::Crossing, Some((a, b))) => {
            let beyond = (a - x).max(x - b);
            prior.outside_m + (100e-6 - prior.outside_m) * (-(beyond / 0.3).powi(2)).exp().min(1.0) * 0.5
        }
        (Side::Crossing, None) => {
            let inside = (-0.5 * ((x.abs() - 1.5).max(0.0) / 0.25).powi(2)).exp();
            prior.outside_m + (0.6e-3 - prior.outside_m) * inside
        }
    };
    let knots = grids.knots();
    let covariance = Mat::from_fn(knots.len(), knots.len(), |i, j| {
        let ((a, x), (b, y)) = (knots[i], knots[j]);
        if a != b {
            return 0.0;
        }
        let jitter = if i == j { 1e-6 } else { 0.0 };
        sd(a, x) * sd(b, y) * (matern((x - y).abs() / CORRELATION_M) + jitter)
    });
    let factor = covariance
        .llt(faer::Side::Lower)
        .map_err(|_| GapError::Singular { what: "the prior of the path" })?;
    Ok(factor.L().to_owned())
}

/// Relative error of the forward model that all wheels share, as a part of the mean window's RMS.
const DISCREPANCY: f64 = 0.01;

/// What is known of a site before it is fitted.
#[derive(Clone, Default)]
pub struct Given {
    /// Recorder.
    pub sensor: SensorModel,
    /// Effects over which it is fitted, which are not in the frame afterwards.
    pub effects: Vec<Form>,
    /// Something has been taken off the recordings that may have led trains astray.
    pub cleaned: bool,
}

/// An effect with the coordinates of its parameters.
pub type Form = (&'static dyn Effect, Vec<f64>);

impl Given {
    /// Nothing but the recorder.
    pub fn recorder(sensor: SensorModel) -> Self {
        Self { sensor, ..Self::default() }
    }
}

/// How much track is simulated follows from the ballast of the quasi-static fit, if that leaves less than this of the displacement, RMS ratio. It
/// leaves 0.07 to 0.49 where there is a deflection, over voids too, and 0.70 to 0.98 where the baseline jumps, where it finds 0.4 MN/m²: that
/// were 20 sleepers on either side.
const LEFT_OF_DEFLECTION: f64 = 0.6;

/// Fits the base model to the passages of `subset`; the first, rough fits use `search` only.
pub fn base(
    site: &Site,
    subset: &[usize],
    search: &[usize],
    prior: &PathPrior,
    given: &Given,
) -> Result<Base, GapError> {
    let mut observed = observe(site)?;
    if observed.len() < site.passages.len() {
        // `subset` counts all of them.
        let silent = |id: &i32| observed.iter().all(|o| o.passage_id != *id);
        let passage_id = site.passages.iter().map(|p| p.passage_id).filter(silent).collect();
        return Err(GapError::SilentPassages { passage_id });
    }
    let crossing = &site.crossing;
    let pattern = AxlePattern::of_vehicle(&crossing.vehicle);
    let direction = crossing.traffic_direction.sign();
    let track = Track::of_crossing(crossing, Mesh::default());
    let window = window_of(crossing);
    let force = |o: &Observed| static_wheel_force_n(o.axle_load_kg, crossing.vehicle.gravity_m_s2);
    let inputs: Vec<(&Recording, f64, f64)> = subset
        .iter()
        .map(|i| (&observed[*i].recording, observed[*i].speed_m_s, force(&observed[*i])))
        .collect();
    let quasi_static = QuasiStatic::new(&track, direction, &pattern, &inputs).fit(BallastParameters::NOMINAL);
    let start = match given.sensor.range_m_s2 {
        // A clipped record has steps in its velocity, which the quasi-static fit takes for deflection.
        Some(_) => BallastParameters::NOMINAL,
        None => quasi_static.start_of_evidence(),
    };
    let sinks = quasi_static.misfit < LEFT_OF_DEFLECTION;
    let sleepers = sleepers_on(crossing, if sinks { &start } else { &BallastParameters::NOMINAL });
    let nominal = || nominal_world(site, start).map(|world| World { sleepers, ..world });
    let mut world = nominal()?;
    world.path.deviation = PathSplines::level(HALF_M, path_steps_m(&observed));
    world.sensor = given.sensor;
    for (effect, coordinates) in &given.effects {
        effect.apply(&mut world, &values(*effect, coordinates));
    }
    let linear = world.bed.is_linear();
    let place = if given.cleaned { find_places } else { align };
    place(&world, &mut observed, window)?;
    observed.par_iter_mut().for_each(|o| o.line_up(window));
    let grids = world.path.deviation.clone();
    let deviation_root = path_root(site, &grids, prior)?;
    // Without a scan the path must be found together with the ballast; with one, ballast and axle times come first.
    let responses: Vec<BogieResponses> = match site.scan {
        None => {
            let linear = Linear::new(&world, &observed)?;
            observed.par_iter().map(|o| linear.responses(o)).collect()
        }
        Some(_) => observed.iter().map(|o| BogieResponses::without_path(o.mean.len(), grids.len())).collect(),
    };
    let factors = rough_factors(&observed);
    let mut frame = Frame {
        base: world,
        observed,
        responses,
        factors,
        deviation_root,
        unknown: Unknown::Stiffness,
        recall: Recall::default(),
    };
    let state = State::start(&frame, &start);
    let options = FitOptions { steps: 5, renew: 3, tolerance: 3.0, damped: false, detail: Detail::Full };
    let first = fit(&frame, &[], state, search, options)?;
    // With the ballast about right, a passage that had locked onto a neighbouring wave finds its place.
    let mut state = first.state;
    let world = state.world(&frame, &[]);
    place(&world, &mut frame.observed, window)?;
    state.shift_m.fill(0.0);
    let (responses, shapes) = linearise(&world, &frame.observed)?;
    frame.responses = responses;
    let second = fit(&frame, &[], state, search, options)?;
    let variation = variation_of(&frame, &shapes, &[], &second.state, search)?;
    frame.take(&shapes, &variation, linear)?;
    let fit = settled(&frame, &[], second.state, subset)?;
    if !given.effects.is_empty() {
        frame.base = without_effects(&frame.base, nominal()?, given.sensor);
        return Ok(Base { frame, fit, variation, shapes, window_m: window });
    }
    let mut base = Base { frame, fit, variation, shapes, window_m: window };
    find_damping(&mut base, subset, search)?;
    Ok(base)
}

/// Where the damping of crossing.toml is wrong by far, it is unknown from here on, as in an analysis, if the base model is not lost then: what
/// effects do to a model that is lost passes for damping, too.
fn find_damping(base: &mut Base, subset: &[usize], search: &[usize]) -> Result<(), GapError> {
    base.frame.unknown = Unknown::StiffnessAndDamping;
    let says = damping(&base.frame, &base.fit.state, search)?;
    if says.seems_far_off() {
        let found = settled(&base.frame, &[], base.fit.state.clone(), search)?;
        let off = found.state.ballast().damping_factor.ln();
        if says.at(off).is_far_off() && !found.lost() {
            relinearise(base, &[], &found.state, search)?;
            base.fit = settled(&base.frame, &[], found.state, subset)?;
            return Ok(());
        }
    }
    base.frame.unknown = Unknown::Stiffness;
    Ok(())
}

/// A world of which only the path's grid and how wheels differ are kept.
fn without_effects(world: &World, nominal: World, sensor: SensorModel) -> World {
    let path = Path { stock_dip: None, ..world.path.clone() };
    let wheels = Wheels { depth_sd: world.wheels.depth_sd, ..nominal.wheels };
    World { path, wheels, sensor, ..nominal }
}

/// Linearises anew in a given state, and estimates the wheels' variation there.
pub fn relinearise(
    base: &mut Base,
    effects: &[&dyn Effect],
    state: &State,
    subset: &[usize],
) -> Result<(), GapError> {
    let world = state.world(&base.frame, effects);
    (base.frame.responses, base.shapes) = linearise(&world, &base.frame.observed)?;
    fit_variation(base, effects, state, subset)
}

/// Estimates the wheels' variation anew in a given state.
pub fn fit_variation(
    base: &mut Base,
    effects: &[&dyn Effect],
    state: &State,
    subset: &[usize],
) -> Result<(), GapError> {
    base.variation = variation_of(&base.frame, &base.shapes, effects, state, subset)?;
    let linear = state.world(&base.frame, effects).bed.is_linear();
    base.frame.take(&base.shapes, &base.variation, linear)
}

impl Frame {
    /// Takes over how wheels differ: as covariance of the mean windows, as blur of the path of the mean wheel, and for what clips.
    fn take(&mut self, shapes: &[Shapes], variation: &Variation, linear: bool) -> Result<(), GapError> {
        self.factors = factors(&self.observed, shapes, variation)?;
        let most_m = if linear { f64::INFINITY } else { MOST_BLUR_M };
        self.base.path.blur_m = variation.shift_m.min(most_m);
        self.base.wheels.depth_sd = variation.depth;
        Ok(())
    }
}

/// Sound wheels meet the transition within this, standard deviation, metres: 8 to 17 mm on sites with them. Over a deep void, where how
/// wheels differ does not follow from derivatives, 51 mm were found, and a path blurred by as much leaves two thirds of the shocks.
const MOST_BLUR_M: f64 = 0.02;

/// Share of the signal that the first fits may miss: a poor start is not taken too seriously.
const ROUGH_SHARE: f64 = 0.1;

/// Covariance factors before the variation is known: white.
fn rough_factors(observed: &[Observed]) -> Vec<faer::linalg::solvers::Llt<f64>> {
    observed
        .iter()
        .filter_map(|o| {
            let variance = (ROUGH_SHARE * crate::signal::rms(&o.mean)).powi(2) + 1e-4;
            let n = o.mean.len();
            Mat::<f64>::from_fn(n, n, |i, j| if i == j { variance } else { 0.0 }).llt(faer::Side::Lower).ok()
        })
        .collect()
}

/// Linear responses of a well mounted sensor, and shapes of the variation of the one there is, around a world, per passage.
fn linearise(world: &World, observed: &[Observed]) -> Result<(Vec<BogieResponses>, Vec<Shapes>), GapError> {
    let linear = Linear::new(world, observed)?;
    let own = OwnIrregularity::new(&world.path.deviation);
    let both: Vec<(BogieResponses, Shapes)> = observed
        .par_iter()
        .map(|o| {
            let r = linear.responses(o);
            // Wheels differ in what the sensor shows of them.
            let moves = linear.moves(o)?.map(|m| m.through_mount(&world.sensor));
            let shapes = Shapes::new(&r.through_mount(&world.sensor), moves, &own, &world.sensor);
            Ok((r, shapes))
        })
        .collect::<Result<_, GapError>>()?;
    Ok(both.into_iter().unzip())
}

/// Searches for the axle times, one after the other, metres of travel in both directions.
const ALIGN_M: [f64; 2] = [0.6, 0.12];

/// Moves the first axle of every passage to where a world's prediction fits best. Where some then lie a wave beside the others, all are
/// moved to where they lie by these, and as one to where the prediction fits all of them best, if it fits them far better there.
fn find_places(world: &World, observed: &mut [Observed], window: (f64, f64)) -> Result<(), GapError> {
    align(world, observed, window)?;
    let Some(ahead_m) = ahead_m(observed) else { return Ok(()) };
    let (here, missed): (Vec<f64>, Vec<Vec<f64>>) = observed
        .par_iter()
        .zip(&ahead_m)
        .map(|(o, ahead_m)| missed_around(world, o, *ahead_m))
        .collect::<Result<Vec<_>, GapError>>()?
        .into_iter()
        .unzip();
    let all = |k: usize| missed.iter().map(|m| m[k]).sum::<f64>();
    let best = (0..=2 * TOGETHER.1).min_by(|a, b| all(*a).total_cmp(&all(*b))).unwrap_or(TOGETHER.1);
    if all(best) > FAR_BETTER * here.iter().sum::<f64>() {
        return Ok(());
    }
    observed.par_iter_mut().zip(&ahead_m).try_for_each(|(o, ahead_m)| {
        o.delay((ahead_m + together_m(best)) / o.speed_m_s, window);
        align_one(world, o, window, &[APART_M])
    })
}

/// Step in which all passages are moved as one, metres, and number of steps in either direction.
const TOGETHER: (f64, usize) = (0.05, 24);
/// How far each may then still be beside its place, metres.
const APART_M: f64 = 0.15;
/// What the prediction misses of all passages must become less than this part of what it misses where they were.
const FAR_BETTER: f64 = 0.7;

fn together_m(step: usize) -> f64 {
    (step as f64 - TOGETHER.1 as f64) * TOGETHER.0
}

/// Part of a passage's squares that a world's prediction misses: where the passage is, and where it is moved to the others and with them by
/// every step.
fn missed_around(world: &World, o: &Observed, ahead_m: f64) -> Result<(f64, Vec<f64>), GapError> {
    let (response, gain) = shown(world, o)?;
    let at = |by_m: f64| o.share_missed(&response, gain, by_m / o.speed_m_s);
    let apart = (APART_M / TOGETHER.0).round() as i64;
    let nearby = |step: usize| {
        (-apart..=apart)
            .map(|k| at(ahead_m + together_m(step) + k as f64 * TOGETHER.0))
            .fold(f64::INFINITY, f64::min)
    };
    Ok((at(0.0), (0..=2 * TOGETHER.1).map(nearby).collect()))
}

/// What a world's sensor shows of a bogie of a passage, and its sensitivity then.
fn shown(world: &World, o: &Observed) -> Result<(Response, f64), GapError> {
    let response = Simulator::new(world, o.axle_load_kg)?.response(o.speed_m_s)?;
    Ok((response, world.sensor.gain_at(o.temperature_c)))
}

/// Moves the first axle of a passage to where what is shown fits best.
fn place_one(o: &mut Observed, (response, gain): (&Response, f64), window: (f64, f64), reaches_m: &[f64]) {
    for reach_m in reaches_m {
        let late_s = o.lag(response, gain, *reach_m);
        o.delay(late_s, window);
    }
}

/// Moves the first axle of every passage to where a world's prediction fits best.
pub fn align(world: &World, observed: &mut [Observed], window: (f64, f64)) -> Result<(), GapError> {
    observed.par_iter_mut().try_for_each(|o| align_one(world, o, window, &ALIGN_M))
}

fn align_one(world: &World, o: &mut Observed, window: (f64, f64), reaches_m: &[f64]) -> Result<(), GapError> {
    let (response, gain) = shown(world, o)?;
    place_one(o, (&response, gain), window, reaches_m);
    Ok(())
}

/// Part of a passage's squares that a world's prediction misses where it fits best. In the world trains may run the other way than in the
/// one that the passage was read for.
pub fn missed_at_best(world: &World, mut o: Observed) -> Result<f64, GapError> {
    let window = window_of(&world.crossing);
    o.cut(window);
    let (response, gain) = shown(world, &o)?;
    place_one(&mut o, (&response, gain), window, &ALIGN_M);
    Ok(o.share_missed(&response, gain, 0.0))
}

/// Factors of the covariances of the mean windows.
fn factors(
    observed: &[Observed],
    shapes: &[Shapes],
    variation: &Variation,
) -> Result<Vec<faer::linalg::solvers::Llt<f64>>, GapError> {
    observed
        .par_iter()
        .zip(shapes)
        .map(|(o, s)| {
            let scale = 1.0 / o.windows.len().max(1) as f64;
            let discrepancy = (DISCREPANCY * crate::signal::rms(&o.mean)).powi(2);
            let mut covariance = s.covariance(variation) * faer::Scale(scale);
            for k in 0..o.mean.len() {
                covariance[(k, k)] += discrepancy;
            }
            covariance
                .llt(faer::Side::Lower)
                .map_err(|_| GapError::Singular { what: "the covariance of a passage" })
        })
        .collect()
}

/// Residual windows of every bogie of a passage for a state.
fn variation_of(
    frame: &Frame,
    shapes: &[Shapes],
    effects: &[&dyn Effect],
    state: &State,
    subset: &[usize],
) -> Result<Variation, GapError> {
    let world = state.world(frame, effects);
    let responses = super::fit::simulate(&world, frame, subset)?;
    let scatters: Vec<(&Shapes, Mat<f64>)> = subset
        .iter()
        .zip(&responses)
        .map(|(i, r)| {
            let o = &frame.observed[*i];
            let residuals = o.window_residuals(r, 1.0, state.shift_m[*i] / o.speed_m_s);
            (&shapes[*i], scatter(&residuals))
        })
        .collect();
    Ok(estimate(&scatters, &frame.base.crossing.sensor))
}

#[cfg(test)]
pub(super) mod tests {
    use std::path::Path;

    use super::*;
    use crate::gap::diagnosis::PATH_PRIOR;
    use crate::recording::read_site;

    /// Of reference-1 with its first passages, at most, fitted to the first one: for tests of what works on one.
    pub(in crate::gap) fn of_reference(passages: usize) -> Base {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field/reference-1");
        let mut site = read_site(&root).unwrap();
        site.passages.truncate(passages);
        base(&site, &[0], &[0], &PATH_PRIOR, &Given::default()).unwrap()
    }
}
