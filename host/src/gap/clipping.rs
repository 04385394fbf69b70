//! A transducer that clips, seen by the mean of wheels that differ: the mean of clipped peaks is less than the mean peak, clipped.

use std::f64::consts::{PI, SQRT_2};

use crate::signal::slope;

/// How wheels differ, as far as it matters to a transducer that clips.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Standard deviation of the depth of their paths, relative.
    pub depth: f64,
    /// Standard deviation of when they meet it, s.
    pub time_s: f64,
}

/// Mean over wheels of what a transducer of a range (m/s²) makes of an acceleration that is that of the mean wheel, sampled at
/// `rate_hz`. Taken sample by sample as Gaussian.
pub fn clipped_mean(mean_m_s2: &[f64], rate_hz: f64, range_m_s2: f64, spread: Spread) -> Vec<f64> {
    let slopes = slope(mean_m_s2, rate_hz);
    let clipped = |(mean, slope): (&f64, &f64)| {
        let sd = (spread.depth * mean).hypot(spread.time_s * slope);
        clipped_gaussian_mean(*mean, sd, range_m_s2)
    };
    mean_m_s2.iter().zip(&slopes).map(clipped).collect()
}

/// Mean of a Gaussian that is clipped at both ends of a range.
fn clipped_gaussian_mean(mean: f64, sd: f64, range: f64) -> f64 {
    if sd <= 0.0 {
        return mean.clamp(-range, range);
    }
    // E max(x − c, 0) of x = N(m, s²) is s φ(u) + (m − c) Φ(u) with u = (m − c) / s.
    let above = |excess: f64| {
        let u = excess / sd;
        let density = (-0.5 * u * u).exp() / (2.0 * PI).sqrt();
        sd * density + excess * 0.5 * libm::erfc(-u / SQRT_2)
    };
    mean - above(mean - range) + above(-mean - range)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::passage::random::Random;

    #[test]
    fn analytic_mean_of_clipped_gaussians() {
        // Far inside the range nothing is cut, at its end half a deviation's mean, s / √(2π); far outside all of it.
        let at = |mean: f64| clipped_gaussian_mean(mean, 5.0, 80.0);
        assert!((at(20.0) - 20.0).abs() < 1e-9);
        assert!((at(80.0) - (80.0 - 5.0 / (2.0 * PI).sqrt())).abs() < 1e-9);
        assert!((at(-80.0) + at(80.0)).abs() < 1e-9);
        assert!((at(-200.0) + 80.0).abs() < 1e-9);
        assert_eq!(clipped_gaussian_mean(90.0, 0.0, 80.0), 80.0);
    }

    /// Waves whose height differs, and which come earlier or later, clipped one by one.
    #[test]
    fn property_mean_of_clipped_waves_is_met_better_than_by_the_clipped_mean_wave() {
        let (rate_hz, range_m_s2) = (8000.0, 1.0);
        let spread = Spread { depth: 0.15, time_s: 0.2e-3 };
        let wave =
            |k: usize, late_s: f64| (std::f64::consts::TAU * 60.0 * (k as f64 / rate_hz - late_s)).sin();
        let mut random = Random::new(1, 0);
        let wheels = 4000;
        let mut truth = vec![0.0; 400];
        for _ in 0..wheels {
            let (height, late_s) =
                (1.2 * (1.0 + spread.depth * random.normal()), spread.time_s * random.normal());
            let clipped = |k: usize| (height * wave(k, late_s)).clamp(-range_m_s2, range_m_s2);
            truth.iter_mut().enumerate().for_each(|(k, v)| *v += clipped(k) / f64::from(wheels));
        }
        let mean: Vec<f64> = (0..400).map(|k| 1.2 * wave(k, 0.0)).collect();
        let error = |found: &[f64]| -> f64 {
            found.iter().zip(&truth).map(|(f, t)| (f - t).powi(2)).sum::<f64>().sqrt()
        };
        let plain: Vec<f64> = mean.iter().map(|m| m.clamp(-range_m_s2, range_m_s2)).collect();
        let (met, missed) = (error(&clipped_mean(&mean, rate_hz, range_m_s2, spread)), error(&plain));
        assert!(met < 0.2 * missed, "{met} {missed}");
    }
}
