//! Recordings as the diagnosis sees them: one window per bogie, all windows of a passage on the same time axis.

use super::forward::{BAND_HZ, Response};
use crate::reconstruct::Recording;
use crate::recording::Sensor;
use crate::signal::{dot, mean_of, slope};
use crate::vehicle::AxlePattern;

/// Rate of the windows, Hz.
pub const RATE_HZ: f64 = 800.0;
/// The train is gone this far from x = 0, metres.
const CLEAR_M: f64 = 8.0;
/// Longest stretch of travel in a window, metres; shorter where bogies follow one another more closely.
const LONGEST_M: f64 = 7.25;

/// Quiet stretch at each end of a recording, s: it begins and ends at least 0.3 s before and after the train.
pub const QUIET_S: f64 = 0.27;

/// Step in which a lag is looked for, samples. Half a sample is an eighth of a wave of 200 Hz: a passage that far from its place
/// leaves three quarters of the wave, and may fit better a whole wave further on.
const LAG_STEP: f64 = 0.25;

/// One train-free end of a recording.
pub struct QuietEnd {
    /// Recorder time of the first value, s.
    pub start_s: f64,
    /// At [`RATE_HZ`].
    pub value_m_s2: Vec<f64>,
}

/// One passage.
#[derive(Clone, Debug)]
pub struct Observed {
    /// As in the recordings.
    pub passage_id: i32,
    /// Corrected recording.
    pub recording: Recording,
    /// Speed by the recorder's clock, m/s.
    pub speed_m_s: f64,
    /// The operator's speed, m/s.
    pub operator_m_s: Option<f64>,
    /// Temperature at the sensor, °C.
    pub temperature_c: f64,
    /// Axle load as the operator has it, kg.
    pub axle_load_kg: f64,
    /// Time of the first axle at x = 0, s.
    pub first_axle_s: f64,
    /// Front axle of each bogie behind the first axle, metres.
    pub bogie_m: Vec<f64>,
    /// Windows of the bogies, m/s².
    pub windows: Vec<Vec<f64>>,
    /// Their mean.
    pub mean: Vec<f64>,
    /// Time of the first window sample after the bogie's front axle is at x = 0, s (negative).
    pub first_s: f64,
}

/// RMS of a sensor's stated noise in the band of the comparison, m/s².
pub fn stated_noise_m_s2(sensor: &Sensor) -> f64 {
    (2.0 * BAND_HZ[1] / sensor.sample_rate_hz).min(1.0).sqrt() * sensor.noise_rms_m_s2
}

/// Steps of the baseline are this many times as large as what is left of them behind the train, after some of their decay times.
const STEP_LEFT: f64 = 4.0;

/// Where a window lies, metres of travel of the front axle: first, length.
pub fn window_m(pattern: &AxlePattern, sensor_along_m: f64, axle_spacing_m: f64) -> (f64, f64) {
    let bogies: Vec<f64> = pattern.offset_m.iter().step_by(2).copied().collect();
    let closest = bogies.windows(2).map(|p| p[1] - p[0]).fold(LONGEST_M, f64::min);
    let length = closest.max(axle_spacing_m + 2.0);
    (sensor_along_m + 0.5 * axle_spacing_m - 0.5 * length, length)
}

impl Observed {
    /// Cuts the windows anew around the current first axle.
    pub fn cut(&mut self, (first_m, length_m): (f64, f64)) {
        let n = (length_m / self.speed_m_s * RATE_HZ).floor() as usize;
        self.first_s = first_m / self.speed_m_s;
        self.windows = self
            .bogie_m
            .iter()
            .map(|offset| {
                let start = self.first_axle_s + offset / self.speed_m_s + self.first_s;
                self.recording.window(start, RATE_HZ, n, BAND_HZ)
            })
            .collect();
        self.mean = mean_of(&self.windows);
    }

    /// Corrects the speed so that the bogies line up with one another: each window's lag behind the mean, regressed on the
    /// bogie's distance from the middle of the train. Needs no model.
    pub fn line_up(&mut self, window: (f64, f64)) {
        for _ in 0..LINE_UP_ROUNDS {
            let slope = slope(&self.mean, RATE_HZ);
            let power: f64 = slope.iter().map(|s| s * s).sum();
            let middle = crate::signal::mean(&self.bogie_m);
            let (mut numerator, mut denominator) = (0.0, 0.0);
            for (w, bogie) in self.windows.iter().zip(&self.bogie_m) {
                let product: f64 = w.iter().zip(&self.mean).zip(&slope).map(|((a, m), s)| (m - a) * s).sum();
                let late_s = product / power.max(f64::MIN_POSITIVE);
                numerator += late_s * (bogie - middle);
                denominator += (bogie - middle).powi(2);
            }
            if denominator <= 0.0 {
                return;
            }
            // Seconds per metre that the train is slower than assumed.
            let slowness = (numerator / denominator).clamp(-LARGEST_S_M, LARGEST_S_M);
            let before = middle / self.speed_m_s;
            self.speed_m_s = 1.0 / (1.0 / self.speed_m_s + slowness);
            self.first_axle_s += before - middle / self.speed_m_s;
            self.cut(window);
        }
    }

    /// Moves the first axle by `late_s` and cuts the windows anew.
    pub fn delay(&mut self, late_s: f64, window: (f64, f64)) {
        self.first_axle_s += late_s;
        self.cut(window);
    }

    /// What is recorded before the train comes and after it has gone.
    pub fn quiet_ends(&self) -> [QuietEnd; 2] {
        let n = (QUIET_S * RATE_HZ) as usize;
        let last_s = self.recording.duration_s() - QUIET_S;
        [0.01, last_s - 0.01].map(|start_s| QuietEnd {
            start_s,
            value_m_s2: self.recording.window(start_s, RATE_HZ, n, BAND_HZ),
        })
    }

    /// Largest acceleration, m/s², that is not of the train: what shows before it comes, and steps of the baseline by what they leave
    /// behind it.
    pub fn on_top_m_s2(&self) -> f64 {
        let [before, behind] = self.quiet_ends();
        let level_m_s2 = |end: &QuietEnd| crate::signal::mean(&end.value_m_s2);
        let largest_m_s2 = before.value_m_s2.iter().fold(0.0, |l: f64, v| l.max(v.abs()));
        largest_m_s2 + STEP_LEFT * (level_m_s2(&behind) - level_m_s2(&before)).abs()
    }

    /// Delay of the recording behind a prediction at which both agree best, s, among `range_m` of travel in both directions.
    pub fn lag(&self, response: &Response, gain: f64, range_m: f64) -> f64 {
        let step_s = LAG_STEP / RATE_HZ;
        let steps = (range_m / self.speed_m_s / step_s).ceil() as i64;
        let misfit = |late_s: f64| self.misfit(response, gain, late_s);
        let best = (-steps..=steps)
            .map(|k| k as f64 * step_s)
            .map(|t| (t, misfit(t)))
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .map_or(0.0, |b| b.0);
        let h = 0.5 * step_s;
        let (l, m, r) = (misfit(best - h), misfit(best), misfit(best + h));
        let curvature = l - 2.0 * m + r;
        best + if curvature > 0.0 { (0.5 * h * (l - r) / curvature).clamp(-h, h) } else { 0.0 }
    }

    /// Squares by which the mean window misses a prediction that is later by `late_s`, (m/s²)².
    pub fn misfit(&self, response: &Response, gain: f64, late_s: f64) -> f64 {
        let predicted = self.predicted_mean(response, gain, late_s);
        self.mean.iter().zip(&predicted).map(|(m, p)| (m - p).powi(2)).sum()
    }

    /// The same as a part of the squares of the mean window.
    pub fn share_missed(&self, response: &Response, gain: f64, late_s: f64) -> f64 {
        self.misfit(response, gain, late_s) / dot(&self.mean, &self.mean).max(f64::MIN_POSITIVE)
    }

    /// Times of the bogies after the first axle, s.
    pub fn bogie_s(&self) -> Vec<f64> {
        self.bogie_m.iter().map(|m| m / self.speed_m_s).collect()
    }

    /// Part of the bogies' windows that is above `m_s2` in magnitude.
    pub fn share_above(&self, m_s2: f64) -> f64 {
        let values = || self.windows.iter().flatten();
        values().filter(|a| a.abs() > m_s2).count() as f64 / values().count().max(1) as f64
    }

    /// The whole train, from 8 m before its first axle to 8 m behind its last: recorder time of the first value, values at
    /// [`RATE_HZ`].
    pub fn trace(&self) -> (f64, Vec<f64>) {
        let last = self.bogie_m.last().copied().unwrap_or(0.0);
        let start_s = self.trace_start_s();
        let n = ((last + 3.0 + 2.0 * CLEAR_M) / self.speed_m_s * RATE_HZ).ceil() as usize;
        (start_s, self.recording.window(start_s, RATE_HZ, n, BAND_HZ))
    }

    /// Recorder time of the first value of [`Self::trace`], s.
    pub fn trace_start_s(&self) -> f64 {
        self.first_axle_s - CLEAR_M / self.speed_m_s
    }

    /// Takes known contributions off the windows.
    pub fn remove(&mut self, contributions: &[Vec<f64>]) {
        self.add(contributions, -1.0);
    }

    /// Puts contributions taken off by [`Self::remove`] back.
    pub fn restore(&mut self, contributions: &[Vec<f64>]) {
        self.add(contributions, 1.0);
    }

    fn add(&mut self, contributions: &[Vec<f64>], factor: f64) {
        for (window, part) in self.windows.iter_mut().zip(contributions) {
            window.iter_mut().zip(part).for_each(|(w, p)| *w += factor * p);
        }
        self.mean = mean_of(&self.windows);
    }

    /// Windows of the bogies less the whole train's prediction.
    pub fn window_residuals(&self, response: &Response, gain: f64, late_s: f64) -> Vec<Vec<f64>> {
        let bogies = self.bogie_s();
        self.windows
            .iter()
            .zip(&bogies)
            .map(|(window, at)| {
                let others: Vec<f64> = bogies.iter().map(|b| b - at + late_s).collect();
                let mut predicted = vec![0.0; window.len()];
                response.add_train(&others, gain, self.first_s, 1.0 / RATE_HZ, &mut predicted);
                window.iter().zip(&predicted).map(|(m, p)| m - p).collect()
            })
            .collect()
    }

    /// What the windows' mean would be, for a bogie response and a gain; `late_s` shifts the train.
    pub fn predicted_mean(&self, response: &Response, gain: f64, late_s: f64) -> Vec<f64> {
        let bogies = self.bogie_s();
        let mut sum = vec![0.0; self.mean.len()];
        for window in &bogies {
            let others: Vec<f64> = bogies.iter().map(|b| b - window + late_s).collect();
            response.add_train(&others, gain, self.first_s, 1.0 / RATE_HZ, &mut sum);
        }
        for value in &mut sum {
            *value /= bogies.len() as f64;
        }
        sum
    }
}

/// Rounds of [`Observed::line_up`].
const LINE_UP_ROUNDS: usize = 4;
/// Largest correction per round, s/m: 10 mm over 10 m at 40 m/s.
const LARGEST_S_M: f64 = 2.5e-5;

/// Sum of squares of windows, and the part of it that is in their mean.
pub fn energies(windows: &[Vec<f64>]) -> (f64, f64) {
    let total = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>();
    (windows.iter().map(|w| total(w)).sum(), windows.len() as f64 * total(&mean_of(windows)))
}

/// Sum of squares of what differs between windows, without the bias of their number, from [`energies`].
pub fn own_energy((all, shared): (f64, f64), windows: usize) -> f64 {
    let k = windows as f64;
    ((all - shared) * k / (k - 1.0).max(1.0)).max(0.0)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::recording::{Passage, read_site};

    /// Waves of three and a half samples, recorded half a sample late: a wave further on, whole samples meet them.
    #[test]
    fn regress_a_passage_between_two_samples_is_found() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field/reference-1");
        let mut sensor = read_site(&root).unwrap().crossing.sensor;
        sensor.antialias_order = 0;
        let (f_hz, late_s) = (RATE_HZ / 3.5, 0.5 / RATE_HZ);
        let wave = |t: f64| 100.0 * (-(t / 0.01).powi(2)).exp() * (std::f64::consts::TAU * f_hz * t).sin();
        let rate = sensor.sample_rate_hz;
        let passage = Passage::of_function(rate, 2.0, |t| wave(t - 1.0 - late_s));
        let mut observed = Observed {
            passage_id: 1,
            recording: Recording::new(&passage, &sensor),
            speed_m_s: 45.0,
            operator_m_s: None,
            temperature_c: 20.0,
            axle_load_kg: 16e3,
            first_axle_s: 1.0,
            bogie_m: vec![0.0],
            windows: Vec::new(),
            mean: Vec::new(),
            first_s: 0.0,
        };
        observed.cut((-2.0, 4.0));
        let response = Response::of(-0.2, 1e-4, (0..4000).map(|k| wave(f64::from(k) * 1e-4 - 0.2)).collect());
        let found = observed.lag(&response, 1.0, 0.4);
        assert!((found - late_s).abs() < 0.05 / RATE_HZ, "{found} {late_s}");
    }
}
