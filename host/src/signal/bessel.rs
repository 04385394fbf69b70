//! Analog anti-alias filter of the recorder: Bessel low-pass of given order, -3 dB at the stated frequency.

use faer::c64;

/// Analog Bessel low-pass.
#[derive(Clone, Debug)]
pub struct AntiAlias {
    /// Coefficients of the reverse Bessel polynomial, lowest power first.
    polynomial: Vec<f64>,
    /// Frequency of the normalised polynomial (delay normalisation) at which the gain is -3 dB, rad/s.
    corner_rad_s: f64,
    corner_hz: f64,
}

impl AntiAlias {
    /// Order 0 means no filter. `corner_hz` is the -3 dB frequency.
    pub fn new(order: usize, corner_hz: f64) -> Self {
        let polynomial = reverse_bessel_polynomial(order);
        let corner_rad_s = half_power_frequency(&polynomial);
        Self { polynomial, corner_rad_s, corner_hz }
    }

    /// Complex gain at `f_hz` (time factor e^{+iωt}).
    pub fn response(&self, f_hz: f64) -> c64 {
        if self.polynomial.len() < 2 {
            return c64::new(1.0, 0.0);
        }
        let s = c64::new(0.0, f_hz / self.corner_hz * self.corner_rad_s);
        c64::new(self.polynomial[0], 0.0) / evaluate(&self.polynomial, s)
    }
}

/// θ_n(s) = Σ (2n−k)! / (2^{n−k} k! (n−k)!) s^k.
fn reverse_bessel_polynomial(order: usize) -> Vec<f64> {
    let factorial = |n: usize| (1..=n).map(|k| k as f64).product::<f64>();
    (0..=order)
        .map(|k| {
            factorial(2 * order - k) / (2f64.powi((order - k) as i32) * factorial(k) * factorial(order - k))
        })
        .collect()
}

fn evaluate(polynomial: &[f64], s: c64) -> c64 {
    polynomial.iter().rev().fold(c64::new(0.0, 0.0), |acc, a| acc * s + c64::new(*a, 0.0))
}

/// Bisection for |H|² = 1/2; the gain of a Bessel low-pass falls monotonically.
fn half_power_frequency(polynomial: &[f64]) -> f64 {
    let (mut low, mut high) = (0.0, 100.0);
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        let gain = polynomial[0] / evaluate(polynomial, c64::new(0.0, middle)).norm();
        if gain * gain > 0.5 {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_third_order_polynomial() {
        assert_eq!(reverse_bessel_polynomial(3), vec![15.0, 15.0, 6.0, 1.0]);
    }

    #[test]
    fn analytic_half_power_at_the_corner_and_flat_delay_below() {
        let filter = AntiAlias::new(4, 1500.0);
        assert!((filter.response(1500.0).norm_sqr() - 0.5).abs() < 1e-9);
        let delay = |f: f64| -filter.response(f).arg() / (std::f64::consts::TAU * f);
        assert!((delay(10.0) / delay(600.0) - 1.0).abs() < 1e-3, "group delay is flat in the pass band");
        assert!(AntiAlias::new(0, 1500.0).response(3000.0) == c64::new(1.0, 0.0));
    }
}
