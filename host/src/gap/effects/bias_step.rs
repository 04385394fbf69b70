//! Baseline shifts of the sensor after the shock of a bogie, which decay: charge amplifiers, slipping mounts.
//!
//! Size and decay belong to the sensor, sign and exact size to every shock. The residual is compared below 12 Hz, where the
//! track's own response is smooth and well predicted, with one decaying step per bogie. Large steps drive a model astray, and pass for
//! wheels that differ from one another; but a baseline that decays behind the train is no train's.

use faer::Mat;
use faer::linalg::solvers::Solve as _;
use rayon::prelude::*;

use crate::gap::data::{QuietEnd, RATE_HZ};
use crate::gap::effect::Stage;
use crate::gap::latent::{Latent, LatentFit, Scene};
use crate::signal::{centre, dot, irfft, rfft, rfft_frequencies_hz, sum_in_order, taper};

/// See the module.
pub struct BiasStep;

/// Band of the comparison, Hz.
const LOW_HZ: [f64; 2] = [8.0, 12.0];
/// Decay times tried, s: from a bogie's passage to the whole train.
const DECAY_S: [f64; 8] = [0.05, 0.1, 0.15, 0.25, 0.4, 0.7, 1.2, 2.5];
/// Cost of a step's size and of the decay, nats.
const PER_STEP: f64 = 2.0;
/// Steps show without trains when a baseline that decays behind the train explains this share of what its ends hold, and is this large
/// there, m/s²: of 23 simulated sites with steps all but the weakest reach 0.55, no other site 0.02, ringing voids and interference
/// included; recordings without either have less than 0.02 m/s².
const APART: (f64, f64) = (0.5, 0.05);
/// The sensor's high pass and the grid of decays leave the mean step this uncertain, relative.
const STEP_ERROR: f64 = 0.08;

impl Latent for BiasStep {
    fn name(&self) -> &'static str {
        "bias-step"
    }

    fn stage(&self) -> Stage {
        Stage::Sensor
    }

    fn explore(&self, scene: &Scene) -> Option<LatentFit> {
        let (score, decay_s) = DECAY_S
            .iter()
            .map(|d| (sum_in_order(scene.train.par_iter().map(|i| steps(scene, *i, *d).0)), *d))
            .max_by(|a, b| a.0.total_cmp(&b.0))?;
        if score <= 0.0 {
            return None;
        }
        let fits: Vec<(f64, Vec<f64>)> =
            (0..scene.observed.len()).into_par_iter().map(|i| steps(scene, i, decay_s)).collect();
        let sizes: Vec<f64> = scene.train.iter().flat_map(|i| fits[*i].1.iter().map(|s| s.abs())).collect();
        let step = crate::signal::quantile(&sizes, 0.5);
        let spread = crate::signal::quantile(&sizes, 0.75) - crate::signal::quantile(&sizes, 0.25);
        let half = (1.3 * spread / (sizes.len() as f64).sqrt()).max(0.05 * step);
        let traces: Vec<Vec<f64>> = (0..scene.observed.len())
            .map(|i| {
                let n = scene.traces[i].residual.len();
                let mut out = vec![0.0; n];
                for (column, size) in columns(scene, i, decay_s).iter().zip(&fits[i].1) {
                    out.iter_mut().zip(column).for_each(|(o, c)| *o += size * c);
                }
                out
            })
            .collect();
        let behind: Vec<(f64, f64)> =
            scene.train.iter().map(|i| decaying(&scene.observed[*i].quiet_ends(), decay_s)).collect();
        let typical = |of: fn(&(f64, f64)) -> f64| {
            crate::signal::quantile(&behind.iter().map(of).collect::<Vec<_>>(), 0.5)
        };
        Some(LatentFit {
            apart: typical(|b| b.0) > APART.0 && typical(|b| b.1.abs()) > APART.1,
            gain: score,
            parameters: vec![
                ("step_m_s2", step, step - half - STEP_ERROR * step, step + half + STEP_ERROR * step),
                ("decay_s", decay_s, decay_s / 1.6, decay_s * 1.6),
            ],
            wheel_share: None,
            windows: scene.cut(&traces),
            traces,
        })
    }
}

/// Unit steps at the bogies of a passage.
fn columns(scene: &Scene, passage: usize, decay_s: f64) -> Vec<Vec<f64>> {
    let o = &scene.observed[passage];
    let direction = scene.world.crossing.traffic_direction.sign();
    let sensor_s = direction * scene.world.crossing.track.crossing_sleeper_x_m / o.speed_m_s;
    let trace = &scene.traces[passage];
    o.bogie_s()
        .iter()
        .map(|b| {
            let at = o.first_axle_s + b + sensor_s - trace.start_s;
            (0..trace.residual.len())
                .map(|k| {
                    let t = k as f64 / RATE_HZ - at;
                    if t < 0.0 { 0.0 } else { (-t / decay_s).exp() }
                })
                .collect()
        })
        .collect()
}

/// Share of the energy of the train-free ends, about their mean, that a baseline explains which is level before the train and decays
/// behind it; and its size at the first value there, m/s².
fn decaying([before, behind]: &[QuietEnd; 2], decay_s: f64) -> (f64, f64) {
    let mut y = [&before.value_m_s2[..], &behind.value_m_s2[..]].concat();
    let fall = (0..behind.value_m_s2.len()).map(|k| (-(k as f64) / (RATE_HZ * decay_s)).exp());
    let mut x: Vec<f64> = before.value_m_s2.iter().map(|_| 0.0).chain(fall).collect();
    for v in [&mut x, &mut y] {
        centre(v);
    }
    let size_m_s2 = dot(&x, &y) / dot(&x, &x).max(f64::MIN_POSITIVE);
    (size_m_s2 * dot(&x, &y) / dot(&y, &y).max(f64::MIN_POSITIVE), size_m_s2)
}

fn low(values: &[f64]) -> Vec<f64> {
    let n = values.len();
    let mut spectrum = rfft(values);
    for (v, f) in spectrum.iter_mut().zip(rfft_frequencies_hz(n, RATE_HZ)) {
        *v *= taper(f, LOW_HZ[0], LOW_HZ[1]);
    }
    irfft(&spectrum, n)
}

/// Gain in log evidence (BIC) and sizes of the steps of one passage.
fn steps(scene: &Scene, passage: usize, decay_s: f64) -> (f64, Vec<f64>) {
    let y = low(&scene.traces[passage].residual);
    let n = y.len();
    let mut all: Vec<Vec<f64>> = columns(scene, passage, decay_s).iter().map(|c| low(c)).collect();
    let count = all.len();
    all.push(vec![1.0; n]);
    let x = Mat::from_fn(n, all.len(), |k, c| all[c][k]);
    let right = Mat::from_fn(n, 1, |k, _| y[k]);
    let gram = x.transpose() * &x;
    let Ok(factor) = gram.llt(faer::Side::Lower) else { return (f64::NEG_INFINITY, vec![0.0; count]) };
    let solved = factor.solve(x.transpose() * &right);
    let left = &right - &x * &solved;
    let squares = |m: &Mat<f64>| m.col_as_slice(0).iter().map(|v| v * v).sum::<f64>();
    let mean = crate::signal::mean(&y);
    let before: f64 = y.iter().map(|v| (v - mean).powi(2)).sum();
    let independent = n as f64 * 2.0 * LOW_HZ[1] / RATE_HZ;
    let ratio = (before / squares(&left).max(1e-12)).ln();
    let gain = 0.5 * independent * ratio - PER_STEP * count as f64;
    (gain, (0..count).map(|c| solved[(c, 0)]).collect())
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
}
