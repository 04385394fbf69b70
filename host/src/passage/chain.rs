//! Rail seats coupled along the track: a symmetric block-tridiagonal system of real 4×4 blocks, eliminated from both
//! ends towards the middle. The two halves do not wait for each other, which halves the time of a solution.

/// 4×4 block: deflection and rotation of the crossing rail, then of the stock rail.
pub type Block = [[f64; 4]; 4];
/// Values of one seat.
pub type Seat = [f64; 4];

/// Factorised chain.
#[derive(Clone, Debug, Default)]
pub struct SeatChain {
    inverse: Vec<Block>,
    /// Inverse diagonal × coupling towards the middle, transposed for a column-wise product.
    towards_middle: Vec<Block>,
    middle: usize,
}

impl SeatChain {
    /// Factorises; `upper[i]` couples seat i to seat i + 1. `None` when a block is singular.
    pub fn new(mut diagonal: Vec<Block>, upper: &[Block]) -> Option<Self> {
        let n = diagonal.len();
        let middle = n / 2;
        let mut inverse = vec![[[0.0; 4]; 4]; n];
        let mut towards_middle = vec![[[0.0; 4]; 4]; n];
        for i in 0..middle {
            inverse[i] = invert(&diagonal[i])?;
            towards_middle[i] = multiply(&inverse[i], &upper[i]);
            let update = multiply(&transpose(&upper[i]), &towards_middle[i]);
            subtract(&mut diagonal[i + 1], &update);
        }
        for i in (middle + 1..n).rev() {
            inverse[i] = invert(&diagonal[i])?;
            towards_middle[i] = multiply(&inverse[i], &transpose(&upper[i - 1]));
            let update = multiply(&upper[i - 1], &towards_middle[i]);
            subtract(&mut diagonal[i - 1], &update);
        }
        inverse[middle] = invert(&diagonal[middle])?;
        Some(Self { inverse, towards_middle, middle })
    }

    /// Solves in place.
    #[inline(always)]
    pub fn solve(&self, x: &mut [Seat]) {
        let (n, m) = (x.len().min(self.inverse.len()), self.middle);
        let pairs = m.min(n - 1 - m);
        for j in 0..pairs {
            self.eliminate(x, j, j + 1);
            self.eliminate(x, n - 1 - j, n - 2 - j);
        }
        for j in pairs..m {
            self.eliminate(x, j, j + 1);
        }
        for j in (m + 1..n - pairs).rev() {
            self.eliminate(x, j, j - 1);
        }
        x[m] = apply(&self.inverse[m], &x[m]);
        for j in (m + 1)..(n - pairs) {
            self.substitute(x, j, j - 1);
        }
        for j in (pairs..m).rev() {
            self.substitute(x, j, j + 1);
        }
        for j in (0..pairs).rev() {
            self.substitute(x, j, j + 1);
            self.substitute(x, n - 1 - j, n - 2 - j);
        }
    }

    #[inline(always)]
    fn eliminate(&self, x: &mut [Seat], from: usize, to: usize) {
        let (w, source) = (&self.towards_middle[from], x[from]);
        let mut target = x[to];
        for (row, s) in w.iter().zip(source) {
            for (t, value) in target.iter_mut().zip(row) {
                *t -= value * s;
            }
        }
        x[to] = target;
    }

    #[inline(always)]
    fn substitute(&self, x: &mut [Seat], at: usize, known: usize) {
        let (w, k) = (&self.towards_middle[at], x[known]);
        let mut value = apply(&self.inverse[at], &x[at]);
        for (v, row) in value.iter_mut().zip(w) {
            *v -= (row[0] * k[0] + row[1] * k[1]) + (row[2] * k[2] + row[3] * k[3]);
        }
        x[at] = value;
    }
}

#[inline(always)]
fn apply(m: &Block, v: &Seat) -> Seat {
    // Inverses of symmetric blocks are symmetric: columns serve as rows.
    let mut out = [0.0; 4];
    for (row, s) in m.iter().zip(v) {
        for (o, value) in out.iter_mut().zip(row) {
            *o += value * s;
        }
    }
    out
}

fn multiply(a: &Block, b: &Block) -> Block {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..4).map(|k| a[i][k] * b[k][j]).sum()))
}

fn transpose(a: &Block) -> Block {
    std::array::from_fn(|i| std::array::from_fn(|j| a[j][i]))
}

fn subtract(a: &mut Block, b: &Block) {
    for (row, other) in a.iter_mut().zip(b) {
        for (value, o) in row.iter_mut().zip(other) {
            *value -= o;
        }
    }
}

fn invert(a: &Block) -> Option<Block> {
    let matrix = nalgebra::Matrix4::from_fn(|i, j| 0.5 * (a[i][j] + a[j][i]));
    let inverse = matrix.cholesky()?.inverse();
    Some(std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (inverse[(i, j)] + inverse[(j, i)]))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn property_solution_satisfies_the_system_for_even_and_odd_lengths() {
        for n in [1, 2, 3, 6, 7] {
            let value = |i: usize, j: usize, s: f64| (1.3 * i as f64 - 0.7 * j as f64 + s).sin();
            let diagonal: Vec<Block> = (0..n)
                .map(|k| {
                    std::array::from_fn(|i| {
                        std::array::from_fn(|j| {
                            value(i, j, k as f64) + value(j, i, k as f64) + if i == j { 20.0 } else { 0.0 }
                        })
                    })
                })
                .collect();
            let upper: Vec<Block> = (1..n)
                .map(|k| std::array::from_fn(|i| std::array::from_fn(|j| value(i, j, 0.3 + k as f64))))
                .collect();
            let rhs: Vec<Seat> = (0..n).map(|k| std::array::from_fn(|i| value(i, k, 0.9))).collect();
            let mut x = rhs.clone();
            SeatChain::new(diagonal.clone(), &upper).unwrap().solve(&mut x);
            for i in 0..n {
                for r in 0..4 {
                    let mut sum = 0.0;
                    for k in 0..4 {
                        sum += diagonal[i][r][k] * x[i][k];
                        if i > 0 {
                            sum += upper[i - 1][k][r] * x[i - 1][k];
                        }
                        if i + 1 < n {
                            sum += upper[i][r][k] * x[i + 1][k];
                        }
                    }
                    assert!((sum - rhs[i][r]).abs() < 1e-12, "{n} {i} {r}");
                }
            }
        }
    }
}
