//! Rows of values as vectors of the machine.
//!
//! Operations act on each lane by itself, and a multiply-add is rounded once on every machine, so that the width of the
//! vectors does not change a bit of the result.

use aligned_vec::AVec;
use pulp::Simd;

use super::model::{CHUNK, Lanes};

/// List that begins with a cache line, so that a whole chunk of a row of whole chunks never lies on two.
pub(super) type Aligned<T> = AVec<T>;

/// Vectors in a chunk.
pub(super) const fn parts<S: Simd>() -> usize {
    CHUNK / S::F64_LANES
}

/// A row; what does not fill a vector is left out, and rows of whole chunks leave nothing.
#[inline(always)]
pub(super) fn vectors<S: Simd>(row: &[f64]) -> &[S::f64s] {
    S::as_simd_f64s(row).0
}

/// A row.
#[inline(always)]
pub(super) fn vectors_mut<S: Simd>(row: &mut [f64]) -> &mut [S::f64s] {
    S::as_mut_simd_f64s(row).0
}

/// The first `count` vectors of a row from a place on. In lists of rows this is written out: `map` of an array is not compiled into the
/// step.
#[inline(always)]
pub(super) fn vectors_from<S: Simd>(row: &[f64], at: usize, count: usize) -> &[S::f64s] {
    &vectors::<S>(&row[at..])[..count]
}

/// Chunks.
#[inline(always)]
pub(super) fn of_chunks<S: Simd>(chunks: &[Lanes]) -> &[S::f64s] {
    vectors::<S>(chunks.as_flattened())
}

/// Chunks.
#[inline(always)]
pub(super) fn of_chunks_mut<S: Simd>(chunks: &mut [Lanes]) -> &mut [S::f64s] {
    vectors_mut::<S>(chunks.as_flattened_mut())
}
