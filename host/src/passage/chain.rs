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

    /// Motion `x` under the loads `rhs`, rows of the same value of every seat; `collected` is spoilt.
    #[inline(always)]
    pub fn solve(&self, rhs: [&[f64]; 4], collected: &mut [Seat], mut x: [&mut [f64]; 4]) {
        let (n, m) = (collected.len().min(self.inverse.len()), self.middle);
        if n == 0 {
            return;
        }
        let (mut from_left, mut from_right) = ([0.0; 4], [0.0; 4]);
        let (left, right) = (m, n - 1 - m);
        let pairs = left.min(right);
        for j in 0..pairs {
            from_left = self.collect(j, &rhs, collected, from_left);
            from_right = self.collect(n - 1 - j, &rhs, collected, from_right);
        }
        for j in pairs..left {
            from_left = self.collect(j, &rhs, collected, from_left);
        }
        for j in pairs..right {
            from_right = self.collect(n - 1 - j, &rhs, collected, from_right);
        }
        let load = add(&add(&seat(&rhs, m), &from_left), &from_right);
        let middle = apply(&self.inverse[m], &load, &[0.0; 4]);
        set_seat(&mut x, m, middle);
        let (mut known_left, mut known_right) = (middle, middle);
        for j in 0..pairs {
            known_left = self.recover(m - 1 - j, collected, &mut x, known_left);
            known_right = self.recover(m + 1 + j, collected, &mut x, known_right);
        }
        for j in pairs..left {
            known_left = self.recover(m - 1 - j, collected, &mut x, known_left);
        }
        for j in pairs..right {
            known_right = self.recover(m + 1 + j, collected, &mut x, known_right);
        }
    }

    /// Collects the load of a seat with what comes from outside; returns what goes on towards the middle.
    #[inline(always)]
    fn collect(&self, at: usize, rhs: &[&[f64]; 4], collected: &mut [Seat], from_outside: Seat) -> Seat {
        let load = add(&seat(rhs, at), &from_outside);
        collected[at] = load;
        apply(&self.eliminate[at], &load, &[0.0; 4])
    }

    /// Motion of a seat, whose load was collected, from that of its neighbour.
    #[inline(always)]
    fn recover(&self, at: usize, collected: &[Seat], x: &mut [&mut [f64]; 4], known: Seat) -> Seat {
        let own = apply(&self.inverse[at], &collected[at], &[0.0; 4]);
        let motion = apply(&self.substitute[at], &known, &own);
        set_seat(x, at, motion);
        motion
    }
}

/// Values of one seat.
#[inline(always)]
fn seat(rows: &[&[f64]; 4], at: usize) -> Seat {
    [rows[0][at], rows[1][at], rows[2][at], rows[3][at]]
}

#[inline(always)]
fn set_seat(rows: &mut [&mut [f64]; 4], at: usize, values: Seat) {
    for (row, value) in rows.iter_mut().zip(values) {
        row[at] = value;
    }
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
            let rows: [Vec<f64>; 4] = std::array::from_fn(|r| rhs.iter().map(|seat| seat[r]).collect());
            let mut x = rows.clone();
            SeatChain::new(diagonal.clone(), &upper).unwrap().solve(
                rows.each_ref().map(|row| &row[..]),
                &mut rhs.clone(),
                x.each_mut().map(|row| &mut row[..]),
            );
            for i in 0..n {
                for r in 0..4 {
                    let mut sum = 0.0;
                    for k in 0..4 {
                        sum += diagonal[i][r][k] * x[k][i];
                        if i > 0 {
                            sum += upper[i - 1][k][r] * x[k][i - 1];
                        }
                        if i + 1 < n {
                            sum += upper[i][r][k] * x[k][i + 1];
                        }
                    }
                    assert!((sum - rhs[i][r]).abs() < 1e-12, "{n} {i} {r}");
                }
            }
        }
    }
}
