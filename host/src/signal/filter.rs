//! Frequency-domain filters.

use super::{irfft, rfft, rfft_frequencies_hz};

/// Rectangular ("brick") band filter in the frequency domain, as the paper uses it: components outside
/// `low_hz ..= high_hz` are removed, all others are kept unchanged in amplitude and phase.
pub fn brick_band(signal: &[f64], rate_hz: f64, low_hz: f64, high_hz: f64) -> Vec<f64> {
    let mut spectrum = rfft(signal);
    for (value, f) in spectrum.iter_mut().zip(rfft_frequencies_hz(signal.len(), rate_hz)) {
        if f < low_hz || f > high_hz {
            *value = faer::c64::new(0.0, 0.0);
        }
    }
    irfft(&spectrum, signal.len())
}

/// Signal after a gain per frequency, Hz, with a quarter of its length of zeros behind it for what rings on.
pub fn filtered(signal: &[f64], rate_hz: f64, gain: impl Fn(f64) -> faer::c64) -> Vec<f64> {
    let n = signal.len();
    let padded = (n + n / 4).next_multiple_of(2);
    let mut samples = signal.to_vec();
    samples.resize(padded, 0.0);
    let mut spectrum = rfft(&samples);
    for (value, f) in spectrum.iter_mut().zip(rfft_frequencies_hz(padded, rate_hz)) {
        *value *= gain(f);
    }
    let mut out = irfft(&spectrum, padded);
    out.truncate(n);
    out
}

/// Raised-cosine low-pass gain: 1 below `pass_hz`, 0 above `stop_hz`.
pub fn taper(f_hz: f64, pass_hz: f64, stop_hz: f64) -> f64 {
    if f_hz <= pass_hz {
        1.0
    } else if f_hz >= stop_hz {
        0.0
    } else {
        0.5 + 0.5 * (std::f64::consts::PI * (f_hz - pass_hz) / (stop_hz - pass_hz)).cos()
    }
}
