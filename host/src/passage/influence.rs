//! Motion of a rail point under the loads near it: rows of the inverse effective matrix, cut off where they have decayed.
//!
//! Within one time step a force moves only the rail around it; the reach is a few decay lengths (EI dt²/4m)^¼, 0.13 m at
//! 1e-4 s. So the contact force of a wheel can be found before the track is solved, from the loads near the wheel.

use super::chain::Seat;
use super::effective::Effective;
use super::model::{Layout, RailPoint, TrackModel};

/// Rows are cut where they fall below this part of their largest value.
const CUT: f64 = 1e-9;

/// Cut rows for the four degrees of freedom of every element.
#[derive(Clone, Debug)]
pub(super) struct Influence {
    layout: Layout,
    /// Sleepers on either side that are kept.
    reach: usize,
    /// `[point][row][quad of lanes][dof]`.
    rows: Vec<[Quad; 4]>,
    /// `[point]`: motion of degree of freedom a per load on b.
    own: Vec<[[f64; 4]; 4]>,
    /// Largest part cut off, relative to the row's largest value, both rails.
    pub cut_off: f64,
}

impl Influence {
    pub fn new(model: &TrackModel, effective: &Effective) -> Self {
        let layout = model.layout;
        let reach = reach(layout, effective);
        let points = 2 * layout.sleepers * layout.nodes_per_bay;
        let mut influence = Self {
            layout,
            reach,
            rows: vec![[[0.0; 4]; 4]; points * layout.rows() * quads(reach)],
            own: vec![[[0.0; 4]; 4]; points],
            cut_off: 0.0,
        };
        let mut scratch = Columns::new(layout);
        for side in 0..2 {
            for bay in 0..layout.sleepers {
                for element in 0..layout.nodes_per_bay {
                    // The last sleeper is the end of the last bay: it has a left neighbour only.
                    if bay + 1 == layout.sleepers && element > 0 {
                        break;
                    }
                    for dof in 0..2 {
                        let loaded = layout.dof(side, bay, element, dof);
                        let column = scratch.column(effective, loaded);
                        influence.cut_off = influence.cut_off.max(outside(layout, column, side, bay, reach));
                        influence.store(column, side, [bay, element], dof);
                    }
                }
            }
        }
        influence
    }

    /// Files the motion under a unit load on one node with the two elements that share the node.
    fn store(&mut self, column: &[f64], side: usize, [bay, element]: [usize; 2], dof: usize) {
        let nodes = self.layout.nodes_per_bay;
        self.store_for(column, side, [bay, element], dof);
        match (bay, element) {
            (0, 0) => {}
            (_, 0) => self.store_for(column, side, [bay - 1, nodes - 1], dof + 2),
            _ => self.store_for(column, side, [bay, element - 1], dof + 2),
        }
    }

    fn store_for(&mut self, column: &[f64], side: usize, [bay, element]: [usize; 2], dof: usize) {
        let (layout, reach) = (self.layout, self.reach);
        let point = self.point(side, bay, element);
        let first = self.first_lane(side, bay);
        for row in 0..layout.rows() {
            let target = (point * layout.rows() + row) * quads(reach);
            for k in 0..4 * quads(reach) {
                let sleeper = (first + k) as i64 - (side * layout.stride) as i64;
                if sleeper >= 0 && sleeper < layout.sleepers as i64 {
                    self.rows[target + k / 4][dof][k % 4] = column[row * layout.row + first + k];
                }
            }
        }
        for a in 0..4 {
            let at = layout.dof(side, bay, element, a);
            self.own[point][a][dof] = column[at];
        }
    }

    fn point(&self, side: usize, bay: usize, element: usize) -> usize {
        (side * self.layout.sleepers + bay) * self.layout.nodes_per_bay + element
    }

    /// First lane of the window around a bay; windows at the rail ends are moved inwards.
    #[inline(always)]
    fn first_lane(&self, side: usize, bay: usize) -> usize {
        let most = (self.layout.row - 4 * quads(self.reach))
            .min(side * self.layout.stride + self.layout.stride.saturating_sub(4 * quads(self.reach) - 1));
        (side * self.layout.stride + bay.saturating_sub(self.reach)).min(most)
    }

    /// Rate of the point under the loads `rhs`.
    #[inline(always)]
    pub fn rate(&self, point: &RailPoint, rhs: &[f64]) -> f64 {
        let (layout, quads) = (self.layout, quads(self.reach));
        let first = self.first_lane(point.side, point.bay);
        let index = self.point(point.side, point.bay, point.element) * layout.rows() * quads;
        let mut sums: [Quad; 4] = [[0.0; 4]; 4];
        let rows = self.rows[index..index + layout.rows() * quads].chunks_exact(quads);
        for (row, influence) in rows.enumerate() {
            let start = row * layout.row + first;
            let loads: &[Quad] = rhs[start..start + 4 * quads].as_chunks().0;
            for (of_dofs, load) in influence.iter().zip(loads) {
                let load = *load;
                for (sum, values) in sums.iter_mut().zip(of_dofs) {
                    for l in 0..4 {
                        sum[l] += values[l] * load[l];
                    }
                }
            }
        }
        let total = |sum: &Quad| (sum[0] + sum[1]) + (sum[2] + sum[3]);
        sums.iter().zip(&point.weights).map(|(sum, weight)| weight * total(sum)).sum()
    }

    /// Rate of the point per force on it, 1/(N s)·m.
    #[inline(always)]
    pub fn compliance(&self, point: &RailPoint) -> f64 {
        let own = &self.own[self.point(point.side, point.bay, point.element)];
        let mut sum = 0.0;
        for (row, a) in own.iter().zip(&point.weights) {
            for (value, b) in row.iter().zip(&point.weights) {
                sum += a * value * b;
            }
        }
        sum
    }
}

/// Four neighbouring lanes.
type Quad = [f64; 4];

/// Quads of lanes in a window.
#[inline(always)]
fn quads(reach: usize) -> usize {
    (2 * reach + 2).div_ceil(4)
}

struct Columns {
    load: Vec<f64>,
    motion: Vec<f64>,
    seats: Vec<Seat>,
}

impl Columns {
    fn new(layout: Layout) -> Self {
        let rails = || vec![0.0; layout.rows() * layout.row];
        Self { load: rails(), motion: rails(), seats: vec![[0.0; 4]; layout.sleepers] }
    }

    /// Motion of the rails under a unit load on one degree of freedom.
    fn column(&mut self, effective: &Effective, loaded: usize) -> &[f64] {
        self.load.fill(0.0);
        self.load[loaded] = 1.0;
        pulp::Arch::new().dispatch(Solve { effective, columns: self });
        &self.motion
    }
}

struct Solve<'a> {
    effective: &'a Effective,
    columns: &'a mut Columns,
}

impl pulp::WithSimd for Solve<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        let Columns { load, motion, seats } = self.columns;
        self.effective.solve_rails(simd, load, motion, seats);
    }
}

/// Sleepers to keep on either side, from loads on a few places along the track.
fn reach(layout: Layout, effective: &Effective) -> usize {
    let mut scratch = Columns::new(layout);
    let mut reach = 1;
    for bay in (0..layout.sleepers).step_by(5) {
        for dof in 0..2 {
            let column = scratch.column(effective, layout.dof(0, bay, 0, dof));
            while reach < layout.sleepers / 2 && outside(layout, column, 0, bay, reach) > CUT {
                reach += 1;
            }
        }
    }
    reach
}

/// Largest motion of the same kind outside the window of `reach` sleepers on the loaded rail, relative to the largest
/// inside.
fn outside(layout: Layout, column: &[f64], side: usize, bay: usize, reach: usize) -> f64 {
    let mut worst: f64 = 0.0;
    for kind in 0..2 {
        let (mut inside, mut beyond) = (0.0_f64, 0.0_f64);
        for row in (kind..layout.rows()).step_by(2) {
            for sleeper in 0..layout.sleepers {
                let value = column[row * layout.row + side * layout.stride + sleeper].abs();
                if sleeper.abs_diff(bay) <= reach {
                    inside = inside.max(value);
                } else {
                    beyond = beyond.max(value);
                }
            }
        }
        worst = worst.max(beyond / inside.max(f64::MIN_POSITIVE));
    }
    worst
}
