//! Low-pass and decimation: 4 kHz sensor codes to the 1 kHz acceleration that everything else works on.
//!
//! One linear-phase FIR filter. Pass band to 250 Hz, where the method ends; stop band from 500 Hz, so that
//! nothing at all folds back, not only nothing below 250 Hz. A stop band from 600 Hz would save a third of the
//! taps, but the filter costs 15 000 multiplications a second as it is, and the window that the operators see
//! would then hold folded energy between 400 and 500 Hz, which no model on the host could account for.

use crate::kaiser;
use crate::sample::{M_S2_PER_CODE, RAW_RATE_HZ, SensorCode};

/// Raw samples per decimated sample.
pub const DECIMATION: usize = 4;
/// Rate of the decimated samples, Hz.
pub const RATE_HZ: f32 = (RAW_RATE_HZ / DECIMATION as u32) as f32;
/// Number of taps.
pub const TAPS_LEN: usize = 61;
/// Group delay in raw samples: a decimated sample belongs to the time of the raw sample that many earlier than
/// the newest one in it.
pub const DELAY_SAMPLES: u32 = (TAPS_LEN as u32 - 1) / 2;
/// End of the pass band, Hz.
pub const PASS_HZ: f64 = 250.0;
/// Start of the stop band, Hz.
pub const STOP_HZ: f64 = 500.0;
/// Attenuation the design aims at, dB: what 61 taps reach over this transition by Kaiser's formula,
/// A = 2.285 · 60 · 2π · 250/4000 + 7.95.
const DESIGN_DB: f64 = 61.8;

/// The filter, in the order in which samples arrive (it is symmetric); its sum is 1.
pub const TAPS: [f32; TAPS_LEN] = kaiser::low_pass(0.5 * (PASS_HZ + STOP_HZ) / RAW_RATE_HZ as f64, DESIGN_DB);

/// State of the filter.
#[derive(Clone, Debug)]
pub struct Decimator {
    line: [f32; TAPS_LEN],
    fresh: [f32; DECIMATION],
    phase: usize,
    missing: usize,
}

impl Default for Decimator {
    fn default() -> Self {
        Self::new()
    }
}

impl Decimator {
    /// An empty filter.
    pub const fn new() -> Self {
        Self { line: [0.0; TAPS_LEN], fresh: [0.0; DECIMATION], phase: 0, missing: TAPS_LEN }
    }

    /// Takes one raw sample; every fourth gives the acceleration [`DELAY_SAMPLES`] ago, m/s².
    ///
    /// Nothing comes out until all taps have seen a sample.
    pub fn push(&mut self, code: SensorCode) -> Option<f32> {
        if let Some(slot) = self.fresh.get_mut(self.phase) {
            *slot = code.get() as f32; // exact: 20 bits fit in the mantissa
        }
        self.phase += 1;
        if self.phase < DECIMATION {
            return None;
        }
        self.phase = 0;
        self.line.copy_within(DECIMATION.., 0);
        self.line[TAPS_LEN - DECIMATION..].copy_from_slice(&self.fresh);
        self.missing = self.missing.saturating_sub(DECIMATION);
        (self.missing == 0).then(|| self.output())
    }

    /// The symmetric halves are folded first: half the multiplications.
    fn output(&self) -> f32 {
        let half = TAPS_LEN / 2;
        let folded = self.line.iter().zip(self.line.iter().rev());
        let mut sum = 0.0;
        for ((old, new), tap) in folded.zip(&TAPS).take(half) {
            sum += tap * (old + new);
        }
        (sum + TAPS[half] * self.line[half]) * M_S2_PER_CODE
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::PI;

    /// Ripple allowed in the pass band, relative.
    const RIPPLE: f64 = 5e-3;
    /// Attenuation asked for in the stop band, 60 dB.
    const STOP: f64 = 1e-3;

    fn gain(hz: f64) -> f64 {
        let w = 2.0 * PI * hz / f64::from(RAW_RATE_HZ);
        let middle = f64::from(DELAY_SAMPLES);
        TAPS.iter().enumerate().map(|(k, &h)| f64::from(h) * libm::cos(w * (k as f64 - middle))).sum()
    }

    #[test]
    fn analytic_pass_band_is_flat() {
        for hz in 0..=250 {
            assert!((gain(f64::from(hz)) - 1.0).abs() < RIPPLE, "{hz} Hz: {}", gain(f64::from(hz)));
        }
    }

    #[test]
    fn analytic_stop_band_is_60_db_down() {
        for hz in 500..=2000 {
            assert!(gain(f64::from(hz)).abs() < STOP, "{hz} Hz: {}", gain(f64::from(hz)));
        }
    }

    #[test]
    fn property_symmetric() {
        for k in 0..TAPS_LEN {
            assert_eq!(TAPS[k], TAPS[TAPS_LEN - 1 - k]);
        }
    }

    #[test]
    fn analytic_design_is_the_kaiser_windowed_sinc() {
        // Independent of the compile-time series: libm's sine and an integral representation of I0.
        let i0 = |x: f64| {
            (0..2000).map(|k| libm::cosh(x * libm::cos(PI * (f64::from(k) + 0.5) / 2000.0))).sum::<f64>()
                / 2000.0
        };
        let beta = 0.1102 * (61.8 - 8.7);
        let shape = |n: f64| {
            let x = PI * 0.1875 * n;
            let sinc = if n == 0.0 { 1.0 } else { libm::sin(x) / x };
            sinc * i0(beta * libm::sqrt(1.0 - (n / 31.0) * (n / 31.0))) / i0(beta)
        };
        let sum: f64 = (-30..=30).map(|n| shape(f64::from(n))).sum();
        for (k, &tap) in TAPS.iter().enumerate() {
            assert!((f64::from(tap) - shape(k as f64 - 30.0) / sum).abs() < 1e-8, "tap {k}");
        }
    }

    #[test]
    fn analytic_delay_of_a_tone() {
        let w = 2.0 * PI * 100.0 / f64::from(RAW_RATE_HZ);
        let mut filter = Decimator::new();
        for k in 0..4000 {
            let code = SensorCode::new((4e5 * libm::sin(w * f64::from(k))) as i32);
            if let Some(y) = filter.push(code) {
                let t = f64::from(k) - f64::from(DELAY_SAMPLES);
                let expected = 4e5 * libm::sin(w * t) * f64::from(M_S2_PER_CODE);
                assert!((f64::from(y) - expected).abs() < 0.5, "sample {k}: {y} {expected}");
            }
        }
    }

    #[test]
    fn analytic_silent_until_filled() {
        let mut filter = Decimator::new();
        let first = (0..200).position(|_| filter.push(SensorCode::new(1000)).is_some());
        assert_eq!(first, Some(63), "61 taps need 16 blocks of 4");
    }
}
