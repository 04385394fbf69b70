//! Whether an effect that fits well can be one, and a model that fits well the right one: sizes, ranges, and what is known beside
//! the residual.

use faer::Mat;

use super::Session;
use super::candidates::{APART_SHARE, LEAST_DISPLACEMENT_EXCESS};
use super::recorder::{SATURATION, clock_by_operator, shows};
use crate::gap::GapError;
use crate::gap::data::{Observed, stated_noise_m_s2};
use crate::gap::effect::{Effect, Hints, Stage, Witness};
use crate::gap::fit::{Fit, simulate, values, whitened};
use crate::gap::forward::{BAND_HZ, Response};
use crate::signal::{centre, dot, freed, quantile, rms};
use crate::track::Side;

/// Probability that temperatures shuffled among the passages would go with their scale as well, above which a gain does not
/// follow the temperature: trains differ by chance.
const MOST_CHANCE: f64 = 0.01;
const SHUFFLES: usize = 999;

/// What is recorded before trains come is more than noise above this many times the sensor's stated one: 549 sites without
/// interference have up to 1.1 times of it, a tone of 0.23 m/s² 4.7 times.
const MORE_THAN_NOISE: f64 = 2.0;

/// How far the displacement may be above what differs from bogie to bogie, in squares, with the effects that are there: 0.30 on a recording
/// of a clock that is 1.5 % wrong and beside clipping over voids; stand-ins for what is left out of the catalogue leave 0.76 to 0.87.
const MOST_DISPLACEMENT_LEFT: f64 = 0.5;

/// What speaks against a model from outside its residual.
pub(super) struct Denial {
    /// Whether a path that is estimated, because there is no laser scan, can make it as well.
    pub of_path: bool,
    /// Where it points, if anywhere.
    pub stage: Option<Stage>,
    /// What to do about it.
    pub remark: String,
}

impl Session<'_> {
    /// Whether what was recorded beside the acceleration bears an effect out: the temperatures a gain that follows them.
    pub(super) fn borne_out(&self, effect: &dyn Effect) -> bool {
        let observed = &self.base.frame.observed;
        if effect.witness() != Witness::Temperatures {
            return true;
        }
        let train = &self.split.train;
        let of = |value: &dyn Fn(usize) -> f64| -> Vec<f64> { train.iter().map(|i| value(*i)).collect() };
        let Ok(scales) = self.scales(train) else { return false };
        let temperatures = of(&|i| observed[i].temperature_c);
        let speeds = of(&|i| observed[i].speed_m_s);
        chance(&scales, &temperatures, &speeds) < MOST_CHANCE
    }

    /// What denies the model, however small the gap.
    pub(super) fn denials(&self) -> Result<Vec<Denial>, GapError> {
        let fit = self.current();
        let path = fit.state.untenable(&self.base.frame).map(|side| Denial {
            of_path: true,
            stage: None,
            remark: match side {
                Side::Crossing => {
                    "model and recordings agree only over a path that departs from the laser scan more than scans do: scan again, or \
                     something acts that is not in the catalogue"
                }
                Side::Stock => {
                    "model and recordings agree only over a stock rail that is rougher than rails are: look at it, or something acts \
                     that is not in the catalogue"
                }
            }
            .into(),
        });
        let bed = fit.denies_bed().then(|| Denial {
            of_path: true,
            stage: None,
            remark: format!(
                "model and recordings agree only over ballast that changes from sleeper to sleeper around the crossing as hardly a bed \
                 does (shape p3 {:.2}, 0.2 … 0.6 expected): voids, pads or rail differ from what is known, or something acts that is not \
                 in the catalogue",
                fit.state.ballast[2]
            ),
        });
        let recorder = [self.clipping_denial(), self.clock_denial(), self.unrest_denial()];
        let others = [self.wheels_denial(), self.lost_denial(), self.displacement_denial()?];
        let others = recorder.into_iter().chain(others);
        Ok([path, bed].into_iter().chain(others).flatten().collect())
    }

    /// More than noise is recorded before trains come, enough to matter beside the wheels' scatter, and nothing named accounts for
    /// it.
    fn unrest_denial(&self) -> Option<Denial> {
        // Without a search nothing is known of the wheels' scatter; a noise of 0 is not stated.
        let unstated = self.base.frame.base.crossing.sensor.noise_rms_m_s2 <= 0.0;
        if unstated || self.scatter.1 <= 0.0 || self.latent_fits.iter().any(|(_, found)| found.apart) {
            return None;
        }
        let (observed, sensor) = (&self.base.frame.observed, &self.base.frame.base.crossing.sensor);
        let (found_m_s2, stated_m_s2) = (before_trains_m_s2(observed), stated_noise_m_s2(sensor));
        let samples: usize = self.split.train.iter().flat_map(|i| &observed[*i].windows).map(Vec::len).sum();
        let share = samples as f64 * (found_m_s2.powi(2) - stated_m_s2.powi(2)) / self.scatter.1;
        (share > APART_SHARE && found_m_s2 > MORE_THAN_NOISE * stated_m_s2).then(|| Denial {
            of_path: false,
            stage: Some(Stage::Sensor),
            remark: format!(
                "before trains come the sensor shows {found_m_s2:.2} m/s\u{b2} (RMS below {:.0} Hz), of which its stated noise is \
                 {stated_m_s2:.2}: look for interference, a loose cable, or something else that shakes the track",
                BAND_HZ[0]
            ),
        })
    }

    /// Range of a transducer that clips, m/s², where no clipping is named.
    pub(super) fn clips_unnamed_at_m_s2(&self) -> Option<f64> {
        self.clips_at_m_s2.filter(|_| self.named.iter().all(|n| n.name != SATURATION))
    }

    fn clipping_denial(&self) -> Option<Denial> {
        Some(Denial {
            of_path: false,
            stage: Some(Stage::Sensor),
            remark: format!(
                "values pile up at \u{b1}{:.1} m/s\u{b2} in most recordings: the transducer clips there, which no effect found accounts \
                 for; use a sensor with a larger range",
                self.clips_unnamed_at_m_s2()?
            ),
        })
    }

    /// The operator's speeds show a wrong clock beyond chance, and no clock error is named.
    fn clock_denial(&self) -> Option<Denial> {
        let named = self.named.iter().any(|n| n.stage == Stage::Timing);
        let (mean, sd) = clock_by_operator(&self.base.frame).filter(|c| shows(c) && !named)?;
        Some(Denial {
            of_path: false,
            stage: Some(Stage::Timing),
            remark: format!(
                "by the operator's speeds the recorder's clock is off by {:.1} ± {:.1} %, which no effect found accounts for: check \
                 its sampling rate, and the speeds",
                100.0 * mean,
                100.0 * sd
            ),
        })
    }

    /// Wheels differ more than sound ones do, and nothing is named; where the model is lost, scatter says nothing of wheels.
    fn wheels_denial(&self) -> Option<Denial> {
        let sought = self.named.is_empty() && !self.base.fit.lost();
        let how = sought.then(|| self.base.variation.unnatural()).flatten()?;
        Some(Denial {
            of_path: false,
            stage: Some(Stage::Vehicle),
            remark: format!("wheels differ from one another more than sound wheels do, {how}"),
        })
    }

    /// The model is lost, and nothing is named: what differs from bogie to bogie may be as large, and then hides the gap.
    fn lost_denial(&self) -> Option<Denial> {
        let misfit = self.base.fit.inflation();
        (self.named.is_empty() && self.base.fit.lost()).then(|| Denial {
            of_path: true,
            stage: None,
            remark: format!(
                "what all bogies share departs from the model by {:.1} times what differs from bogie to bogie accounts for: something acts \
                 that the model does not hold; look at how the sensor is mounted, its cable and its range, and at the panel",
                misfit.sqrt()
            ),
        })
    }

    /// The displacement is missed, with whatever is named: what acts on it may be a small part of the acceleration.
    fn displacement_denial(&self) -> Result<Option<Denial>, GapError> {
        let [_, displacement] = self.missed()?;
        let excess = displacement.excess();
        let (with, most) = match self.named.is_empty() {
            true => ("", LEAST_DISPLACEMENT_EXCESS),
            false => (", with the effects named,", MOST_DISPLACEMENT_LEFT),
        };
        Ok((excess > most).then(|| Denial {
            of_path: true,
            stage: None,
            remark: format!(
                "the sleeper's displacement departs from the model{with} by {:.1} times what differs from bogie to bogie: look at the \
                 ballast, for voids, and at the loads",
                (1.0 + excess).sqrt()
            ),
        }))
    }

    /// Factors by which the base model's mean windows fit passages best, given how wheels differ.
    fn scales(&self, passages: &[usize]) -> Result<Vec<f64>, GapError> {
        let frame = &self.base.frame;
        // Over voids there is no base model without them.
        let (state, effects) = match self.linear {
            Some(_) => (self.state(), self.accepted.as_slice()),
            None => (self.base.fit.state.clone(), [].as_slice()),
        };
        let world = state.world(frame, effects);
        let responses = simulate(&world, frame, passages)?;
        let scale = |index: usize, response: &Response| {
            let o = &frame.observed[index];
            let late_s = state.shift_m[index] / o.speed_m_s;
            let predicted = o.predicted_mean(response, 1.0, late_s);
            let columns = Mat::from_fn(o.mean.len(), 2, |k, c| if c == 0 { o.mean[k] } else { predicted[k] });
            let white = whitened(&frame.factors[index], &columns);
            let (mean, predicted) = (white.col_as_slice(0), white.col_as_slice(1));
            dot(predicted, mean) / dot(predicted, predicted).max(f64::MIN_POSITIVE)
        };
        Ok(passages.iter().zip(&responses).map(|(i, r)| scale(*i, r)).collect())
    }
}

/// Acceleration before trains come: RMS in the band of the comparison, median of the recordings, m/s².
fn before_trains_m_s2(observed: &[Observed]) -> f64 {
    let levels = observed.iter().map(|o| {
        let [mut end, _] = o.quiet_ends();
        centre(&mut end.value_m_s2);
        rms(&end.value_m_s2)
    });
    quantile(&levels.collect::<Vec<_>>(), 0.5)
}

/// How often shuffled `x` go with `y` at least as well as `x` do, both freed of what goes with `z`.
fn chance(y: &[f64], x: &[f64], z: &[f64]) -> f64 {
    let (y, mut x) = (freed(y, &[z]), freed(x, &[z]));
    let found = dot(&x, &y).abs();
    let mut random = crate::passage::random::Random::new(1, 1);
    let mut as_good = 0;
    for _ in 0..SHUFFLES {
        for i in (1..x.len()).rev() {
            x.swap(i, random.below(i + 1));
        }
        as_good += usize::from(dot(&x, &y).abs() >= found);
    }
    (as_good + 1) as f64 / (SHUFFLES + 1) as f64
}

/// Sizes of an effect must be this many standard deviations away from nought.
const CLEAR_OF_NOUGHT: f64 = 3.0;

/// Where there is no nought to be clear of, recordings that leave this part of what was uncertain before them tell no size.
const TOLD: f64 = 0.5;

/// Gains in log evidence per independent look, nats, from which on these parts of the least size are enough. Moving ballast of 38 kg/m that
/// gained 254 nats was refused for its size, and pads with 144 named instead of it; so were pads of 0.89 with 300, and light wheelsets with
/// 270. On sites without effect no size between the half and the whole gains anything, and pads of 1.06, a quarter, up to 92.
const SURE_OF_SIZE: [(f64, f64); 2] = [(250.0, 0.25), (100.0, 0.5)];

/// Whether effect `index` of a fit is larger than what the forward model's own errors can pass for, and than what is uncertain of
/// it; `inflation` is the squared misfit per value, `gain` that of the effect in log evidence per independent look.
pub(super) fn large_enough(
    effect: &dyn Effect,
    (fit, index): (&Fit, usize),
    inflation: f64,
    gain: f64,
) -> bool {
    let Some(coordinates) = fit.state.effects.get(index) else { return true };
    let from_it_on: usize = fit.state.effects[index..].iter().map(Vec::len).sum();
    let first = fit.covariance.nrows() - from_it_on;
    let Some(nought) = effect.nought() else {
        let mut sizes = effect.parameters().iter().take(effect.sizes()).enumerate();
        return sizes.all(|(k, p)| fit.covariance[(first + k, first + k)] < (TOLD * p.prior.1).powi(2));
    };
    let part = SURE_OF_SIZE.iter().find(|(sure, _)| gain > *sure).map_or(1.0, |(_, part)| *part);
    let parameters = effect.parameters().iter().zip(coordinates.iter().zip(&nought)).enumerate();
    parameters.take(effect.telling()).any(|(k, (p, (c, n)))| {
        let sd = (inflation * fit.covariance[(first + k, first + k)].max(0.0)).sqrt();
        (c - n).abs() >= (part * p.least).max(CLEAR_OF_NOUGHT * sd)
    })
}

/// Whether the recordings can come about with an effect of a fit, the one at `index`.
pub(super) fn possible(effect: &dyn Effect, (fit, index): (&Fit, usize), hints: &Hints) -> bool {
    let Some(coordinates) = fit.state.effects.get(index) else { return true };
    effect.possible(&values(effect, coordinates), hints)
}

/// Whether an effect of a fit, the one at `index`, is away from the ends of its ranges.
pub(super) fn inside_ranges(effect: &dyn Effect, fit: &Fit, index: usize) -> bool {
    let Some(coordinates) = fit.state.effects.get(index) else { return true };
    effect
        .parameters()
        .iter()
        .zip(coordinates)
        .filter(|(p, _)| !p.nuisance)
        .all(|(p, c)| *c > p.range[0] + 1e-9 && *c < p.range[1] - 1e-9)
}
