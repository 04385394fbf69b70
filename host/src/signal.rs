//! Spectra, filters and interpolation shared by all stages.

mod bessel;
mod filter;
mod spline;

pub use bessel::AntiAlias;
pub use filter::{brick_band, filtered, taper};
pub use spline::CubicSpline;

use std::cell::RefCell;
use std::collections::HashMap;
use std::sync::Arc;
use std::thread::LocalKey;

use faer::c64;
use rayon::iter::IndexedParallelIterator;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};

/// 90 % of a normal distribution lie within this many standard deviations.
pub const HALF_WIDTH_90: f64 = 1.6449;

type Plans<T> = RefCell<HashMap<usize, Arc<T>>>;

thread_local! {
    /// Plans by length are kept per thread: making one costs more than using it.
    static FORWARD: Plans<dyn RealToComplex<f64>> = Plans::default();
    static INVERSE: Plans<dyn ComplexToReal<f64>> = Plans::default();
}

/// Plan for a length. Each has its own planner, as a planner makes another plan, which rounds otherwise, where it can build on one
/// that it has made before.
fn planned<T: ?Sized>(
    plans: &'static LocalKey<Plans<T>>,
    len: usize,
    plan: impl FnOnce(&mut RealFftPlanner<f64>, usize) -> Arc<T>,
) -> Arc<T> {
    plans.with_borrow_mut(|p| p.entry(len).or_insert_with(|| plan(&mut RealFftPlanner::new(), len)).clone())
}

/// One-sided spectrum of a real signal (unnormalised forward transform): `n/2 + 1` values.
pub fn rfft(signal: &[f64]) -> Vec<c64> {
    if signal.is_empty() {
        return Vec::new();
    }
    let plan = planned(&FORWARD, signal.len(), RealFftPlanner::plan_fft_forward);
    let mut input = signal.to_vec();
    let mut spectrum = plan.make_output_vec();
    // The lengths come from the plan itself, so the transform cannot refuse them.
    let _ = plan.process(&mut input, &mut spectrum);
    spectrum
}

/// Inverse of [`rfft`]: `n` real samples, normalised by 1/n.
///
/// The imaginary parts of the first and (even `n`) last value are dropped, as they must be zero for a real signal.
pub fn irfft(spectrum: &[c64], n: usize) -> Vec<f64> {
    if n == 0 {
        return Vec::new();
    }
    let plan = planned(&INVERSE, n, RealFftPlanner::plan_fft_inverse);
    let mut input = plan.make_input_vec();
    let shared = input.len().min(spectrum.len());
    input[..shared].copy_from_slice(&spectrum[..shared]);
    input[0].im = 0.0;
    if n.is_multiple_of(2)
        && let Some(last) = input.last_mut()
    {
        last.im = 0.0;
    }
    let mut output = plan.make_output_vec();
    let _ = plan.process(&mut input, &mut output);
    for value in &mut output {
        *value /= n as f64;
    }
    output
}

/// Frequencies of [`rfft`] for `n` samples at `rate_hz`.
pub fn rfft_frequencies_hz(n: usize, rate_hz: f64) -> Vec<f64> {
    (0..=n / 2).map(|k| k as f64 * rate_hz / n as f64).collect()
}

/// Band-limited resampling to `len` samples over the same duration; the signal must be about equal at both ends.
pub fn resample(signal: &[f64], len: usize) -> Vec<f64> {
    if signal.is_empty() || len == 0 {
        return vec![0.0; len];
    }
    let spectrum = rfft(signal);
    let shared = spectrum.len().min(len / 2 + 1);
    let mut out = irfft(&spectrum[..shared], len);
    let scale = len as f64 / signal.len() as f64;
    for value in &mut out {
        *value *= scale;
    }
    out
}

/// Derivative by central differences of values at `rate_hz`, per second.
pub fn slope(values: &[f64], rate_hz: f64) -> Vec<f64> {
    let last = values.len().saturating_sub(1);
    (0..values.len())
        .map(|k| {
            let (a, b) = (k.saturating_sub(1), (k + 1).min(last));
            (values[b] - values[a]) * rate_hz / (b - a).max(1) as f64
        })
        .collect()
}

/// Root mean square; 0 for an empty slice.
pub fn rms(values: &[f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

/// Arithmetic mean; 0 for an empty slice.
pub fn mean(values: &[f64]) -> f64 {
    if values.is_empty() { 0.0 } else { values.iter().sum::<f64>() / values.len() as f64 }
}

/// Mean of series of equal length, value by value; empty of none.
pub fn mean_of(series: &[Vec<f64>]) -> Vec<f64> {
    let n = series.first().map_or(0, Vec::len);
    let scale = 1.0 / series.len().max(1) as f64;
    (0..n).map(|k| series.iter().map(|s| s[k]).sum::<f64>() * scale).collect()
}

/// Values of `count` places, 1 at one of them and 0 at the others.
pub fn one_at(place: usize, count: usize) -> Vec<f64> {
    (0..count).map(|i| f64::from(u8::from(i == place))).collect()
}

/// Place of the value that is nearest to `at`; 0 of none.
pub fn nearest(values: &[f64], at: f64) -> usize {
    let far = |i: &usize| (values[*i] - at).abs();
    (0..values.len()).min_by(|a, b| far(a).total_cmp(&far(b))).unwrap_or(0)
}

/// Takes the mean off, in place.
pub fn centre(values: &mut [f64]) {
    let mean = mean(values);
    values.iter_mut().for_each(|v| *v -= mean);
}

/// Sum of products of two slices, up to the length of the shorter one.
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// `values` less their mean and what goes linearly with each of `others` in turn.
pub fn freed(values: &[f64], others: &[&[f64]]) -> Vec<f64> {
    let mut out = values.to_vec();
    centre(&mut out);
    for (k, other) in others.iter().enumerate() {
        let along = freed(other, &others[..k]);
        let slope = dot(&along, &out) / dot(&along, &along).max(f64::MIN_POSITIVE);
        out.iter_mut().zip(&along).for_each(|(v, a)| *v -= slope * a);
    }
    out
}

/// Sum of values computed side by side, in their order: threads finish as they will, and rounding would tell.
pub fn sum_in_order(values: impl IndexedParallelIterator<Item = f64>) -> f64 {
    values.collect::<Vec<f64>>().iter().sum()
}

/// Value on the straight line between two samples, at a place counted in samples; `None` outside.
pub fn between(values: &[f64], place: f64) -> Option<f64> {
    let pair = if place < 0.0 { None } else { values.get(place as usize..)?.get(..2) };
    pair.map(|v| v[0] + place.fract() * (v[1] - v[0]))
}

/// Mean of the values within `half` samples of `at` on either side, as far as there are any.
pub fn mean_around(values: &[f64], at: usize, half: usize) -> f64 {
    mean(&values[at.saturating_sub(half)..(at + half + 1).min(values.len())])
}

/// Quantile `q` in 0 … 1 by linear interpolation between order statistics; NaN for an empty slice.
pub fn quantile(values: &[f64], q: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    let position = q.clamp(0.0, 1.0) * last as f64;
    let low = position.floor() as usize;
    let high = (low + 1).min(last);
    sorted[low] + (sorted[high] - sorted[low]) * (position - low as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn property_sum_in_order_is_the_sum_of_one_thread() {
        use rayon::prelude::*;
        let values: Vec<f64> =
            (0..1000).map(|i| (f64::from(i) * 0.7).sin().exp() * 10f64.powi(i % 7)).collect();
        let one: f64 = values.iter().sum();
        for _ in 0..20 {
            assert_eq!(sum_in_order(values.par_iter().copied()), one);
        }
    }

    /// 1054 is twice a prime, for whose transform a planner makes one of 576.
    #[test]
    fn property_spectrum_does_not_depend_on_what_was_transformed_before() {
        let signal = |n: u32| -> Vec<f64> { (0..n).map(|i| (f64::from(i) * 0.37).sin()).collect() };
        let there_and_back = |before: Option<u32>| {
            let transforms = move || {
                before.iter().for_each(|n| drop(irfft(&rfft(&signal(*n)), *n as usize)));
                let spectrum = rfft(&signal(576));
                (irfft(&spectrum, 576), spectrum)
            };
            std::thread::spawn(transforms).join().unwrap()
        };
        assert!(there_and_back(Some(1054)) == there_and_back(None));
    }

    #[test]
    fn property_inverse_undoes_forward_for_even_and_odd_lengths() {
        for n in [1usize, 2, 7, 64, 375] {
            let signal: Vec<f64> = (0..n).map(|i| (i as f64 * 0.7).sin() + 0.1 * i as f64).collect();
            let back = irfft(&rfft(&signal), n);
            for (a, b) in signal.iter().zip(&back) {
                assert!((a - b).abs() < 1e-10, "n {n}: {a} {b}");
            }
        }
    }

    #[test]
    fn analytic_quantiles_of_a_ramp() {
        let ramp: Vec<f64> = (0..=10).map(f64::from).collect();
        assert_eq!(quantile(&ramp, 0.9), 9.0);
        assert_eq!(quantile(&ramp, 0.55), 5.5);
        assert!(quantile(&[], 0.5).is_nan());
    }
}
