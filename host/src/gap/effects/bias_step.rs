//! Baseline shifts of the sensor after the shock of a bogie, which decay: charge amplifiers, slipping mounts.
//!
//! Decay, and where a bogie is when it shocks the sensor, belong to the site; sign and size to every shock. The residual is compared
//! below 12 Hz, where the track's own response is smooth and well predicted, with one decaying step per bogie; where the steps rise is
//! told by the whole band. Large steps drive a model astray, and pass for wheels that differ from one another; but a baseline that
//! decays behind the train is no train's.

use argmin::core::{CostFunction, Executor};
use argmin::solver::neldermead::NelderMead;
use faer::Mat;
use faer::linalg::solvers::Solve as _;
use rayon::prelude::*;

use crate::gap::data::{QuietEnd, RATE_HZ};
use crate::gap::effect::{Advice, Stage};
use crate::gap::forward::BAND_HZ;
use crate::gap::included::{How, Inclusion};
use crate::gap::latent::{Latent, LatentFit, Scene};
use crate::signal::{
    between, dot, freed, irfft, mean, quantile, rfft, rfft_frequencies_hz, sum_in_order, taper,
};

/// See the module.
pub struct BiasStep;

/// Band of the comparison, Hz.
const LOW_HZ: [f64; 2] = [8.0, 12.0];
/// Decay times tried, s: from a bogie's passage to the whole train.
const DECAY_S: [f64; 8] = [0.05, 0.1, 0.15, 0.25, 0.4, 0.7, 1.2, 2.5];
/// Where the front axle is when the shock comes, metres of travel: either axle may bring it.
const AT_M: [f64; 3] = [0.0, 1.3, 2.6];
/// First steps of the search from there: logarithm of the decay, metres; where it ends.
const SEARCH: [f64; 2] = [0.2, 0.4];
const SEARCHED: f64 = 1e-6;
const MOST_STEPS: u64 = 60;
/// Cost of a step's size and of the decay, nats.
const PER_STEP: f64 = 2.0;
/// Steps show without trains when a baseline that decays behind the train explains this share of what its ends hold, and is this large
/// there, m/s²: of 23 simulated sites with steps all but the weakest reach 0.55, no other site 0.02, ringing voids and interference
/// included; recordings without either have less than 0.02 m/s².
const APART: (f64, f64) = (0.5, 0.05);
/// Values that a train-free end is filled up to with noughts, so that the strongest of its frequencies is found within 0.2 Hz.
const TONE_LINES: usize = 4096;
/// The sensor's high pass and the errors of the model leave the mean step this uncertain, relative; and the decay, as a factor.
const STEP_ERROR: f64 = 0.08;
const DECAY_FACTOR: f64 = 1.3;

/// What all steps of a site share.
#[derive(Clone, Copy, Debug)]
struct Shock {
    decay_s: f64,
    /// Where the front axle of a bogie is, metres of travel behind x = 0.
    at_m: f64,
}

impl Latent for BiasStep {
    fn name(&self) -> &'static str {
        "bias-step"
    }

    fn stage(&self) -> Stage {
        Stage::Sensor
    }

    fn advice(&self) -> Advice {
        Advice {
            what: "the sensor's baseline shifts after shocks",
            action: "Check how the sensor is fixed, and its amplifier; replace it if that does not help.",
        }
    }

    fn inclusion(&self) -> Inclusion {
        let does = "Forces and displacements: `analyse --with-effects` takes the steps off the recordings.";
        Inclusion { does: Some(does), how: How::Steadied }
    }

    fn explore(&self, scene: &Scene) -> Option<LatentFit> {
        let comparison = Comparison::new(scene);
        let (score, shock) = comparison.coarse()?;
        if score <= 0.0 {
            return None;
        }
        let shock = comparison.refined(shock);
        if !(DECAY_S[0]..=DECAY_S[7]).contains(&shock.decay_s) {
            // What is over before the bogie has passed is its own doing, what outlasts trains the recorder's bias.
            return None;
        }
        let fits: Vec<Steps> =
            (0..scene.observed.len()).into_par_iter().map(|i| comparison.steps(i, shock)).collect();
        let score = scene.train.iter().map(|i| fits[*i].gain).sum();
        let learnt: Vec<f64> =
            scene.train.iter().flat_map(|i| fits[*i].sizes.iter().map(|s| s.abs())).collect();
        let step = quantile(&learnt, 0.5);
        let spread = quantile(&learnt, 0.75) - quantile(&learnt, 0.25);
        let half = (1.3 * spread / (learnt.len() as f64).sqrt()).max(0.05 * step);
        let traces: Vec<Vec<f64>> = (0..scene.observed.len())
            .map(|i| {
                let n = scene.traces[i].residual.len();
                let mut out = vec![fits[i].level; n];
                for (column, size) in comparison.columns(i, shock).iter().zip(&fits[i].sizes) {
                    out.iter_mut().zip(column).for_each(|(o, c)| *o += size * c);
                }
                out
            })
            .collect();
        let decay_s = shock.decay_s;
        let behind: Vec<(f64, f64)> =
            scene.train.iter().map(|i| decaying(&scene.observed[*i].quiet_ends(), decay_s)).collect();
        let typical = |of: fn(&(f64, f64)) -> f64| quantile(&behind.iter().map(of).collect::<Vec<_>>(), 0.5);
        Some(LatentFit {
            apart: typical(|b| b.0) > APART.0 && typical(|b| b.1.abs()) > APART.1,
            gain: score,
            parameters: vec![
                ("step_m_s2", step, step - half - STEP_ERROR * step, step + half + STEP_ERROR * step),
                ("decay_s", decay_s, decay_s / DECAY_FACTOR, decay_s * DECAY_FACTOR),
            ],
            decay_s: Some(decay_s),
            wheel_share: None,
            windows: scene.cut(&traces),
            traces,
        })
    }
}

/// What shocks are compared with.
struct Comparison<'a, 's> {
    scene: &'a Scene<'s>,
    edge: Edge,
    /// Residuals of the passages in the low band.
    low: Vec<Vec<f64>>,
}

impl<'a, 's> Comparison<'a, 's> {
    fn new(scene: &'a Scene<'s>) -> Self {
        let low = scene.traces.par_iter().map(|t| low(&t.residual)).collect();
        Self { scene, edge: Edge::new(), low }
    }

    /// Gain and shock of the best of those that are tried.
    fn coarse(&self) -> Option<(f64, Shock)> {
        DECAY_S
            .iter()
            .flat_map(|decay_s| AT_M.map(|at_m| Shock { decay_s: *decay_s, at_m }))
            .map(|shock| (self.score(shock), shock))
            .max_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// The shock that leaves least of the residual, from one near it.
    fn refined(&self, from: Shock) -> Shock {
        let start = vec![from.decay_s.ln(), from.at_m];
        let mut simplex = vec![start; 3];
        (0..2).for_each(|k| simplex[k + 1][k] += SEARCH[k]);
        let solver = NelderMead::new(simplex).with_sd_tolerance(SEARCHED);
        let found = solver
            .and_then(|s| Executor::new(self, s).configure(|state| state.max_iters(MOST_STEPS)).run())
            .ok()
            .and_then(|result| result.state.best_param);
        found.map_or(from, |best| Shock { decay_s: best[0].exp(), at_m: best[1] })
    }

    /// Gain in log evidence over the training passages.
    fn score(&self, shock: Shock) -> f64 {
        sum_in_order(self.scene.train.par_iter().map(|i| self.steps(*i, shock).gain))
    }

    /// Steps of one passage.
    fn steps(&self, passage: usize, shock: Shock) -> Steps {
        let y = &self.low[passage];
        let all: Vec<Vec<f64>> = self.columns(passage, shock).iter().map(|c| low(c)).collect();
        let count = all.len();
        let Some((left, sizes, level)) = least_squares(all, y) else {
            return Steps { gain: f64::NEG_INFINITY, sizes: vec![0.0; count], level: 0.0 };
        };
        let middle = mean(y);
        let before: f64 = y.iter().map(|v| (v - middle).powi(2)).sum();
        let independent = y.len() as f64 * 2.0 * LOW_HZ[1] / RATE_HZ;
        let ratio = (before / left.max(1e-12)).ln();
        Steps { gain: 0.5 * independent * ratio - PER_STEP * count as f64, sizes, level }
    }

    /// Unit steps at the bogies of a passage.
    fn columns(&self, passage: usize, shock: Shock) -> Vec<Vec<f64>> {
        let o = &self.scene.observed[passage];
        let trace = &self.scene.traces[passage];
        o.bogie_s()
            .iter()
            .map(|b| {
                let at = o.first_axle_s + b + shock.at_m / o.speed_m_s - trace.start_s;
                (0..trace.residual.len())
                    .map(|k| {
                        let t = k as f64 / RATE_HZ - at;
                        self.edge.at(t) * (-t.max(0.0) / shock.decay_s).exp()
                    })
                    .collect()
            })
            .collect()
    }
}

/// What steps of the logarithm of the decay and of the place leave of the residual in the whole band.
impl CostFunction for &Comparison<'_, '_> {
    type Param = Vec<f64>;
    type Output = f64;

    fn cost(&self, p: &Vec<f64>) -> Result<f64, argmin::core::Error> {
        let shock = Shock { decay_s: p[0].exp(), at_m: p[1] };
        Ok(sum_in_order(self.scene.train.par_iter().map(|i| {
            let left = least_squares(self.columns(*i, shock), &self.scene.traces[*i].residual);
            left.map_or(f64::INFINITY, |(left, ..)| left)
        })))
    }
}

/// A unit step that ends where the band of the recordings does.
struct Edge {
    /// Rise above one half, from the middle on, every [`Self::STEP_S`].
    rise: Vec<f64>,
}

impl Edge {
    const STEP_S: f64 = 1e-4;
    /// Until then its waves have died down.
    const LONGEST_S: f64 = 0.06;

    fn new() -> Self {
        let count = (Self::LONGEST_S / Self::STEP_S) as usize + 2;
        let lines = BAND_HZ[1] as usize;
        let rise = (0..count).map(|k| {
            let t = k as f64 * Self::STEP_S;
            let line = |i: usize| {
                let f = i as f64 + 0.5;
                let phase = std::f64::consts::TAU * f * t;
                taper(f, BAND_HZ[0], BAND_HZ[1]) * phase.sin() / (std::f64::consts::PI * f)
            };
            (0..lines).map(line).sum::<f64>()
        });
        Self { rise: rise.collect() }
    }

    /// Value a time after the step.
    fn at(&self, t_s: f64) -> f64 {
        let rise = between(&self.rise, t_s.abs() / Self::STEP_S).unwrap_or(0.5);
        if t_s < 0.0 { 0.5 - rise } else { 0.5 + rise }
    }
}

/// Share of the energy of the train-free ends, about their mean and without the strongest tone in them, that a baseline explains which is
/// level before the train and decays behind it; and its size at the first value there, m/s².
fn decaying([before, behind]: &[QuietEnd; 2], decay_s: f64) -> (f64, f64) {
    let y = [&before.value_m_s2[..], &behind.value_m_s2[..]].concat();
    let fall = (0..behind.value_m_s2.len()).map(|k| (-(k as f64) / (RATE_HZ * decay_s)).exp());
    let x: Vec<f64> = before.value_m_s2.iter().map(|_| 0.0).chain(fall).collect();
    // Interference may be louder than the baseline, and hides nothing of it.
    let rest = freed(&y, &[&x]);
    let tone = strongest_tone(&rest, before.value_m_s2.len());
    let tone: Vec<&[f64]> = tone.iter().map(Vec::as_slice).collect();
    let (x, y) = (freed(&x, &tone), freed(&y, &tone));
    let size_m_s2 = dot(&x, &y) / dot(&x, &x).max(f64::MIN_POSITIVE);
    (size_m_s2 * dot(&x, &y) / dot(&y, &y).max(f64::MIN_POSITIVE), size_m_s2)
}

/// Cosine and sine in each of two ends, of `first` values and the rest, at the frequency that is strongest in both together.
fn strongest_tone(ends: &[f64], first: usize) -> Vec<Vec<f64>> {
    let (before, behind) = ends.split_at(first.min(ends.len()));
    let spectra = [before, behind].map(|end| {
        let mut padded = end.to_vec();
        padded.resize(TONE_LINES.max(end.len()), 0.0);
        rfft(&padded)
    });
    let lines = rfft_frequencies_hz(TONE_LINES, RATE_HZ);
    let power = |k: usize| spectra.iter().filter_map(|s| s.get(k)).map(|v| v.norm_sqr()).sum::<f64>();
    let in_band = (0..lines.len()).filter(|k| (LOW_HZ[1]..BAND_HZ[0]).contains(&lines[*k]));
    let Some(strongest) = in_band.max_by(|a, b| power(*a).total_cmp(&power(*b))) else { return Vec::new() };
    let omega = std::f64::consts::TAU * lines[strongest] / RATE_HZ;
    let column = |of: fn(f64) -> f64, end: usize| -> Vec<f64> {
        let inside = |k: usize| usize::from(k >= before.len()) == end;
        (0..ends.len()).map(|k| if inside(k) { of(omega * k as f64) } else { 0.0 }).collect()
    };
    [0, 1].into_iter().flat_map(|end| [column(f64::cos, end), column(f64::sin, end)]).collect()
}

fn low(values: &[f64]) -> Vec<f64> {
    let n = values.len();
    let mut spectrum = rfft(values);
    for (v, f) in spectrum.iter_mut().zip(rfft_frequencies_hz(n, RATE_HZ)) {
        *v *= taper(f, LOW_HZ[0], LOW_HZ[1]);
    }
    irfft(&spectrum, n)
}

/// Steps of one passage.
struct Steps {
    /// Gain in log evidence (BIC).
    gain: f64,
    /// m/s², one per bogie.
    sizes: Vec<f64>,
    /// Level before the train, m/s²: what decays behind it has passed for the recorder's bias.
    level: f64,
}

/// Squares that columns and a level leave of a signal, the sizes of the columns, and the level.
fn least_squares(mut columns: Vec<Vec<f64>>, y: &[f64]) -> Option<(f64, Vec<f64>, f64)> {
    let count = columns.len();
    columns.push(vec![1.0; y.len()]);
    let gram = Mat::from_fn(count + 1, count + 1, |i, j| dot(&columns[i], &columns[j]));
    let right = Mat::from_fn(count + 1, 1, |i, _| dot(&columns[i], y));
    let solved = gram.llt(faer::Side::Lower).ok()?.solve(&right);
    let explained: f64 = (0..=count).map(|i| solved[(i, 0)] * right[(i, 0)]).sum();
    Some((dot(y, y) - explained, (0..count).map(|c| solved[(c, 0)]).collect(), solved[(count, 0)]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::passage::random::Random;

    /// Two ends of 0.27 s with noise of 0.05 m/s² and a baseline that decays behind the train.
    fn ends(size_m_s2: f64, decay_s: f64) -> [QuietEnd; 2] {
        let mut random = Random::new(5, 0);
        [0.0, size_m_s2].map(|size| QuietEnd {
            start_s: 0.0,
            value_m_s2: (0..216)
                .map(|k| 0.1 + size * (-(k as f64) / (RATE_HZ * decay_s)).exp() + 0.05 * random.normal())
                .collect(),
        })
    }

    #[test]
    fn property_a_baseline_that_decays_behind_the_train_shows_its_size() {
        for (size_m_s2, decay_s) in [(0.4, 0.3), (-2.0, 0.15), (0.2, 1.0)] {
            let (share, found) = decaying(&ends(size_m_s2, decay_s), decay_s);
            assert!(share > APART.0 && found.abs() > APART.1, "{share} {found}");
            assert!((found - size_m_s2).abs() < 0.03, "{found} of {size_m_s2}");
        }
        let (share, found) = decaying(&ends(0.0, 0.3), 0.3);
        assert!(share < APART.0 && found.abs() < APART.1, "{share} {found}");
    }

    #[test]
    fn regress_a_baseline_decays_beside_interference() {
        let beside = |size_m_s2: f64| {
            let mut ends = ends(size_m_s2, 0.7);
            for end in &mut ends {
                end.value_m_s2
                    .iter_mut()
                    .enumerate()
                    .for_each(|(k, v)| *v += 3.9 * (0.1605 * k as f64 + 1.0).sin());
            }
            decaying(&ends, 0.7)
        };
        let (share, found) = beside(1.5);
        assert!(share > APART.0 && (found - 1.5).abs() < 0.05, "{share} {found}");
        let (share, _) = beside(0.0);
        assert!(share < APART.0, "{share}");
    }

    #[test]
    fn analytic_a_step_that_ends_with_the_band() {
        let edge = Edge::new();
        assert!((edge.at(0.0) - 0.5).abs() < 1e-12);
        // The slope in the middle is twice the area under the taper: 250 Hz and half of 50 Hz.
        let slope = (edge.at(2e-4) - edge.at(-2e-4)) / 4e-4;
        assert!((slope / (2.0 * 275.0) - 1.0).abs() < 0.01, "{slope}");
        // Si(pi)/pi - 1/2 = 0.0895 for a sharp end of the band; a tapered one rings less.
        let most = (0..600).map(|k| edge.at(f64::from(k) * 1e-4)).fold(0.0, f64::max) - 1.0;
        assert!(0.05 < most && most < 0.0895, "{most}");
        assert!((edge.at(0.05) - 1.0).abs() < 1e-3 && edge.at(-0.05).abs() < 1e-3);
    }
}
