//! Irregularity along the track that all wheels of a site share.

use faer::Mat;

use super::prior::{Prior, matern_at};
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

/// One part of the common profile: cubic B-splines on a grid.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Part {
    side: Side,
    grid: PositionGrid,
    first: usize,
}

/// Layout of the common profile's spline coefficients in one joint vector.
#[derive(Clone, Debug, PartialEq)]
pub struct ProfileGrids {
    parts: [Part; 2],
}

impl ProfileGrids {
    /// Grids on both rails within `half_m` of x = 0.
    pub fn new(half_m: f64, crossing_step_m: f64, stock_step_m: f64) -> Self {
        let crossing = PositionGrid::covering(half_m, crossing_step_m);
        let stock = PositionGrid::covering(half_m, stock_step_m);
        Self {
            parts: [
                Part { side: Side::Crossing, grid: crossing, first: 0 },
                Part { side: Side::Stock, grid: stock, first: crossing.len },
            ],
        }
    }

    /// Length of the joint vector.
    pub fn len(&self) -> usize {
        self.parts.iter().map(|p| p.grid.len).sum()
    }

    /// Never: a grid has at least two points.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Entries of the joint vector that make up the irregularity at `x_m`, with their weights.
    pub fn entries(&self, side: Side, x_m: f64) -> impl Iterator<Item = (usize, f64)> + '_ {
        let part = self.parts.iter().filter(move |p| p.side == side);
        part.flat_map(move |p| p.grid.splines(x_m).map(move |(i, value)| (p.first + i, value)))
    }

    /// Prior covariance of the joint vector, m².
    pub fn prior_covariance(&self, prior: &Prior) -> Mat<f64> {
        let mut out = Mat::zeros(self.len(), self.len());
        for p in &self.parts {
            let sd = |i: usize| prior.irregularity_sd_m(p.side, p.grid.position_m(i));
            for i in 0..p.grid.len {
                for j in 0..p.grid.len {
                    let correlation = matern_at(i.abs_diff(j), p.grid.step_m / prior.correlation_m);
                    out[(p.first + i, p.first + j)] = sd(i) * sd(j) * correlation;
                }
                out[(p.first + i, p.first + i)] += 1e-9 * sd(i).powi(2);
            }
        }
        out
    }
}

/// Irregularity that all wheels of a site share, on [`ProfileGrids`].
#[derive(Clone, Debug, PartialEq)]
pub struct CommonProfile {
    /// Layout.
    pub grids: ProfileGrids,
    /// Joint vector of irregularities, metres, positive down.
    pub irregularity_m: Vec<f64>,
}

impl CommonProfile {
    /// Smooth rails.
    pub fn zero(grids: ProfileGrids) -> Self {
        let irregularity_m = vec![0.0; grids.len()];
        Self { grids, irregularity_m }
    }

    /// Irregularity at `x_m`, metres; zero outside the grid.
    pub fn at(&self, side: Side, x_m: f64) -> f64 {
        self.grids.entries(side, x_m).map(|(i, weight)| weight * self.irregularity_m[i]).sum()
    }
}
