//! Force identification from displacement of one bogie: the paper's rule and others as named methods, so that every
//! table can show them side by side (paper, section 4.2, eq. 9-12).
//!
//! All of them solve d = G f for the force under one wheel at consecutive samples of its passage, one force for
//! both wheels of a bogie if the kernel was built that way. They differ in what keeps the ill-conditioned G in check.

mod evidence;
mod rules;

pub use evidence::{Correlation, EvidenceFit, EvidenceForce, ForcePrior, fit_by_evidence};
pub use rules::{Rule, RuleForce, RuleSolver};

use faer::Mat;

use crate::signal::brick_band;

/// Why a force cannot be identified from displacement.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum DisplacementError {
    /// Nothing is unknown, or nothing was measured.
    #[error("kernel of {rows} window samples for {columns} force samples: both must be at least 3")]
    Empty {
        /// Window samples.
        rows: usize,
        /// Force samples.
        columns: usize,
    },
    /// The band limit leaves nothing or is above half the sampling rate.
    #[error("low-pass at {low_pass_hz} Hz does not fit a sampling rate of {rate_hz} Hz")]
    Band {
        /// Cut-off.
        low_pass_hz: f64,
        /// Sampling rate.
        rate_hz: f64,
    },
    /// A window of another length than the kernel.
    #[error("window has {found} samples, the kernel {expected}")]
    Window {
        /// Samples of the kernel.
        expected: usize,
        /// Samples of the window.
        found: usize,
    },
    /// A factorisation broke down: the kernel or the prior holds numbers that are not finite.
    #[error("{0} of the kernel cannot be computed; check stiffnesses and prior")]
    Decomposition(&'static str),
}

/// Linear model of one displacement window.
pub struct DisplacementModel {
    /// Window samples × force samples, m/N.
    pub kernel: Mat<f64>,
    /// Sampling rate of window and force, Hz.
    pub rate_hz: f64,
    /// Force outside the unknown stretch, newtons.
    pub static_force_n: f64,
    /// Samples with static force assumed before and after the unknown stretch where a force is low-passed.
    pub surround: [usize; 2],
    /// Forces are low-passed here, Hz.
    pub low_pass_hz: f64,
}

impl DisplacementModel {
    /// Refuses what no method can work on.
    pub fn check(&self) -> Result<(), DisplacementError> {
        let (rows, columns) = (self.kernel.nrows(), self.kernel.ncols());
        if rows < 3 || columns < 3 {
            return Err(DisplacementError::Empty { rows, columns });
        }
        let (low_pass_hz, rate_hz) = (self.low_pass_hz, self.rate_hz);
        if !(low_pass_hz > 0.0 && low_pass_hz <= 0.5 * rate_hz && rate_hz.is_finite()) {
            return Err(DisplacementError::Band { low_pass_hz, rate_hz });
        }
        Ok(())
    }

    fn check_window(&self, window: &[f64]) -> Result<(), DisplacementError> {
        let (expected, found) = (self.kernel.nrows(), window.len());
        if expected == found { Ok(()) } else { Err(DisplacementError::Window { expected, found }) }
    }

    /// Brick-wall low-pass of a deviation that is zero outside the unknown stretch, as a matrix: the filter is linear
    /// and the same for every sample, so one impulse response gives all of it.
    pub fn low_pass(&self) -> Mat<f64> {
        let n = self.kernel.ncols();
        let total = self.surround[0] + n + self.surround[1];
        let mut impulse = vec![0.0; total];
        impulse[0] = 1.0;
        let response = brick_band(&impulse, self.rate_hz, 0.0, self.low_pass_hz);
        Mat::from_fn(n, n, |i, j| response[(total + i - j) % total])
    }

    /// Window of the static force in the unknown stretch.
    fn static_window(&self) -> Vec<f64> {
        let n = self.kernel.ncols();
        (0..self.kernel.nrows())
            .map(|i| self.static_force_n * (0..n).map(|j| self.kernel[(i, j)]).sum::<f64>())
            .collect()
    }
}

/// A slice as a column.
fn column(values: &[f64]) -> Mat<f64> {
    Mat::from_fn(values.len(), 1, |i, _| values[i])
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A sensor that feels the passing force like an overcritically damped oscillator with a bell-shaped reach: smooth
    /// and as ill-conditioned as a track.
    pub fn example() -> DisplacementModel {
        let kernel = Mat::from_fn(60, 60, |i, j| {
            let lag = i as f64 - j as f64;
            let reach = (-0.5 * ((j as f64 - 30.0) / 25.0).powi(2)).exp();
            if lag < 0.0 { 0.0 } else { 1e-10 * reach * (lag / 3.0) * (-lag / 3.0).exp() }
        });
        DisplacementModel {
            kernel,
            rate_hz: 1000.0,
            static_force_n: 75e3,
            surround: [100, 100],
            low_pass_hz: 125.0,
        }
    }

    /// A force with a dip and a peak, band-limited, and its window.
    pub fn manufactured(model: &DisplacementModel) -> (Vec<f64>, Vec<f64>) {
        let bell = |i: usize, at: f64, w: f64| (-((i as f64 - at) / w).powi(2)).exp();
        let deviation: Vec<f64> =
            (0..60).map(|i| 60e3 * bell(i, 30.0, 6.0) - 30e3 * bell(i, 20.0, 7.0)).collect();
        let force: Vec<f64> = deviation.iter().map(|v| model.static_force_n + v).collect();
        let window = &model.kernel * column(&force);
        (force, (0..60).map(|i| window[(i, 0)]).collect())
    }

    #[test]
    fn property_low_pass_matrix_is_the_filter() {
        let model = example();
        let deviation: Vec<f64> = (0..60).map(|i| (0.7 * i as f64).sin()).collect();
        let mut long = vec![0.0; 260];
        long[100..160].copy_from_slice(&deviation);
        let filtered = brick_band(&long, 1000.0, 0.0, 125.0);
        let product = model.low_pass() * column(&deviation);
        for i in 0..60 {
            assert!((product[(i, 0)] - filtered[100 + i]).abs() < 1e-12);
        }
    }

    #[test]
    fn property_bad_models_are_refused_with_their_numbers() {
        let mut model = example();
        model.low_pass_hz = 600.0;
        assert_eq!(model.check(), Err(DisplacementError::Band { low_pass_hz: 600.0, rate_hz: 1000.0 }));
        model.low_pass_hz = 0.0;
        assert!(model.check().is_err());
        let empty = DisplacementModel { kernel: Mat::zeros(5, 0), ..example() };
        assert_eq!(empty.check(), Err(DisplacementError::Empty { rows: 5, columns: 0 }));
        assert_eq!(
            example().check_window(&[0.0; 7]),
            Err(DisplacementError::Window { expected: 60, found: 7 })
        );
    }
}
