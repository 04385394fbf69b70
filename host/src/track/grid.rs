//! From rail nodes to a finer grid along the whole track, by the shape functions of the rail elements.

use faer::c64;

use super::{Side, Track, ZERO};
use crate::beam;

/// Equidistant points along the whole track, and how the nodes around each act on it.
#[derive(Clone, Debug)]
pub struct RailGrid {
    points: Vec<Point>,
}

/// Element of a point, and the shape functions there on the crossing and on the stock rail, times the share of the static load.
#[derive(Clone, Debug)]
struct Point {
    element: usize,
    shape: [[f64; 4]; 2],
}

impl Track {
    /// Points from the first rail node on, `step_m` apart.
    pub fn rail_grid(&self, step_m: f64) -> RailGrid {
        let last = self.node_x_m.len() - 1;
        let count = (last as f64 * self.step_m / step_m + 1e-9).floor() as usize + 1;
        let point = |i: usize| {
            let position = i as f64 * step_m / self.step_m;
            let element = (position as usize).min(last - 1);
            let shape = [(Side::Crossing, self.load_factor[0]), (Side::Stock, self.load_factor[1])];
            let shape = shape.map(|(side, factor)| {
                let phi = self.shear_ratio(side, element);
                beam::shape(phi, self.step_m, position - element as f64).map(|n| factor * n)
            });
            Point { element, shape }
        };
        RailGrid { points: (0..count).map(point).collect() }
    }
}

impl RailGrid {
    /// Receptance at the sensor to an axle at every point, per half its load, of nodal values of one frequency.
    pub fn both_rails(&self, crossing: &[[c64; 2]], stock: &[[c64; 2]]) -> Vec<c64> {
        let at = |point: &Point| {
            [crossing, stock].iter().zip(&point.shape).fold(ZERO, |sum, (nodal, n)| {
                let [a, b] = [nodal[point.element], nodal[point.element + 1]];
                sum + a[0] * n[0] + a[1] * n[1] + b[0] * n[2] + b[1] * n[3]
            })
        };
        self.points.iter().map(at).collect()
    }
}
