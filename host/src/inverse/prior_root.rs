//! Cholesky factor of the prior of what all passages share: a block per part of the profile, which the prior takes for
//! independent, and a number per scalar. Products with it cost a fraction of those with a full matrix.

use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::{Accum, Mat, MatRef, Par};
use rayon::prelude::*;

/// Lower triangular, block diagonal.
pub(super) struct PriorRoot {
    /// With the first row of each.
    blocks: Vec<(usize, Mat<f64>)>,
    len: usize,
}

impl PriorRoot {
    /// Factors of the covariances of the parts; `None` if one of them is not positive definite.
    pub(super) fn of_covariances(covariances: &[Mat<f64>]) -> Option<Self> {
        let mut out = Self { blocks: Vec::new(), len: 0 };
        for covariance in covariances {
            let factor = covariance.llt(faer::Side::Lower).ok()?;
            out.push(factor.L().to_owned());
        }
        Some(out)
    }

    /// Adds a scalar of standard deviation `sd`.
    pub(super) fn push_scalar(&mut self, sd: f64) {
        self.push(Mat::from_fn(1, 1, |_, _| sd));
    }

    fn push(&mut self, block: Mat<f64>) {
        let first = self.len;
        self.len += block.nrows();
        self.blocks.push((first, block));
    }

    /// root · x
    pub(super) fn times(&self, x: MatRef<'_, f64>) -> Mat<f64> {
        by_rows(&self.blocks, x, |root| (root, BlockStructure::TriangularLower))
    }

    /// rootᵀ · x
    pub(super) fn transposed_times(&self, x: MatRef<'_, f64>) -> Mat<f64> {
        transposed_times(&self.blocks, x)
    }

    /// 1 + rootᵀ · information · root of a symmetric matrix, lower triangle; what is above it may be left out.
    pub(super) fn whitened(&self, information: &Mat<f64>) -> Mat<f64> {
        let columns: Vec<Mat<f64>> = (0..self.blocks.len())
            .into_par_iter()
            .map(|b| {
                let (first, block) = &self.blocks[b];
                let n = block.nrows();
                let below = information.submatrix(*first, *first, self.len - first, n);
                let mut half = Mat::zeros(self.len - first, n);
                triangular::matmul(
                    &mut half,
                    BlockStructure::Rectangular,
                    Accum::Replace,
                    below,
                    BlockStructure::Rectangular,
                    block,
                    BlockStructure::TriangularLower,
                    1.0,
                    Par::Seq,
                );
                transposed_times(&self.blocks[b..], half.as_ref())
            })
            .collect();
        let mut out = Mat::identity(self.len, self.len);
        for ((first, block), column) in self.blocks.iter().zip(&columns) {
            let mut target = out.submatrix_mut(*first, *first, self.len - first, block.nrows());
            target += column;
        }
        out
    }

    /// root · covariance · rootᵀ of a symmetric matrix.
    pub(super) fn coloured(&self, covariance: &Mat<f64>) -> Mat<f64> {
        let half = self.times(covariance.as_ref());
        self.times(half.transpose())
    }
}

fn transposed_times(blocks: &[(usize, Mat<f64>)], x: MatRef<'_, f64>) -> Mat<f64> {
    by_rows(blocks, x, |root| (root.transpose(), BlockStructure::TriangularUpper))
}

/// Products of neighbouring blocks with the rows of `x`, which begin with the first of them.
fn by_rows(
    blocks: &[(usize, Mat<f64>)],
    x: MatRef<'_, f64>,
    of: impl Fn(MatRef<'_, f64>) -> (MatRef<'_, f64>, BlockStructure),
) -> Mat<f64> {
    let start = blocks.first().map_or(0, |(first, _)| *first);
    let mut out = Mat::zeros(x.nrows(), x.ncols());
    for (first, block) in blocks {
        let (matrix, structure) = of(block.as_ref());
        triangular::matmul(
            out.subrows_mut(first - start, block.nrows()),
            BlockStructure::Rectangular,
            Accum::Replace,
            matrix,
            structure,
            x.subrows(first - start, block.nrows()),
            BlockStructure::Rectangular,
            1.0,
            Par::Seq,
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn property_products_are_those_of_the_full_matrix() {
        let covariance = |n: usize, by: f64| {
            Mat::from_fn(n, n, |i, j| (-by * i.abs_diff(j) as f64).exp() + if i == j { 0.1 } else { 0.0 })
        };
        let mut root = PriorRoot::of_covariances(&[covariance(5, 0.3), covariance(3, 0.7)]).unwrap();
        root.push_scalar(2.0);
        let full = root.times(Mat::identity(9, 9).as_ref());
        let symmetric = Mat::from_fn(9, 9, |i, j| ((i + j) as f64).sin() + ((i * j) as f64).cos());
        let coloured = &full * &symmetric * full.transpose();
        let whitened = Mat::<f64>::identity(9, 9) + full.transpose() * &symmetric * &full;
        assert!((root.coloured(&symmetric) - &coloured).norm_max() < 1e-12 * coloured.norm_max());
        let found = root.whitened(&symmetric);
        for j in 0..9 {
            for i in j..9 {
                assert!((found[(i, j)] - whitened[(i, j)]).abs() < 1e-12 * whitened.norm_max());
            }
        }
    }
}
