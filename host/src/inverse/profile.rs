//! Force deviation along the track that all wheels of a site share.

use faer::Mat;

use super::prior::Prior;
use crate::track::Side;

/// Equidistant positions along the track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionGrid {
    /// First position x, metres.
    pub first_m: f64,
    /// Step, metres.
    pub step_m: f64,
    /// Number of positions.
    pub len: usize,
}

impl PositionGrid {
    /// Symmetric grid covering ±`half_m` with about `step_m`.
    pub fn covering(half_m: f64, step_m: f64) -> Self {
        let parts = (2.0 * half_m / step_m).round().max(1.0) as usize;
        Self { first_m: -half_m, step_m: 2.0 * half_m / parts as f64, len: parts + 1 }
    }

    /// Position of point `i`, metres.
    pub fn position_m(&self, i: usize) -> f64 {
        self.first_m + i as f64 * self.step_m
    }

    /// Cubic B-splines that are not zero at `x_m`, with their values; those beyond the ends of the grid are left out.
    fn splines(&self, x_m: f64) -> impl Iterator<Item = (usize, f64)> {
        let p = (x_m - self.first_m) / self.step_m;
        let inside = p >= 0.0 && p <= (self.len.max(1) - 1) as f64;
        let (i, t) = (p.floor() as i64, p - p.floor());
        let u = 1.0 - t;
        let values = [
            u * u * u / 6.0,
            (3.0 * t * t * t - 6.0 * t * t + 4.0) / 6.0,
            (3.0 * u * u * u - 6.0 * u * u + 4.0) / 6.0,
            t * t * t / 6.0,
        ];
        let len = self.len as i64;
        (0..4usize)
            .map(move |k| (i - 1 + k as i64, values[k]))
            .filter(move |(index, _)| inside && *index >= 0 && *index < len)
            .map(|(index, value)| (index as usize, value))
    }
}

/// How a part of the common profile enters the force of a wheel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Regressor {
    /// The same for all wheels.
    Constant,
    /// In proportion to the speed relative to the site's mean, per [`SPEED_UNIT`].
    Speed,
    /// With opposite sign for the leading and the trailing wheel of a bogie.
    Lead,
}

/// Relative speed difference at which the speed part has its full size.
pub const SPEED_UNIT: f64 = 0.05;

/// What distinguishes one wheel from another as far as the common profile goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WheelClass {
    /// Speed relative to the site's mean, in [`SPEED_UNIT`].
    pub speed: f64,
    /// +1 for the leading, -1 for the trailing wheel of a bogie.
    pub lead: f64,
}

impl WheelClass {
    /// Class of an axle, counted from the front of its group (whole bogies), at a speed.
    pub fn new(speed_m_s: f64, mean_speed_m_s: f64, axle: usize) -> Self {
        Self {
            speed: (speed_m_s / mean_speed_m_s - 1.0) / SPEED_UNIT,
            lead: if axle.is_multiple_of(2) { 1.0 } else { -1.0 },
        }
    }

    fn weight(&self, regressor: Regressor) -> f64 {
        match regressor {
            Regressor::Constant => 1.0,
            Regressor::Speed => self.speed,
            Regressor::Lead => self.lead,
        }
    }
}

/// One part of the common profile: cubic B-splines on a grid, multiplied by a regressor.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Part {
    side: Side,
    regressor: Regressor,
    grid: PositionGrid,
    first: usize,
    /// Prior standard deviation relative to that of the constant part.
    scale: f64,
}

/// Layout of the common profile's spline coefficients in one joint vector.
#[derive(Clone, Debug, PartialEq)]
pub struct ProfileGrids {
    parts: Vec<Part>,
    /// Speed at which the speed part vanishes, m/s.
    pub mean_speed_m_s: f64,
}

/// Size of the speed and the lead parts relative to the constant part.
const SPEED_SCALE: f64 = 0.25;
const LEAD_SCALE: f64 = 0.1;

impl ProfileGrids {
    /// Constant, speed and lead parts on the crossing side; constant and speed parts on the stock side.
    pub fn new(half_m: f64, crossing_step_m: f64, stock_step_m: f64, mean_speed_m_s: f64) -> Self {
        let wanted = [
            (Side::Crossing, Regressor::Constant, crossing_step_m, 1.0),
            (Side::Crossing, Regressor::Speed, crossing_step_m, SPEED_SCALE),
            (Side::Crossing, Regressor::Lead, crossing_step_m, LEAD_SCALE),
            (Side::Stock, Regressor::Constant, stock_step_m, 1.0),
            (Side::Stock, Regressor::Speed, stock_step_m, SPEED_SCALE),
        ];
        let mut first = 0;
        let parts = wanted
            .map(|(side, regressor, step_m, scale)| {
                let grid = PositionGrid::covering(half_m, step_m);
                let part = Part { side, regressor, grid, first, scale };
                first += grid.len;
                part
            })
            .to_vec();
        Self { parts, mean_speed_m_s }
    }

    /// Length of the joint vector.
    pub fn len(&self) -> usize {
        self.parts.iter().map(|p| p.grid.len).sum()
    }

    /// Never: a grid has at least two points.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Entries of the joint vector that make up the deviation of a wheel at `x_m`, with their weights.
    pub fn entries(
        &self,
        side: Side,
        x_m: f64,
        class: WheelClass,
    ) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.parts.iter().filter(move |p| p.side == side).flat_map(move |p| {
            let weight = class.weight(p.regressor);
            p.grid
                .splines(x_m)
                .map(move |(i, value)| (p.first + i, weight * value))
                .filter(|(_, w)| *w != 0.0)
        })
    }

    /// Prior covariance of the joint vector, N².
    pub fn prior_covariance(&self, prior: &Prior) -> Mat<f64> {
        let mut out = Mat::zeros(self.len(), self.len());
        for p in &self.parts {
            let positions: Vec<f64> = (0..p.grid.len).map(|i| p.grid.position_m(i)).collect();
            let sd: Vec<f64> = positions
                .iter()
                .map(|x| match p.side {
                    Side::Crossing => p.scale * prior.crossing_sd_n(&prior.common, *x),
                    Side::Stock => p.scale * prior.common.stock_n,
                })
                .collect();
            let block = prior.covariance(&positions, &sd, p.grid.step_m / prior.correlation_m);
            out.submatrix_mut(p.first, p.first, p.grid.len, p.grid.len).copy_from(&block);
        }
        out
    }
}

/// Values on [`ProfileGrids`].
#[derive(Clone, Debug, PartialEq)]
pub struct CommonProfile {
    /// Layout.
    pub grids: ProfileGrids,
    /// Joint vector of force deviations f − Q, newtons.
    pub deviation_n: Vec<f64>,
}

impl CommonProfile {
    /// No deviation anywhere.
    pub fn zero(grids: ProfileGrids) -> Self {
        let deviation_n = vec![0.0; grids.len()];
        Self { grids, deviation_n }
    }

    /// Deviation of a wheel at `x_m`, newtons; zero outside the grid.
    pub fn at(&self, side: Side, x_m: f64, class: WheelClass) -> f64 {
        self.grids.entries(side, x_m, class).map(|(i, weight)| weight * self.deviation_n[i]).sum()
    }
}
