//! What is assumed of the forces before the recording is seen.

use faer::Mat;

/// Gaussian prior of the force deviations f − Q and of the noise.
#[derive(Clone, Debug, PartialEq)]
pub struct Prior {
    /// Transition region, x in metres.
    pub region_m: [f64; 2],
    /// Standard deviation of the crossing-side deviation inside the region, newtons.
    pub region_sd_n: f64,
    /// … outside the region.
    pub outside_sd_n: f64,
    /// Standard deviation of the stock-side deviation, newtons.
    pub stock_sd_n: f64,
    /// Length over which the standard deviation falls off outside the region (Gaussian), metres.
    pub edge_m: f64,
    /// Correlation time of the deviations (Matérn 5/2), seconds.
    pub correlation_s: f64,
    /// Standard deviation of a wheel's static load relative to the nominal one.
    pub load_sd: f64,
    /// Noise of one window sample, m/s².
    pub noise_m_s2: f64,
    /// Standard deviation of a constant offset of the window, m/s².
    pub offset_sd_m_s2: f64,
    /// Deviations are unknown while the wheel is within this distance of x = 0, metres; static beyond.
    pub half_m: f64,
}

impl Prior {
    /// Starting values for traffic in a direction (+1 facing, -1 trailing); the hyper-parameters are refined by evidence.
    /// The transition region is 2.4 m as in the paper (section 4.2), 0.3 m behind the nose tip in facing direction.
    pub fn starting(direction: f64) -> Self {
        Self {
            region_m: [-1.2 + 0.3 * direction, 1.2 + 0.3 * direction],
            region_sd_n: 25e3,
            outside_sd_n: 4e3,
            stock_sd_n: 4e3,
            edge_m: 0.25,
            correlation_s: 2e-3,
            load_sd: 0.02,
            noise_m_s2: 0.08,
            offset_sd_m_s2: 0.02,
            half_m: 4.0,
        }
    }

    /// Standard deviation of the crossing-side deviation at `x_m`, newtons.
    pub fn crossing_sd_n(&self, x_m: f64) -> f64 {
        let beyond = (self.region_m[0] - x_m).max(x_m - self.region_m[1]).max(0.0);
        let inside = (-0.5 * (beyond / self.edge_m).powi(2)).exp();
        self.outside_sd_n + (self.region_sd_n - self.outside_sd_n) * inside
    }

    /// Lower Cholesky factor of the Matérn-5/2 correlation of `n` samples at `rate_hz`; a jitter of 1e-9 keeps it
    /// positive definite. `None` if even so the factorisation fails (a non-finite correlation time).
    pub fn correlation_factor(&self, n: usize, rate_hz: f64) -> Option<Mat<f64>> {
        let root = 5f64.sqrt();
        let value = |lag: usize| {
            let r = root * lag as f64 / rate_hz / self.correlation_s;
            (1.0 + r + r * r / 3.0) * (-r).exp()
        };
        let correlation =
            Mat::from_fn(n, n, |i, j| value(i.abs_diff(j)) + if i == j { 1e-9 } else { 0.0 });
        correlation.llt(faer::Side::Lower).ok().map(|f| f.L().to_owned())
    }
}
