//! Recorder: from the motion of the sleeper to a recording. Transducer (gain, mount, range) → analog Bessel low-pass →
//! sampling → noise, bias, interference → quantisation.

use faer::c64;

use super::random::Random;
use super::run::PassageRecord;
use crate::recording::Sensor;
use crate::signal::{AntiAlias, irfft, rfft, rfft_frequencies_hz};

/// The recorder and what can be wrong with it; all defaults are a sound one.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorChain {
    /// Nominal sampling rate, Hz.
    pub sample_rate_hz: f64,
    /// Range of the transducer, ±, m/s².
    pub range_m_s2: f64,
    /// Resolution over the nominal ± range.
    pub quantisation_range_m_s2: f64,
    /// Bits.
    pub bits: u32,
    /// Order of the Bessel low-pass; 0 is none.
    pub antialias_order: usize,
    /// Its −3 dB frequency, Hz.
    pub antialias_hz: f64,
    /// White noise in the sampled band, m/s² rms.
    pub noise_rms_m_s2: f64,
    /// Constant offset, m/s².
    pub bias_m_s2: f64,
    /// Sensitivity, 1 is right.
    pub gain: f64,
    /// The clock runs faster than nominal by this part.
    pub clock_error: f64,
    /// Resonance of the mounting.
    pub mount: Option<MountResonance>,
    /// Electrical interference.
    pub tones: Vec<Tone>,
    /// Shifts of the baseline.
    pub bias_steps: Vec<BiasStep>,
}

/// Second-order resonance between sleeper and transducer.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct MountResonance {
    pub frequency_hz: f64,
    pub damping_ratio: f64,
}

/// Sinusoid of the recorder's own time.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct Tone {
    pub frequency_hz: f64,
    pub amplitude_m_s2: f64,
    pub phase_rad: f64,
}

/// Baseline shift that decays.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct BiasStep {
    pub time_s: f64,
    pub step_m_s2: f64,
    pub decay_s: f64,
}

/// The filtered signal is interpolated between points at least this dense, Hz: cubic interpolation is then good to 2e-4 at
/// the Nyquist frequency of 4 kHz.
const DENSE_HZ: f64 = 40e3;

impl SensorChain {
    /// Nominal recorder of a site, without bias.
    pub fn of_sensor(sensor: &Sensor) -> Self {
        Self {
            sample_rate_hz: sensor.sample_rate_hz,
            range_m_s2: sensor.range_m_s2,
            quantisation_range_m_s2: sensor.range_m_s2,
            bits: sensor.bits,
            antialias_order: sensor.antialias_order,
            antialias_hz: sensor.antialias_hz,
            noise_rms_m_s2: sensor.noise_rms_m_s2,
            bias_m_s2: 0.0,
            gain: 1.0,
            clock_error: 0.0,
            mount: None,
            tones: Vec::new(),
            bias_steps: Vec::new(),
        }
    }

    /// Recording of a passage. The motion must begin and end at rest.
    pub fn record(&self, passage: &PassageRecord, random: &mut Random) -> Vec<f32> {
        let rate = self.sample_rate_hz * (1.0 + self.clock_error);
        let (dense, dense_hz) = self.filtered(passage);
        let samples = samples_of(passage, rate);
        let lsb = 2.0 * self.quantisation_range_m_s2 / 2f64.powi(self.bits as i32);
        (0..samples)
            .map(|k| {
                let value = interpolate(&dense, k as f64 / rate * dense_hz)
                    + self.noise_rms_m_s2 * random.normal()
                    + self.bias(k as f64 / rate)
                    + self.interference(k as f64 / self.sample_rate_hz);
                let limited = value.clamp(-self.quantisation_range_m_s2, self.quantisation_range_m_s2 - lsb);
                ((limited / lsb).round() * lsb) as f32
            })
            .collect()
    }

    /// Acceleration behind the low-pass on a dense time axis, and its rate.
    fn filtered(&self, passage: &PassageRecord) -> (Vec<f64>, f64) {
        let rate = 1.0 / passage.dt_s;
        // Zeros behind the end: the train has gone. The length suits the transform.
        let n = (passage.sensor_m.len() + 64).next_multiple_of(1024);
        let mut motion = passage.sensor_m.clone();
        motion.resize(n, 0.0);
        let mut spectrum = rfft(&motion);
        let frequencies = rfft_frequencies_hz(n, rate);
        for (value, f) in spectrum.iter_mut().zip(&frequencies) {
            let omega = std::f64::consts::TAU * f;
            *value *= self.mounted(*f) * (-omega * omega * self.gain);
        }
        let mut acceleration = irfft(&spectrum, n);
        for value in &mut acceleration {
            *value = value.clamp(-self.range_m_s2, self.range_m_s2);
        }
        let filter = AntiAlias::new(self.antialias_order, self.antialias_hz);
        let mut spectrum = rfft(&acceleration);
        for (value, f) in spectrum.iter_mut().zip(&frequencies) {
            *value *= filter.response(*f);
        }
        let factor = (DENSE_HZ / rate).ceil().max(1.0) as usize;
        let mut dense = irfft(&spectrum, n * factor);
        for value in &mut dense {
            *value *= factor as f64;
        }
        (dense, rate * factor as f64)
    }

    fn mounted(&self, f_hz: f64) -> c64 {
        match self.mount {
            None => c64::new(1.0, 0.0),
            Some(m) => {
                let s = f_hz / m.frequency_hz;
                let damping = c64::new(0.0, 2.0 * m.damping_ratio * s);
                (damping + 1.0) / (damping + (1.0 - s * s))
            }
        }
    }

    fn bias(&self, time_s: f64) -> f64 {
        let steps = self.bias_steps.iter().filter(|b| time_s >= b.time_s);
        self.bias_m_s2 + steps.map(|b| b.step_m_s2 * (-(time_s - b.time_s) / b.decay_s).exp()).sum::<f64>()
    }

    fn interference(&self, recorder_s: f64) -> f64 {
        let omega = std::f64::consts::TAU * recorder_s;
        self.tones.iter().map(|t| t.amplitude_m_s2 * (omega * t.frequency_hz + t.phase_rad).sin()).sum()
    }
}

/// Displacement of the sleeper at the samples of an ideal clock, m.
pub fn ideal_displacement(passage: &PassageRecord, sample_rate_hz: f64) -> Vec<f64> {
    let step = 1.0 / (sample_rate_hz * passage.dt_s);
    (0..samples_of(passage, sample_rate_hz))
        .map(|k| interpolate(&passage.sensor_m, k as f64 * step))
        .collect()
}

/// Samples of a recording of the passage at a rate.
fn samples_of(passage: &PassageRecord, rate_hz: f64) -> usize {
    ((passage.sensor_m.len() - 1) as f64 * passage.dt_s * rate_hz + 1e-6).floor() as usize
}

/// Cubic Lagrange interpolation at a fractional index.
fn interpolate(values: &[f64], position: f64) -> f64 {
    let n = values.len();
    if n < 4 {
        return values.first().copied().unwrap_or(0.0);
    }
    let i = (position as usize).clamp(1, n - 3);
    let t = position - i as f64;
    let (y, below, above) = (&values[i - 1..i + 3], t + 1.0, t - 1.0);
    y[0] * (-t * above * (t - 2.0) / 6.0)
        + y[1] * (below * above * (t - 2.0) / 2.0)
        + y[2] * (-below * t * (t - 2.0) / 2.0)
        + y[3] * (below * t * above / 6.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chain() -> SensorChain {
        SensorChain {
            sample_rate_hz: 4000.0,
            range_m_s2: 490.5,
            quantisation_range_m_s2: 490.5,
            bits: 16,
            antialias_order: 4,
            antialias_hz: 1500.0,
            noise_rms_m_s2: 0.0,
            bias_m_s2: 0.0,
            gain: 1.0,
            clock_error: 0.0,
            mount: None,
            tones: Vec::new(),
            bias_steps: Vec::new(),
        }
    }

    /// A burst of `frequency_hz` with 50 m/s² amplitude around t = 0.5 s.
    fn burst(frequency_hz: f64) -> PassageRecord {
        let omega = std::f64::consts::TAU * frequency_hz;
        let motion = |t: f64| {
            -50.0 / (omega * omega) * (omega * (t - 0.5)).cos() * (-((t - 0.5) / 0.08f64).powi(2)).exp()
        };
        PassageRecord {
            dt_s: 1e-4,
            sensor_m: (0..=10_000).map(|k| motion(k as f64 * 1e-4)).collect(),
            contacts: Vec::new(),
        }
    }

    fn peak(recording: &[f32]) -> f64 {
        recording.iter().fold(0.0, |p, a| f64::max(p, f64::from(a.abs())))
    }

    #[test]
    fn analytic_amplitude_and_half_power_frequency() {
        // Energy of the burst: 50² · 0.08 √(π/2) / 2.
        let expected = 2500.0 * 0.08 * (std::f64::consts::PI / 2.0).sqrt() / 2.0;
        let energy = |frequency_hz: f64| {
            let recording = chain().record(&burst(frequency_hz), &mut Random::new(0, 0));
            recording.iter().map(|a| f64::from(*a).powi(2) / 4000.0).sum::<f64>()
        };
        assert!((energy(100.0) / expected - 1.0).abs() < 0.01, "{}", energy(100.0) / expected);
        assert!((energy(1500.0) / expected - 0.5).abs() < 0.01, "{}", energy(1500.0) / expected);
    }

    #[test]
    fn analytic_delay_of_the_low_pass() {
        let recording = chain().record(&burst(100.0), &mut Random::new(0, 0));
        // Group delay of a 4th-order Bessel at −3 dB 1500 Hz: 2.114/(2π 1500) s = 0.224 ms, 0.9 samples.
        let (mut sum, mut weight) = (0.0, 0.0);
        for (k, a) in recording.iter().enumerate() {
            sum += k as f64 * f64::from(a * a);
            weight += f64::from(a * a);
        }
        assert!((sum / weight - 2000.0 - 0.9).abs() < 0.05, "{}", sum / weight - 2000.0);
    }

    #[test]
    fn property_range_quantisation_bias_and_interference() {
        let mut random = Random::new(0, 0);
        let clipped = SensorChain { range_m_s2: 30.0, antialias_order: 0, ..chain() };
        assert!(peak(&clipped.record(&burst(40.0), &mut random)) < 33.0);
        let silent = PassageRecord { sensor_m: vec![0.0; 10_001], ..burst(100.0) };
        let biased = SensorChain { bias_m_s2: 0.1, ..chain() };
        let lsb = 2.0 * 490.5 / 65536.0;
        let recording = biased.record(&silent, &mut random);
        assert_eq!(recording.len(), 4000);
        assert!(recording.iter().all(|a| (f64::from(*a) - 0.1).abs() <= 0.51 * lsb));
        let noisy = SensorChain { noise_rms_m_s2: 0.1, ..chain() };
        let values: Vec<f64> = noisy.record(&silent, &mut random).into_iter().map(f64::from).collect();
        assert!((crate::signal::rms(&values) - 0.1).abs() < 0.005);
        let tone = Tone { frequency_hz: 50.0, amplitude_m_s2: 1.0, phase_rad: 0.0 };
        let hum = SensorChain { tones: vec![tone], ..chain() }.record(&silent, &mut random);
        assert!((peak(&hum) - 1.0).abs() < 0.02);
    }

    #[test]
    fn property_fast_clock_takes_more_samples() {
        let fast = SensorChain { clock_error: 0.01, ..chain() };
        let recording = fast.record(&burst(100.0), &mut Random::new(0, 0));
        assert_eq!(recording.len(), 4040);
        assert_eq!(ideal_displacement(&burst(100.0), 4000.0).len(), 4000);
    }
}
