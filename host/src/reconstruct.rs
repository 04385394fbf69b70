//! From a recording to what the identification needs: corrected spectrum, speed, axle times, displacement.

mod comb;
mod displacement;
mod flat_top;
mod speed;

pub use comb::{FARTHEST_HIT_M, SPEEDS_M_S, comb, envelope};
pub use displacement::{HighPassSearch, complementary_displacement, high_pass_displacement};
pub use flat_top::flat_top_m_s2;
pub use speed::{ABOUT, SpeedSearch, estimate_speed};

use faer::c64;

use crate::recording::{Passage, Sensor};
use crate::signal::{AntiAlias, irfft, mean, rfft, rms, taper};

/// Above this frequency the recording is dropped, Hz; the recorder's filter is undone below it.
const USED_BAND_HZ: [f64; 2] = [500.0, 700.0];
/// Samples are taken as quiet (no train near) in this long a stretch at both ends of a recording, seconds; recordings
/// begin and end at least 0.3 s before and after the train.
const QUIET_S: f64 = 0.25;
/// Windows are cut at multiples of this rate, Hz, and of a quarter of it.
const WINDOW_STEP_HZ: f64 = 100.0;
/// Transform lengths are a multiple of this many of the shortest that lasts whole samples at [`WINDOW_STEP_HZ`]: they last an even number
/// at a quarter of it as well.
const LEAST_UNITS: usize = 8;
/// How well a window's time base is met, relative: 1 µs in a recording of 10 s.
const TIME_BASE: f64 = 1e-7;

/// A recording with bias removed and the recorder's anti-alias filter undone, kept as its spectrum.
#[derive(Clone, Debug)]
pub struct Recording {
    /// Raw sampling rate, Hz.
    pub rate_hz: f64,
    /// Raw samples.
    pub len: usize,
    /// Acceleration noise in the quiet ends, RMS in the band below [`Self::NOISE_BAND_HZ`], m/s².
    pub quiet_rms_m_s2: f64,
    /// Largest |acceleration| of the raw samples, m/s².
    pub max_m_s2: f64,
    /// Transform length: `len` padded with zeros.
    padded: usize,
    spectrum: Vec<c64>,
}

impl Recording {
    /// Band in which the quiet noise is measured, Hz.
    pub const NOISE_BAND_HZ: [f64; 2] = [5.0, 300.0];

    /// Takes over the raw samples.
    pub fn new(passage: &Passage, sensor: &Sensor) -> Self {
        let raw: Vec<f64> = passage.acceleration_m_s2.iter().map(|a| f64::from(*a)).collect();
        let quiet = ((QUIET_S * passage.sample_rate_hz) as usize).min(raw.len() / 2);
        let ends: Vec<f64> = raw[..quiet].iter().chain(&raw[raw.len() - quiet..]).copied().collect();
        let bias = mean(&ends);
        let padded = padded_len(raw.len(), passage.sample_rate_hz);
        let mut signal: Vec<f64> = raw.iter().map(|a| a - bias).collect();
        signal.resize(padded, 0.0);
        let mut spectrum = rfft(&signal);
        let antialias = AntiAlias::new(sensor.antialias_order, sensor.antialias_hz);
        for (k, value) in spectrum.iter_mut().enumerate() {
            let f = k as f64 * passage.sample_rate_hz / padded as f64;
            let gain = taper(f, USED_BAND_HZ[0], USED_BAND_HZ[1]);
            *value = if gain > 0.0 { *value * gain / antialias.response(f) } else { c64::new(0.0, 0.0) };
        }
        let mut out = Self {
            rate_hz: passage.sample_rate_hz,
            len: raw.len(),
            quiet_rms_m_s2: 0.0,
            max_m_s2: raw.iter().fold(0.0, |m, a| m.max(a.abs())),
            padded,
            spectrum,
        };
        let banded = out.filtered(|f| {
            if (Self::NOISE_BAND_HZ[0]..=Self::NOISE_BAND_HZ[1]).contains(&f) { 1.0 } else { 0.0 }
        });
        let quiet_banded: Vec<f64> =
            banded[..quiet].iter().chain(&banded[raw.len() - quiet..]).copied().collect();
        out.quiet_rms_m_s2 = rms(&quiet_banded);
        out
    }

    /// Spectral density, one-sided, of the noise in the quiet ends, taken for white, m²/s³.
    pub fn quiet_density_m2_s3(&self) -> f64 {
        let [low_hz, high_hz] = Self::NOISE_BAND_HZ;
        self.quiet_rms_m_s2.powi(2) / (high_hz - low_hz)
    }

    /// As a sensor would have it that is upside down.
    pub fn inverted(&self) -> Self {
        Self { spectrum: self.spectrum.iter().map(|v| -v).collect(), ..self.clone() }
    }

    /// Duration, seconds.
    pub fn duration_s(&self) -> f64 {
        self.len as f64 / self.rate_hz
    }

    /// Frequency of spectrum line `k`, Hz.
    pub fn frequency_hz(&self, k: usize) -> f64 {
        k as f64 * self.rate_hz / self.padded as f64
    }

    /// Corrected spectrum (unnormalised transform of the zero-padded acceleration).
    pub fn spectrum(&self) -> &[c64] {
        &self.spectrum
    }

    /// Acceleration at the raw rate after a real gain per frequency, m/s² times the gain's unit.
    pub fn filtered(&self, gain: impl Fn(f64) -> f64) -> Vec<f64> {
        let spectrum: Vec<c64> =
            self.spectrum.iter().enumerate().map(|(k, v)| v * gain(self.frequency_hz(k))).collect();
        let mut signal = irfft(&spectrum, self.padded);
        signal.truncate(self.len);
        signal
    }

    /// Band-limited acceleration at `window_rate_hz`, a multiple of 25 Hz, `len` samples from `start_s` on (any real time;
    /// zero outside the recording). Resampling is exact: the time shift is a phase in the spectrum.
    pub fn window(&self, start_s: f64, window_rate_hz: f64, len: usize, band_hz: [f64; 2]) -> Vec<f64> {
        self.resampled(start_s, window_rate_hz, len, |f| c64::new(taper(f, band_hz[0], band_hz[1]), 0.0))
    }

    fn resampled(
        &self,
        start_s: f64,
        window_rate_hz: f64,
        len: usize,
        gain: impl Fn(f64) -> c64,
    ) -> Vec<f64> {
        let n = (self.padded as f64 * window_rate_hz / self.rate_hz).round() as usize;
        let first = (start_s * window_rate_hz).floor();
        let shift_s = start_s - first / window_rate_hz;
        let spectrum: Vec<c64> = self
            .spectrum
            .iter()
            .take(n / 2 + 1)
            .enumerate()
            .map(|(k, value)| {
                let f = self.frequency_hz(k);
                let phase = std::f64::consts::TAU * f * shift_s;
                value * c64::new(phase.cos(), phase.sin()) * gain(f)
            })
            .collect();
        let signal = irfft(&spectrum, n);
        let scale = n as f64 / self.padded as f64;
        (0..len as i64)
            .map(|k| {
                usize::try_from(first as i64 + k).ok().and_then(|i| signal.get(i)).map_or(0.0, |v| v * scale)
            })
            .collect()
    }
}

/// Transform length: at least a quarter longer than the recording, lasting a whole number of samples at every rate that windows
/// are cut at (a decimation by 12.5 is none by 12 or 13), and otherwise a power of two for speed.
fn padded_len(len: usize, rate_hz: f64) -> usize {
    let unit = numerator(rate_hz / WINDOW_STEP_HZ);
    unit * (len + len / 4).div_ceil(unit).next_power_of_two().max(LEAST_UNITS)
}

/// Numerator of the simplest fraction that is `ratio` but for [`TIME_BASE`]: convergents of its continued fraction.
fn numerator(ratio: f64) -> usize {
    let (mut last, mut now) = ((1.0, 0.0), (ratio.floor(), 1.0));
    let mut rest = ratio.fract();
    while (now.0 - ratio * now.1).abs() > TIME_BASE * ratio * now.1 {
        let inverse = rest.recip();
        let digit = inverse.floor();
        rest = inverse - digit;
        (last, now) = (now, (digit * now.0 + last.0, digit * now.1 + last.1));
    }
    // Rates that recorders have are far below: a convergent that near has a small denominator.
    (now.0.clamp(1.0, 2.5e5) as usize).max(1)
}

/// Speed and axle times of one passage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Timing {
    /// Train speed, m/s.
    pub speed_m_s: f64,
    /// Time at which the first axle is at x = 0, seconds after the first sample.
    pub first_axle_s: f64,
}

impl Timing {
    /// Time at which an axle `offset_m` behind the first is at x = 0.
    pub fn axle_s(&self, offset_m: f64) -> f64 {
        self.first_axle_s + offset_m / self.speed_m_s
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    /// A burst of 40 Hz at 0.8 s, as a recorder without filter takes it.
    fn burst(t_s: f64) -> f64 {
        50.0 * (-((t_s - 0.8) / 0.03).powi(2)).exp() * (TAU * 40.0 * (t_s - 0.8)).sin()
    }

    fn recorded(sample_rate_hz: f64) -> Recording {
        let sensor = Sensor {
            sleeper_index: 30,
            y_m: 1.2,
            sample_rate_hz,
            range_m_s2: 500.0,
            bits: 16,
            antialias_order: 0,
            antialias_hz: 0.4 * sample_rate_hz,
            noise_rms_m_s2: 0.0,
            bias_max_m_s2: 0.0,
        };
        Recording::new(&Passage::of_function(sample_rate_hz, 1.7, burst), &sensor)
    }

    /// At 2 and 10 kHz, windows of 800 Hz were cut at 667 and 769 Hz, and forces were 40 to 60 % wrong without a word.
    #[test]
    fn regress_windows_keep_time_at_any_sampling_rate() {
        for rate_hz in
            [801.5, 1000.0, 1652.9, 2000.0, 2048.0, 3999.7, 4000.0, 5000.0, 10e3, 12.8e3, 44.1e3, 51.2e3]
        {
            let recording = recorded(rate_hz);
            for window_hz in [200.0, 375.0, 400.0, 800.0, 1000.0] {
                let n = window_hz as usize;
                let window = recording.window(
                    0.3012,
                    window_hz,
                    n,
                    [260.0, 330.0].map(|f: f64| f.min(0.45 * window_hz)),
                );
                let worst = (0..n)
                    .map(|k| (window[k] - burst(0.3012 + k as f64 / window_hz)).abs())
                    .fold(0.0, f64::max);
                assert!(worst < 0.01, "{rate_hz} Hz to {window_hz} Hz: {worst} m/s2");
            }
        }
    }

    #[test]
    fn analytic_transforms_hold_whole_samples_of_windows() {
        assert_eq!(padded_len(10_000, 4000.0), 40 * 512, "as ever at the rate of the node");
        for (rate_hz, unit) in
            [(2000.0, 20), (10e3, 100), (12.8e3, 128), (2048.0, 512), (44.1e3, 441), (3999.7, 13_319)]
        {
            assert_eq!(numerator(rate_hz / WINDOW_STEP_HZ), unit, "{rate_hz} Hz");
        }
        for rate_hz in [f64::NAN, 0.0, -1.0, f64::INFINITY, 1e-300] {
            assert!((2..=2_000_000).contains(&padded_len(1000, rate_hz)), "{rate_hz} Hz");
        }
    }
}
