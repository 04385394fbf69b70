//! Electrical interference: a sinusoid of the recorder's own time, in every recording, also while no train is near.
//!
//! Frequency and amplitude belong to the site, the phase to each recording. All of them follow from the train-free ends, so
//! nothing is learnt from the passage itself.

use rayon::prelude::*;

use crate::gap::data::{Observed, RATE_HZ};
use crate::gap::effect::Stage;
use crate::gap::forward::BAND_HZ;
use crate::gap::latent::{Latent, LatentFit, Scene};

/// See the module.
pub struct Tonal;

/// Frequencies searched, Hz, and step: the ends together are 0.6 s long, two seconds apart.
const SEARCH_HZ: (f64, f64, f64) = (8.0, 248.0, 0.1);
/// Quiet stretch at each end, s: recordings begin and end at least 0.3 s before and after the train.
const QUIET_S: f64 = 0.27;
/// Cost of choosing the frequency among some thousand, nats.
const CHOICE: f64 = 10.0;

/// Train-free ends of a recording.
struct Quiet {
    time_s: Vec<f64>,
    value: Vec<f64>,
    variance: f64,
}

impl Quiet {
    fn new(o: &Observed) -> Self {
        let n = (QUIET_S * RATE_HZ) as usize;
        let last = o.recording.duration_s() - QUIET_S;
        let (mut time_s, mut value) = (Vec::new(), Vec::new());
        for start in [0.01, last - 0.01] {
            let part = o.recording.window(start, RATE_HZ, n, BAND_HZ);
            let mean = crate::signal::mean(&part);
            time_s.extend((0..n).map(|k| start + k as f64 / RATE_HZ));
            value.extend(part.iter().map(|v| v - mean));
        }
        let variance = value.iter().map(|v| v * v).sum::<f64>() / value.len().max(1) as f64;
        Self { time_s, value, variance }
    }

    /// Cosine and sine amplitude at a frequency.
    fn amplitudes(&self, f_hz: f64) -> [f64; 2] {
        let omega = std::f64::consts::TAU * f_hz;
        let scale = 2.0 / self.value.len().max(1) as f64;
        let (mut c, mut s) = (0.0, 0.0);
        for (t, v) in self.time_s.iter().zip(&self.value) {
            let (sin, cos) = (omega * t).sin_cos();
            (c, s) = (c + v * cos, s + v * sin);
        }
        [c * scale, s * scale]
    }

    /// Log likelihood ratio with the best sinusoid at a frequency.
    fn gain(&self, f_hz: f64) -> f64 {
        let [c, s] = self.amplitudes(f_hz);
        let n = self.value.len() as f64;
        let left = (self.variance - 0.5 * (c * c + s * s)).max(1e-3 * self.variance);
        // Band-limited noise has fewer independent values than samples.
        0.5 * n * (2.0 * BAND_HZ[1] / RATE_HZ) * (self.variance / left.max(f64::MIN_POSITIVE)).ln() - 2.0
    }
}

impl Latent for Tonal {
    fn name(&self) -> &'static str {
        "tonal"
    }

    fn stage(&self) -> Stage {
        Stage::Sensor
    }

    fn explore(&self, scene: &Scene) -> Option<LatentFit> {
        let quiet: Vec<Quiet> = scene.observed.par_iter().map(Quiet::new).collect();
        let total = |f: f64| scene.train.iter().map(|i| quiet[*i].gain(f)).sum::<f64>();
        let steps = ((SEARCH_HZ.1 - SEARCH_HZ.0) / SEARCH_HZ.2) as usize;
        let coarse = (0..steps)
            .into_par_iter()
            .map(|k| SEARCH_HZ.0 + k as f64 * SEARCH_HZ.2)
            .map(|f| (total(f), f))
            .max_by(|a, b| a.0.total_cmp(&b.0))?;
        let (score, frequency) = (-20..=20)
            .map(|k| coarse.1 + 0.005 * f64::from(k))
            .map(|f| (total(f), f))
            .max_by(|a, b| a.0.total_cmp(&b.0))?;
        if score <= CHOICE {
            return None;
        }
        let squares: Vec<f64> =
            scene.train.iter().map(|i| quiet[*i].amplitudes(frequency)).map(|[c, s]| c * c + s * s).collect();
        let sampling = scene.train.iter().map(|i| 4.0 * quiet[*i].variance / quiet[*i].value.len() as f64);
        let noise = sampling.sum::<f64>() / scene.train.len().max(1) as f64;
        let amplitude = (crate::signal::mean(&squares) - noise).max(0.0).sqrt();
        let sd = (noise / scene.train.len().max(1) as f64).sqrt().max(0.01 * amplitude);
        let traces: Vec<Vec<f64>> = scene
            .traces
            .iter()
            .zip(&quiet)
            .map(|(trace, q)| {
                let [c, s] = q.amplitudes(frequency);
                let omega = std::f64::consts::TAU * frequency;
                (0..trace.residual.len())
                    .map(|k| {
                        let (sin, cos) = (omega * (trace.start_s + k as f64 / RATE_HZ)).sin_cos();
                        c * cos + s * sin
                    })
                    .collect()
            })
            .collect();
        Some(LatentFit {
            gain: score - CHOICE,
            parameters: vec![
                ("frequency_hz", frequency, frequency - 0.05, frequency + 0.05),
                ("amplitude_m_s2", amplitude, amplitude - 1.645 * sd, amplitude + 1.645 * sd),
            ],
            wheel_share: None,
            windows: scene.cut(&traces),
            traces,
        })
    }
}
