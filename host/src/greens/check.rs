//! Refuses samplings, ballast and motions that give no Green's functions or empty kernels.

use faer::Mat;

use super::moving::{WheelPath, kernel};
use super::{Chain, GreensFunctions, GreensSampling, Quantity};
use crate::track::{Side, Track};

/// Why there are no Green's functions or no kernel.
#[derive(Clone, Copy, Debug, thiserror::Error, PartialEq)]
pub enum GreensError {
    /// One stiffness per sleeper is needed.
    #[error("{found} ballast stiffnesses for {sleepers} sleepers")]
    BallastCount {
        /// Sleepers of the track.
        sleepers: usize,
        /// Values given.
        found: usize,
    },
    /// Ballast cannot pull; without any, the static deflection is infinite.
    #[error("ballast stiffness of sleeper {sleeper} must be positive, got {value} N/m²")]
    Ballast {
        /// Sleeper number.
        sleeper: usize,
        /// Value.
        value: f64,
    },
    /// No time axis.
    #[error("{len} samples at {rate_hz} Hz are no time axis")]
    Sampling {
        /// Rate.
        rate_hz: f64,
        /// Samples.
        len: usize,
    },
    /// The band is empty or beyond half the rate.
    #[error(
        "band limit {low_hz} … {high_hz} Hz must rise and end below {limit_hz} Hz, half the sampling rate"
    )]
    Band {
        /// End of the pass band.
        low_hz: f64,
        /// Begin of the stop band.
        high_hz: f64,
        /// Half the sampling rate.
        limit_hz: f64,
    },
    /// A wheel that does not move never arrives.
    #[error("speed must be positive, got {0} m/s")]
    Speed(f64),
    /// The unknown stretch leaves the rails.
    #[error("stretch of ±{half_m} m leaves the track, which reaches from {from_m} to {to_m} m")]
    Window {
        /// Half length of the stretch.
        half_m: f64,
        /// First rail node.
        from_m: f64,
        /// Last rail node.
        to_m: f64,
    },
}

impl GreensSampling {
    /// Refuses an empty time axis or band.
    pub fn check(&self) -> Result<(), GreensError> {
        let Self { rate_hz, len, band_hz: [low_hz, high_hz] } = *self;
        if !(rate_hz > 0.0 && rate_hz.is_finite() && len >= 2) {
            return Err(GreensError::Sampling { rate_hz, len });
        }
        let limit_hz = 0.5 * rate_hz;
        if !(low_hz >= 0.0 && high_hz > low_hz && high_hz <= limit_hz) {
            return Err(GreensError::Band { low_hz, high_hz, limit_hz });
        }
        Ok(())
    }
}

impl GreensFunctions {
    /// [`GreensFunctions::new`], refused where a number is impossible.
    pub fn try_new(
        track: &Track,
        ballast_n_m2: &[f64],
        sampling: GreensSampling,
        quantity: Quantity,
        chain: &Chain,
    ) -> Result<Self, GreensError> {
        sampling.check()?;
        let (sleepers, found) = (track.sleeper_x_m.len(), ballast_n_m2.len());
        if sleepers != found {
            return Err(GreensError::BallastCount { sleepers, found });
        }
        if let Some((sleeper, value)) =
            ballast_n_m2.iter().copied().enumerate().find(|(_, k)| !(*k > 0.0 && k.is_finite()))
        {
            return Err(GreensError::Ballast { sleeper, value });
        }
        Ok(Self::new(track, ballast_n_m2, sampling, quantity, chain))
    }

    /// Where the rails begin and end, metres.
    pub fn extent_m(&self) -> [f64; 2] {
        [self.first_node_x_m, self.first_node_x_m + (self.n_nodes - 1) as f64 * self.step_m]
    }
}

/// [`kernel`], refused where the wheel does not move or the stretch leaves the track.
pub fn try_kernel(
    greens: &GreensFunctions,
    side: Side,
    path: &WheelPath,
    half_m: f64,
    window_len: usize,
) -> Result<Mat<f64>, GreensError> {
    if !(path.speed_m_s > 0.0 && path.speed_m_s.is_finite()) {
        return Err(GreensError::Speed(path.speed_m_s));
    }
    let [from_m, to_m] = greens.extent_m();
    if !(half_m > 0.0 && -half_m >= from_m && half_m <= to_m) {
        return Err(GreensError::Window { half_m, from_m, to_m });
    }
    Ok(kernel(greens, side, path, half_m, window_len))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::track::Mesh;
    use crate::verification::reference::{SOFT, ballast, panel};

    #[test]
    fn property_impossible_requests_are_refused_with_their_numbers() {
        let track = panel(SOFT, Mesh::default());
        let sampling = GreensSampling { rate_hz: 500.0, len: 64, band_hz: [100.0, 200.0] };
        let with = |sampling, ballast: &[f64]| {
            GreensFunctions::try_new(&track, ballast, sampling, Quantity::Displacement, &Chain::Corrected)
                .map(|_| ())
        };
        let sound = ballast(&track);
        assert_eq!(with(sampling, &sound), Ok(()));
        assert_eq!(with(sampling, &sound[1..]), Err(GreensError::BallastCount { sleepers: 37, found: 36 }));
        let mut voided = sound.clone();
        voided[18] = 0.0;
        assert_eq!(with(sampling, &voided), Err(GreensError::Ballast { sleeper: 18, value: 0.0 }));
        let empty = GreensSampling { band_hz: [200.0, 200.0], ..sampling };
        assert_eq!(
            with(empty, &sound),
            Err(GreensError::Band { low_hz: 200.0, high_hz: 200.0, limit_hz: 250.0 })
        );
        assert!(with(GreensSampling { band_hz: [200.0, 300.0], ..sampling }, &sound).is_err());
        assert!(with(GreensSampling { len: 0, ..sampling }, &sound).is_err());
    }

    #[test]
    fn property_kernels_of_no_motion_or_beyond_the_rails_are_refused() {
        let track = panel(SOFT, Mesh::default());
        let sampling = GreensSampling { rate_hz: 500.0, len: 64, band_hz: [100.0, 200.0] };
        let greens = GreensFunctions::new(
            &track,
            &ballast(&track),
            sampling,
            Quantity::Displacement,
            &Chain::Corrected,
        );
        let path = |speed_m_s| WheelPath { direction: 1.0, speed_m_s, time_at_origin_s: 0.1 };
        let refused = |speed, half_m| try_kernel(&greens, Side::Crossing, &path(speed), half_m, 50).err();
        assert_eq!(refused(0.0, 2.0), Some(GreensError::Speed(0.0)));
        assert!(matches!(refused(50.0, 12.0), Some(GreensError::Window { half_m: 12.0, .. })));
        assert_eq!(refused(50.0, 2.0), None);
    }
}
