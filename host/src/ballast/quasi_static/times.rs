//! When trains pass, by the deflection under them.

use faer::c64;
use rayon::prelude::*;

use super::{BallastParameters, QuasiStatic, QuasiStaticFit, QuasiStaticPassage, unit};

/// Step of the search for the first axle, s.
const SEARCH_STEP_S: f64 = 1e-3;
/// What the model does not hold of a line, relative to the strongest: dynamic force of the crossing leaks into the band.
const UNMODELLED: f64 = 0.3;
/// Part of the deflection that is left from which on a fit says nothing, RMS.
const DOUBTFUL: f64 = 0.5;
/// Part of what is left that has to be noise for that, RMS.
const NOISE_OF_MISFIT: f64 = 0.4;

/// What the deflection under a train says of when it passes.
#[derive(Clone, Debug)]
pub struct Sinking {
    /// First time of the first axle at x = 0 that is looked at, s.
    first_s: f64,
    /// Likelihood of that time and of those behind it, [`SEARCH_STEP_S`] apart, relative to their mean.
    likelihood: Vec<f64>,
}

impl Sinking {
    /// Of log-likelihoods of times from the first on, 1 ms apart.
    pub fn of(first_s: f64, log_likelihood: &[f64]) -> Self {
        let most = log_likelihood.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mut likelihood: Vec<f64> = log_likelihood.iter().map(|l| (l - most).exp()).collect();
        let mean = crate::signal::mean(&likelihood);
        likelihood.iter_mut().for_each(|l| *l /= mean);
        Self { first_s, likelihood }
    }

    /// Likelihood of a time relative to that of a train that may be at any of those that are looked at; none outside.
    pub fn at(&self, time_s: f64) -> Option<f64> {
        let step = (time_s - self.first_s) / SEARCH_STEP_S;
        if step >= 0.0 { self.likelihood.get(step as usize).copied() } else { None }
    }
}

impl QuasiStaticPassage {
    /// Squared magnitude that the noise of quiet track has on a line of the displacement, m² s².
    fn noise_m2_s2(&self, frequency_hz: f64) -> f64 {
        self.quiet_m2_s2 / (std::f64::consts::TAU * frequency_hz).powi(4)
    }
}

impl QuasiStatic<'_> {
    /// Times of the first axles for given ballast: global search, then Newton steps on the correlation.
    pub fn align(&self, ballast: &BallastParameters) -> Vec<f64> {
        let models = self.models(ballast);
        self.passages.par_iter().zip(&models).map(|(p, m)| self.search_time(p, m)).collect()
    }

    /// What the deflections say of the times of the trains on given ballast.
    ///
    /// A line lacks the noise of quiet track, integrated twice, and a part of what is strongest; and more where the best time leaves more.
    pub fn sinking(&self, ballast: &BallastParameters) -> Vec<Sinking> {
        let models = self.models(ballast);
        self.passages.par_iter().zip(&models).map(|(p, m)| self.sinking_of(p, m)).collect()
    }

    fn sinking_of(&self, passage: &QuasiStaticPassage, model: &[c64]) -> Sinking {
        let lines = self.in_band(passage);
        let strongest = model.iter().take(lines).map(c64::norm_sqr).fold(f64::MIN_POSITIVE, f64::max);
        let weight = |f: &f64| 1.0 / (passage.noise_m2_s2(*f) + UNMODELLED.powi(2) * strongest);
        let weights: Vec<f64> = self.frequency_hz.iter().take(lines).map(weight).collect();
        let weighted = passage.measured.iter().zip(model).zip(&weights);
        let products = weighted.clone().map(|((a, m), w)| 2.0 * w * a * m.conj()).collect();
        let squares: f64 = weighted.map(|((a, m), w)| w * (a.norm_sqr() + m.norm_sqr())).sum();
        let mut log_likelihood = self.correlation(passage, products);
        let best = log_likelihood.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let left = ((squares - best) / lines.max(1) as f64).max(1.0);
        log_likelihood.iter_mut().for_each(|l| *l /= left);
        Sinking::of(passage.search_s[0], &log_likelihood)
    }

    /// Whether noise hides the deflection, so that neither ballast nor times of a fit mean anything: 0.02 to 0.28 is left on sites where they
    /// do, 0.6 and more under slow trains with noisy sensors. What else leaves as much, drift or half a recording upside down, is to be
    /// noticed.
    pub fn is_hidden(&self, fit: &QuasiStaticFit) -> bool {
        fit.misfit > DOUBTFUL && self.noise() > NOISE_OF_MISFIT * fit.misfit
    }

    /// Noise of quiet track in the band, RMS ratio to the measured displacement.
    fn noise(&self) -> f64 {
        let (mut noise, mut power) = (0.0, 0.0);
        for passage in &self.passages {
            let lines = self.in_band(passage);
            noise += self.frequency_hz.iter().take(lines).map(|f| passage.noise_m2_s2(*f)).sum::<f64>();
            power += passage.measured.iter().take(lines).map(|v| v.norm_sqr()).sum::<f64>();
        }
        (noise / power.max(f64::MIN_POSITIVE)).sqrt()
    }

    /// Share of the passages in which a track that rises under the wheels matches better than one that sinks: near 1 where the sensor is
    /// upside down.
    pub fn rising(&self, ballast: &BallastParameters) -> f64 {
        let models = self.models(ballast);
        let rises = |(p, m): &(&QuasiStaticPassage, &Vec<c64>)| {
            let down: Vec<c64> = m.iter().map(|v| -v).collect();
            let match_of = |model: &[c64]| {
                let time = self.search_time(p, model);
                (0..self.in_band(p))
                    .map(|k| {
                        let turn = unit(std::f64::consts::TAU * self.frequency_hz[k] * time);
                        (p.measured[k] * model[k].conj() * turn).re
                    })
                    .sum::<f64>()
            };
            match_of(&down) > match_of(m)
        };
        let count = self.passages.iter().zip(&models).filter(rises).count();
        count as f64 / self.passages.len().max(1) as f64
    }

    /// Time of the highest correlation.
    fn search_time(&self, passage: &QuasiStaticPassage, model: &[c64]) -> f64 {
        let lines = self.in_band(passage);
        let products = (0..lines).map(|k| passage.measured[k] * model[k].conj()).collect();
        let (mut best, mut most) = (passage.search_s[0], f64::NEG_INFINITY);
        for (i, correlation) in self.correlation(passage, products).into_iter().enumerate() {
            if correlation > most {
                (best, most) = (passage.search_s[0] + i as f64 * SEARCH_STEP_S, correlation);
            }
        }
        self.refine_time(passage, model, best)
    }

    /// Newton steps on the correlation.
    pub(super) fn refine_time(&self, passage: &QuasiStaticPassage, model: &[c64], start: f64) -> f64 {
        let lines = self.in_band(passage);
        let mut t = start;
        for _ in 0..4 {
            let (mut slope, mut curvature) = (0.0, 0.0);
            for ((hz, measured), modelled) in
                self.frequency_hz.iter().zip(&passage.measured).zip(model).take(lines)
            {
                let w = std::f64::consts::TAU * hz;
                let e = measured * modelled.conj() * unit(w * t);
                slope -= w * e.im;
                curvature -= w * w * e.re;
            }
            if curvature < 0.0 {
                t -= (slope / curvature).clamp(-5e-3, 5e-3);
            }
        }
        t
    }

    /// Σ over the lines of products with a turning phase, at every time that is looked at.
    fn correlation(&self, passage: &QuasiStaticPassage, mut products: Vec<c64>) -> Vec<f64> {
        let [from_s, to_s] = passage.search_s;
        let count = ((to_s - from_s).max(0.0) / SEARCH_STEP_S) as usize + 1;
        let turn = |k: usize, s: f64| unit(std::f64::consts::TAU * self.frequency_hz[k] * s);
        // The phases advance by constant factors: powers are cheaper than sines.
        let advance: Vec<c64> = (0..products.len()).map(|k| turn(k, SEARCH_STEP_S)).collect();
        products.iter_mut().enumerate().for_each(|(k, p)| *p *= turn(k, from_s));
        (0..count)
            .map(|_| {
                let sum = products.iter().map(|p| p.re).sum();
                products.iter_mut().zip(&advance).for_each(|(p, a)| *p *= a);
                sum
            })
            .collect()
    }
}
