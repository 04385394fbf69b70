//! The linear-Gaussian estimator of one kind of axle group at one speed.

use faer::linalg::matmul::{matmul, triangular};
use faer::linalg::solvers::Llt;
use faer::linalg::solvers::Solve as _;
use faer::{Accum, Mat, MatRef, Par};

use super::Prior;
use super::profile::CommonProfile;
use crate::greens::GreensFunctions;
use crate::greens::moving::{WheelPath, constant_force_response, kernel};
use crate::interaction::Interaction;
use crate::signal::CubicSpline;
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
    /// +1 facing, -1 trailing.
    pub direction: f64,
    /// Speed, m/s.
    pub speed_m_s: f64,
    /// Offsets of the group's axles behind its first, metres.
    pub axle_offset_m: &'a [f64],
    /// Offsets of all axles of the train behind the group's first (negative for those in front), metres.
    pub train_offset_m: &'a [f64],
    /// Static wheel force, newtons.
    pub static_force_n: f64,
    /// Mean force deviation of earlier wheels on the crossing side as a function of x, newtons; it takes the place of what
    /// the common irregularity predicts. `None` when nothing is known.
    pub mean_force: Option<&'a CubicSpline>,
}

/// Window and model of one axle group: what the sensor is expected to show and how it varies.
pub struct Estimator {
    /// Rate of the window, Hz.
    pub rate_hz: f64,
    /// Window samples before the moment at which the group's first axle is at x = 0.
    pub before: usize,
    /// Expected window under the prior mean, m/s².
    pub expected_m_s2: Vec<f64>,
    static_force_n: f64,
    prior: Prior,
    factor: Llt<f64>,
    log_det_half: f64,
    axles: Vec<AxleModel>,
    /// Window per metre of the common irregularity, window length × profile points.
    profile_response: Mat<f64>,
}

struct AxleModel {
    path: WheelPath,
    first_sample: i64,
    /// Factor of the covariance of the wheel's own deviation at the force samples, N.
    root_n: Mat<f64>,
    /// kernel · root: window per whitened force deviation.
    shaped: Mat<f64>,
    /// Window of the wheel's static force.
    static_m_s2: Vec<f64>,
    /// Window of static force and mean deviation.
    expected_m_s2: Vec<f64>,
    /// Mean deviation at each force sample, newtons.
    mean_n: Vec<f64>,
}

/// Linear map from a window to the force of one axle on a grid: force = base + gain · (window − expected).
pub struct AxleGain {
    /// Grid points × window length, N per m/s².
    pub gain: Mat<f64>,
    /// Force if the window is as expected, newtons.
    pub base_n: Vec<f64>,
    /// Posterior standard deviation, newtons.
    pub sd_n: Vec<f64>,
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
    /// Window extent for a group: while any of its wheels is within the window reach, and the decay after. The forces
    /// are unknown over a longer stretch than that, so that what the window holds is never blamed on too few of them.
    fn extent(geometry: &GroupGeometry, prior: &Prior, rate_hz: f64) -> (usize, usize) {
        let reach_s = prior.window_m / geometry.speed_m_s;
        let before = (reach_s * rate_hz).ceil() as usize;
        let last = geometry.axle_offset_m.last().copied().unwrap_or(0.0);
        let after = (last / geometry.speed_m_s + reach_s + DECAY_S) * rate_hz;
        (before, before + after.ceil() as usize + 1)
    }

    /// Builds the model of one group.
    pub fn new(
        greens: &GreensFunctions,
        geometry: &GroupGeometry,
        prior: &Prior,
        interaction: &Interaction,
        mean: &CommonProfile,
    ) -> Result<Self, InverseError> {
        if !(geometry.speed_m_s.is_finite() && geometry.speed_m_s > 0.0) {
            return Err(InverseError::Speed(geometry.speed_m_s));
        }
        let rate_hz = greens.sampling.rate_hz;
        let (before, len) = Self::extent(geometry, prior, rate_hz);
        let bad = || InverseError::Covariance { len, noise_m_s2: prior.noise_m_s2 };
        let path = |offset: f64| WheelPath {
            direction: geometry.direction,
            speed_m_s: geometry.speed_m_s,
            time_at_origin_s: before as f64 / rate_hz + offset / geometry.speed_m_s,
        };
        let mut covariance = noise_covariance(prior, len);
        let mut profile_response = Mat::zeros(len, mean.grids.len());
        let context = Context {
            greens,
            interaction,
            static_force_n: geometry.static_force_n,
            mean_force: geometry.mean_force,
            prior,
            mean,
        };
        let axles: Vec<AxleModel> = geometry
            .axle_offset_m
            .iter()
            .map(|o| AxleModel::new(&context, path(*o), &mut covariance, &mut profile_response))
            .collect::<Option<_>>()
            .ok_or_else(bad)?;
        let expected_m_s2 = expected_window(greens, geometry, &path, &axles, len);
        let factor = covariance.llt(faer::Side::Lower).map_err(|_| bad())?;
        let l = factor.L();
        let log_det_half = (0..len).map(|i| l[(i, i)].ln()).sum();
        Ok(Self {
            rate_hz,
            before,
            expected_m_s2,
            static_force_n: geometry.static_force_n,
            prior: prior.clone(),
            factor,
            log_det_half,
            axles,
            profile_response,
        })
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

    /// Response of the window to the common profile: window length × profile points, m/s² per metre.
    pub fn profile_response(&self) -> MatRef<'_, f64> {
        self.profile_response.as_ref()
    }

    /// Lower Cholesky factor of the window's covariance.
    pub fn covariance_root(&self) -> MatRef<'_, f64> {
        self.factor.L()
    }

    /// Covariance⁻¹ · `columns`.
    pub fn whiten(&self, columns: &Mat<f64>) -> Mat<f64> {
        self.factor.solve(columns)
    }

    /// Linear maps to the force of every axle, low-passed at `low_pass_hz` (brick wall), at positions `grid_m`.
    pub fn gains(&self, grid_m: &[f64], low_pass_hz: f64) -> Vec<AxleGain> {
        self.axles.iter().map(|axle| self.axle_gain(axle, grid_m, low_pass_hz)).collect()
    }

    fn axle_gain(&self, axle: &AxleModel, grid_m: &[f64], low_pass_hz: f64) -> AxleGain {
        let (m, n, g) = (axle.mean_n.len(), self.len(), grid_m.len());
        let low_pass = axle.low_pass(grid_m, low_pass_hz, self.rate_hz);
        let whitened = &low_pass * &axle.root_n;
        let load_variance = self.prior.load_sd.powi(2);
        // Covariance between the forces on the grid and the window.
        let mut cross = Mat::from_fn(g, n, |_, k| load_variance * self.static_force_n * axle.static_m_s2[k]);
        matmul(&mut cross, Accum::Add, &whitened, axle.shaped.transpose(), 1.0, Par::Seq);
        let gain = self.factor.solve(cross.transpose()).transpose().to_owned();
        let base_n = (0..g)
            .map(|i| self.static_force_n + (0..m).map(|j| low_pass[(i, j)] * axle.mean_n[j]).sum::<f64>())
            .collect();
        let sd_n = (0..g)
            .map(|i| {
                let prior: f64 = (0..m).map(|j| whitened[(i, j)].powi(2)).sum();
                let explained: f64 = (0..n).map(|k| cross[(i, k)] * gain[(i, k)]).sum();
                (prior + load_variance * self.static_force_n.powi(2) - explained).max(0.0).sqrt()
            })
            .collect();
        AxleGain { gain, base_n, sd_n }
    }
}

/// What all axles of a window have in common.
struct Context<'a> {
    greens: &'a GreensFunctions,
    interaction: &'a Interaction,
    static_force_n: f64,
    mean_force: Option<&'a CubicSpline>,
    prior: &'a Prior,
    mean: &'a CommonProfile,
}

impl AxleModel {
    /// Adds the axle's share to the covariance of the window and to its response to the common profile.
    fn new(
        context: &Context,
        path: WheelPath,
        covariance: &mut Mat<f64>,
        profile_response: &mut Mat<f64>,
    ) -> Option<Self> {
        let Context { greens, interaction, static_force_n, mean_force, prior, mean } = *context;
        let (rate, len) = (greens.sampling.rate_hz, covariance.nrows());
        let range = path.samples_within(prior.half_m, rate);
        let positions: Vec<f64> = range.clone().map(|j| path.x_m(j as f64 / rate)).collect();
        let step = 1.0 / (rate * prior.correlation_s);
        let own_root = |side: Side| {
            let sd_n: Vec<f64> = positions.iter().map(|x| prior.own_sd_n(side, *x)).collect();
            prior.covariance_factor(&positions, &sd_n, step)
        };
        let (root_n, stock_root_n) = (own_root(Side::Crossing)?, own_root(Side::Stock)?);
        let mut static_m_s2 = vec![0.0; len];
        for side in [Side::Crossing, Side::Stock] {
            for (s, r) in static_m_s2.iter_mut().zip(constant_force_response(greens, side, &path, len)) {
                *s += static_force_n * r;
            }
        }
        let mut expected_m_s2 = static_m_s2.clone();
        let mut add_side = |side: Side, root: &Mat<f64>| {
            let matrix = kernel(greens, side, &path, prior.half_m, len);
            let follow = interaction.force_per_irregularity(side, &positions, static_force_n);
            let deflection = interaction.static_deflection_m(side, &positions, static_force_n);
            let excitation =
                Mat::from_fn(positions.len(), 1, |j, _| deflection[j] + mean.at(side, positions[j]));
            let mut mean_n = &follow * &excitation;
            if let (Side::Crossing, Some(force)) = (side, mean_force) {
                for (j, x) in positions.iter().enumerate() {
                    mean_n[(j, 0)] = force.at(*x);
                }
            }
            let response = &matrix * &follow;
            for (j, x) in positions.iter().enumerate() {
                add_scaled(&mut expected_m_s2, matrix.col_as_slice(j), mean_n[(j, 0)]);
                for (entry, weight) in mean.grids.entries(side, *x) {
                    add_scaled(profile_response.col_as_slice_mut(entry), response.col_as_slice(j), weight);
                }
            }
            let shaped = &matrix * root;
            add_square(covariance, &shaped);
            (shaped, mean_n)
        };
        let (shaped, mean) = add_side(Side::Crossing, &root_n);
        add_side(Side::Stock, &stock_root_n);
        add_outer(covariance, &static_m_s2, prior.load_sd.powi(2));
        let mean_n = (0..positions.len()).map(|j| mean[(j, 0)]).collect();
        Some(Self { path, first_sample: *range.start(), root_n, shaped, static_m_s2, expected_m_s2, mean_n })
    }

    /// Brick-wall low-pass of the force samples, evaluated at the positions `grid_m`: band-limited interpolation.
    fn low_pass(&self, grid_m: &[f64], low_pass_hz: f64, rate_hz: f64) -> Mat<f64> {
        let scale = 2.0 * low_pass_hz / rate_hz;
        Mat::from_fn(grid_m.len(), self.mean_n.len(), |i, j| {
            let t = self.path.time_at_origin_s + self.path.direction * grid_m[i] / self.path.speed_m_s;
            let u = 2.0 * low_pass_hz * (t - (self.first_sample + j as i64) as f64 / rate_hz);
            let pi_u = std::f64::consts::PI * u;
            scale * if pi_u.abs() < 1e-9 { 1.0 } else { pi_u.sin() / pi_u }
        })
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

/// Window under the prior mean: static forces of the whole train, mean deviations of the group's own axles.
fn expected_window(
    greens: &GreensFunctions,
    geometry: &GroupGeometry,
    path: &dyn Fn(f64) -> WheelPath,
    axles: &[AxleModel],
    len: usize,
) -> Vec<f64> {
    let mut expected = vec![0.0; len];
    let own = geometry.axle_offset_m;
    for offset in geometry.train_offset_m.iter().filter(|o| !own.contains(o)) {
        for side in [Side::Crossing, Side::Stock] {
            let response = constant_force_response(greens, side, &path(*offset), len);
            for (e, r) in expected.iter_mut().zip(&response) {
                *e += geometry.static_force_n * r;
            }
        }
    }
    for axle in axles {
        for (e, r) in expected.iter_mut().zip(&axle.expected_m_s2) {
            *e += r;
        }
    }
    expected
}
