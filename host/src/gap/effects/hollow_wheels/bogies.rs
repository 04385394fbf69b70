//! Which wheelsets of the bogies of a train are hollow, by what their windows show.
//!
//! All windows are whitened by the covariance of natural wheels. What the bogies of a train have in common is not looked at: it is free,
//! and found together with who is hollow, by expectation-maximisation, from what the model has for it: from the mean of all windows it
//! ended elsewhere on some sites, and left more.

use faer::Mat;
use faer::linalg::solvers::{Llt, Solve as _};

use crate::signal::dot;

/// Neither wheelset of a bogie is hollow, the front one is, the rear one, both.
pub(super) const CASES: usize = 4;
/// Wheelsets that are hollow in each.
const HOLLOW: [f64; CASES] = [0.0, 1.0, 1.0, 2.0];
/// How much less windows say than their covariance lets them, in squares: what is simulated is not all that a hollow wheel does.
const DOUBT: f64 = 2.0;
/// Steps of expectation-maximisation.
const STEPS: usize = 12;

/// What hollow wheels add to the window of a bogie in one case.
pub(super) struct Case {
    added: Vec<f64>,
    /// What each of them differs by from the others, for one standard deviation: columns.
    own: Mat<f64>,
    solver: Option<Llt<f64>>,
    /// Half of the logarithm of the determinant of what `solver` solves.
    log_det: f64,
}

impl Case {
    /// From whitened windows: what is added, and columns of depth and shift of each hollow wheelset's own, or none.
    pub(super) fn new(added: Vec<f64>, own: Mat<f64>) -> Self {
        let gram = own.transpose() * &own;
        let n = gram.nrows();
        let gram = Mat::from_fn(n, n, |i, j| gram[(i, j)] / DOUBT + if i == j { 1.0 } else { 0.0 });
        let solver = (n > 0).then(|| gram.llt(faer::Side::Lower).ok()).flatten();
        let log_det = solver.as_ref().map_or(0.0, |s| (0..n).map(|k| s.L()[(k, k)].ln()).sum());
        Self { added, own, solver, log_det }
    }

    /// Log likelihood of a window, the likeliest that hollow wheels add to it, and what they differ by from the others.
    fn of(&self, window: &[f64]) -> (f64, Vec<f64>, Vec<f64>) {
        let left: Vec<f64> = window.iter().zip(&self.added).map(|(w, a)| w - a).collect();
        let plain = -0.5 * dot(&left, &left) / DOUBT;
        let Some(solver) = &self.solver else { return (plain, self.added.clone(), Vec::new()) };
        let columns = || (0..self.own.ncols()).map(|c| self.own.col_as_slice(c));
        let shown: Vec<f64> = columns().map(|c| dot(c, &left) / DOUBT).collect();
        let size = solver.solve(Mat::from_fn(shown.len(), 1, |k, _| shown[k]));
        let mut added = self.added.clone();
        for (column, size) in columns().zip(size.col_as_slice(0)) {
            added.iter_mut().zip(column).for_each(|(a, c)| *a += size * c);
        }
        let size = size.col_as_slice(0).to_vec();
        (plain + 0.5 * dot(&shown, &size) - self.log_det, added, size)
    }
}

/// The bogies of a passage with their hollow wheels.
pub(super) struct Weighed {
    /// Log likelihood of all windows.
    pub(super) log_likelihood: f64,
    /// Number of hollow wheelsets to be expected.
    pub(super) hollow: f64,
    /// What they all differ by from what they are thought to be, standard deviations: depth and shift, sums.
    pub(super) own: [f64; 2],
    /// What they add to every window.
    pub(super) added: Vec<Vec<f64>>,
    /// What all bogies have in common.
    common: Vec<f64>,
}

impl Weighed {
    /// Of the windows of a train, at least one, of whose wheelsets a share is hollow.
    pub(super) fn of(windows: &[Vec<f64>], cases: &[Case; CASES], share: f64) -> Self {
        let right = vec![0.0; windows.first().map_or(0, Vec::len)];
        Self::weigh(windows, cases, share, right).settled(windows, cases, share)
    }

    /// The same with other cases.
    pub(super) fn again(self, windows: &[Vec<f64>], cases: &[Case; CASES], share: f64) -> Self {
        Self::weigh(windows, cases, share, self.common).settled(windows, cases, share)
    }

    fn settled(mut self, windows: &[Vec<f64>], cases: &[Case; CASES], share: f64) -> Self {
        for _ in 1..STEPS {
            self = Self::weigh(windows, cases, share, common(windows, &self.added));
        }
        self
    }

    fn weigh(windows: &[Vec<f64>], cases: &[Case; CASES], share: f64, common: Vec<f64>) -> Self {
        let (q, p) = (share.ln(), (1.0 - share).ln());
        let prior = [2.0 * p, q + p, q + p, 2.0 * q];
        let mut out = Self { log_likelihood: 0.0, hollow: 0.0, own: [0.0; 2], added: Vec::new(), common };
        for window in windows {
            let left: Vec<f64> = window.iter().zip(&out.common).map(|(w, c)| w - c).collect();
            let found = cases.each_ref().map(|case| case.of(&left));
            let logs: [f64; CASES] = std::array::from_fn(|k| prior[k] + found[k].0);
            let top = logs.into_iter().fold(f64::NEG_INFINITY, f64::max);
            let sum: f64 = logs.iter().map(|l| (l - top).exp()).sum();
            let mut mean = vec![0.0; left.len()];
            for (k, (_, added, own)) in found.iter().enumerate() {
                let probability = (logs[k] - top).exp() / sum;
                out.hollow += probability * HOLLOW[k];
                // Depth and shift of one wheelset, then of the other.
                own.iter().enumerate().for_each(|(c, size)| out.own[c % 2] += probability * size);
                mean.iter_mut().zip(added).for_each(|(m, a)| *m += probability * a);
            }
            out.log_likelihood += top + sum.ln();
            out.added.push(mean);
        }
        out
    }
}

/// Mean of what windows hold beside what is added to them.
fn common(windows: &[Vec<f64>], added: &[Vec<f64>]) -> Vec<f64> {
    let mut mean = vec![0.0; windows.first().map_or(0, Vec::len)];
    for (window, added) in windows.iter().zip(added) {
        let left = window.iter().zip(added).map(|(w, a)| (w - a) / windows.len() as f64);
        mean.iter_mut().zip(left).for_each(|(m, l)| *m += l);
    }
    mean
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::passage::random::Random;

    /// What a window shows for the front wheelset (bumps at 3 and 5) and for the rear one (9 and 11).
    const FRONT: [f64; 12] = [0.0, 0.0, 0.0, 8.0, 0.0, -6.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    const REAR: [f64; 12] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 8.0, 0.0, -6.0];

    fn of_case(case: usize, size: f64) -> Vec<f64> {
        let [front, rear] = [[0.0, 1.0, 0.0, 1.0][case], [0.0, 0.0, 1.0, 1.0][case]];
        FRONT.iter().zip(REAR).map(|(f, r)| size * (front * f + rear * r)).collect()
    }

    fn alike() -> [Case; CASES] {
        std::array::from_fn(|case| Case::new(of_case(case, 1.0), Mat::zeros(12, 0)))
    }

    /// A window of 1.2 times what hollow wheels add on average, c with |c| = 10, where they differ by a tenth, d = c/10. With a doubt of 2
    /// that leaves e = c/5 and −|e|²/4; dᵀe/2 = 1 over 1 + |d|²/2 are two thirds of a deviation, which gain half of that, less
    /// ln(1 + |d|²/2)/2.
    #[test]
    fn analytic_what_a_hollow_wheel_differs_by() {
        let own = Mat::from_fn(12, 1, |k, _| 0.1 * FRONT[k]);
        let (log_likelihood, added, own) = Case::new(FRONT.to_vec(), own).of(&of_case(1, 1.2));
        let (shown, one): (f64, f64) = (0.5 * 0.2 * 10.0, 1.0 + 0.5);
        let expected = -0.25 * 4.0 + 0.5 * shown * shown / one - 0.5 * one.ln();
        assert!((log_likelihood - expected).abs() < 1e-12, "{log_likelihood} {expected}");
        assert!((added[3] - 8.0 * (1.0 + 0.1 * shown / one)).abs() < 1e-12, "{added:?}");
        assert!((own[0] - shown / one).abs() < 1e-12, "{own:?}");
    }

    /// Six of twenty bogies have hollow wheels, over a path that is off by what a third of them would show.
    #[test]
    fn property_hollow_wheels_are_told_from_what_all_bogies_have_in_common() {
        let mut random = Random::new(11, 0);
        let case_of = |bogie: usize| {
            [3, 0, 1, 0, 0, 2, 0, 0, 0, 1].get(bogie).copied().unwrap_or(usize::from(bogie > 17))
        };
        let window = |bogie: usize, random: &mut Random| -> Vec<f64> {
            let shown = of_case(case_of(bogie), 1.0);
            shown.iter().enumerate().map(|(k, s)| s + 3.0 * (k as f64).sin() + random.normal()).collect()
        };
        let windows: Vec<Vec<f64>> = (0..20).map(|bogie| window(bogie, &mut random)).collect();
        let found = Weighed::of(&windows, &alike(), 0.2);
        assert!((found.hollow - 7.0).abs() < 0.2, "{}", found.hollow);
        for (bogie, added) in found.added.iter().enumerate() {
            let expected = of_case(case_of(bogie), 1.0);
            assert!(added.iter().zip(expected).all(|(a, e)| (a - e).abs() < 0.5), "{bogie}: {added:?}");
        }
        let without = Weighed::of(
            &windows,
            &std::array::from_fn(|_| Case::new(of_case(0, 1.0), Mat::zeros(12, 0))),
            0.2,
        );
        assert!(found.log_likelihood > without.log_likelihood + 50.0);
    }
}
