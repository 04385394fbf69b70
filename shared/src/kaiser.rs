//! Kaiser-windowed sinc filters, designed at compile time.
//!
//! Everything is `const` and in double precision, so the tables are the same bits on every target and the
//! design formula stands in the source instead of a list of numbers.

const PI: f64 = core::f64::consts::PI;

/// Kaiser's β for a stop-band attenuation in dB above 50 (Oppenheim & Schafer, eq. 7.75).
pub const fn beta(attenuation_db: f64) -> f64 {
    0.1102 * (attenuation_db - 8.7)
}

/// Kaiser window at `x` in −1 … 1, relative to its middle; 0 outside.
pub const fn window(x: f64, beta: f64) -> f64 {
    let inside = 1.0 - x * x;
    if inside < 0.0 {
        return 0.0;
    }
    // I0 is a series in the square of its argument, so no square root is needed.
    bessel_i0_of_square(beta * beta * inside) / bessel_i0_of_square(beta * beta)
}

/// Taps of a linear-phase low-pass, symmetric, with sum 1. `N` is odd. `cutoff` is the middle of the transition in
/// cycles per sample; the transition is (`attenuation_db` − 7.95) / (14.36 (N − 1)) cycles per sample wide (Kaiser's
/// formula).
pub const fn low_pass<const N: usize>(cutoff: f64, attenuation_db: f64) -> [f32; N] {
    let middle = (N / 2) as f64;
    let mut exact = [0.0; N];
    let mut sum = 0.0;
    let mut k = 0;
    while k < N {
        let n = k as f64 - middle;
        exact[k] = sinc(2.0 * cutoff * n) * window(n / (middle + 1.0), beta(attenuation_db));
        sum += exact[k];
        k += 1;
    }
    let mut taps = [0.0; N];
    k = 0;
    while k < N {
        taps[k] = (exact[k] / sum) as f32;
        k += 1;
    }
    taps
}

/// sin(πx) / (πx).
pub const fn sinc(x: f64) -> f64 {
    if x == 0.0 { 1.0 } else { sin_pi(x) / (PI * x) }
}

/// Modified Bessel function I0(√s) by its power series; 40 terms reach double precision up to √s = 20.
const fn bessel_i0_of_square(s: f64) -> f64 {
    let mut sum = 1.0;
    let mut term = 1.0;
    let mut k = 1;
    while k < 40 {
        term *= s / 4.0 / (k * k) as f64;
        sum += term;
        k += 1;
    }
    sum
}

/// sin(πx): reduced to half a period, then the Taylor series.
const fn sin_pi(x: f64) -> f64 {
    let half = if x < 0.0 { -0.5 } else { 0.5 };
    let nearest = (x + half) as i64;
    let r = (x - nearest as f64) * PI;
    let mut sum = r;
    let mut term = r;
    let mut k = 1;
    while k < 14 {
        term *= -r * r / ((2 * k) * (2 * k + 1)) as f64;
        sum += term;
        k += 1;
    }
    if nearest % 2 == 0 { sum } else { -sum }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Double-precision series with some ten terms of rounding.
    const ROUNDING: f64 = 1e-14;

    #[test]
    fn analytic_sinc_matches_libm() {
        for i in -400..400 {
            let x = f64::from(i) * 0.037;
            let expected = if x == 0.0 { 1.0 } else { libm::sin(PI * x) / (PI * x) };
            assert!((sinc(x) - expected).abs() < ROUNDING, "x = {x}");
        }
    }

    #[test]
    fn reference_bessel_i0() {
        // Abramowitz & Stegun, table 9.8: exp(-x) I0(x) at x = 5 is 0.18354 08126.
        assert!((bessel_i0_of_square(25.0) * libm::exp(-5.0) - 0.183_540_812_6).abs() < 1e-10);
    }

    #[test]
    fn analytic_window_ends() {
        assert_eq!(window(0.0, 6.0), 1.0);
        assert_eq!(window(1.1, 6.0), 0.0);
        assert!((window(1.0, 6.0) - 1.0 / bessel_i0_of_square(36.0)).abs() < ROUNDING);
    }
}
