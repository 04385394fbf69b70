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

    /// Interval and relative position in it for linear interpolation; `None` outside.
    pub fn locate(&self, x_m: f64) -> Option<(usize, f64)> {
        let p = (x_m - self.first_m) / self.step_m;
        if self.len < 2 || !(p >= 0.0 && p <= (self.len - 1) as f64) {
            return None;
        }
        let i = (p as usize).min(self.len - 2);
        Some((i, p - i as f64))
    }
}

/// Grids of the common profile on both rails.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProfileGrids {
    /// Crossing side.
    pub crossing: PositionGrid,
    /// Stock side.
    pub stock: PositionGrid,
}

impl ProfileGrids {
    /// Points of both grids together.
    pub fn len(&self) -> usize {
        self.crossing.len + self.stock.len
    }

    /// Never: a grid has at least two points.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Grid and index of its first point in the joint vector (crossing side first).
    pub fn part(&self, side: Side) -> (PositionGrid, usize) {
        match side {
            Side::Crossing => (self.crossing, 0),
            Side::Stock => (self.stock, self.crossing.len),
        }
    }

    /// Prior covariance of the joint vector, N².
    pub fn prior_covariance(&self, prior: &Prior) -> Mat<f64> {
        let mut out = Mat::zeros(self.len(), self.len());
        for side in [Side::Crossing, Side::Stock] {
            let (grid, first) = self.part(side);
            let positions: Vec<f64> = (0..grid.len).map(|i| grid.position_m(i)).collect();
            let sd: Vec<f64> = positions
                .iter()
                .map(|x| match side {
                    Side::Crossing => prior.crossing_sd_n(&prior.common, *x),
                    Side::Stock => prior.common.stock_n,
                })
                .collect();
            let part = prior.covariance(&positions, &sd, grid.step_m / prior.correlation_m);
            out.submatrix_mut(first, first, grid.len, grid.len).copy_from(&part);
        }
        out
    }
}

/// Values on [`ProfileGrids`].
#[derive(Clone, Debug, PartialEq)]
pub struct CommonProfile {
    /// Positions.
    pub grids: ProfileGrids,
    /// Force deviation f − Q, newtons, crossing side first.
    pub deviation_n: Vec<f64>,
}

impl CommonProfile {
    /// No deviation anywhere.
    pub fn zero(grids: ProfileGrids) -> Self {
        Self { grids, deviation_n: vec![0.0; grids.len()] }
    }

    /// Deviation at `x_m`, newtons; zero outside the grid.
    pub fn at(&self, side: Side, x_m: f64) -> f64 {
        let (grid, first) = self.grids.part(side);
        grid.locate(x_m).map_or(0.0, |(i, part)| {
            self.deviation_n[first + i] * (1.0 - part) + self.deviation_n[first + i + 1] * part
        })
    }
}
