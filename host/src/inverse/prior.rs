//! What is assumed of the forces before the recording is seen.

use std::f64::consts::PI;

use faer::Mat;
use faer::linalg::solvers::Solve as _;

use crate::track::Side;

/// Gaussian prior of the force deviations f − Q and of the noise.
///
/// A deviation is the sum of what an irregularity that all wheels of the site share (geometry of the crossing, roughness
/// of both rails) makes of it at the wheel's speed, and a part of each wheel's own (its profile, its path, its
/// roundness).
#[derive(Clone, Debug, PartialEq)]
pub struct Prior {
    /// Transition region, x in metres.
    pub region_m: [f64; 2],
    /// Irregularity that all wheels share, metres.
    pub common: Spread,
    /// Each wheel's own part, in the same unit.
    pub own: Spread,
    /// Length over which the standard deviations fall off outside the region (Gaussian), metres.
    pub edge_m: f64,
    /// Correlation time of a wheel's own part (Matérn 5/2), seconds.
    pub correlation_s: f64,
    /// Correlation length of a wheel's own irregularity (Matérn 5/2), metres.
    pub own_correlation_m: f64,
    /// Correlation length of the common profile (Matérn 5/2), metres.
    pub correlation_m: f64,
    /// Dip of the wheels' path from wing rail to nose: standard deviation inside the region, metres.
    pub dip_m: f64,
    /// Correlation length of the dip, metres.
    pub dip_correlation_m: f64,
    /// Standard deviation of the deviation's amplitude at wavelengths longer than 2.3 m, newtons: the
    /// unsprung mass cannot produce more, because it follows the slow variation of the deflection.
    pub slow_n: f64,
    /// Standard deviation of a wheel's static load relative to the nominal one.
    pub load_sd: f64,
    /// Noise of one window sample, m/s².
    pub noise_m_s2: f64,
    /// What else a window holds that its model does not.
    pub beyond: Option<Beyond>,
    /// Standard deviation of a constant offset of the window, m/s².
    pub offset_sd_m_s2: f64,
    /// Deviations are unknown while the wheel is within this distance of x = 0, metres; static beyond.
    pub half_m: f64,
    /// The window holds the response while a wheel is within this distance of x = 0, metres.
    pub window_m: f64,
}

/// Frequencies of a window that nothing is to be concluded from: the model of the track is less accurate there than the
/// sensor, and alike for all wheels, whose number therefore does not average its errors out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beyond {
    /// Where they begin, Hz.
    pub from_hz: f64,
    /// Noise that stands for them, standard deviation of one sample if they began at 0 Hz, m/s².
    pub noise_m_s2: f64,
}

impl Beyond {
    /// Covariance of two samples `lag` apart at a rate, (m/s²)²: of white noise, less its part below.
    pub fn covariance(&self, lag: usize, rate_hz: f64) -> f64 {
        let below = (2.0 * self.from_hz / rate_hz).min(1.0);
        let angle = PI * below * lag as f64;
        let share = if lag == 0 { 1.0 - below } else { -below * angle.sin() / angle };
        self.noise_m_s2.powi(2) * share
    }
}

/// Standard deviations along the track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Crossing side, inside the transition region.
    pub region: f64,
    /// Crossing side, outside.
    pub outside: f64,
    /// Stock side.
    pub stock: f64,
}

impl Prior {
    /// Starting values for traffic in a direction (+1 facing, -1 trailing); the hyper-parameters are refined by evidence.
    /// The transition region is 2.4 m as in the paper (section 4.2), 0.3 m behind the nose tip in facing direction.
    pub fn starting(direction: f64) -> Self {
        Self {
            region_m: [-1.2 + 0.3 * direction, 1.2 + 0.3 * direction],
            common: Spread { region: 0.3e-3, outside: 0.05e-3, stock: 0.03e-3 },
            own: Spread { region: 60e-6, outside: 10e-6, stock: 10e-6 },
            own_correlation_m: 0.15,
            edge_m: 0.25,
            correlation_s: 2e-3,
            correlation_m: 0.15,
            dip_m: 1e-3,
            dip_correlation_m: 0.4,
            slow_n: 0.5e3,
            load_sd: 0.02,
            noise_m_s2: 0.03,
            beyond: None,
            offset_sd_m_s2: 0.02,
            half_m: 5.5,
            window_m: 4.0,
        }
    }

    /// For the force estimate at the full band, where the linearised interaction of wheel and track is not accurate
    /// enough to carry knowledge from one wheel to the next: the wheels share a force profile. Newtons.
    pub fn common_force(direction: f64) -> Self {
        Self {
            common: Spread { region: 25e3, outside: 6e3, stock: 6e3 },
            own: Spread { region: 4e3, outside: 0.7e3, stock: 0.4e3 },
            slow_n: 1.5e3,
            // At the low sampling the load competes with the ballast; here it is the wheels' own, weighed one by one.
            load_sd: 0.025,
            correlation_m: 0.07,
            noise_m_s2: 0.06,
            half_m: 4.5,
            window_m: 4.0,
            ..Self::starting(direction)
        }
    }

    /// Nothing shared: what the wheels could have in common, each may have for itself. For a prior of forces.
    pub fn with_common_as_own(&self) -> Self {
        let own = Spread {
            region: self.common.region.hypot(self.own.region),
            outside: self.common.outside.hypot(self.own.outside),
            stock: self.common.stock.hypot(self.own.stock),
        };
        Self { own, ..self.clone() }
    }

    /// Every wheel stands for itself: a wide prior of its force, nothing shared.
    pub fn each_wheel_for_itself(direction: f64) -> Self {
        Self {
            own: Spread { region: 25e3, outside: 4e3, stock: 4e3 },
            slow_n: 20e3,
            noise_m_s2: 0.08,
            ..Self::starting(direction)
        }
    }

    /// As far as a wheel's own part on a rail depends on it: all else is zero.
    pub fn of_own(&self, side: Side) -> Self {
        let Spread { region, outside, stock } = self.own;
        let none = Spread { region: 0.0, outside: 0.0, stock: 0.0 };
        Self {
            own: match side {
                Side::Crossing => Spread { region, outside, ..none },
                Side::Stock => Spread { stock, ..none },
            },
            common: none,
            correlation_m: 0.0,
            dip_m: 0.0,
            dip_correlation_m: 0.0,
            load_sd: 0.0,
            noise_m_s2: 0.0,
            beyond: None,
            offset_sd_m_s2: 0.0,
            window_m: 0.0,
            ..self.clone()
        }
    }

    /// Standard deviation of a wheel's own part at `x_m`, in the unit of the profile.
    pub fn own_sd(&self, side: Side, x_m: f64) -> f64 {
        self.along(&self.own, side, x_m)
    }

    /// Standard deviation of the common profile at `x_m`, in its unit.
    pub fn common_sd(&self, side: Side, x_m: f64) -> f64 {
        self.along(&self.common, side, x_m)
    }

    /// Standard deviation of the dip at `x_m`, metres.
    pub fn dip_sd_m(&self, side: Side, x_m: f64) -> f64 {
        self.along(&Spread { region: self.dip_m, outside: 0.0, stock: 0.0 }, side, x_m)
    }

    fn along(&self, spread: &Spread, side: Side, x_m: f64) -> f64 {
        if side == Side::Stock {
            return spread.stock;
        }
        let beyond = (self.region_m[0] - x_m).max(x_m - self.region_m[1]).max(0.0);
        let inside = (-0.5 * (beyond / self.edge_m).powi(2)).exp();
        spread.outside + (spread.region - spread.outside) * inside
    }

    /// Covariance of a deviation with standard deviations `sd_n` at equidistant positions, N²: Matérn 5/2 with `step`
    /// correlation lengths between neighbours, its slow part limited to [`Self::slow_n`].
    pub fn covariance(&self, positions_m: &[f64], sd_n: &[f64], step: f64) -> Mat<f64> {
        let n = positions_m.len();
        let correlation: Vec<f64> = (0..n).map(|lag| matern_at(lag, step)).collect();
        let free = Mat::from_fn(n, n, |i, j| sd_n[i] * sd_n[j] * correlation[i.abs_diff(j)]);
        let slow = slow_amplitudes(positions_m, 2.0 * self.half_m);
        let cross = &free * &slow;
        let k = slow.ncols();
        let inner = slow.transpose() * &cross
            + Mat::from_fn(k, k, |i, j| if i == j { self.slow_n.powi(2) } else { 0.0 });
        match inner.llt(faer::Side::Lower) {
            Ok(factor) => &free - &cross * factor.solve(cross.transpose()),
            Err(_) => free,
        }
    }

    /// Lower Cholesky factor of the covariance of a wheel's own irregularity at equidistant positions, metres: Matérn 5/2
    /// with `step` correlation lengths between neighbours; `None` if it is not finite.
    pub fn path_factor(&self, positions_m: &[f64], side: Side, step: f64) -> Option<Mat<f64>> {
        let n = positions_m.len();
        let sd: Vec<f64> = positions_m.iter().map(|x| self.own_sd(side, *x)).collect();
        let correlation: Vec<f64> = (0..n).map(|lag| matern_at(lag, step)).collect();
        let covariance = Mat::from_fn(n, n, |i, j| {
            sd[i] * sd[j] * (correlation[i.abs_diff(j)] + if i == j { JITTER } else { 0.0 })
        });
        covariance.llt(faer::Side::Lower).ok().map(|f| f.L().to_owned())
    }

    /// Lower Cholesky factor of [`Self::covariance`]; `None` if it is not finite.
    pub fn covariance_factor(&self, positions_m: &[f64], sd_n: &[f64], step: f64) -> Option<Mat<f64>> {
        let mut covariance = self.covariance(positions_m, sd_n, step);
        let largest = (0..positions_m.len()).map(|i| covariance[(i, i)]).fold(0.0, f64::max);
        for i in 0..positions_m.len() {
            covariance[(i, i)] += JITTER * largest + f64::MIN_POSITIVE;
        }
        covariance.llt(faer::Side::Lower).ok().map(|f| f.L().to_owned())
    }
}

/// Wavelength beyond which the response is quasi-static, metres (paper, section 3.1).
pub const SLOW_WAVELENGTH_M: f64 = 2.3;
/// Relative to the largest variance; keeps a Cholesky factorisation alive.
const JITTER: f64 = 1e-9;

/// Functionals that read the amplitudes of the slow harmonics over a stretch of `span_m` from equidistant values.
fn slow_amplitudes(positions_m: &[f64], span_m: f64) -> Mat<f64> {
    let harmonics = (span_m / SLOW_WAVELENGTH_M).floor() as usize;
    let n = positions_m.len();
    Mat::from_fn(n, 1 + 2 * harmonics, |i, c| {
        let phase = std::f64::consts::TAU * c.div_ceil(2) as f64 * positions_m[i] / span_m;
        match c {
            0 => 1.0 / n as f64,
            _ if c % 2 == 1 => 2.0 / n as f64 * phase.cos(),
            _ => 2.0 / n as f64 * phase.sin(),
        }
    })
}

/// Matérn-5/2 correlation at a distance of `lag` steps of `step` correlation lengths.
pub fn matern_at(lag: usize, step: f64) -> f64 {
    let r = 5f64.sqrt() * lag as f64 * step;
    (1.0 + r + r * r / 3.0) * (-r).exp()
}
