//! A train passing at a speed: all of the model of its windows that does not depend on the hyper-parameters of forces and
//! noise. Groups that begin with the same axles share what these do to the sensor.

use std::sync::{Arc, OnceLock};

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par};
use rayon::prelude::*;

use super::deviations::{Deviations, Latest};
use super::estimator::{Estimator, InverseError};
use super::hierarchy::GroupOffsets;
use super::prior::Prior;
use super::profile::{CommonProfile, Shapes, WheelClass, add_scaled};
use super::wheel::{Basis, Means, Running, SIDES, TrackModel, Wheel};
use crate::greens::moving::{PassingResponse, own_clock_kernel};

/// Time after the last wheel has left the reach during which its response is still used, seconds.
const DECAY_S: f64 = 0.03;
/// Axles this close to each other behind the first of their groups are the same, metres.
const SAME_OFFSET_M: f64 = 1e-6;

/// Groups of axles of a train at one speed.
pub struct Train {
    pub(super) running: Running,
    /// Static force of a wheel on the crossing rail, newtons.
    pub(super) static_force_n: f64,
    pub(super) rate_hz: f64,
    pub(super) wheel: Wheel,
    pub(super) shapes: Shapes,
    pub(super) axles: Vec<Axle>,
    pub(super) groups: Vec<Group>,
    latest: Latest,
}

/// One axle behind the first of a group.
pub(super) struct Axle {
    offset_m: f64,
    pub(super) class: WheelClass,
    /// Window per force on the wheel's clock, `[crossing, stock]`, of the longest group that has the axle.
    pub(super) kernels: [Mat<f64>; 2],
    /// Window of the wheel's static force.
    pub(super) static_m_s2: Vec<f64>,
}

/// What the window of a group is expected to show.
pub(super) struct Group {
    pub(super) window: Window,
    /// Of the train's.
    pub(super) axles: Vec<usize>,
    pub(super) expected_m_s2: Vec<f64>,
    pub(super) expected_slope_m_s3: Vec<f64>,
    /// Expected on the tracks close by.
    pub(super) moved_m_s2: Vec<Vec<f64>>,
    /// Window per amplitude of the profile's shapes; only what learns the profile needs it.
    response: OnceLock<Mat<f64>>,
}

impl Train {
    /// Of the given groups, and what they show on tracks close to that of `model`.
    pub fn new(
        model: &TrackModel,
        moved: &[TrackModel],
        running: Running,
        groups: &[&GroupOffsets],
        prior: &Prior,
        common: &CommonProfile,
    ) -> Result<Self, InverseError> {
        if !(running.speed_m_s.is_finite() && running.speed_m_s > 0.0) {
            return Err(InverseError::Speed(running.speed_m_s));
        }
        let rate_hz = model.greens.sampling.rate_hz;
        let windows: Vec<Window> =
            groups.iter().map(|g| Window::of(&running, &g.own, prior, rate_hz)).collect();
        let longest = windows.iter().copied().max_by_key(|w| w.len).unwrap_or_default();
        let wheel = Wheel::new(model, moved, &running, prior.half_m, common);
        let clock = (wheel.first_sample, wheel.position_m.as_slice());
        let expectation = Expectation::new(model, &running, longest.len, clock, &wheel.mean_n);
        let nearby: Vec<Expectation> = moved
            .iter()
            .zip(&wheel.moved_n)
            .map(|(m, mean_n)| Expectation::new(m, &running, longest.len, clock, mean_n))
            .collect();
        let mut train = Self {
            running,
            static_force_n: model.greens.load_factor[0] * running.static_force_n,
            rate_hz,
            wheel,
            shapes: common.grids.shapes(running.speed_m_s),
            axles: Vec::new(),
            groups: Vec::new(),
            latest: Latest::default(),
        };
        let axles = train.add_axles(model, &expectation.standing, groups, &windows, common);
        for ((offsets, window), axles) in groups.iter().zip(windows).zip(axles) {
            let classes = axles.iter().map(|a: &usize| train.axles[*a].class).collect();
            let group = Placed { window, running, offsets, classes, rate_hz };
            train.groups.push(Group {
                window,
                axles,
                expected_m_s2: expectation.window(&group),
                expected_slope_m_s3: expectation.sum(&group, PassingResponse::slope),
                moved_m_s2: nearby.iter().map(|e| e.window(&group)).collect(),
                response: OnceLock::new(),
            });
        }
        Ok(train)
    }

    /// Adds the axles of all groups; returns their indices.
    fn add_axles(
        &mut self,
        model: &TrackModel,
        standing: &PassingResponse,
        groups: &[&GroupOffsets],
        windows: &[Window],
        common: &CommonProfile,
    ) -> Vec<Vec<usize>> {
        // The longest group first: its axles serve the others.
        let mut order: Vec<usize> = (0..groups.len()).collect();
        order.sort_by_key(|g| std::cmp::Reverse(windows[*g].len));
        let mut out = vec![Vec::new(); groups.len()];
        for g in order {
            for (i, offset_m) in groups[g].own.iter().enumerate() {
                let class = common.grids.class(self.running.speed_m_s, i);
                out[g].push(self.axle(model, standing, windows[g], *offset_m, class));
            }
        }
        out
    }

    /// Index of the axle at an offset, which is added if it is not there yet.
    fn axle(
        &mut self,
        model: &TrackModel,
        standing: &PassingResponse,
        window: Window,
        offset_m: f64,
        class: WheelClass,
    ) -> usize {
        let same =
            |a: &Axle| (a.offset_m - offset_m).abs() < SAME_OFFSET_M && a.class.leading == class.leading;
        if let Some(known) = self.axles.iter().position(same) {
            return known;
        }
        let time_s = window.time_at_origin_s(offset_m, &self.running, self.rate_hz);
        let samples = time_s * self.rate_hz;
        let whole = samples.floor();
        let reach_m = self.wheel.position_m.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
        let greens = model.greens.delayed(samples - whole, reach_m);
        let first = self.wheel.first_sample + whole as i64;
        let kernels =
            SIDES.map(|side| own_clock_kernel(&greens, side, &self.wheel.position_m, first, window.len));
        let static_m_s2 = standing.window(&[time_s], window.len);
        self.axles.push(Axle { offset_m, class, kernels, static_m_s2 });
        self.axles.len() - 1
    }

    /// Window of a group per amplitude of the profile's shapes, window length × columns of the shapes, m/s² per unit.
    pub(super) fn response(&self, group: usize) -> &Mat<f64> {
        self.groups[group].response.get_or_init(|| self.response_of(&self.groups[group]))
    }

    fn response_of(&self, group: &Group) -> Mat<f64> {
        let len = group.window.len;
        let mut out = Mat::zeros(len, self.shapes.len());
        for axle in group.axles.iter().map(|a| &self.axles[*a]) {
            for (rail, side) in SIDES.into_iter().enumerate() {
                let kernel = axle.kernels[rail].subrows(0, len);
                match &self.wheel.basis {
                    Basis::Full(contacts) => {
                        let basis = &contacts[usize::from(!axle.class.leading)][rail];
                        matmul(out.as_mut(), Accum::Add, kernel, basis, 1.0, Par::Seq);
                    }
                    Basis::Splines(splines) => {
                        let response = times_sparse(kernel, &splines[rail]);
                        for (column, sign) in self.shapes.of(side, axle.class.leading) {
                            for c in 0..response.ncols() {
                                add_scaled(out.col_mut(column + c), response.col(c), sign);
                            }
                        }
                    }
                }
            }
        }
        out
    }

    /// Estimators of all groups under a prior.
    pub fn estimators(self: &Arc<Self>, prior: &Prior) -> Result<Vec<Estimator>, InverseError> {
        let own = self.deviations(prior)?;
        (0..self.groups.len()).into_par_iter().map(|g| Estimator::of_group(self, g, prior, &own)).collect()
    }

    /// How the wheels deviate under a prior, `[crossing, stock]`.
    pub(super) fn deviations(&self, prior: &Prior) -> Result<[Arc<Deviations>; 2], InverseError> {
        let bad = || InverseError::Covariance {
            len: self.groups.iter().map(|g| g.window.len).max().unwrap_or(0),
            noise_m_s2: prior.noise_m_s2,
        };
        self.latest.under(prior, &self.wheel, &self.axles).ok_or_else(bad)
    }
}

/// Product with a matrix of mostly zeros: four splines meet at a position.
fn times_sparse(matrix: MatRef<'_, f64>, sparse: &Mat<f64>) -> Mat<f64> {
    let mut out = Mat::zeros(matrix.nrows(), sparse.ncols());
    for c in 0..sparse.ncols() {
        for (j, value) in sparse.col_as_slice(c).iter().enumerate() {
            add_scaled(out.col_mut(c), matrix.col(j), *value);
        }
    }
    out
}

/// Extent of the window of a group.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Window {
    /// Samples before the moment at which the group's first axle is at x = 0.
    pub(super) before: usize,
    pub(super) len: usize,
}

impl Window {
    /// While any wheel of the group is within the window reach, and the decay after. The forces are unknown over a longer
    /// stretch than that, so that what the window holds is never blamed on too few of them.
    fn of(running: &Running, axle_offset_m: &[f64], prior: &Prior, rate_hz: f64) -> Self {
        let speed = running.speed_m_s;
        let reach_s = prior.window_m / speed;
        let before = (reach_s * rate_hz).ceil() as usize;
        let last = axle_offset_m.last().copied().unwrap_or(0.0);
        let after = (last / speed + reach_s + DECAY_S) * rate_hz;
        Self { before, len: before + after.ceil() as usize + 1 }
    }

    fn time_at_origin_s(&self, offset_m: f64, running: &Running, rate_hz: f64) -> f64 {
        self.before as f64 / rate_hz + offset_m / running.speed_m_s
    }
}

/// Response to passing wheels under the mean forces.
struct Expectation {
    /// Static force only.
    standing: PassingResponse,
    /// Leading and trailing wheels of bogies with their mean deviations.
    running: [PassingResponse; 2],
}

impl Expectation {
    /// Of mean deviations on a wheel's own clock, from sample `first` on, for windows of up to `len` samples.
    fn new(
        model: &TrackModel,
        running: &Running,
        len: usize,
        (first, position_m): (i64, &[f64]),
        mean_n: &Means,
    ) -> Self {
        let Running { direction, speed_m_s, static_force_n } = *running;
        let standing = PassingResponse::of_constant(model.greens, direction, speed_m_s, len, static_force_n);
        let running = mean_n
            .each_ref()
            .map(|[crossing, stock]| standing.with(model.greens, first, position_m, [crossing, stock]));
        Self { standing, running }
    }

    fn window(&self, group: &Placed) -> Vec<f64> {
        self.sum(group, PassingResponse::window)
    }

    /// Static forces of the whole train, mean deviations of the group's own axles.
    fn sum(&self, group: &Placed, of: fn(&PassingResponse, &[f64], usize) -> Vec<f64>) -> Vec<f64> {
        let len = group.window.len;
        let time = |o: &f64| group.window.time_at_origin_s(*o, &group.running, group.rate_hz);
        let own = &group.offsets.own;
        let others: Vec<f64> = group.offsets.train.iter().filter(|o| !own.contains(o)).map(time).collect();
        let mut sum = of(&self.standing, &others, len);
        for (which, response) in self.running.iter().enumerate() {
            let times: Vec<f64> = own
                .iter()
                .zip(&group.classes)
                .filter(|(_, class)| usize::from(!class.leading) == which)
                .map(|(o, _)| time(o))
                .collect();
            for (s, r) in sum.iter_mut().zip(of(response, &times, len)) {
                *s += r;
            }
        }
        sum
    }
}

/// A group over its window.
struct Placed<'a> {
    window: Window,
    running: Running,
    offsets: &'a GroupOffsets,
    classes: Vec<WheelClass>,
    rate_hz: f64,
}
