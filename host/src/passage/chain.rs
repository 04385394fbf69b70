//! Rail seats coupled along the track: a symmetric block-tridiagonal system of real 4×4 blocks, eliminated from both
//! ends towards the middle. The two halves do not wait for each other, which halves the time of a solution.

/// 4×4 block: deflection and rotation of the crossing rail, then of the stock rail.
pub type Block = [[f64; 4]; 4];
/// Values of one seat.
pub type Seat = [f64; 4];

/// Factorised chain.
#[derive(Clone, Debug, Default)]
pub struct SeatChain {
    /// Per seat; symmetric, so that columns serve as rows.
    inverse: Vec<Block>,
    /// Load moved towards the middle per load on a seat, negative, by columns.
    eliminate: Vec<Block>,
    /// Motion of a seat per motion of its neighbour towards the middle, by columns.
    substitute: Vec<Block>,
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
        // Loads move with the transpose of what motion follows: its rows are the columns of the one …
        let eliminate = towards_middle.iter().map(negative).collect();
        // … and its columns are the columns of the other.
        let substitute = towards_middle.iter().map(|w| negative(&transpose(w))).collect();
        Some(Self { inverse, eliminate, substitute, middle })
    }

    /// Solves in place.
    #[inline(always)]
    pub fn solve(&self, x: &mut [Seat]) {
        let (n, m) = (x.len().min(self.inverse.len()), self.middle);
        let (left, rest) = x[..n].split_at_mut(m);
        let Some((middle, right)) = rest.split_first_mut() else { return };
        let (mut from_left, mut from_right) = ([0.0; 4], [0.0; 4]);
        let pairs = left.len().min(right.len());
        for j in 0..pairs {
            from_left = step(&self.eliminate[j], &mut left[j], from_left);
            from_right = step(&self.eliminate[n - 1 - j], &mut right[n - 2 - m - j], from_right);
        }
        for j in pairs..left.len() {
            from_left = step(&self.eliminate[j], &mut left[j], from_left);
        }
        for j in pairs..right.len() {
            from_right = step(&self.eliminate[n - 1 - j], &mut right[n - 2 - m - j], from_right);
        }
        let load = add(&add(middle, &from_left), &from_right);
        *middle = apply(&self.inverse[m], &load, &[0.0; 4]);
        let (mut known_left, mut known_right) = (*middle, *middle);
        for j in 0..pairs {
            let (l, r) = (m - 1 - j, m + 1 + j);
            known_left = self.recover(l, &mut left[l], known_left);
            known_right = self.recover(r, &mut right[j], known_right);
        }
        for l in (0..left.len() - pairs).rev() {
            known_left = self.recover(l, &mut left[l], known_left);
        }
        for j in pairs..right.len() {
            known_right = self.recover(m + 1 + j, &mut right[j], known_right);
        }
    }

    /// Motion of a seat, whose load was collected, from that of its neighbour.
    #[inline(always)]
    fn recover(&self, at: usize, seat: &mut Seat, known: Seat) -> Seat {
        let own = apply(&self.inverse[at], seat, &[0.0; 4]);
        *seat = apply(&self.substitute[at], &known, &own);
        *seat
    }
}

/// Collects the load of a seat with what comes from outside; returns what goes on towards the middle.
#[inline(always)]
fn step(eliminate: &Block, seat: &mut Seat, from_outside: Seat) -> Seat {
    *seat = add(seat, &from_outside);
    apply(eliminate, seat, &[0.0; 4])
}

#[inline(always)]
fn add(a: &Seat, b: &Seat) -> Seat {
    std::array::from_fn(|i| a[i] + b[i])
}

/// Sum of columns times values, plus `rest`; in pairs, because each waits for the one before.
#[inline(always)]
fn apply(columns: &Block, v: &Seat, rest: &Seat) -> Seat {
    let (mut first, mut second) = ([0.0; 4], [0.0; 4]);
    for i in 0..4 {
        first[i] = columns[1][i].mul_add(v[1], columns[0][i].mul_add(v[0], rest[i]));
        second[i] = columns[3][i].mul_add(v[3], columns[2][i] * v[2]);
    }
    add(&first, &second)
}

fn negative(a: &Block) -> Block {
    a.map(|row| row.map(|value| -value))
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
