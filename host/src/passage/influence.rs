//! Motion of a rail point under the loads near it: rows of the inverse effective matrix, cut off where they have decayed.
//!
//! Within one time step a force moves only the rail around it; the reach is a few decay lengths (EI dt²/4m)^¼, 0.13 m at
//! 1e-4 s. So the contact force of a wheel can be found before the track is solved, from the loads near the wheel.

use aligned_vec::avec;
use pulp::Simd;

use super::chain::Seat;
use super::effective::Effective;
use super::model::{CHUNK, Lanes, Layout, RailPoint, TrackModel};
use super::vectors::{Aligned, parts, vectors, vectors_mut};

/// Rows are cut where they fall below this part of their largest value: a load of 100 kN leaves out the motion of at most 0.5 N, near the
/// free ends of the rails of 2 N. Nothing accumulates, because the track is then solved as a whole. At 0.1 ms a row is one chunk and not
/// two.
const CUT: f64 = 5e-6;

/// Cut rows for the four degrees of freedom of every element.
#[derive(Clone, Debug)]
pub(super) struct Influence {
    layout: Layout,
    /// Sleepers on either side that are kept.
    reach: usize,
    /// `[point][row][chunk of lanes][dof]`.
    rows: Aligned<Lanes>,
    /// `[point]`: motion of degree of freedom a per load on b.
    own: Vec<[[f64; 4]; 4]>,
}

impl Influence {
    pub fn new(model: &TrackModel, effective: &Effective) -> Self {
        let layout = model.layout;
        let reach = reach(layout, effective);
        let points = 2 * layout.sleepers * layout.nodes_per_bay;
        let mut influence = Self {
            layout,
            reach,
            rows: avec![[0.0; CHUNK]; points * layout.rows() * 4 * chunks(reach)],
            own: vec![[[0.0; 4]; 4]; points],
        };
        each_column(layout, effective, |column, side, node, dof| {
            for (element, first) in elements_at(layout, node) {
                influence.store(column, side, element, first + dof);
            }
        });
        influence
    }

    /// Largest part cut off, relative to the row's largest value, both rails.
    pub fn cut_off(&self, effective: &Effective) -> f64 {
        let mut worst: f64 = 0.0;
        each_column(self.layout, effective, |column, side, node, _| {
            for ([bay, _], _) in elements_at(self.layout, node) {
                let first = self.first_lane(side, bay);
                let window = first..first + CHUNK * chunks(self.reach);
                worst = worst.max(outside(self.layout, column, side, |lane| window.contains(&lane)));
            }
        });
        worst
    }

    /// Files the motion under a unit load on one end of an element.
    fn store(&mut self, column: &[f64], side: usize, [bay, element]: [usize; 2], dof: usize) {
        let (layout, reach) = (self.layout, self.reach);
        let point = self.point(side, bay, element);
        let first = self.first_lane(side, bay);
        for row in 0..layout.rows() {
            let target = (point * layout.rows() + row) * chunks(reach);
            for k in 0..CHUNK * chunks(reach) {
                let sleeper = (first + k) as i64 - (side * layout.stride) as i64;
                if sleeper >= 0 && sleeper < layout.sleepers as i64 {
                    self.rows[(target + k / CHUNK) * 4 + dof][k % CHUNK] =
                        column[row * layout.row + first + k];
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
        let width = CHUNK * chunks(self.reach);
        let most = (self.layout.row - width)
            .min(side * self.layout.stride + self.layout.stride.saturating_sub(width - 1));
        (side * self.layout.stride + bay.saturating_sub(self.reach)).min(most)
    }

    /// Rate of the point under the loads `rhs`.
    #[inline(always)]
    pub fn rate<S: Simd>(&self, simd: S, point: &RailPoint, rhs: &[f64]) -> f64 {
        let (rows, width) = (self.layout.rows(), chunks(self.reach));
        let first = self.first_lane(point.side, point.bay);
        let index = self.point(point.side, point.bay, point.element) * rows * 4 * width;
        let influence = self.rows[index..index + rows * 4 * width].as_chunks::<4>().0;
        let mut sum = [0.0; CHUNK];
        for part in 0..parts::<S>() {
            let mut of_dofs = [simd.splat_f64s(0.0); 4];
            for row in 0..rows {
                for chunk in 0..width {
                    let start = row * self.layout.row + first + chunk * CHUNK;
                    let load = vectors::<S>(&rhs[start..start + CHUNK])[part];
                    for (sum, values) in of_dofs.iter_mut().zip(&influence[row * width + chunk]) {
                        *sum = simd.mul_add_f64s(vectors::<S>(values)[part], load, *sum);
                    }
                }
            }
            let mut total = simd.splat_f64s(0.0);
            for (of_dof, weight) in of_dofs.iter().zip(&point.weights) {
                total = simd.mul_add_f64s(simd.splat_f64s(*weight), *of_dof, total);
            }
            vectors_mut::<S>(&mut sum)[part] = total;
        }
        let [a, b, c, d, e, f, g, h] = sum;
        ((a + e) + (c + g)) + ((b + f) + (d + h))
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

/// Chunks of lanes in a window.
#[inline(always)]
fn chunks(reach: usize) -> usize {
    (2 * reach + 2).div_ceil(CHUNK)
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

/// Motion of the rails under a unit load on every degree of freedom of every node: the column, rail, node as bay and place in it, and
/// which degree of freedom.
fn each_column(layout: Layout, effective: &Effective, mut of: impl FnMut(&[f64], usize, [usize; 2], usize)) {
    let mut scratch = Columns::new(layout);
    for side in 0..2 {
        for bay in 0..layout.sleepers {
            // The last sleeper is the end of the last bay.
            let nodes = if bay + 1 == layout.sleepers { 1 } else { layout.nodes_per_bay };
            for element in 0..nodes {
                for dof in 0..2 {
                    let column = scratch.column(effective, layout.dof(side, bay, element, dof));
                    of(column, side, [bay, element], dof);
                }
            }
        }
    }
}

/// The elements that share a node, as bay and place in it, and the first of the degrees of freedom that they have there.
fn elements_at(layout: Layout, [bay, element]: [usize; 2]) -> impl Iterator<Item = ([usize; 2], usize)> {
    let before = match (bay, element) {
        (0, 0) => None,
        (_, 0) => Some([bay - 1, layout.nodes_per_bay - 1]),
        _ => Some([bay, element - 1]),
    };
    std::iter::once(([bay, element], 0)).chain(before.map(|element| (element, 2)))
}

/// Sleepers to keep on either side, from loads on a few places along the track.
fn reach(layout: Layout, effective: &Effective) -> usize {
    let mut scratch = Columns::new(layout);
    let mut reach = 1;
    for bay in (0..layout.sleepers).step_by(5) {
        for dof in 0..2 {
            let column = scratch.column(effective, layout.dof(0, bay, 0, dof));
            while reach < layout.sleepers / 2
                && outside(layout, column, 0, |lane| lane.abs_diff(bay) <= reach) > CUT
            {
                reach += 1;
            }
        }
    }
    reach
}

/// Largest motion of the same kind on lanes of the loaded rail that are not `kept`, relative to the largest on those that are.
fn outside(layout: Layout, column: &[f64], side: usize, kept: impl Fn(usize) -> bool) -> f64 {
    let mut worst: f64 = 0.0;
    for kind in 0..2 {
        let (mut inside, mut beyond) = (0.0_f64, 0.0_f64);
        for row in (kind..layout.rows()).step_by(2) {
            for lane in side * layout.stride..side * layout.stride + layout.sleepers {
                let value = column[row * layout.row + lane].abs();
                let largest = if kept(lane) { &mut inside } else { &mut beyond };
                *largest = largest.max(value);
            }
        }
        worst = worst.max(beyond / inside.max(f64::MIN_POSITIVE));
    }
    worst
}
