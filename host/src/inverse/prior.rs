//! What is assumed of the forces before the recording is seen.

use faer::Mat;

/// Gaussian prior of the force deviations f − Q and of the noise.
///
/// A deviation is the sum of a profile that all wheels of the site share (geometry of the crossing, roughness of both
/// rails) and a part of each wheel's own (its profile, its path, its roundness).
#[derive(Clone, Debug, PartialEq)]
pub struct Prior {
    /// Transition region, x in metres.
    pub region_m: [f64; 2],
    /// The profile that all wheels share.
    pub common: Spread,
    /// Each wheel's own part.
    pub own: Spread,
    /// Length over which the standard deviations fall off outside the region (Gaussian), metres.
    pub edge_m: f64,
    /// Correlation time of a wheel's own part (Matérn 5/2), seconds.
    pub correlation_s: f64,
    /// Correlation length of the common profile (Matérn 5/2), metres.
    pub correlation_m: f64,
    /// Standard deviation of a wheel's static load relative to the nominal one.
    pub load_sd: f64,
    /// Noise of one window sample, m/s².
    pub noise_m_s2: f64,
    /// Standard deviation of a constant offset of the window, m/s².
    pub offset_sd_m_s2: f64,
    /// Deviations are unknown while the wheel is within this distance of x = 0, metres; static beyond.
    pub half_m: f64,
}

/// Standard deviations of a force deviation, newtons.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Crossing side, inside the transition region.
    pub region_n: f64,
    /// Crossing side, outside.
    pub outside_n: f64,
    /// Stock side.
    pub stock_n: f64,
}

impl Prior {
    /// Starting values for traffic in a direction (+1 facing, -1 trailing); the hyper-parameters are refined by evidence.
    /// The transition region is 2.4 m as in the paper (section 4.2), 0.3 m behind the nose tip in facing direction.
    pub fn starting(direction: f64) -> Self {
        Self {
            region_m: [-1.2 + 0.3 * direction, 1.2 + 0.3 * direction],
            common: Spread { region_n: 25e3, outside_n: 6e3, stock_n: 6e3 },
            own: Spread { region_n: 6e3, outside_n: 1.5e3, stock_n: 1e3 },
            edge_m: 0.25,
            correlation_s: 2e-3,
            correlation_m: 0.09,
            load_sd: 0.02,
            noise_m_s2: 0.08,
            offset_sd_m_s2: 0.02,
            half_m: 4.0,
        }
    }

    /// The same knowledge, but with no profile shared between wheels: each wheel stands for itself.
    pub fn independent(&self) -> Self {
        let join = |a: f64, b: f64| a.hypot(b);
        let own = Spread {
            region_n: join(self.common.region_n, self.own.region_n),
            outside_n: join(self.common.outside_n, self.own.outside_n),
            stock_n: join(self.common.stock_n, self.own.stock_n),
        };
        Self { common: Spread { region_n: 0.0, outside_n: 0.0, stock_n: 0.0 }, own, ..self.clone() }
    }

    /// Standard deviation of a crossing-side deviation at `x_m`, newtons.
    pub fn crossing_sd_n(&self, spread: &Spread, x_m: f64) -> f64 {
        let beyond = (self.region_m[0] - x_m).max(x_m - self.region_m[1]).max(0.0);
        let inside = (-0.5 * (beyond / self.edge_m).powi(2)).exp();
        spread.outside_n + (spread.region_n - spread.outside_n) * inside
    }

    /// Lower Cholesky factor of the Matérn-5/2 correlation of `n` force samples at `rate_hz`; `None` if the
    /// factorisation fails (a non-finite correlation time).
    pub fn correlation_factor(&self, n: usize, rate_hz: f64) -> Option<Mat<f64>> {
        let step = 1.0 / (rate_hz * self.correlation_s);
        matern(n, step).llt(faer::Side::Lower).ok().map(|f| f.L().to_owned())
    }
}

/// Matérn-5/2 correlation matrix of `n` equidistant points, `step` correlation lengths apart; a jitter of 1e-9 keeps
/// it positive definite.
pub fn matern(n: usize, step: f64) -> Mat<f64> {
    let value = |lag: usize| {
        let r = 5f64.sqrt() * lag as f64 * step;
        (1.0 + r + r * r / 3.0) * (-r).exp()
    };
    Mat::from_fn(n, n, |i, j| value(i.abs_diff(j)) + if i == j { 1e-9 } else { 0.0 })
}
