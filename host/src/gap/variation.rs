//! How wheels of the same train differ from one another: what no model of the panel can know.
//!
//! The covariance of a bogie's window is a sum of parts with known shape and unknown size: load of a wheelset, share of
//! its two sides, depth and shift of its path through the crossing, its own irregularity, noise. The sizes follow from
//! the scatter of the bogies of each train about their mean, which holds no error that the bogies share.

use faer::Mat;
use faer::linalg::solvers::Llt;

use super::linear::BogieResponses;
use super::splines::PathSplines;
use super::world::Path;
use crate::track::Side;

/// Sizes (standard deviations) of the parts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Variation {
    /// Noise of a window sample, m/s².
    pub noise_m_s2: f64,
    /// Static force of a wheelset, relative.
    pub load: f64,
    /// Share of its crossing side, relative.
    pub side_load: f64,
    /// Depth of the path through the crossing, relative.
    pub depth: f64,
    /// Shift of that path, metres.
    pub shift_m: f64,
    /// Irregularity of each wheel on the crossing side, metres.
    pub own_m: f64,
    /// The same on the stock side, metres.
    pub own_stock_m: f64,
}

/// Number of parts.
const PARTS: usize = 7;

impl Variation {
    /// Starting values; ranges keep the search physical.
    const START: Self = Self {
        noise_m_s2: 0.05,
        load: 0.01,
        side_load: 0.005,
        depth: 0.03,
        shift_m: 0.005,
        own_m: 3e-6,
        own_stock_m: 1e-6,
    };
    const RANGE: [[f64; 2]; PARTS] =
        [[0.01, 2.0], [1e-3, 0.1], [1e-3, 0.05], [1e-3, 0.3], [1e-3, 0.1], [1e-7, 3e-4], [1e-7, 1e-3]];

    fn values(&self) -> [f64; PARTS] {
        [self.noise_m_s2, self.load, self.side_load, self.depth, self.shift_m, self.own_m, self.own_stock_m]
    }

    fn of_values(v: [f64; PARTS]) -> Self {
        Self {
            noise_m_s2: v[0],
            load: v[1],
            side_load: v[2],
            depth: v[3],
            shift_m: v[4],
            own_m: v[5],
            own_stock_m: v[6],
        }
    }
}

/// Shapes of the parts of one passage's covariance, each for size 1.
pub struct Shapes {
    parts: Vec<Mat<f64>>,
    len: usize,
}

/// Correlation length of a wheel's own irregularity, metres.
const OWN_CORRELATION_M: f64 = 0.12;
/// Step for the slope of the path, metres.
const SLOPE_M: f64 = 5e-3;

impl Shapes {
    /// For the windows of one passage.
    pub fn new(responses: &BogieResponses, grids: &PathSplines, path: &Path) -> Self {
        let len = responses.profile[0].nrows();
        let mut parts: Vec<Mat<f64>> = (0..PARTS - 1).map(|_| Mat::zeros(len, len)).collect();
        let knots = grids.knots();
        let [depth, slope] = path_shapes(path).map(|c| Mat::from_fn(c.len(), 1, |i, _| c[i]));
        for axle in 0..2 {
            let a = &responses.profile[axle];
            let [c, s] = &responses.load[axle];
            let column = |f: &dyn Fn(usize) -> f64| Mat::from_fn(len, 1, |k, _| f(k));
            add_outer(&mut parts[0], &column(&|k| c[k] + s[k]));
            add_outer(&mut parts[1], &column(&|k| c[k] - s[k]));
            add_outer(&mut parts[2], &(a * &depth));
            add_outer(&mut parts[3], &(a * &slope));
            for (part, side) in [(4, Side::Crossing), (5, Side::Stock)] {
                let own = Mat::from_fn(knots.len(), knots.len(), |i, j| {
                    if knots[i].0 != side || knots[j].0 != side {
                        return 0.0;
                    }
                    super::splines::matern((knots[i].1 - knots[j].1).abs() / OWN_CORRELATION_M)
                });
                let half = a * &own;
                parts[part] += &half * a.transpose();
            }
        }
        Self { parts, len }
    }

    /// Covariance of one bogie's window.
    pub fn covariance(&self, variation: &Variation) -> Mat<f64> {
        let v = variation.values();
        let mut out = Mat::from_fn(self.len, self.len, |i, j| if i == j { v[0] * v[0] } else { 0.0 });
        for (part, size) in self.parts.iter().zip(&v[1..]) {
            let square = size * size;
            for j in 0..self.len {
                for i in 0..self.len {
                    out[(i, j)] += square * part[(i, j)];
                }
            }
        }
        out
    }

    /// Factor of that covariance.
    pub fn factor(&self, variation: &Variation) -> Option<Llt<f64>> {
        self.covariance(variation).llt(faer::Side::Lower).ok()
    }

    /// Log likelihood of the scatter of windows about their mean.
    fn log_likelihood(&self, variation: &Variation, scatter: &Mat<f64>) -> f64 {
        use faer::linalg::solvers::Solve as _;
        let Some(factor) = self.factor(variation) else { return f64::NEG_INFINITY };
        let solved = factor.solve(scatter);
        let windows = scatter.ncols();
        let quadratic: f64 =
            (0..windows).map(|c| (0..self.len).map(|k| scatter[(k, c)] * solved[(k, c)]).sum::<f64>()).sum();
        let l = factor.L();
        let log_det: f64 = (0..self.len).map(|i| l[(i, i)].ln()).sum();
        -0.5 * quadratic - (windows - 1) as f64 * log_det
    }
}

/// Depth and slope of the path on the crossing side at the knots of its splines.
pub fn path_shapes(path: &Path) -> [Vec<f64>; 2] {
    let knots = path.deviation.knots();
    let pick = |f: &dyn Fn(f64) -> f64| -> Vec<f64> {
        knots.iter().map(|(side, x)| if *side == Side::Crossing { f(*x) } else { 0.0 }).collect()
    };
    let depth = pick(&|x| path.at(Side::Crossing, x));
    let slope = pick(&|x| {
        (path.at(Side::Crossing, x + SLOPE_M) - path.at(Side::Crossing, x - SLOPE_M)) / (2.0 * SLOPE_M)
    });
    [depth, slope]
}

fn add_outer(target: &mut Mat<f64>, column: &Mat<f64>) {
    *target += column * column.transpose();
}

/// Deviations of residual windows from their mean, as columns.
pub fn scatter(residuals: &[Vec<f64>]) -> Mat<f64> {
    let mean = super::data::mean_of(residuals);
    Mat::from_fn(mean.len(), residuals.len(), |k, c| residuals[c][k] - mean[k])
}

/// Steps of the search, as factors.
const FACTORS: [f64; 3] = [3.0, 1.6, 1.25];

/// Sizes that make the scatter most probable: one at a time, by shrinking factors.
pub fn estimate(passages: &[(&Shapes, Mat<f64>)]) -> Variation {
    use rayon::prelude::*;
    let total = |v: &[f64; PARTS]| -> f64 {
        let variation = Variation::of_values(*v);
        passages.par_iter().map(|(shapes, scatter)| shapes.log_likelihood(&variation, scatter)).sum()
    };
    let mut best = Variation::START.values();
    let mut highest = total(&best);
    for factor in FACTORS {
        for part in 0..PARTS {
            for step in [factor, 1.0 / factor] {
                let mut moved = false;
                loop {
                    let mut candidate = best;
                    candidate[part] =
                        (candidate[part] * step).clamp(Variation::RANGE[part][0], Variation::RANGE[part][1]);
                    let found = if candidate == best { f64::NEG_INFINITY } else { total(&candidate) };
                    if found <= highest {
                        break;
                    }
                    (best, highest, moved) = (candidate, found, true);
                }
                if moved {
                    break;
                }
            }
        }
    }
    Variation::of_values(best)
}
