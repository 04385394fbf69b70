//! The linear-Gaussian estimator of one kind of axle group at one speed.

use std::sync::Arc;

use faer::linalg::matmul::matmul;
use faer::linalg::solvers::Llt;
use faer::linalg::solvers::Solve as _;
use faer::{Accum, Mat, MatRef, Par};

use super::deviations::Deviations;
use super::hierarchy::GroupOffsets;
use super::prior::Prior;
use super::profile::{CommonProfile, WheelClass, add_scaled};
use super::train::{Axle, Group, Train};
use super::wheel::{Basis, Running, SIDES, TrackModel};
use crate::track::Side;

/// Phase below which a sine is its argument, radians: exact to 2e-13.
const NEAR: f64 = 1e-6;

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
    load_sd: f64,
    factor: Llt<f64>,
    log_det_half: f64,
    train: Arc<Train>,
    group: usize,
    /// On the crossing rail.
    own: Arc<Deviations>,
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
        let offsets =
            GroupOffsets { own: geometry.axle_offset_m.to_vec(), train: geometry.train_offset_m.to_vec() };
        let train = Arc::new(Train::new(model, moved, geometry.running, &[&offsets], prior, common)?);
        let estimator = Self::of_group(&train, 0, prior, &train.deviations(prior)?)?;
        Ok((estimator, train.groups[0].moved_m_s2.clone()))
    }

    /// Of a group of a train, with the deviations of its wheels on `[crossing, stock]`.
    pub(super) fn of_group(
        train: &Arc<Train>,
        group: usize,
        prior: &Prior,
        own: &[Arc<Deviations>; 2],
    ) -> Result<Self, InverseError> {
        let Group { window, axles, expected_m_s2, expected_slope_m_s3, .. } = &train.groups[group];
        let len = window.len;
        let mut covariance = noise_covariance(prior, len, train.rate_hz);
        for axle in axles {
            own.iter().for_each(|rail| rail.add_covariance(*axle, &mut covariance));
            add_outer(&mut covariance, &train.axles[*axle].static_m_s2[..len], prior.load_sd.powi(2));
        }
        let bad = |_| InverseError::Covariance { len, noise_m_s2: prior.noise_m_s2 };
        let factor = covariance.llt(faer::Side::Lower).map_err(bad)?;
        let l = factor.L();
        let log_det_half = (0..len).map(|i| l[(i, i)].ln()).sum();
        Ok(Self {
            rate_hz: train.rate_hz,
            before: window.before,
            expected_m_s2: expected_m_s2.clone(),
            expected_slope_m_s3: expected_slope_m_s3.clone(),
            load_sd: prior.load_sd,
            factor,
            log_det_half,
            train: Arc::clone(train),
            group,
            own: Arc::clone(&own[0]),
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
        let forces = self.axles().map(|(axle, shaped)| {
            let which = usize::from(!axle.class.leading);
            let mut deviation = &self.own.root_n[which] * (shaped.transpose() * &solved);
            for (i, mean) in self.train.wheel.mean_n[which][0].iter().enumerate() {
                deviation[(i, 0)] += mean;
            }
            let load: f64 = (0..n).map(|k| axle.static_m_s2[k] * solved[(k, 0)]).sum();
            let static_n = self.train.static_force_n * (1.0 + self.load_sd.powi(2) * load);
            let low = &low_pass * &deviation;
            (0..grid_m.len()).map(|i| static_n + low[(i, 0)]).collect()
        });
        forces.collect()
    }

    /// Axles of the group, with the windows per whitened force deviation of the crossing side.
    fn axles(&self) -> impl Iterator<Item = (&Axle, MatRef<'_, f64>)> {
        let n = self.len();
        let axles = self.train.groups[self.group].axles.iter();
        axles.map(move |a| (&self.train.axles[*a], self.own.shaped[*a].subrows(0, n)))
    }

    /// Linear maps to the force of every axle, low-passed at `low_pass_hz` (brick wall), at positions `grid_m`.
    pub fn gains(&self, grid_m: &[f64], low_pass_hz: f64, common: &CommonProfile) -> Vec<AxleGain> {
        let low_pass = self.low_pass(grid_m, low_pass_hz);
        // Window per entry of the joint vector.
        let response = self.train.shapes.expanded_columns(self.train.response(self.group).as_ref());
        let gain = |(axle, shaped)| self.axle_gain(axle, shaped, &low_pass, &response, common);
        self.axles().map(gain).collect()
    }

    fn axle_gain(
        &self,
        axle: &Axle,
        shaped: MatRef<'_, f64>,
        low_pass: &Mat<f64>,
        response: &Mat<f64>,
        common: &CommonProfile,
    ) -> AxleGain {
        let which = usize::from(!axle.class.leading);
        let wheel = &self.train.wheel;
        let mean_n = &wheel.mean_n[which][0];
        let (m, n, g) = (mean_n.len(), self.len(), low_pass.nrows());
        let whitened = low_pass * &self.own.root_n[which];
        let load_variance = self.load_sd.powi(2);
        let static_force_n = self.train.static_force_n;
        // Covariance between the forces on the grid and the window.
        let mut cross = Mat::from_fn(g, n, |_, k| load_variance * static_force_n * axle.static_m_s2[k]);
        matmul(&mut cross, Accum::Add, &whitened, shaped.transpose(), 1.0, Par::Seq);
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
        let mut profile = match &wheel.basis {
            Basis::Full(contacts) => low_pass * &contacts[which][0],
            Basis::Splines([crossing, _]) => {
                let mut all = Mat::zeros(g, common.grids.len());
                add_parts(&mut all, &(low_pass * crossing), common, SIDES[0], axle.class);
                all
            }
        };
        matmul(&mut profile, Accum::Add, &gain, response, -1.0, Par::Seq);
        AxleGain { gain, base_n, sd_n, profile }
    }

    /// Brick-wall low-pass of the force samples, evaluated at the positions `grid_m`: band-limited interpolation.
    fn low_pass(&self, grid_m: &[f64], low_pass_hz: f64) -> Mat<f64> {
        let scale = 2.0 * low_pass_hz / self.rate_hz;
        let (wheel, running) = (&self.train.wheel, &self.train.running);
        let phase = |time_s: f64| std::f64::consts::TAU * low_pass_hz * time_s;
        let samples =
            (0..wheel.position_m.len()).map(|j| phase((wheel.first_sample + j as i64) as f64 / self.rate_hz));
        let samples: Vec<(f64, (f64, f64))> = samples.map(|p| (p, p.sin_cos())).collect();
        let places = grid_m.iter().map(|x| phase(running.direction * x / running.speed_m_s));
        let places: Vec<(f64, (f64, f64))> = places.map(|p| (p, p.sin_cos())).collect();
        Mat::from_fn(grid_m.len(), samples.len(), |i, j| {
            let ((place, (s, c)), (sample, (sample_s, sample_c))) = (places[i], samples[j]);
            let distance = place - sample;
            // The sine of the distance, by those of its ends: one for each row and column.
            scale * if distance.abs() < NEAR { 1.0 } else { (s * sample_c - c * sample_s) / distance }
        })
    }
}

/// Adds the forces per spline of one rail to all parts of the profile on it.
fn add_parts(
    target: &mut Mat<f64>,
    splines: &Mat<f64>,
    common: &CommonProfile,
    side: Side,
    class: WheelClass,
) {
    for (part, weight) in common.grids.parts_of(side, class) {
        for c in 0..splines.ncols() {
            add_scaled(target.col_mut(part.first + c), splines.col(c), weight);
        }
    }
}

/// covariance += scale · v vᵀ, lower triangle.
fn add_outer(covariance: &mut Mat<f64>, v: &[f64], scale: f64) {
    for j in 0..v.len() {
        for (c, value) in covariance.col_as_slice_mut(j)[j..].iter_mut().zip(&v[j..]) {
            *c += scale * value * v[j];
        }
    }
}

fn noise_covariance(prior: &Prior, len: usize, rate_hz: f64) -> Mat<f64> {
    let at_lag = |lag: usize| {
        let white = if lag == 0 { prior.noise_m_s2.powi(2) } else { 0.0 };
        let beyond = prior.beyond.map_or(0.0, |b| b.covariance(lag, rate_hz));
        prior.offset_sd_m_s2.powi(2) + white + beyond
    };
    let by_lag: Vec<f64> = (0..len).map(at_lag).collect();
    Mat::from_fn(len, len, |i, j| by_lag[i.abs_diff(j)])
}
