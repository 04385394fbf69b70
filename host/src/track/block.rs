//! Symmetric block-tridiagonal systems with small complex blocks: sleepers (2×2) and the pair of rails (4×4).

use faer::c64;

/// Square complex block.
pub type Block<const B: usize> = [[c64; B]; B];
/// Some columns of a block.
pub type Columns<const B: usize, const C: usize> = [[c64; C]; B];

pub const ZERO: c64 = c64::new(0.0, 0.0);

/// Factorised complex-symmetric block-tridiagonal matrix (block LDLᵀ without pivoting between blocks; the blocks
/// of a damped structure on an elastic foundation stay well conditioned).
pub struct Factor<const B: usize> {
    /// Inverses of the eliminated diagonal blocks.
    inverse: Vec<Block<B>>,
    /// D⁻¹U of every eliminated block row.
    coupling: Vec<Block<B>>,
}

impl<const B: usize> Factor<B> {
    /// Factorises. `upper[i]` couples block i to block i+1; there must be one fewer than diagonal blocks.
    pub fn new(mut diagonal: Vec<Block<B>>, upper: &[Block<B>]) -> Self {
        let n = diagonal.len();
        let mut inverse = Vec::with_capacity(n);
        let mut coupling = Vec::with_capacity(n.saturating_sub(1));
        for i in 0..n {
            let inv = invert(diagonal[i]);
            inverse.push(inv);
            if i + 1 < n {
                let w = multiply(&inv, &upper[i]);
                subtract_transposed_product(&mut diagonal[i + 1], &upper[i], &w);
                coupling.push(w);
            }
        }
        Self { inverse, coupling }
    }

    /// Solves for one right-hand side, in place.
    pub fn solve(&self, rhs: &mut [[c64; B]]) {
        for i in 0..self.coupling.len() {
            let previous = rhs[i];
            for (r, target) in rhs[i + 1].iter_mut().enumerate() {
                for (row, value) in self.coupling[i].iter().zip(&previous) {
                    *target -= row[r] * value;
                }
            }
        }
        for i in (0..self.inverse.len()).rev() {
            let mut x = apply(&self.inverse[i], &rhs[i]);
            if i < self.coupling.len() {
                let correction = apply(&self.coupling[i], &rhs[i + 1]);
                for (value, c) in x.iter_mut().zip(correction) {
                    *value -= c;
                }
            }
            rhs[i] = x;
        }
    }

    /// Some columns of the blocks (i, j), i ≤ j, of the inverse for `first` ≤ i ≤ j ≤ `last`, row by row from the diagonal on: a
    /// backward recursion costs one product per block, where solving for columns would go through the whole system each time.
    pub fn inverse_columns<const C: usize>(
        &self,
        [first, last]: [usize; 2],
        columns: [usize; C],
    ) -> Vec<Vec<Columns<B, C>>> {
        let n = self.inverse.len();
        let mut rows: Vec<Vec<Columns<B, C>>> = Vec::new();
        let mut diagonal = [[ZERO; B]; B];
        for i in (first..n).rev() {
            let below = diagonal;
            diagonal = self.inverse[i];
            if i + 1 < n {
                let across = multiply(&self.coupling[i], &below);
                for (r, row) in diagonal.iter_mut().enumerate() {
                    for (c, value) in row.iter_mut().enumerate() {
                        for k in 0..B {
                            *value += across[r][k] * self.coupling[i][c][k];
                        }
                    }
                }
            }
            if i <= last {
                let next = rows.last().map_or(&[][..], |next| next);
                let mut row = Vec::with_capacity(1 + next.len());
                row.push(std::array::from_fn(|r| columns.map(|c| diagonal[r][c])));
                row.extend(next.iter().map(|block| negative_product(&self.coupling[i], block)));
                rows.push(row);
            }
        }
        rows.reverse();
        rows
    }
}

fn negative_product<const B: usize, const C: usize>(a: &Block<B>, b: &Columns<B, C>) -> Columns<B, C> {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..B).fold(ZERO, |acc, k| acc - a[i][k] * b[k][j])))
}

fn apply<const B: usize>(m: &Block<B>, v: &[c64; B]) -> [c64; B] {
    std::array::from_fn(|i| (0..B).fold(ZERO, |acc, k| acc + m[i][k] * v[k]))
}

fn multiply<const B: usize>(a: &Block<B>, b: &Block<B>) -> Block<B> {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..B).fold(ZERO, |acc, k| acc + a[i][k] * b[k][j])))
}

/// target −= aᵀ b
fn subtract_transposed_product<const B: usize>(target: &mut Block<B>, a: &Block<B>, b: &Block<B>) {
    for i in 0..B {
        for j in 0..B {
            for k in 0..B {
                target[i][j] -= a[k][i] * b[k][j];
            }
        }
    }
}

/// Gauss-Jordan with row pivoting. A singular block (which a physical track does not have) gives infinities that
/// the caller's finite-number check reports.
pub fn invert<const B: usize>(mut a: Block<B>) -> Block<B> {
    let mut inv: Block<B> =
        std::array::from_fn(|i| std::array::from_fn(|j| if i == j { c64::new(1.0, 0.0) } else { ZERO }));
    for col in 0..B {
        let pivot =
            (col..B).max_by(|p, q| a[*p][col].norm_sqr().total_cmp(&a[*q][col].norm_sqr())).unwrap_or(col);
        a.swap(col, pivot);
        inv.swap(col, pivot);
        let scale = c64::new(1.0, 0.0) / a[col][col];
        for j in 0..B {
            a[col][j] *= scale;
            inv[col][j] *= scale;
        }
        for row in 0..B {
            if row != col {
                let factor = a[row][col];
                for j in 0..B {
                    let (x, y) = (a[col][j], inv[col][j]);
                    a[row][j] -= factor * x;
                    inv[row][j] -= factor * y;
                }
            }
        }
    }
    inv
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn property_solution_satisfies_the_system() {
        let value = |i: usize, j: usize, s: f64| {
            c64::new((1.3 * i as f64 - 0.7 * j as f64 + s).sin(), (0.3 * (i + j) as f64).cos())
        };
        let block = |s: f64| -> Block<2> { std::array::from_fn(|i| std::array::from_fn(|j| value(i, j, s))) };
        let symmetric = |s: f64| -> Block<2> {
            let b = block(s);
            std::array::from_fn(|i| {
                std::array::from_fn(|j| b[i][j] + b[j][i] + if i == j { c64::new(9.0, 2.0) } else { ZERO })
            })
        };
        let diagonal: Vec<Block<2>> = (0..5).map(|k| symmetric(k as f64)).collect();
        let upper: Vec<Block<2>> = (0..4).map(|k| block(0.5 + k as f64)).collect();
        let rhs: Vec<[c64; 2]> = (0..5).map(|k| [value(k, 1, 0.2), value(2, k, 0.9)]).collect();
        let mut x = rhs.clone();
        Factor::new(diagonal.clone(), &upper).solve(&mut x);
        let blocks = Factor::new(diagonal.clone(), &upper).inverse_columns([1, 3], [0, 1]);
        let second = Factor::new(diagonal.clone(), &upper).inverse_columns([1, 3], [1]);
        for (j, column) in [(1, 0), (2, 1), (3, 1)] {
            let mut unit = vec![[ZERO; 2]; 5];
            unit[j][column] = c64::new(1.0, 0.0);
            Factor::new(diagonal.clone(), &upper).solve(&mut unit);
            for i in 1..=j {
                for r in 0..2 {
                    let found = blocks[i - 1][j - i][r];
                    assert!((found[column] - unit[i][r]).norm() < 1e-12, "{i} {j}");
                    assert_eq!(second[i - 1][j - i][r], [found[1]], "{i} {j}");
                }
            }
        }
        for i in 0..5 {
            for r in 0..2 {
                let mut sum = ZERO;
                for k in 0..2 {
                    sum += diagonal[i][r][k] * x[i][k];
                    if i > 0 {
                        sum += upper[i - 1][k][r] * x[i - 1][k];
                    }
                    if i < 4 {
                        sum += upper[i][r][k] * x[i + 1][k];
                    }
                }
                assert!((sum - rhs[i][r]).norm() < 1e-12);
            }
        }
    }
}
