//! The linear-Gaussian estimator of one kind of axle group at one speed.

use faer::linalg::matmul::{matmul, triangular};
use faer::linalg::solvers::Llt;
use faer::linalg::solvers::Solve as _;
use faer::{Accum, Mat, MatRef, Par};

use super::Prior;
use super::profile::{CommonProfile, WheelClass};
use super::wheel::{Basis, Means, Running, SIDES, TrackModel, Wheel};
use crate::greens::moving::{PassingResponse, own_clock_kernel};
use crate::track::Side;

/// Time after the last wheel has left the reach during which its response is still used, seconds.
const DECAY_S: f64 = 0.03;

/// Why an estimator could not be built.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum InverseError {
    /// The speed is not a positive number.
    #[error("train speed must be positive, got {0} m/s")]
    Speed(f64),
    /// The covariance of the window is not positive definite.
    #[error(
        "covariance of a window of {len} samples is not positive definite; check noise ({noise_m_s2} m/s²) and prior"
    )]
    Covariance {
        /// Window length.
        len: usize,
        /// Noise standard deviation.
        noise_m_s2: f64,
    },
}

/// Axles of a group, as they follow one another over the sensor.
#[derive(Clone, Copy, Debug)]
pub struct GroupGeometry<'a> {
    /// Direction, speed and load.
    pub running: Running,
    /// Offsets of the group's axles behind its first, metres.
    pub axle_offset_m: &'a [f64],
    /// Offsets of all axles of the train behind the group's first (negative for those in front), metres.
    pub train_offset_m: &'a [f64],
}

/// Window and model of one axle group: what the sensor is expected to show and how it varies.
pub struct Estimator {
    /// Rate of the window, Hz.
    pub rate_hz: f64,
    /// Window samples before the moment at which the group's first axle is at x = 0.
    pub before: usize,
    /// Expected window under the common profile, m/s².
    pub expected_m_s2: Vec<f64>,
    /// Its time derivative, m/s³.
    pub expected_slope_m_s3: Vec<f64>,
    running: Running,
    prior: Prior,
    factor: Llt<f64>,
    log_det_half: f64,
    wheel: Wheel,
    axles: Vec<AxleModel>,
    /// Window per unit of the common profile, window length × profile entries.
    profile_response: Mat<f64>,
}

struct AxleModel {
    class: WheelClass,
    /// kernel · root: window per whitened force deviation of the crossing side.
    shaped: Mat<f64>,
    /// Window of the wheel's static force.
    static_m_s2: Vec<f64>,
}

/// Linear map from a window to the force of one axle on a grid: force = base + gain · (window − expected).
pub struct AxleGain {
    /// Grid points × window length, N per m/s².
    pub gain: Mat<f64>,
    /// Force if the window is as expected, newtons.
    pub base_n: Vec<f64>,
    /// Posterior standard deviation with the common profile known, newtons.
    pub sd_n: Vec<f64>,
    /// Force on the grid per entry of the common profile at given window, grid points × profile entries.
    pub profile: Mat<f64>,
}

impl AxleGain {
    /// Force on the grid for a residual window (measured − expected), newtons.
    pub fn apply(&self, residual_m_s2: &[f64]) -> Vec<f64> {
        let mut force = self.base_n.clone();
        for (k, r) in residual_m_s2.iter().enumerate().take(self.gain.ncols()) {
            for (f, g) in force.iter_mut().zip(self.gain.col(k).iter()) {
                *f += g * r;
            }
        }
        force
    }
}

impl Estimator {
    /// Builds the model of one group.
    pub fn new(
        model: &TrackModel,
        geometry: &GroupGeometry,
        prior: &Prior,
        common: &CommonProfile,
    ) -> Result<Self, InverseError> {
        Ok(Self::with_moved(model, &[], geometry, prior, common)?.0)
    }

    /// Builds the model of one group, and what it expects ([`Self::expected_m_s2`]) on tracks close to that of `model`.
    pub fn with_moved(
        model: &TrackModel,
        moved: &[TrackModel],
        geometry: &GroupGeometry,
        prior: &Prior,
        common: &CommonProfile,
    ) -> Result<(Self, Vec<Vec<f64>>), InverseError> {
        let running = geometry.running;
        if !(running.speed_m_s.is_finite() && running.speed_m_s > 0.0) {
            return Err(InverseError::Speed(running.speed_m_s));
        }
        let rate_hz = model.greens.sampling.rate_hz;
        let window = Window::of(geometry, prior, rate_hz);
        let len = window.len;
        let bad = || InverseError::Covariance { len, noise_m_s2: prior.noise_m_s2 };
        let (wheel, moved_n) = Wheel::new(model, moved, &running, prior, common).ok_or_else(bad)?;
        let clock = (wheel.first_sample, wheel.position_m.as_slice());
        let expectation = Expectation::new(model, &running, window, clock, &wheel.mean_n);
        let moved_m_s2 = moved
            .iter()
            .zip(&moved_n)
            .map(|(m, mean_n)| {
                Expectation::new(m, &running, window, clock, mean_n).window(geometry, common, rate_hz)
            })
            .collect();
        let mut covariance = noise_covariance(prior, len);
        let mut profile_response = Mat::zeros(len, common.grids.len());
        let mut axles = Vec::with_capacity(geometry.axle_offset_m.len());
        for (i, offset) in geometry.axle_offset_m.iter().enumerate() {
            let class = common.grids.class(running.speed_m_s, i);
            let time_s = window.time_at_origin_s(*offset, &running, rate_hz);
            let shaped =
                add_axle(model, &wheel, common, class, time_s, &mut covariance, &mut profile_response);
            let static_m_s2 = expectation.standing.window(&[time_s], len);
            add_outer(&mut covariance, &static_m_s2, prior.load_sd.powi(2));
            axles.push(AxleModel { class, shaped, static_m_s2 });
        }
        let factor = covariance.llt(faer::Side::Lower).map_err(|_| bad())?;
        let l = factor.L();
        let log_det_half = (0..len).map(|i| l[(i, i)].ln()).sum();
        let estimator = Self {
            rate_hz,
            before: window.before,
            expected_m_s2: expectation.window(geometry, common, rate_hz),
            expected_slope_m_s3: expectation.sum(geometry, common, rate_hz, PassingResponse::slope),
            running,
            prior: prior.clone(),
            factor,
            log_det_half,
            wheel,
            axles,
            profile_response,
        };
        Ok((estimator, moved_m_s2))
    }

    /// Window length in samples.
    pub fn len(&self) -> usize {
        self.expected_m_s2.len()
    }

    /// Never: a window has at least the samples of one wheel.
    pub fn is_empty(&self) -> bool {
        self.expected_m_s2.is_empty()
    }

    /// Log marginal likelihood of a window, the forces integrated out.
    pub fn log_evidence(&self, window_m_s2: &[f64]) -> f64 {
        let n = self.len();
        let residual = Mat::from_fn(n, 1, |i, _| window_m_s2[i] - self.expected_m_s2[i]);
        let solved = self.factor.solve(&residual);
        let quadratic: f64 = (0..n).map(|i| residual[(i, 0)] * solved[(i, 0)]).sum();
        -0.5 * quadratic - self.log_det_half - 0.5 * n as f64 * std::f64::consts::TAU.ln()
    }

    /// Half the log determinant of the window's covariance.
    pub fn log_det_half(&self) -> f64 {
        self.log_det_half
    }

    /// Response of the window to the common profile: window length × profile entries, m/s² per unit of the profile.
    pub fn profile_response(&self) -> MatRef<'_, f64> {
        self.profile_response.as_ref()
    }

    /// Lower Cholesky factor of the window's covariance.
    pub fn covariance_root(&self) -> MatRef<'_, f64> {
        self.factor.L()
    }

    /// L⁻¹ · `columns`, with L the Cholesky factor of the window's covariance; in place.
    pub fn whiten(&self, columns: &mut Mat<f64>) {
        faer::linalg::triangular_solve::solve_lower_triangular_in_place(
            self.factor.L(),
            columns.as_mut(),
            Par::Seq,
        );
    }

    /// Forces of every axle for a window, low-passed at `low_pass_hz` (brick wall), at positions `grid_m`: what
    /// [`Self::gains`] gives, without the matrices.
    pub fn forces_n(&self, window_m_s2: &[f64], grid_m: &[f64], low_pass_hz: f64) -> Vec<Vec<f64>> {
        let n = self.len();
        let residual = Mat::from_fn(n, 1, |i, _| window_m_s2[i] - self.expected_m_s2[i]);
        let solved = self.factor.solve(&residual);
        let low_pass = self.low_pass(grid_m, low_pass_hz);
        self.axles
            .iter()
            .map(|axle| {
                let root = &self.wheel.root_n[usize::from(!axle.class.leading)][0];
                let mut deviation = root * (axle.shaped.transpose() * &solved);
                for (i, mean) in self.wheel.mean_n[usize::from(!axle.class.leading)][0].iter().enumerate() {
                    deviation[(i, 0)] += mean;
                }
                let load: f64 = (0..n).map(|k| axle.static_m_s2[k] * solved[(k, 0)]).sum();
                let static_n = self.running.static_force_n * (1.0 + self.prior.load_sd.powi(2) * load);
                let low = &low_pass * &deviation;
                (0..grid_m.len()).map(|i| static_n + low[(i, 0)]).collect()
            })
            .collect()
    }

    /// Linear maps to the force of every axle, low-passed at `low_pass_hz` (brick wall), at positions `grid_m`.
    pub fn gains(&self, grid_m: &[f64], low_pass_hz: f64, common: &CommonProfile) -> Vec<AxleGain> {
        let low_pass = self.low_pass(grid_m, low_pass_hz);
        self.axles.iter().map(|axle| self.axle_gain(axle, &low_pass, common)).collect()
    }

    fn axle_gain(&self, axle: &AxleModel, low_pass: &Mat<f64>, common: &CommonProfile) -> AxleGain {
        let mean_n = &self.wheel.mean_n[usize::from(!axle.class.leading)][0];
        let (m, n, g) = (mean_n.len(), self.len(), low_pass.nrows());
        let whitened = low_pass * &self.wheel.root_n[usize::from(!axle.class.leading)][0];
        let load_variance = self.prior.load_sd.powi(2);
        let static_force_n = self.running.static_force_n;
        // Covariance between the forces on the grid and the window.
        let mut cross = Mat::from_fn(g, n, |_, k| load_variance * static_force_n * axle.static_m_s2[k]);
        matmul(&mut cross, Accum::Add, &whitened, axle.shaped.transpose(), 1.0, Par::Seq);
        let gain = self.factor.solve(cross.transpose()).transpose().to_owned();
        let base_n = (0..g)
            .map(|i| static_force_n + (0..m).map(|j| low_pass[(i, j)] * mean_n[j]).sum::<f64>())
            .collect();
        let sd_n = (0..g)
            .map(|i| {
                let prior: f64 = (0..m).map(|j| whitened[(i, j)].powi(2)).sum();
                let explained: f64 = (0..n).map(|k| cross[(i, k)] * gain[(i, k)]).sum();
                (prior + load_variance * static_force_n.powi(2) - explained).max(0.0).sqrt()
            })
            .collect();
        let mut profile = match &self.wheel.basis {
            Basis::Full(contacts) => low_pass * &contacts[usize::from(!axle.class.leading)][0],
            Basis::Splines([crossing, _]) => {
                let mut all = Mat::zeros(g, common.grids.len());
                add_parts(&mut all, &(low_pass * crossing), common, SIDES[0], axle.class);
                all
            }
        };
        matmul(&mut profile, Accum::Add, &gain, &self.profile_response, -1.0, Par::Seq);
        AxleGain { gain, base_n, sd_n, profile }
    }

    /// Brick-wall low-pass of the force samples, evaluated at the positions `grid_m`: band-limited interpolation.
    fn low_pass(&self, grid_m: &[f64], low_pass_hz: f64) -> Mat<f64> {
        let scale = 2.0 * low_pass_hz / self.rate_hz;
        Mat::from_fn(grid_m.len(), self.wheel.position_m.len(), |i, j| {
            let t = self.running.direction * grid_m[i] / self.running.speed_m_s;
            let u = 2.0 * low_pass_hz * (t - (self.wheel.first_sample + j as i64) as f64 / self.rate_hz);
            let pi_u = std::f64::consts::PI * u;
            scale * if pi_u.abs() < 1e-9 { 1.0 } else { pi_u.sin() / pi_u }
        })
    }
}

/// Extent of the window of a group.
#[derive(Clone, Copy, Debug)]
struct Window {
    before: usize,
    len: usize,
}

impl Window {
    /// While any wheel of the group is within the window reach, and the decay after. The forces are unknown over a longer
    /// stretch than that, so that what the window holds is never blamed on too few of them.
    fn of(geometry: &GroupGeometry, prior: &Prior, rate_hz: f64) -> Self {
        let speed = geometry.running.speed_m_s;
        let reach_s = prior.window_m / speed;
        let before = (reach_s * rate_hz).ceil() as usize;
        let last = geometry.axle_offset_m.last().copied().unwrap_or(0.0);
        let after = (last / speed + reach_s + DECAY_S) * rate_hz;
        Self { before, len: before + after.ceil() as usize + 1 }
    }

    fn time_at_origin_s(&self, offset_m: f64, running: &Running, rate_hz: f64) -> f64 {
        self.before as f64 / rate_hz + offset_m / running.speed_m_s
    }
}

/// Response to passing wheels under the mean forces.
struct Expectation {
    window: Window,
    /// Static force only.
    standing: PassingResponse,
    /// Leading and trailing wheels of bogies with their mean deviations.
    running: [PassingResponse; 2],
}

impl Expectation {
    /// Of mean deviations on a wheel's own clock, from sample `first` on.
    fn new(
        model: &TrackModel,
        running: &Running,
        window: Window,
        (first, position_m): (i64, &[f64]),
        mean_n: &Means,
    ) -> Self {
        let Running { direction, speed_m_s, static_force_n } = *running;
        let standing =
            PassingResponse::of_constant(model.greens, direction, speed_m_s, window.len, static_force_n);
        let running = mean_n
            .each_ref()
            .map(|[crossing, stock]| standing.with(model.greens, first, position_m, [crossing, stock]));
        Self { window, standing, running }
    }

    fn window(&self, geometry: &GroupGeometry, common: &CommonProfile, rate_hz: f64) -> Vec<f64> {
        self.sum(geometry, common, rate_hz, PassingResponse::window)
    }

    /// Static forces of the whole train, mean deviations of the group's own axles.
    fn sum(
        &self,
        geometry: &GroupGeometry,
        common: &CommonProfile,
        rate_hz: f64,
        of: fn(&PassingResponse, &[f64], usize) -> Vec<f64>,
    ) -> Vec<f64> {
        let running = &geometry.running;
        let time = |o: &f64| self.window.time_at_origin_s(*o, running, rate_hz);
        let own = geometry.axle_offset_m;
        let others: Vec<f64> =
            geometry.train_offset_m.iter().filter(|o| !own.contains(o)).map(time).collect();
        let mut sum = of(&self.standing, &others, self.window.len);
        for (which, response) in self.running.iter().enumerate() {
            let times: Vec<f64> = own
                .iter()
                .enumerate()
                .filter(|(i, _)| usize::from(!common.grids.class(running.speed_m_s, *i).leading) == which)
                .map(|(_, o)| time(o))
                .collect();
            for (s, r) in sum.iter_mut().zip(of(response, &times, self.window.len)) {
                *s += r;
            }
        }
        sum
    }
}

/// Adds an axle's share to the covariance of the window and to its response to the common profile; returns the
/// window per whitened force deviation of the crossing side.
fn add_axle(
    model: &TrackModel,
    wheel: &Wheel,
    common: &CommonProfile,
    class: WheelClass,
    time_at_origin_s: f64,
    covariance: &mut Mat<f64>,
    profile_response: &mut Mat<f64>,
) -> Mat<f64> {
    let len = covariance.nrows();
    let samples = time_at_origin_s * model.greens.sampling.rate_hz;
    let whole = samples.floor();
    let reach_m = wheel.position_m.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
    let greens = model.greens.delayed(samples - whole, reach_m);
    let mut crossing = Mat::zeros(0, 0);
    for (rail, side) in SIDES.into_iter().enumerate() {
        let first = wheel.first_sample + whole as i64;
        let kernel = own_clock_kernel(&greens, side, &wheel.position_m, first, len);
        match &wheel.basis {
            Basis::Full(contacts) => {
                let basis = &contacts[usize::from(!class.leading)][rail];
                matmul(profile_response.as_mut(), Accum::Add, &kernel, basis, 1.0, Par::Seq);
            }
            Basis::Splines(splines) => {
                add_parts(profile_response, &(&kernel * &splines[rail]), common, side, class);
            }
        }
        let shaped = &kernel * &wheel.root_n[usize::from(!class.leading)][rail];
        add_square(covariance, &shaped);
        if side == SIDES[0] {
            crossing = shaped;
        }
    }
    crossing
}

/// Adds the response to the splines of one rail to all parts of the profile on it.
fn add_parts(
    target: &mut Mat<f64>,
    response: &Mat<f64>,
    common: &CommonProfile,
    side: Side,
    class: WheelClass,
) {
    for (part, weight) in common.grids.parts_of(side, class) {
        for c in 0..response.ncols() {
            add_scaled(target.col_as_slice_mut(part.first + c), response.col_as_slice(c), weight);
        }
    }
}

fn add_scaled(target: &mut [f64], column: &[f64], scale: f64) {
    if scale != 0.0 {
        for (t, c) in target.iter_mut().zip(column) {
            *t += scale * c;
        }
    }
}

/// covariance += scale · v vᵀ, lower triangle.
fn add_outer(covariance: &mut Mat<f64>, v: &[f64], scale: f64) {
    for j in 0..v.len() {
        for i in j..v.len() {
            covariance[(i, j)] += scale * v[i] * v[j];
        }
    }
}

fn noise_covariance(prior: &Prior, len: usize) -> Mat<f64> {
    let offset = prior.offset_sd_m_s2.powi(2);
    Mat::from_fn(len, len, |i, j| offset + if i == j { prior.noise_m_s2.powi(2) } else { 0.0 })
}

/// covariance += shaped · shapedᵀ, lower triangle.
fn add_square(covariance: &mut Mat<f64>, shaped: &Mat<f64>) {
    triangular::matmul(
        covariance,
        triangular::BlockStructure::TriangularLower,
        Accum::Add,
        shaped,
        triangular::BlockStructure::Rectangular,
        shaped.transpose(),
        triangular::BlockStructure::Rectangular,
        1.0,
        Par::Seq,
    );
}
