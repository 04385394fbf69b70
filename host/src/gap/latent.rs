//! Effects that differ from wheel to wheel or from passage to passage: their size is a parameter, their phase, place or
//! sign is drawn anew every time and found in the recording itself, like the axle times.

use faer::{Mat, c64};
use rayon::prelude::*;

use super::GapError;
use super::base::Base;
use super::data::{Observed, RATE_HZ, energies, own_energy};
use super::effect::{ActsOn, Advice, Stage, Stated};
use super::fit::{State, simulate};
use super::forward::Response;
use super::included::Inclusion;
use super::linear::BogieResponses;
use super::measure::ALIGN_M;
use super::variation::{Shapes, Variation};
use super::world::{SensorModel, World};
use crate::signal::{dot, filtered, quantile, taper};
use crate::track::Side;

/// What a latent effect may look at.
pub struct Scene<'a> {
    /// World of the current model.
    pub world: &'a World,
    /// All passages.
    pub observed: &'a [Observed],
    /// Residual windows of every passage and bogie.
    pub residuals: Vec<Vec<Vec<f64>>>,
    /// Linear responses of every passage.
    pub responses: &'a [BogieResponses],
    /// Shapes of the natural variation, per passage.
    pub shapes: &'a [Shapes],
    /// Sizes of the natural variation.
    pub variation: Variation,
    /// Passages to learn from.
    pub train: &'a [usize],
    /// Residual of the whole recording, per passage.
    pub traces: Vec<Trace>,
}

/// Residual over the whole train.
pub struct Trace {
    /// Recorder time of the first value, s.
    pub start_s: f64,
    /// Measured less predicted, at [`RATE_HZ`], m/s².
    pub residual: Vec<f64>,
}

/// What a latent effect found.
#[derive(Clone, Debug)]
pub struct LatentFit {
    /// Gain in log evidence over the training passages.
    pub gain: f64,
    /// Values with intervals: name, value, lower, upper.
    pub parameters: Vec<Stated>,
    /// Whether it shows in what is recorded while no train is near, whatever the model.
    pub apart: bool,
    /// Share of the wheels that have it; none for an effect of the recordings.
    pub wheel_share: Option<f64>,
    /// Time in which what it adds decays behind the trains, s, where it does.
    pub decay_s: Option<f64>,
    /// What it adds to every window: passage, bogie.
    pub windows: Vec<Vec<Vec<f64>>>,
    /// What it adds to the whole recording, on the time axis of the scene's traces.
    pub traces: Vec<Vec<f64>>,
}

/// An effect of this kind.
pub trait Latent: Sync + Send {
    /// Name in the contract.
    fn name(&self) -> &'static str;
    /// Place in the chain.
    fn stage(&self) -> Stage;
    /// What it means, and what to do about it.
    fn advice(&self) -> Advice;
    /// What `--with-effects` does with it.
    fn inclusion(&self) -> Inclusion;
    /// What it acts on.
    fn acts_on(&self) -> ActsOn {
        if self.stage() == Stage::Vehicle { ActsOn::Wheels } else { ActsOn::Recordings }
    }
    /// Whether all wheels that have it show the same.
    fn alike(&self) -> bool {
        false
    }
    /// Looks for the effect; `None` when there is no trace of it.
    fn explore(&self, scene: &Scene) -> Option<LatentFit>;
}

impl<'a> Scene<'a> {
    /// Residuals of all passages in a world, which is that of a state fitted to some of them; `train`: passages to learn from.
    pub fn of(
        base: &'a Base,
        world: &'a World,
        (state, fitted): (&State, &[usize]),
        train: &'a [usize],
    ) -> Result<Self, GapError> {
        let observed = &base.frame.observed;
        let all: Vec<usize> = (0..observed.len()).collect();
        let bogies = simulate(world, &base.frame, &all)?;
        let late_s = late_s(observed, (state, fitted), &bogies, world.sensor);
        let gain = |o: &Observed| world.sensor.gain_at(o.temperature_c);
        let residuals: Vec<Vec<Vec<f64>>> = observed
            .par_iter()
            .zip(&bogies)
            .zip(&late_s)
            .map(|((o, r), late)| o.window_residuals(r, gain(o), *late))
            .collect();
        let traces = observed
            .par_iter()
            .zip(&bogies)
            .zip(&late_s)
            .map(|((o, r), late)| {
                let (start_s, mut residual) = o.trace();
                let bogies: Vec<f64> = o.bogie_s().iter().map(|b| -(b + late)).collect();
                let starts: Vec<f64> = bogies.iter().map(|b| -b).collect();
                let mut predicted = vec![0.0; residual.len()];
                r.add_train(&starts, gain(o), start_s - o.first_axle_s, 1.0 / RATE_HZ, &mut predicted);
                residual.iter_mut().zip(&predicted).for_each(|(a, p)| *a -= p);
                Trace { start_s, residual }
            })
            .collect();
        let (responses, shapes) = (&base.frame.responses, &base.shapes);
        Ok(Self { world, observed, residuals, responses, shapes, variation: base.variation, train, traces })
    }

    /// Values of a function of travelled distance at the knots of the path: along the crossing rail, and on the stock rail
    /// where `both`.
    pub fn at_knots(&self, both: bool, f: impl Fn(f64) -> f64) -> Vec<f64> {
        let direction = self.world.crossing.traffic_direction.sign();
        let knots = self.world.path.deviation.knots();
        knots
            .iter()
            .map(|(side, x)| if both || *side == Side::Crossing { f(direction * x) } else { 0.0 })
            .collect()
    }

    /// Energy of what differs between the windows of the training passages, (m/s²)².
    pub fn scatter(&self) -> f64 {
        self.of_training().map(|(_, own)| own).sum()
    }

    /// How far the whole residual is above that, relative: median of the training passages.
    pub fn excess(&self) -> f64 {
        let above = self.of_training().map(|(all, own)| all / own.max(f64::MIN_POSITIVE) - 1.0);
        quantile(&above.collect::<Vec<_>>(), 0.5)
    }

    /// Energy of the windows of every training passage, and of what differs between them.
    fn of_training(&self) -> impl Iterator<Item = (f64, f64)> {
        self.train.iter().map(|i| {
            let inside = energies(&self.residuals[*i]);
            (inside.0, own_energy(inside, self.residuals[*i].len()))
        })
    }

    /// Passages that nothing is learned from.
    pub fn held_out(&self) -> Vec<usize> {
        (0..self.observed.len()).filter(|i| !self.train.contains(i)).collect()
    }

    /// The one of some passages, at least one, whose speed is in the middle.
    pub fn of_middle_speed(&self, mut passages: Vec<usize>) -> usize {
        let speed = |i: &usize| self.observed[*i].speed_m_s;
        passages.sort_by(|a, b| speed(a).total_cmp(&speed(b)));
        passages[passages.len() / 2]
    }

    /// What shapes around wheels add to windows, as far as the recordings of the training passages bear it out, and the same over the whole
    /// recordings: what a wheel does that leaves the rail over a flat is less than its linear response. Not for what wheels have in common,
    /// of which the model has its part already: hollow ones are borne out by too little.
    pub fn around_wheels(&self, mut windows: Vec<Vec<Vec<f64>>>) -> (Vec<Vec<Vec<f64>>>, Vec<Vec<f64>>) {
        let of_training = self.train.iter().flat_map(|i| self.residuals[*i].iter().zip(&windows[*i]));
        let part = borne_out(of_training);
        windows.iter_mut().flatten().flatten().for_each(|value| *value *= part);
        let traces = self.spread(&windows).iter().map(|trace| without_slow(trace)).collect();
        (windows, traces)
    }

    /// Spreads window contributions over the recordings.
    pub fn spread(&self, windows: &[Vec<Vec<f64>>]) -> Vec<Vec<f64>> {
        self.observed
            .iter()
            .zip(&self.traces)
            .zip(windows)
            .map(|((o, trace), windows)| {
                let mut out = vec![0.0; trace.residual.len()];
                for (bogie, window) in o.bogie_s().iter().zip(windows) {
                    let from = o.first_axle_s + bogie + o.first_s - trace.start_s;
                    for (k, value) in out.iter_mut().enumerate() {
                        let p = (k as f64 / RATE_HZ - from) * RATE_HZ;
                        if p >= 0.0 && (p as usize) + 1 < window.len() {
                            let (i, t) = (p as usize, p.fract());
                            *value += (1.0 - t) * window[i] + t * window[i + 1];
                        }
                    }
                }
                out
            })
            .collect()
    }

    /// Windows cut from signals over the whole recording.
    pub fn cut(&self, traces: &[Vec<f64>]) -> Vec<Vec<Vec<f64>>> {
        self.observed
            .iter()
            .zip(&self.traces)
            .zip(traces)
            .map(|((o, trace), signal)| {
                let window = |bogie: &f64| {
                    let from = o.first_axle_s + bogie + o.first_s - trace.start_s;
                    (0..o.mean.len())
                        .map(|k| {
                            let p = from * RATE_HZ + k as f64;
                            let i = p.max(0.0) as usize;
                            let t = p - i as f64;
                            match signal.get(i..i + 2) {
                                Some(s) => (1.0 - t) * s[0] + t * s[1],
                                None => 0.0,
                            }
                        })
                        .collect()
                };
                o.bogie_s().iter().map(window).collect()
            })
            .collect()
    }
}

/// How late passages are by a model, s: as it was fitted to some of them, by correlation for the others.
fn late_s(
    observed: &[Observed],
    (state, fitted): (&State, &[usize]),
    responses: &[Response],
    sensor: SensorModel,
) -> Vec<f64> {
    let of = |(i, o): (usize, &Observed)| match fitted.contains(&i) {
        true => state.shift_m[i] / o.speed_m_s,
        false => o.lag(&responses[i], sensor.gain_at(o.temperature_c), ALIGN_M),
    };
    observed.iter().enumerate().map(of).collect()
}

/// Part of what windows are thought to hold that lowers their squares the most, at most all of it.
pub(super) fn borne_out<'w>(windows: impl Iterator<Item = (&'w Vec<f64>, &'w Vec<f64>)>) -> f64 {
    let (both, own) = windows.fold((0.0, 0.0), |(both, own), (y, w)| (both + dot(y, w), own + dot(w, w)));
    (both / f64::max(own, f64::MIN_POSITIVE)).clamp(0.0, 1.0)
}

/// What shapes around wheels do is nothing below the first frequency, and whole above the second, Hz: a wheel sits on springs too soft to
/// press the track more slowly, and waves around it have 23 Hz and more. Windows end before what is in them has died away; integrated
/// twice, such an end is a deflection of the sleeper of several times what there is.
const SLOW_HZ: [f64; 2] = [10.0, 20.0];

/// A signal at [`RATE_HZ`] without what is slower than wheels' shapes are.
fn without_slow(signal: &[f64]) -> Vec<f64> {
    filtered(signal, RATE_HZ, |f| c64::new(1.0 - taper(f, SLOW_HZ[0], SLOW_HZ[1]), 0.0))
}

/// ln(1 − share + share · e^gain), without overflow.
pub fn mixed(share: f64, gain: f64) -> f64 {
    let top = gain.max(0.0);
    top + ((1.0 - share) * (-top).exp() + share * (gain - top).exp()).ln()
}

/// Probability that one of a mixture is there.
pub fn responsibility(share: f64, gain: f64) -> f64 {
    1.0 / (1.0 + (1.0 - share) / share.max(1e-12) * (-gain).exp())
}

/// Shares tried for mixtures.
pub const SHARES: [f64; 9] = [0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.95];

/// Best share for a list of gains: (log evidence, share).
pub fn best_share(gains: &[f64]) -> (f64, f64) {
    SHARES
        .iter()
        .map(|q| (gains.iter().map(|g| mixed(*q, *g)).sum::<f64>(), *q))
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .unwrap_or((0.0, 0.0))
}

/// Product of a matrix with a vector most of whose values are nought.
pub fn times(matrix: &Mat<f64>, vector: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; matrix.nrows()];
    for (j, v) in vector.iter().enumerate().filter(|(_, v)| **v != 0.0) {
        for (o, m) in out.iter_mut().zip(matrix.col_as_slice(j)) {
            *o += v * m;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::measure::displacement;
    use super::*;

    /// A wave of 60 Hz in a window that ends in the middle of it: 1 m/s² is 7 µm.
    #[test]
    fn regress_end_of_a_window_is_no_deflection() {
        let tau = std::f64::consts::TAU;
        let inside = |k: usize| (400..550).contains(&k);
        let wave = |k: usize| (tau * 60.0 * (k - 400) as f64 / RATE_HZ).sin();
        let trace: Vec<f64> = (0..1200).map(|k| if inside(k) { wave(k) } else { 0.0 }).collect();
        let largest = |v: &[f64]| displacement(v).iter().fold(0.0, |l: f64, d| l.max(d.abs()));
        assert!(largest(&trace) > 30e-6, "{}", largest(&trace));
        let kept = without_slow(&trace);
        assert!((6e-6..15e-6).contains(&largest(&kept)), "{}", largest(&kept));
        assert!((425..525).all(|k| (kept[k] - wave(k)).abs() < 0.15));
    }

    #[test]
    fn analytic_part_that_is_borne_out() {
        let (shape, beside) = (vec![2.0, 0.0, 1.0], vec![0.0, 5.0, 0.0]);
        let recorded =
            |part: f64| -> Vec<f64> { shape.iter().zip(&beside).map(|(s, b)| part * s + b).collect() };
        for (part, expected) in [(0.4, 0.4), (1.3, 1.0), (-0.2, 0.0)] {
            let recorded = recorded(part);
            let found = borne_out([(&recorded, &shape)].into_iter());
            assert!((found - expected).abs() < 1e-12, "{part}: {found}");
        }
    }
}
