//! Effective matrix A = a_m M + a_c C + a_k K of the whole track, factorised once: sleepers are condensed to the rail
//! seats, nodes between the seats are condensed bay by bay, and the seats remain as a chain of 4×4 blocks.

use aligned_vec::avec;
use nalgebra::DMatrix;
use pulp::Simd;

use super::chain::{Block, Seat, SeatChain};
use super::error::SimulationError;
use super::model::{CHUNK, Lanes, Layout, TrackModel};
use super::sleepers::Sleepers;
use super::vectors::{Aligned, parts, vectors, vectors_from, vectors_mut};

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
    /// Loads on seats per load inside the bay behind and the bay before them, `[node in bay · chunks + chunk][a · 4 + k]`: on degree
    /// of freedom a, of the node's deflection and rotation behind, then before.
    eliminate: Aligned<[Lanes; 8]>,
    /// Motion inside the bay per motion of its two seats, `[node in bay · chunks + chunk][i · 4 + a]`.
    gain: Aligned<[Lanes; 8]>,
    /// Motion inside the bay per load there, `[(node · nodes inside + loaded node) · chunks + chunk][i · 2 + j]`.
    inverse: Aligned<[Lanes; 4]>,
    chain: SeatChain,
}

impl Effective {
    pub fn new(model: &TrackModel, sleepers: &Sleepers, shares: Shares) -> Result<Self, SimulationError> {
        let layout = model.layout;
        let (inside, chunks) = (layout.nodes_per_bay - 1, layout.lanes() / CHUNK);
        let mut effective = Self {
            layout,
            eliminate: avec![[[0.0; CHUNK]; 8]; inside * chunks],
            gain: avec![[[0.0; CHUNK]; 8]; inside * chunks],
            inverse: avec![[[0.0; CHUNK]; 4]; inside * inside * chunks],
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
            self.store_bay(side * self.layout.stride + bay, &inverse, &gain);
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

    /// Files what was found of the bay of one lane.
    fn store_bay(&mut self, lane: usize, inverse: &DMatrix<f64>, gain: &DMatrix<f64>) {
        let (inside, chunks) = (self.layout.nodes_per_bay - 1, self.layout.lanes() / CHUNK);
        let (at, next) = ([lane / CHUNK, lane % CHUNK], [(lane + 1) / CHUNK, (lane + 1) % CHUNK]);
        for i in 0..2 * inside {
            let (node, of) = (i / 2, i % 2);
            for a in 0..4 {
                self.gain[node * chunks + at[0]][of * 4 + a][at[1]] = -gain[(i, a)];
                let seat = if a < 2 { at } else { next };
                self.eliminate[node * chunks + seat[0]][a % 2 * 4 + a / 2 * 2 + of][seat[1]] = -gain[(i, a)];
            }
            for j in 0..2 * inside {
                self.inverse[(node * inside + j / 2) * chunks + at[0]][of * 2 + j % 2][at[1]] =
                    inverse[(i, j)];
            }
        }
    }

    /// Motion `x` of the rails under `rhs`, which is spoilt, as is `seats`.
    #[inline(always)]
    pub fn solve_rails<S: Simd>(&self, simd: S, rhs: &mut [f64], x: &mut [f64], seats: &mut [Seat]) {
        self.eliminate_bays(simd, rhs);
        let (row, stride) = (self.layout.row, self.layout.stride);
        let n = seats.len();
        let loads = [&rhs[..n], &rhs[row..][..n], &rhs[stride..][..n], &rhs[row + stride..][..n]];
        let (deflection, rotation) = x.split_at_mut(row);
        let ((w0, w1), (t0, t1)) = (deflection.split_at_mut(stride), rotation.split_at_mut(stride));
        self.chain.solve(loads, seats, [w0, t0, w1, t1]);
        self.recover_bays(simd, rhs, x);
    }

    /// Loads inside the bays, moved to the seats.
    #[inline(always)]
    fn eliminate_bays<S: Simd>(&self, simd: S, rhs: &mut [f64]) {
        let (row, lanes, p) = (self.layout.row, self.layout.lanes(), parts::<S>());
        let (chunks, count) = (lanes / CHUNK, lanes / CHUNK * p);
        // The lane before the first one of a row is read; it belongs to the end of the row before, which is zero.
        let (seats, inside) = rhs.split_at_mut(2 * row - CHUNK);
        let (deflection, rotation) = seats.split_at_mut(row);
        let deflection = &mut vectors_mut::<S>(deflection)[..count];
        let rotation = &mut vectors_mut::<S>(rotation)[..count];
        for (node, factors) in self.eliminate.chunks_exact(chunks).enumerate() {
            // A seat is an end of the bay behind it and of the bay before it, one lane back.
            let (w, t) = (CHUNK + 2 * node * row, CHUNK + (2 * node + 1) * row);
            let of = |at| vectors_from::<S>(inside, at, count);
            let loads = [of(w), of(t), of(w - 1), of(t - 1)];
            for (chunk, factors) in factors.iter().enumerate() {
                for part in 0..p {
                    let at = chunk * p + part;
                    let mut sums = [deflection[at], rotation[at]];
                    for (sum, factors) in sums.iter_mut().zip(factors.as_chunks::<4>().0) {
                        *sum = add_products(simd, *sum, (factors, part), (&loads, at));
                    }
                    [deflection[at], rotation[at]] = sums;
                }
            }
        }
    }

    /// Motion inside the bays from loads there and motion of the seats.
    #[inline(always)]
    fn recover_bays<S: Simd>(&self, simd: S, loads: &[f64], x: &mut [f64]) {
        let (row, lanes, p) = (self.layout.row, self.layout.lanes(), parts::<S>());
        let (inside, chunks, count) = (self.layout.nodes_per_bay - 1, lanes / CHUNK, lanes / CHUNK * p);
        let (seats, x) = x.split_at_mut(2 * row);
        let of = |at| vectors_from::<S>(seats, at, count);
        let seats = [of(0), of(row), of(1), of(row + 1)];
        for (node, x) in x.chunks_exact_mut(2 * row).enumerate() {
            let (deflection, rotation) = x.split_at_mut(row);
            let deflection = &mut vectors_mut::<S>(deflection)[..count];
            let rotation = &mut vectors_mut::<S>(rotation)[..count];
            for (chunk, gains) in self.gain[node * chunks..(node + 1) * chunks].iter().enumerate() {
                for part in 0..p {
                    let at = chunk * p + part;
                    let mut sums = [simd.splat_f64s(0.0); 2];
                    for (sum, gains) in sums.iter_mut().zip(gains.as_chunks::<4>().0) {
                        *sum = add_products(simd, *sum, (gains, part), (&seats, at));
                    }
                    [deflection[at], rotation[at]] = sums;
                }
            }
            for loaded in 0..inside {
                let of = |at| vectors_from::<S>(loads, at, count);
                let loads = [of((2 * loaded + 2) * row), of((2 * loaded + 3) * row)];
                let first = (node * inside + loaded) * chunks;
                for (chunk, inverse) in self.inverse[first..first + chunks].iter().enumerate() {
                    for part in 0..p {
                        let at = chunk * p + part;
                        let mut sums = [deflection[at], rotation[at]];
                        for (sum, inverse) in sums.iter_mut().zip(inverse.as_chunks::<2>().0) {
                            *sum = add_products(simd, *sum, (inverse, part), (&loads, at));
                        }
                        [deflection[at], rotation[at]] = sums;
                    }
                }
            }
        }
    }
}

/// `sum` and the products of factors with what rows hold at one place.
#[inline(always)]
fn add_products<S: Simd, const N: usize>(
    simd: S,
    mut sum: S::f64s,
    (factors, part): (&[Lanes; N], usize),
    (rows, at): (&[&[S::f64s]; N], usize),
) -> S::f64s {
    for (factor, row) in factors.iter().zip(rows) {
        sum = simd.mul_add_f64s(vectors::<S>(factor)[part], row[at], sum);
    }
    sum
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
