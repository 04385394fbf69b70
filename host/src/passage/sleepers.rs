//! Sleepers of the whole track in one time step, in coordinates that diagonalise their effective matrices.
//!
//! The sleepers are alike but for the ballast k of each. In the coordinates y of this module the effective matrix of the
//! sleeper alone is I and that of the bed is diag β, so that on any ballast it is D = diag(1 + g β), with g the effective
//! stiffness of the bed. With the pads' effective stiffness G, seat shapes Φ and rail motion w:
//!   D v = f + G Φ p,   p = w − Φᵀ v = S (w − Φᵀ D⁻¹ f),   S = (I + G Φᵀ D⁻¹ Φ)⁻¹,
//! and the rails feel G S w − G S Φᵀ D⁻¹ f: two numbers per sleeper, whatever the number of its coordinates.

use aligned_vec::avec;
use nalgebra::{DMatrix, DVector, Matrix2, SymmetricEigen};
use pulp::Simd;

use super::basis::SleeperBasis;
use super::effective::Shares;
use super::error::SimulationError;
use super::model::{BLOCK, CHUNK, Lanes, TrackModel};
use super::support::Support;
use super::vectors::{Aligned, of_chunks, of_chunks_mut, parts, vectors, vectors_mut};

/// The same of neighbouring coordinates.
pub(super) type Block = [f64; BLOCK];

/// All sleepers; values per sleeper and coordinate are at `[sleeper / 8 · coordinates + coordinate][sleeper % 8]`.
#[derive(Clone, Debug)]
pub(super) struct Sleepers {
    /// Number of coordinates, filled up to whole blocks by some that never move.
    pub coordinates: usize,
    /// Deflection at the sensor per coordinate.
    pub sensor: Vec<f64>,
    /// Deflection of each support point per coordinate.
    pub points: Vec<Vec<Block>>,
    /// Deflection at crossing and stock seat per coordinate.
    seat: Vec<[Block; 2]>,
    /// Elastic stiffness, `[block of columns · coordinates + row]`.
    elastic: Vec<Block>,
    elastic_damping_s: f64,
    /// β.
    bed: Vec<Block>,
    pad: Pad,
    /// Effective ballast g, stiffness k, damping c per chunk.
    ballast: Aligned<Ballast>,
    /// D⁻¹.
    inverse: Aligned<Lanes>,
    /// S₀₀, S₀₁, S₁₁ per chunk.
    through: Aligned<[Lanes; 3]>,
    /// Chunks in which some bed is not linear: their rates are kept from step to step.
    nonlinear: Vec<bool>,
    /// Coordinates of the model per coordinate of this module.
    transform: DMatrix<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Pad {
    effective: f64,
    stiffness: f64,
    damping: f64,
}

#[derive(Clone, Copy, Debug)]
struct Ballast {
    stiffness: Lanes,
    damping: Lanes,
}

/// Motion of the sleepers: displacement u, rate v at t + θ dt, momentum term b (within a step with the forces of nonlinear beds).
#[derive(Clone, Debug)]
pub(super) struct SleeperState {
    pub u: Aligned<Lanes>,
    /// Kept where a bed is not linear.
    pub v: Aligned<Lanes>,
    pub b: Aligned<Lanes>,
    /// Forces of the nonlinear beds in this step.
    pub correction: Aligned<Lanes>,
    /// Rates one step earlier.
    pub earlier: Aligned<Lanes>,
    /// Of both pads, `[chunk · 2 + side]`: motion of the seat without the rails, then rate of compression, then force.
    pads: Aligned<Lanes>,
    /// Rates and deformation that one chunk advances with.
    advance: [Aligned<Lanes>; 2],
}

impl Sleepers {
    pub fn new(model: &TrackModel, shares: Shares) -> Result<Self, SimulationError> {
        let (basis, layout) = (&model.basis, model.layout);
        let on_bed = |s: usize| {
            let (k, c) = model.supports[s].implicit();
            shares.mass * model.supports[s].mass_kg_m + shares.damping * c + shares.stiffness * k
        };
        let mean = (0..layout.sleepers).map(on_bed).sum::<f64>() / layout.sleepers as f64;
        // Without inertia the sleeper alone moves freely: the mean bed is counted with it.
        let shift = if shares.mass > 0.0 { 0.0 } else { mean };
        let (transform, beta) = diagonalise(basis, shares, shift)?;
        let shaped = |row: &[f64]| transform.tr_mul(&DVector::from_column_slice(row));
        let (n, chunks) = (basis.len().next_multiple_of(BLOCK), layout.stride / CHUNK);
        let seats = basis.seat.each_ref().map(|seat| blocks(shaped(seat).as_slice()));
        let elastic = DMatrix::from_diagonal(&DVector::from_column_slice(&basis.elastic));
        let elastic = (transform.tr_mul(&elastic) * &transform).resize(n, n, 0.0);
        let mut sleepers = Self {
            coordinates: n,
            sensor: blocks(shaped(&basis.sensor).as_slice()).into_flattened(),
            points: (&basis.points * &transform)
                .row_iter()
                .map(|row| blocks(&row.iter().copied().collect::<Vec<f64>>()))
                .collect(),
            seat: seats[0].iter().zip(&seats[1]).map(|(crossing, stock)| [*crossing, *stock]).collect(),
            elastic: (0..n / BLOCK)
                .flat_map(|block| (0..n).map(move |row| [block, row]))
                .map(|[block, row]| std::array::from_fn(|j| elastic[(row, block * BLOCK + j)]))
                .collect(),
            elastic_damping_s: basis.damping_s,
            pad: Pad {
                effective: shares.damping * model.pad.damping + shares.stiffness * model.pad.stiffness,
                stiffness: model.pad.stiffness,
                damping: model.pad.damping,
            },
            ballast: avec![Ballast { stiffness: [0.0; CHUNK], damping: [0.0; CHUNK] }; chunks],
            inverse: avec![[0.0; CHUNK]; n * chunks],
            through: avec![[[0.0; CHUNK]; 3]; chunks],
            nonlinear: model.supports.chunks(CHUNK).map(|of| !of.iter().all(Support::is_linear)).collect(),
            bed: blocks(beta.as_slice()),
            transform,
        };
        sleepers.nonlinear.resize(chunks, false);
        for s in 0..layout.sleepers {
            sleepers.set(s, on_bed(s) - shift, model.supports[s].implicit())?;
        }
        Ok(sleepers)
    }

    /// D⁻¹ and S of one sleeper.
    fn set(&mut self, sleeper: usize, g: f64, (k, c): (f64, f64)) -> Result<(), SimulationError> {
        let (chunk, lane, n) = (sleeper / CHUNK, sleeper % CHUNK, self.coordinates);
        (self.ballast[chunk].stiffness[lane], self.ballast[chunk].damping[lane]) = (k, c);
        let singular =
            || SimulationError::Singular { what: "effective", place: format!("sleeper {sleeper}") };
        let mut seats = Matrix2::identity();
        for i in 0..self.transform.ncols() {
            let (block, of) = (i / BLOCK, i % BLOCK);
            let diagonal = 1.0 + g * self.bed[block][of];
            if diagonal.is_nan() || diagonal <= 0.0 {
                return Err(singular());
            }
            self.inverse[chunk * n + i][lane] = 1.0 / diagonal;
            for a in 0..2 {
                for b in 0..2 {
                    seats[(a, b)] +=
                        self.pad.effective * self.seat[block][a][of] * self.seat[block][b][of] / diagonal;
                }
            }
        }
        let through = seats.try_inverse().ok_or_else(singular)?;
        let entries = [through[(0, 0)], 0.5 * (through[(0, 1)] + through[(1, 0)]), through[(1, 1)]];
        for (target, value) in self.through[chunk].iter_mut().zip(entries) {
            target[lane] = value;
        }
        Ok(())
    }

    /// Effective stiffness of the two rail seats of a sleeper: own, between them, own.
    pub fn seat_stiffness(&self, sleeper: usize) -> [f64; 3] {
        self.through[sleeper / CHUNK].map(|t| self.pad.effective * t[sleeper % CHUNK])
    }

    pub fn at_rest(&self) -> SleeperState {
        let zero = || avec![[0.0; CHUNK]; self.inverse.len()];
        let pads = avec![[0.0; CHUNK]; 2 * self.through.len()];
        let of_chunk = || avec![[0.0; CHUNK]; self.coordinates];
        SleeperState {
            u: zero(),
            v: zero(),
            b: zero(),
            correction: zero(),
            earlier: zero(),
            pads,
            advance: [of_chunk(), of_chunk()],
        }
    }

    /// Motion of the seats under the sleepers' own forces, and its action on the rail seats, added to `rails`.
    #[inline(always)]
    pub fn condense<S: Simd>(&self, simd: S, state: &mut SleeperState, rails: &mut [f64]) {
        let (n, p, stride) = (self.coordinates, parts::<S>(), self.through.len() * CHUNK);
        let (crossing, stock) = rails[..2 * stride].split_at_mut(stride);
        let (crossing, stock) = (vectors_mut::<S>(crossing), vectors_mut::<S>(stock));
        let (b, inverse) = (of_chunks::<S>(&state.b), of_chunks::<S>(&self.inverse));
        let pads = of_chunks_mut::<S>(&mut state.pads);
        let through = of_chunks::<S>(self.through.as_flattened());
        let pad = simd.splat_f64s(self.pad.effective);
        for chunk in 0..self.through.len() {
            for part in 0..p {
                let (mut t0, mut t1) = (simd.splat_f64s(0.0), simd.splat_f64s(0.0));
                for (block, seat) in self.seat.iter().enumerate() {
                    let of = block_range::<S>(chunk * n + block * BLOCK);
                    let (b, inverse) = (&b[of.clone()], &inverse[of]);
                    for i in 0..BLOCK {
                        let at = i * p + part;
                        let motion = simd.mul_f64s(inverse[at], b[at]);
                        t0 = simd.mul_add_f64s(simd.splat_f64s(seat[0][i]), motion, t0);
                        t1 = simd.mul_add_f64s(simd.splat_f64s(seat[1][i]), motion, t1);
                    }
                }
                let (at, of) = (chunk * p + part, chunk * 3 * p + part);
                (pads[chunk * 2 * p + part], pads[(chunk * 2 + 1) * p + part]) = (t0, t1);
                let (t0, t1) = (simd.mul_f64s(pad, t0), simd.mul_f64s(pad, t1));
                let [s00, s01, s11] = [through[of], through[of + p], through[of + 2 * p]];
                crossing[at] = simd.mul_add_f64s(s00, t0, simd.mul_add_f64s(s01, t1, crossing[at]));
                stock[at] = simd.mul_add_f64s(s01, t0, simd.mul_add_f64s(s11, t1, stock[at]));
            }
        }
    }

    /// Rate of pad compression of both sides, in place of the free motion of the seats.
    #[inline(always)]
    pub fn compress<S: Simd>(&self, simd: S, state: &mut SleeperState, rails: &[f64]) {
        let (p, stride) = (parts::<S>(), self.through.len() * CHUNK);
        let (crossing, stock) = rails[..2 * stride].split_at(stride);
        let (crossing, stock) = (vectors::<S>(crossing), vectors::<S>(stock));
        let pads = of_chunks_mut::<S>(&mut state.pads);
        let through = of_chunks::<S>(self.through.as_flattened());
        for chunk in 0..self.through.len() {
            for part in 0..p {
                let (first, second) = (chunk * 2 * p + part, (chunk * 2 + 1) * p + part);
                let d0 = simd.sub_f64s(crossing[chunk * p + part], pads[first]);
                let d1 = simd.sub_f64s(stock[chunk * p + part], pads[second]);
                let of = chunk * 3 * p + part;
                let [s00, s01, s11] = [through[of], through[of + p], through[of + 2 * p]];
                pads[first] = simd.mul_add_f64s(s00, d0, simd.mul_f64s(s01, d1));
                pads[second] = simd.mul_add_f64s(s01, d0, simd.mul_f64s(s11, d1));
            }
        }
    }

    /// Rates v of the sleepers; after [`Sleepers::compress`].
    #[inline(always)]
    pub fn rates<S: Simd>(&self, simd: S, state: &mut SleeperState) {
        let (n, p) = (self.coordinates, parts::<S>());
        let b = of_chunks::<S>(&state.b);
        let (inverse, pad) = (of_chunks::<S>(&self.inverse), of_chunks::<S>(&state.pads));
        let v = of_chunks_mut::<S>(&mut state.v);
        for chunk in 0..self.through.len() {
            for part in 0..p {
                let effective = simd.splat_f64s(self.pad.effective);
                let p0 = simd.mul_f64s(effective, pad[chunk * 2 * p + part]);
                let p1 = simd.mul_f64s(effective, pad[(chunk * 2 + 1) * p + part]);
                for (block, seat) in self.seat.iter().enumerate() {
                    let of = block_range::<S>(chunk * n + block * BLOCK);
                    let (b, inverse) = (&b[of.clone()], &inverse[of.clone()]);
                    let v = &mut v[of];
                    for i in 0..BLOCK {
                        let at = i * p + part;
                        v[at] = rate(simd, b[at], [seat[0][i], seat[1][i]], [p0, p1], inverse[at]);
                    }
                }
            }
        }
    }

    /// Rates v of the sleepers, their new b and u, and forces of the pads on their way into b; `rails`: old displacement. After
    /// [`Sleepers::compress`]; in one pass, because what it reads does not all fit into the nearest cache.
    ///
    /// With K = E + k B − pads: b ← b − K (u/θ + 2 dt v) − C v/θ.
    #[inline(always)]
    pub fn advance<S: Simd>(
        &self,
        simd: S,
        state: &mut SleeperState,
        rails: &[f64],
        (dt_s, theta): (f64, f64),
    ) {
        let (n, p, stride) = (self.coordinates, parts::<S>(), self.through.len() * CHUNK);
        let (crossing, stock) = rails[..2 * stride].split_at(stride);
        let (crossing, stock) = (vectors::<S>(crossing), vectors::<S>(stock));
        let SleeperState { u, v: kept, b, pads, advance: [v, deformation], .. } = state;
        let inverse = of_chunks::<S>(&self.inverse);
        let [u, v, kept, b, pads, deformation] =
            [u, v, kept, b, pads, deformation].map(|row| of_chunks_mut::<S>(row));
        let effective = simd.splat_f64s(self.pad.effective);
        let (dt, per_theta) = (simd.splat_f64s(dt_s), simd.splat_f64s(1.0 / theta));
        let elastic_rate = simd.splat_f64s(self.elastic_damping_s / theta + 2.0 * dt_s);
        let pad_stiffness = simd.splat_f64s(self.pad.stiffness / theta);
        let pad_rate = simd.splat_f64s(2.0 * dt_s * self.pad.stiffness + self.pad.damping / theta);
        for (chunk, ballast) in self.ballast.iter().enumerate() {
            let (k, c) = (vectors::<S>(&ballast.stiffness), vectors::<S>(&ballast.damping));
            let pads = &mut pads[chunk * 2 * p..(chunk + 1) * 2 * p];
            for part in 0..p {
                let (mut seat0, mut seat1) = (crossing[chunk * p + part], stock[chunk * p + part]);
                let pressed =
                    [simd.mul_f64s(effective, pads[part]), simd.mul_f64s(effective, pads[p + part])];
                for (block, seat) in self.seat.iter().enumerate() {
                    let of = block_range::<S>(chunk * n + block * BLOCK);
                    let (b, u, inverse) = (&b[of.clone()], &u[of.clone()], &inverse[of]);
                    let of_chunk = block_range::<S>(block * BLOCK);
                    let (v, deformation) = (&mut v[of_chunk.clone()], &mut deformation[of_chunk]);
                    for i in 0..BLOCK {
                        let at = i * p + part;
                        v[at] = rate(simd, b[at], [seat[0][i], seat[1][i]], pressed, inverse[at]);
                        seat0 = simd.mul_add_f64s(simd.splat_f64s(-seat[0][i]), u[at], seat0);
                        seat1 = simd.mul_add_f64s(simd.splat_f64s(-seat[1][i]), u[at], seat1);
                        deformation[at] =
                            simd.mul_add_f64s(elastic_rate, v[at], simd.mul_f64s(per_theta, u[at]));
                    }
                }
                let pad0 = simd.mul_add_f64s(pad_stiffness, seat0, simd.mul_f64s(pad_rate, pads[part]));
                let pad1 = simd.mul_add_f64s(pad_stiffness, seat1, simd.mul_f64s(pad_rate, pads[p + part]));
                (pads[part], pads[p + part]) = (pad0, pad1);
                let bed_stiffness = simd.mul_f64s(per_theta, k[part]);
                let bed_rate = simd.mul_add_f64s(
                    simd.splat_f64s(2.0 * dt_s),
                    k[part],
                    simd.mul_f64s(per_theta, c[part]),
                );
                for (block, (seat, beta)) in self.seat.iter().zip(&self.bed).enumerate() {
                    let elastic = self.elastic_forces(simd, part, deformation, block);
                    let of = block_range::<S>(chunk * n + block * BLOCK);
                    let v = &v[block_range::<S>(block * BLOCK)];
                    let (u, b) = (&mut u[of.clone()], &mut b[of]);
                    for i in 0..BLOCK {
                        let at = i * p + part;
                        let bed = simd.mul_add_f64s(bed_stiffness, u[at], simd.mul_f64s(bed_rate, v[at]));
                        let inner = simd.mul_add_f64s(simd.splat_f64s(beta[i]), bed, elastic[i]);
                        let outer = simd.mul_add_f64s(
                            simd.splat_f64s(seat[0][i]),
                            pad0,
                            simd.mul_f64s(simd.splat_f64s(seat[1][i]), pad1),
                        );
                        b[at] = simd.add_f64s(b[at], simd.sub_f64s(outer, inner));
                        u[at] = simd.mul_add_f64s(dt, v[at], u[at]);
                    }
                }
            }
            if self.nonlinear[chunk] {
                kept[chunk * n * p..(chunk + 1) * n * p].copy_from_slice(v);
            }
        }
    }

    /// Elastic forces of one block of coordinates; `deformation` of one chunk of sleepers.
    #[inline(always)]
    fn elastic_forces<S: Simd>(
        &self,
        simd: S,
        part: usize,
        deformation: &[S::f64s],
        block: usize,
    ) -> [S::f64s; BLOCK] {
        let p = parts::<S>();
        let mut forces = [simd.splat_f64s(0.0); BLOCK];
        for (columns, rows) in self.elastic.chunks_exact(self.coordinates).enumerate() {
            let (rows, deformation) =
                (&rows[block * BLOCK..(block + 1) * BLOCK], &deformation[block_range::<S>(columns * BLOCK)]);
            for (force, row) in forces.iter_mut().zip(rows) {
                for (j, e) in row.iter().enumerate() {
                    *force = simd.mul_add_f64s(simd.splat_f64s(*e), deformation[j * p + part], *force);
                }
            }
        }
        forces
    }

    /// Pad forces on one row of rail seats.
    #[inline(always)]
    pub fn advance_seats<S: Simd>(&self, simd: S, state: &SleeperState, (side, b): (usize, &mut [f64])) {
        let p = parts::<S>();
        let (pads, b) = (of_chunks::<S>(&state.pads), vectors_mut::<S>(b));
        for chunk in 0..self.through.len() {
            for part in 0..p {
                let at = chunk * p + part;
                b[at] = simd.sub_f64s(b[at], pads[(chunk * 2 + side) * p + part]);
            }
        }
    }

    /// The same motion in the coordinates of `other`, of the same model.
    pub fn convert(&self, values: &[Lanes], other: &Self) -> Result<Aligned<Lanes>, SimulationError> {
        let singular = || SimulationError::Singular { what: "mass", place: "the sleeper".into() };
        let n = self.transform.ncols();
        let change = other.transform.clone().lu().solve(&self.transform).ok_or_else(singular)?;
        let mut converted = avec![[0.0; CHUNK]; values.len()];
        for (target, source) in
            converted.chunks_exact_mut(self.coordinates).zip(values.chunks_exact(self.coordinates))
        {
            for i in 0..n {
                for (j, value) in source.iter().enumerate().take(n) {
                    for l in 0..CHUNK {
                        target[i][l] += change[(i, j)] * value[l];
                    }
                }
            }
        }
        Ok(converted)
    }
}

/// Rate of a coordinate under what acts on it: b and the pads.
#[inline(always)]
fn rate<S: Simd>(simd: S, b: S::f64s, seat: [f64; 2], pads: [S::f64s; 2], inverse: S::f64s) -> S::f64s {
    let sum = simd.mul_add_f64s(simd.splat_f64s(seat[0]), pads[0], b);
    let sum = simd.mul_add_f64s(simd.splat_f64s(seat[1]), pads[1], sum);
    simd.mul_f64s(inverse, sum)
}

/// Values per coordinate in blocks, filled up with zeros.
fn blocks(values: &[f64]) -> Vec<Block> {
    let block = |of: &[f64]| std::array::from_fn(|i| of.get(i).copied().unwrap_or(0.0));
    values.chunks(BLOCK).map(block).collect()
}

/// Vectors of the block of coordinates that begins with `first`, of all coordinates of all chunks.
#[inline(always)]
pub(super) fn block_range<S: Simd>(first: usize) -> std::ops::Range<usize> {
    let start = first * parts::<S>();
    start..start + BLOCK * parts::<S>()
}

/// T with Tᵀ P T = I and Tᵀ B T = diag β, P the effective matrix of a sleeper without pads on a bed of effective stiffness
/// `shift`, B the bed.
fn diagonalise(
    basis: &SleeperBasis,
    shares: Shares,
    shift: f64,
) -> Result<(DMatrix<f64>, DVector<f64>), SimulationError> {
    let elastic = shares.damping * basis.damping_s + shares.stiffness;
    let mut alone = &basis.bed * shift;
    for (i, e) in basis.elastic.iter().enumerate() {
        alone[(i, i)] += shares.mass + elastic * e;
    }
    let singular = || SimulationError::Singular { what: "effective", place: "a sleeper".into() };
    let lower = alone.cholesky().ok_or_else(singular)?.l();
    let half = lower.solve_lower_triangular(&basis.bed).ok_or_else(singular)?;
    let reduced = lower.solve_lower_triangular(&half.transpose()).ok_or_else(singular)?;
    let eigen = SymmetricEigen::new((&reduced + reduced.transpose()) * 0.5);
    let transform = lower.transpose().solve_upper_triangular(&eigen.eigenvectors).ok_or_else(singular)?;
    Ok((transform, eigen.eigenvalues.map(|b| b.max(0.0))))
}
