//! Profile along the track that all wheels of a site share: an irregularity, or a force deviation.

use faer::{ColMut, ColRef, Mat, MatRef, unzip, zip};

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
    pub fn splines(&self, x_m: f64) -> impl Iterator<Item = (usize, f64)> {
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

    /// Values of the splines at positions: positions × grid points.
    pub fn basis(&self, position_m: &[f64]) -> Mat<f64> {
        let mut out = Mat::zeros(position_m.len(), self.len);
        for (row, x) in position_m.iter().enumerate() {
            for (i, value) in self.splines(*x) {
                out[(row, i)] = value;
            }
        }
        out
    }
}

/// How a part of the common profile enters a wheel.
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
    /// Speed relative to the site's mean, in steps of 5 %.
    pub speed: f64,
    /// Leading wheel of its bogie.
    pub leading: bool,
}

impl WheelClass {
    fn weight(&self, regressor: Regressor) -> f64 {
        match regressor {
            Regressor::Constant => 1.0,
            Regressor::Speed => self.speed,
            Regressor::Lead if self.leading => 1.0,
            Regressor::Lead => -1.0,
        }
    }
}

/// One part of the common profile: splines on the grid of a side, multiplied by a regressor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// Rail.
    pub side: Side,
    /// Regressor.
    pub regressor: Regressor,
    /// First entry in the joint vector.
    pub first: usize,
    /// Prior standard deviation relative to that of the constant part.
    scale: f64,
}

/// Layout of the common profile's spline coefficients in one joint vector.
#[derive(Clone, Debug, PartialEq)]
pub struct ProfileGrids {
    /// Grid of the crossing side.
    pub crossing: PositionGrid,
    /// Grid of the stock side.
    pub stock: PositionGrid,
    /// Parts of the joint vector.
    pub parts: Vec<Part>,
    /// Speed at which the speed parts vanish, m/s.
    pub mean_speed_m_s: f64,
    kind: Kind,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Irregularity,
    Force,
}

/// Size of the speed and the lead parts relative to the constant part: an oscillation that the impact sets off keeps its
/// frequency, so a quarter of a wave behind it 5 % of speed change it by 8 %, two waves behind by half its size; on soft pads
/// the trailing wheel finds the rail still moving by a fifth.
const SPEED_SCALE: f64 = 0.5;
const LEAD_SCALE: f64 = 0.2;

impl ProfileGrids {
    /// Irregularity on both rails within `half_m` of x = 0.
    pub fn irregularity(half_m: f64, crossing_step_m: f64, stock_step_m: f64) -> Self {
        let parts = [(Side::Crossing, Regressor::Constant, 1.0), (Side::Stock, Regressor::Constant, 1.0)];
        Self::with_parts(half_m, crossing_step_m, stock_step_m, &parts, 1.0, Kind::Irregularity)
    }

    /// Force deviation on both rails: what an irregularity makes of it depends on the speed, and the trailing wheel
    /// of a bogie meets a track that the leading one has set in motion.
    pub fn force(half_m: f64, crossing_step_m: f64, stock_step_m: f64, mean_speed_m_s: f64) -> Self {
        let parts = [
            (Side::Crossing, Regressor::Constant, 1.0),
            (Side::Crossing, Regressor::Speed, SPEED_SCALE),
            (Side::Crossing, Regressor::Lead, LEAD_SCALE),
            (Side::Stock, Regressor::Constant, 1.0),
            (Side::Stock, Regressor::Speed, SPEED_SCALE),
        ];
        Self::with_parts(half_m, crossing_step_m, stock_step_m, &parts, mean_speed_m_s, Kind::Force)
    }

    fn with_parts(
        half_m: f64,
        crossing_step_m: f64,
        stock_step_m: f64,
        parts: &[(Side, Regressor, f64)],
        mean_speed_m_s: f64,
        kind: Kind,
    ) -> Self {
        let crossing = PositionGrid::covering(half_m, crossing_step_m);
        let stock = PositionGrid::covering(half_m, stock_step_m);
        let mut first = 0;
        let parts = parts
            .iter()
            .map(|(side, regressor, scale)| {
                let part = Part { side: *side, regressor: *regressor, first, scale: *scale };
                first += if *side == Side::Crossing { crossing.len } else { stock.len };
                part
            })
            .collect();
        Self { crossing, stock, parts, mean_speed_m_s, kind }
    }

    /// Grid of a side.
    pub fn grid(&self, side: Side) -> &PositionGrid {
        if side == Side::Crossing { &self.crossing } else { &self.stock }
    }

    /// Length of the joint vector.
    pub fn len(&self) -> usize {
        self.parts.iter().map(|p| self.grid(p.side).len).sum()
    }

    /// Never: a grid has at least two points.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Class of a wheel: axle counted from the front of its group (whole bogies), at a speed.
    pub fn class(&self, speed_m_s: f64, axle: usize) -> WheelClass {
        WheelClass {
            speed: (speed_m_s / self.mean_speed_m_s - 1.0) / SPEED_UNIT,
            leading: axle.is_multiple_of(2),
        }
    }

    /// Parts of one side with their weights for a class of wheels.
    pub fn parts_of(&self, side: Side, class: WheelClass) -> impl Iterator<Item = (&Part, f64)> {
        self.parts.iter().filter(move |p| p.side == side).map(move |p| (p, class.weight(p.regressor)))
    }

    /// What a train at one speed can tell apart of the profile.
    pub fn shapes(&self, speed_m_s: f64) -> Shapes {
        let speed = self.class(speed_m_s, 0).speed;
        let mut out = Shapes { shapes: Vec::new(), spans: Vec::new(), len: 0 };
        for part in &self.parts {
            let (odd, scale) = match part.regressor {
                Regressor::Constant => (false, 1.0),
                Regressor::Speed => (false, speed),
                Regressor::Lead => (true, 1.0),
            };
            let len = self.grid(part.side).len;
            let column = out.column(part.side, odd, len);
            out.spans.push(Span { first: part.first, len, column, scale });
        }
        out
    }

    /// Prior covariance of the entries of every part, unit of the profile squared, in the order of the joint vector; the
    /// parts are independent of each other.
    pub fn prior_covariances(&self, prior: &Prior) -> Vec<Mat<f64>> {
        let of = |p: &Part| {
            let grid = self.grid(p.side);
            let positions: Vec<f64> = (0..grid.len).map(|i| grid.position_m(i)).collect();
            let sd: Vec<f64> = positions.iter().map(|x| p.scale * prior.common_sd(p.side, *x)).collect();
            let step = grid.step_m / prior.correlation_m;
            let mut block = match self.kind {
                Kind::Force => prior.covariance(&positions, &sd, step),
                Kind::Irregularity => {
                    let long: Vec<f64> = positions.iter().map(|x| prior.dip_sd_m(p.side, *x)).collect();
                    let long_step = grid.step_m / prior.dip_correlation_m;
                    Mat::from_fn(grid.len, grid.len, |i, j| {
                        sd[i] * sd[j] * matern_at(i.abs_diff(j), step)
                            + long[i] * long[j] * matern_at(i.abs_diff(j), long_step)
                    })
                }
            };
            for i in 0..grid.len {
                block[(i, i)] += 1e-9 * sd[i].powi(2);
            }
            block
        };
        self.parts.iter().map(of).collect()
    }
}

/// Shapes of the common profile that a train at one speed can tell apart: the speed part acts there like the constant one,
/// times a number that all wheels share. Responses have a column per entry of a shape, so they and their products are
/// smaller than the joint vector would make them.
#[derive(Clone, Debug)]
pub struct Shapes {
    shapes: Vec<Shape>,
    spans: Vec<Span>,
    len: usize,
}

/// Same force under all wheels of a rail, or with opposite sign under leading and trailing ones.
#[derive(Clone, Copy, Debug)]
struct Shape {
    side: Side,
    odd: bool,
    column: usize,
}

/// Entries of the joint vector, from `first` on, that act as `scale` times the columns of a shape.
#[derive(Clone, Copy, Debug)]
struct Span {
    first: usize,
    len: usize,
    column: usize,
    scale: f64,
}

impl Shapes {
    /// First column of a shape, which is added if there is none like it.
    fn column(&mut self, side: Side, odd: bool, len: usize) -> usize {
        if let Some(known) = self.shapes.iter().find(|s| s.side == side && s.odd == odd) {
            return known.column;
        }
        let column = self.len;
        self.shapes.push(Shape { side, odd, column });
        self.len += len;
        column
    }

    /// Number of columns.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Never: a profile has at least one part.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// First columns of the shapes of a rail, with their sign under a leading or a trailing wheel.
    pub fn of(&self, side: Side, leading: bool) -> impl Iterator<Item = (usize, f64)> {
        self.shapes
            .iter()
            .filter(move |s| s.side == side)
            .map(move |s| (s.column, if s.odd && !leading { -1.0 } else { 1.0 }))
    }

    /// Amplitudes of the shapes' columns for values of the joint vector.
    pub fn amplitudes(&self, value: &[f64]) -> Mat<f64> {
        let mut out = Mat::zeros(self.len, 1);
        for span in &self.spans {
            for i in 0..span.len {
                out[(span.column + i, 0)] += span.scale * value[span.first + i];
            }
        }
        out
    }

    /// Columns of the joint vector from those of the shapes; columns beyond them follow as they are.
    pub fn expanded_columns(&self, columns: MatRef<'_, f64>) -> Mat<f64> {
        let entries: usize = self.spans.iter().map(|s| s.len).sum();
        let more = columns.ncols() - self.len;
        let mut out = Mat::zeros(columns.nrows(), entries + more);
        for span in &self.spans {
            for i in 0..span.len {
                add_scaled(out.col_mut(span.first + i), columns.col(span.column + i), span.scale);
            }
        }
        out.subcols_mut(entries, more).copy_from(columns.subcols(self.len, more));
        out
    }

    /// Adds a symmetric matrix over the shapes' columns, and those beyond them, to one over the joint vector.
    pub fn add_expanded(&self, target: &mut Mat<f64>, symmetric: &Mat<f64>) {
        let entries: usize = self.spans.iter().map(|s| s.len).sum();
        let more = symmetric.ncols() - self.len;
        let beyond = Span { first: entries, len: more, column: self.len, scale: 1.0 };
        let spans = || self.spans.iter().chain([&beyond]).copied().collect::<Vec<_>>();
        for across in spans() {
            for down in spans() {
                for j in 0..across.len {
                    let from = symmetric.col(across.column + j).subrows(down.column, down.len);
                    let to = target.col_mut(across.first + j).subrows_mut(down.first, down.len);
                    add_scaled(to, from, across.scale * down.scale);
                }
            }
        }
    }
}

/// target += scale · column
pub(super) fn add_scaled(target: ColMut<'_, f64>, column: ColRef<'_, f64>, scale: f64) {
    if scale != 0.0 {
        zip!(target, column).for_each(|unzip!(t, c)| *t += scale * *c);
    }
}

/// Profile that all wheels of a site share, on [`ProfileGrids`].
#[derive(Clone, Debug, PartialEq)]
pub struct CommonProfile {
    /// Layout.
    pub grids: ProfileGrids,
    /// Joint vector of spline coefficients: irregularities in metres, positive down, or force deviations in newtons.
    pub value: Vec<f64>,
}

impl CommonProfile {
    /// Zero everywhere.
    pub fn zero(grids: ProfileGrids) -> Self {
        let value = vec![0.0; grids.len()];
        Self { grids, value }
    }

    /// Spline coefficients of one side for a class of wheels.
    pub fn coefficients(&self, side: Side, class: WheelClass) -> Vec<f64> {
        let mut out = vec![0.0; self.grids.grid(side).len];
        for (part, weight) in self.grids.parts_of(side, class) {
            for (o, v) in out.iter_mut().zip(&self.value[part.first..]) {
                *o += weight * v;
            }
        }
        out
    }

    /// Values at positions under the wheels of a bogie at a speed, one column per contact; zero outside the grid.
    pub fn values_at(&self, position_m: &[f64], speed_m_s: f64) -> [[Mat<f64>; 2]; 2] {
        [0, 1].map(|axle: usize| {
            let class = self.grids.class(speed_m_s, axle);
            [Side::Crossing, Side::Stock].map(|side| {
                let grid = self.grids.grid(side);
                let coefficients = self.coefficients(side, class);
                let at = |x: f64| grid.splines(x).map(|(i, weight)| weight * coefficients[i]).sum();
                Mat::from_fn(position_m.len(), 1, |i, _| at(position_m[i]))
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn matrix(rows: usize, columns: usize) -> Mat<f64> {
        Mat::from_fn(rows, columns, |i, j| ((3 * i + 7 * j) as f64).sin() + 0.1 * i as f64)
    }

    /// Columns that are no part of the profile.
    const BEYOND: usize = 2;

    #[test]
    fn property_shapes_respond_like_the_parts_they_stand_for() {
        let grids = ProfileGrids::force(2.0, 0.1, 0.2, 44.0);
        let shapes = grids.shapes(46.0);
        let value: Vec<f64> = (0..grids.len()).map(|i| (i as f64).cos()).collect();
        let amplitudes = shapes.amplitudes(&value);
        for (side, axle) in [(Side::Crossing, 0), (Side::Crossing, 1), (Side::Stock, 0), (Side::Stock, 1)] {
            let class = grids.class(46.0, axle);
            let len = grids.grid(side).len;
            let response = matrix(3, len);
            let by = |entry: &dyn Fn(usize) -> f64| &response * Mat::from_fn(len, 1, |i, _| entry(i));
            let mut of_parts = Mat::<f64>::zeros(3, 1);
            for (part, weight) in grids.parts_of(side, class) {
                of_parts += by(&|i| weight * value[part.first + i]);
            }
            let mut of_shapes = Mat::<f64>::zeros(3, 1);
            for (column, sign) in shapes.of(side, class.leading) {
                of_shapes += by(&|i| sign * amplitudes[(column + i, 0)]);
            }
            assert!((of_parts - of_shapes).norm_max() < 1e-12);
        }
    }

    #[test]
    fn property_expanded_matrices_act_like_those_of_the_shapes() {
        let grids = ProfileGrids::force(2.0, 0.1, 0.2, 44.0);
        let shapes = grids.shapes(46.0);
        let value: Vec<f64> = (0..grids.len() + BEYOND).map(|i| (i as f64).cos()).collect();
        let short = shapes.amplitudes(&value);
        let short = Mat::from_fn(shapes.len() + BEYOND, 1, |i, _| match i.checked_sub(shapes.len()) {
            Some(beyond) => value[grids.len() + beyond],
            None => short[(i, 0)],
        });
        let long = Mat::from_fn(value.len(), 1, |i, _| value[i]);
        let columns = matrix(4, shapes.len() + BEYOND);
        let expanded = shapes.expanded_columns(columns.as_ref());
        assert!((&expanded * &long - &columns * &short).norm_max() < 1e-10);
        let symmetric = columns.transpose() * &columns;
        let mut sum = Mat::zeros(value.len(), value.len());
        shapes.add_expanded(&mut sum, &symmetric);
        assert!((&sum * &long - expanded.transpose() * (&columns * &short)).norm_max() < 1e-9);
    }
}
