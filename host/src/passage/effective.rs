//! Effective matrix A = a_m M + a_c C + a_k K of the whole track, factorised once: sleepers are condensed to the rail
//! seats, nodes between the seats are condensed bay by bay, and the seats remain as a chain of 4×4 blocks.

use aligned_vec::avec;
use nalgebra::DMatrix;
use pulp::Simd;

use super::chain::{Block, Seat, SeatChain};
use super::error::SimulationError;
use super::model::{Layout, TrackModel};
use super::sleepers::Sleepers;
use super::vectors::{Aligned, vectors, vectors_mut};

/// Shares of mass, damping and stiffness in the effective matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Shares {
    pub mass: f64,
    pub damping: f64,
    pub stiffness: f64,
}

/// Factorised effective matrix.
#[derive(Clone, Debug)]
pub(super) struct Effective {
    layout: Layout,
    /// `[(i · m + j) · row + lane]`, m values inside a bay.
    interior_inverse: Aligned<f64>,
    /// `[(i · 4 + a) · row + lane]`: motion inside the bay per motion of its two seats.
    interior_gain: Aligned<f64>,
    chain: SeatChain,
}

impl Effective {
    pub fn new(model: &TrackModel, sleepers: &Sleepers, shares: Shares) -> Result<Self, SimulationError> {
        let layout = model.layout;
        let m = 2 * (layout.nodes_per_bay - 1);
        let mut effective = Self {
            layout,
            interior_inverse: avec![0.0; m * m * layout.row],
            interior_gain: avec![0.0; 4 * m * layout.row],
            chain: SeatChain::default(),
        };
        let mut diagonal: Vec<Block> =
            (0..layout.sleepers).map(|s| seat_block(sleepers.seat_stiffness(s))).collect();
        let mut upper = vec![[[0.0; 4]; 4]; layout.sleepers - 1];
        for side in 0..2 {
            for bay in 0..layout.sleepers - 1 {
                effective.condense_bay(model, shares, [side, bay], (&mut diagonal, &mut upper))?;
            }
        }
        effective.chain = SeatChain::new(diagonal, &upper)
            .ok_or(SimulationError::Singular { what: "effective", place: "the rails".into() })?;
        Ok(effective)
    }

    /// Eliminates the nodes inside one bay of one rail.
    fn condense_bay(
        &mut self,
        model: &TrackModel,
        shares: Shares,
        [side, bay]: [usize; 2],
        (diagonal, upper): (&mut [Block], &mut [Block]),
    ) -> Result<(), SimulationError> {
        let nodes = self.layout.nodes_per_bay;
        let m = 2 * (nodes - 1);
        let mut matrix = DMatrix::zeros(m + 4, m + 4);
        let stiffness = shares.damping * model.rail_damping_s + shares.stiffness;
        for e in 0..nodes {
            let Some(section) = model.section(side, bay, e) else { continue };
            let element = model.element_matrix(section, shares.mass, stiffness);
            for i in 0..4 {
                for j in 0..4 {
                    matrix[(place(e, i, m), place(e, j, m))] += element[i][j];
                }
            }
        }
        let mut seats = matrix.view((m, m), (4, 4)).into_owned();
        if m > 0 {
            let inner = matrix.view((0, 0), (m, m)).into_owned();
            let outer = matrix.view((0, m), (m, 4)).into_owned();
            let inverse = inner
                .cholesky()
                .ok_or_else(|| SimulationError::Singular {
                    what: "effective",
                    place: format!("rail bay {bay}"),
                })?
                .inverse();
            let gain = &inverse * &outer;
            seats -= outer.transpose() * &gain;
            let lane = side * self.layout.stride + bay;
            for i in 0..m {
                for j in 0..m {
                    self.interior_inverse[(i * m + j) * self.layout.row + lane] = inverse[(i, j)];
                }
                for a in 0..4 {
                    self.interior_gain[(i * 4 + a) * self.layout.row + lane] = -gain[(i, a)];
                }
            }
        }
        for i in 0..2 {
            for j in 0..2 {
                let (r, c) = (2 * side + i, 2 * side + j);
                diagonal[bay][r][c] += seats[(i, j)];
                diagonal[bay + 1][r][c] += seats[(i + 2, j + 2)];
                upper[bay][r][c] += seats[(i, j + 2)];
            }
        }
        Ok(())
    }

    /// Motion `x` of the rails under `rhs`, which is spoilt.
    #[inline(always)]
    pub fn solve_rails<S: Simd>(&self, simd: S, rhs: &mut [f64], x: &mut [f64], seats: &mut [Seat]) {
        self.eliminate_bays(simd, rhs);
        let (row, stride, n) = (self.layout.row, self.layout.stride, seats.len());
        let places = [0, row, stride, row + stride];
        let loads = places.map(|at| &rhs[at..at + n]);
        for (s, seat) in seats.iter_mut().enumerate() {
            *seat = loads.map(|row| row[s]);
        }
        self.chain.solve(seats);
        for (a, at) in places.into_iter().enumerate() {
            for (value, seat) in x[at..at + n].iter_mut().zip(&*seats) {
                *value = seat[a];
            }
        }
        self.recover_bays(simd, rhs, x);
    }

    /// Loads inside the bays, moved to the seats.
    #[inline(always)]
    fn eliminate_bays<S: Simd>(&self, simd: S, rhs: &mut [f64]) {
        let (row, lanes, m) = (self.layout.row, self.layout.lanes(), 2 * (self.layout.nodes_per_bay - 1));
        let (seats, interior) = rhs.split_at_mut(2 * row);
        for pair in 0..m / 2 {
            let loads = [2 * pair, 2 * pair + 1].map(|i| vectors::<S>(&interior[i * row..i * row + lanes]));
            for a in 0..4 {
                let gains = [2 * pair, 2 * pair + 1].map(|i| self.gain::<S>(i, a));
                let start = (a % 2) * row + a / 2;
                let target = vectors_mut::<S>(&mut seats[start..start + lanes]);
                add_products(simd, target, &gains, &loads);
            }
        }
    }

    /// Motion inside the bays from loads there and motion of the seats.
    #[inline(always)]
    fn recover_bays<S: Simd>(&self, simd: S, loads: &[f64], x: &mut [f64]) {
        let (row, lanes, m) = (self.layout.row, self.layout.lanes(), 2 * (self.layout.nodes_per_bay - 1));
        let (seats, interior) = x.split_at_mut(2 * row);
        let seats = [0, row, 1, row + 1].map(|at| vectors::<S>(&seats[at..at + lanes]));
        for i in 0..m {
            let target = vectors_mut::<S>(&mut interior[i * row..i * row + lanes]);
            set_products(simd, target, &[0, 1, 2, 3].map(|a| self.gain::<S>(i, a)), &seats);
            for pair in 0..m / 2 {
                let of = [2 * pair, 2 * pair + 1];
                let inverse = of.map(|j| {
                    let at = (i * m + j) * row;
                    vectors::<S>(&self.interior_inverse[at..at + lanes])
                });
                let loads = of.map(|j| vectors::<S>(&loads[(2 + j) * row..(2 + j) * row + lanes]));
                add_products(simd, target, &inverse, &loads);
            }
        }
    }

    /// Motion of value `i` inside the bays per motion of degree of freedom `a` of their ends.
    #[inline(always)]
    fn gain<S: Simd>(&self, i: usize, a: usize) -> &[S::f64s] {
        let at = (i * 4 + a) * self.layout.row;
        vectors::<S>(&self.interior_gain[at..at + self.layout.lanes()])
    }
}

/// Adds the products of rows to a row.
#[inline(always)]
fn add_products<S: Simd, const N: usize>(
    simd: S,
    target: &mut [S::f64s],
    factors: &[&[S::f64s]; N],
    values: &[&[S::f64s]; N],
) {
    let count = target.len();
    let (factors, values) = (factors.map(|row| &row[..count]), values.map(|row| &row[..count]));
    for l in 0..count {
        let mut sum = target[l];
        for n in 0..N {
            sum = simd.mul_add_f64s(factors[n][l], values[n][l], sum);
        }
        target[l] = sum;
    }
}

/// Sum of the products of rows.
#[inline(always)]
fn set_products<S: Simd, const N: usize>(
    simd: S,
    target: &mut [S::f64s],
    factors: &[&[S::f64s]; N],
    values: &[&[S::f64s]; N],
) {
    let count = target.len();
    let (factors, values) = (factors.map(|row| &row[..count]), values.map(|row| &row[..count]));
    for l in 0..count {
        let mut sum = simd.mul_f64s(factors[0][l], values[0][l]);
        for n in 1..N {
            sum = simd.mul_add_f64s(factors[n][l], values[n][l], sum);
        }
        target[l] = sum;
    }
}

/// Seats of both rails on a sleeper.
fn seat_block([own, between, other]: [f64; 3]) -> Block {
    let mut block = [[0.0; 4]; 4];
    (block[0][0], block[2][2]) = (own, other);
    (block[0][2], block[2][0]) = (between, between);
    block
}

/// Row of an element's degree of freedom in a bay matrix: interior first, then left seat, then right seat.
fn place(element: usize, a: usize, interior: usize) -> usize {
    let node = element + a / 2;
    match node {
        0 => interior + a % 2,
        _ if 2 * (node - 1) < interior => 2 * (node - 1) + a % 2,
        _ => interior + 2 + a % 2,
    }
}
