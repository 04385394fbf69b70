//! Effective matrix A = a_m M + a_c C + a_k K of the whole track, factorised once: sleepers are condensed to the rail
//! seats, nodes between the seats are condensed bay by bay, and the seats remain as a chain of 4×4 blocks.

use nalgebra::DMatrix;

use super::chain::{Block, Seat, SeatChain};
use super::error::SimulationError;
use super::model::{CHUNK, Layout, MOST_ELEMENTS, TrackModel};

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
    /// Effective stiffness of a pad.
    pub pad: f64,
    coordinates: usize,
    seat_shape: [Vec<f64>; 2],
    /// `[(i · n + j) · stride + sleeper]`.
    sleeper_inverse: Vec<f64>,
    /// `[(side · n + i) · stride + sleeper]`: motion of the coordinates per seat motion.
    seat_gain: Vec<f64>,
    /// `[(i · m + j) · row + lane]`, m values inside a bay.
    interior_inverse: Vec<f64>,
    /// `[(i · 4 + a) · row + lane]`: motion inside the bay per motion of its two seats, negative.
    interior_gain: Vec<f64>,
    chain: SeatChain,
}

impl Effective {
    pub fn new(model: &TrackModel, shares: Shares) -> Result<Self, SimulationError> {
        let layout = model.layout;
        let (n, m) = (model.basis.len(), 2 * (layout.nodes_per_bay - 1));
        let mut effective = Self {
            layout,
            pad: shares.damping * model.pad.damping + shares.stiffness * model.pad.stiffness,
            coordinates: n,
            seat_shape: model.basis.seat.clone(),
            sleeper_inverse: vec![0.0; n * n * layout.stride],
            seat_gain: vec![0.0; 2 * n * layout.stride],
            interior_inverse: vec![0.0; m * m * layout.row],
            interior_gain: vec![0.0; 4 * m * layout.row],
            chain: SeatChain::default(),
        };
        let mut diagonal = vec![[[0.0; 4]; 4]; layout.sleepers];
        let mut upper = vec![[[0.0; 4]; 4]; layout.sleepers - 1];
        for sleeper in 0..layout.sleepers {
            effective.condense_sleeper(model, shares, sleeper, &mut diagonal[sleeper])?;
        }
        for side in 0..2 {
            for bay in 0..layout.sleepers - 1 {
                effective.condense_bay(model, shares, [side, bay], (&mut diagonal, &mut upper))?;
            }
        }
        effective.chain = SeatChain::new(diagonal, &upper)
            .ok_or(SimulationError::Singular { what: "effective", place: "the rails".into() })?;
        Ok(effective)
    }

    fn condense_sleeper(
        &mut self,
        model: &TrackModel,
        shares: Shares,
        sleeper: usize,
        seat: &mut Block,
    ) -> Result<(), SimulationError> {
        let (basis, support, n) = (&model.basis, &model.supports[sleeper], self.coordinates);
        let (k, c) = support.implicit();
        let elastic = shares.damping * basis.damping_s + shares.stiffness;
        let bed = shares.mass * support.mass_kg_m + shares.damping * c + shares.stiffness * k;
        let mut matrix = &basis.bed * bed;
        for i in 0..n {
            matrix[(i, i)] += shares.mass + elastic * basis.elastic[i];
            for j in 0..n {
                let shapes = basis.seat[0][i] * basis.seat[0][j] + basis.seat[1][i] * basis.seat[1][j];
                matrix[(i, j)] += self.pad * shapes;
            }
        }
        let inverse = matrix
            .cholesky()
            .ok_or_else(|| SimulationError::Singular {
                what: "effective",
                place: format!("sleeper {sleeper}"),
            })?
            .inverse();
        for i in 0..n {
            for j in 0..n {
                self.sleeper_inverse[(i * n + j) * self.layout.stride + sleeper] = inverse[(i, j)];
            }
            for side in 0..2 {
                let gain: f64 = (0..n).map(|j| self.pad * inverse[(i, j)] * basis.seat[side][j]).sum();
                self.seat_gain[(side * n + i) * self.layout.stride + sleeper] = gain;
            }
        }
        for a in 0..2 {
            for b in 0..2 {
                let through: f64 = (0..n)
                    .map(|i| basis.seat[a][i] * self.seat_gain[(b * n + i) * self.layout.stride + sleeper])
                    .sum();
                seat[2 * a][2 * b] += if a == b { self.pad } else { 0.0 } - self.pad * through;
            }
        }
        Ok(())
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
                    self.interior_gain[(i * 4 + a) * self.layout.row + lane] = gain[(i, a)];
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

    /// Free motion of the sleepers (`y`) under `sleepers`, and its action on the rail seats, added to `rails`.
    #[inline(always)]
    pub fn condense(&self, sleepers: &[f64], y: &mut [f64], rails: &mut [f64]) {
        let (n, stride) = (self.coordinates, self.layout.stride);
        for chunk in 0..stride / CHUNK {
            let at = chunk * CHUNK;
            let mut seats = [[0.0; CHUNK]; 2];
            for i in 0..n {
                let mut sum = [0.0; CHUNK];
                for j in 0..n {
                    let a = lanes(&self.sleeper_inverse, (i * n + j) * stride + at);
                    let b = lanes(sleepers, j * stride + at);
                    for l in 0..CHUNK {
                        sum[l] += a[l] * b[l];
                    }
                }
                lanes_mut(y, i * stride + at).copy_from_slice(&sum);
                for (seat, shape) in seats.iter_mut().zip(&self.seat_shape) {
                    let weight = self.pad * shape[i];
                    for l in 0..CHUNK {
                        seat[l] += weight * sum[l];
                    }
                }
            }
            for (side, seat) in seats.iter().enumerate() {
                let target = lanes_mut(rails, side * stride + at);
                for l in 0..CHUNK {
                    target[l] += seat[l];
                }
            }
        }
    }

    /// Motion of the rails under `rhs`, in place; `seats` is scratch of one value per sleeper.
    #[inline(always)]
    pub fn solve_rails(&self, rhs: &mut [f64], seats: &mut [Seat]) {
        self.eliminate_bays(rhs);
        let (row, stride) = (self.layout.row, self.layout.stride);
        for (s, seat) in seats.iter_mut().enumerate() {
            *seat = [rhs[s], rhs[row + s], rhs[stride + s], rhs[row + stride + s]];
        }
        self.chain.solve(seats);
        for (s, seat) in seats.iter().enumerate() {
            [rhs[s], rhs[row + s], rhs[stride + s], rhs[row + stride + s]] = *seat;
        }
        self.recover_bays(rhs);
    }

    #[inline(always)]
    fn eliminate_bays(&self, rhs: &mut [f64]) {
        let (row, m) = (self.layout.row, 2 * (self.layout.nodes_per_bay - 1));
        for at in (0..self.layout.lanes()).step_by(CHUNK) {
            let mut sum = [[0.0; CHUNK]; 4];
            for i in 0..m {
                let b = *lanes(rhs, (2 + i) * row + at);
                for (a, s) in sum.iter_mut().enumerate() {
                    let g = lanes(&self.interior_gain, (i * 4 + a) * row + at);
                    for l in 0..CHUNK {
                        s[l] += g[l] * b[l];
                    }
                }
            }
            for (a, s) in sum.iter().enumerate() {
                let target = lanes_mut(rhs, (a % 2) * row + at + a / 2);
                for l in 0..CHUNK {
                    target[l] -= s[l];
                }
            }
        }
    }

    #[inline(always)]
    fn recover_bays(&self, x: &mut [f64]) {
        let (row, m) = (self.layout.row, 2 * (self.layout.nodes_per_bay - 1));
        let mut inner = [[0.0; CHUNK]; MOST_INTERIOR];
        for at in (0..self.layout.lanes()).step_by(CHUNK) {
            let seat: [[f64; CHUNK]; 4] = std::array::from_fn(|a| *lanes(x, (a % 2) * row + at + a / 2));
            for i in 0..m {
                let mut sum = [0.0; CHUNK];
                for j in 0..m {
                    let (a, b) =
                        (lanes(&self.interior_inverse, (i * m + j) * row + at), lanes(x, (2 + j) * row + at));
                    for l in 0..CHUNK {
                        sum[l] += a[l] * b[l];
                    }
                }
                for (a, s) in seat.iter().enumerate() {
                    let g = lanes(&self.interior_gain, (i * 4 + a) * row + at);
                    for l in 0..CHUNK {
                        sum[l] -= g[l] * s[l];
                    }
                }
                inner[i] = sum;
            }
            for (i, values) in inner.iter().enumerate().take(m) {
                lanes_mut(x, (2 + i) * row + at).copy_from_slice(values);
            }
        }
    }

    /// Motion of the sleepers: `y` becomes y + gain · seat motion.
    #[inline(always)]
    pub fn recover_sleepers(&self, rails: &[f64], y: &mut [f64]) {
        let (n, stride) = (self.coordinates, self.layout.stride);
        for at in (0..stride).step_by(CHUNK) {
            let seats = [*lanes(rails, at), *lanes(rails, stride + at)];
            for i in 0..n {
                let target = lanes_mut(y, i * stride + at);
                for (side, seat) in seats.iter().enumerate() {
                    let g = lanes(&self.seat_gain, (side * n + i) * stride + at);
                    for l in 0..CHUNK {
                        target[l] += g[l] * seat[l];
                    }
                }
            }
        }
    }
}

/// Most values inside a bay.
pub(super) const MOST_INTERIOR: usize = 2 * MOST_ELEMENTS;

/// Row of an element's degree of freedom in a bay matrix: interior first, then left seat, then right seat.
fn place(element: usize, a: usize, interior: usize) -> usize {
    let node = element + a / 2;
    match node {
        0 => interior + a % 2,
        _ if 2 * (node - 1) < interior => 2 * (node - 1) + a % 2,
        _ => interior + 2 + a % 2,
    }
}

/// A fixed number of neighbouring lanes.
#[inline(always)]
pub(super) fn lanes(values: &[f64], at: usize) -> &[f64; CHUNK] {
    match values[at..at + CHUNK].first_chunk() {
        Some(chunk) => chunk,
        None => &[0.0; CHUNK],
    }
}

#[inline(always)]
pub(super) fn lanes_mut(values: &mut [f64], at: usize) -> &mut [f64; CHUNK] {
    // The slice has exactly the length of the array.
    match values[at..at + CHUNK].first_chunk_mut() {
        Some(chunk) => chunk,
        None => unreachable!("a slice of CHUNK values holds CHUNK values"),
    }
}
