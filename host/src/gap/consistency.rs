//! Whether the recordings of a site belong together, before anything is concluded from them.

use faer::Mat;

use super::data::{Observed, RATE_HZ, energies, own_energy};
use crate::signal::{between, dot};

/// Passages that do not resemble the others.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Strangers {
    /// As in the recordings.
    pub passage_id: Vec<i32>,
    /// Passages compared.
    pub of: usize,
}

/// Travel of the front axle over which passages are compared, metres, and step.
const TRAVEL_M: (f64, f64, f64) = (-2.0, 5.0, 0.02);
/// Shift allowed between two passages, steps: the axle times are not known better before a model has been fitted.
const SHIFT: i64 = 30;
/// Correlation of the mean windows below which a passage is a stranger. Speeds 10 % apart leave more than 0.6 (field
/// recordings, `examples/gaps`); other crossings less than 0.3.
const ALIKE: f64 = 0.4;
/// Part of the passages that must be strangers: a single bad recording is not another crossing.
const PART: f64 = 0.15;

impl Strangers {
    /// Compares all passages with the one that most resemble.
    pub fn among(observed: &[Observed]) -> Self {
        let curves: Vec<Curve> = observed.iter().map(Curve::of).collect();
        let n = curves.len();
        let alike = Mat::from_fn(n, n, |i, j| if i == j { 1.0 } else { curves[i].resembles(&curves[j]) });
        let followers = |i: usize| (0..n).filter(|j| alike[(i, *j)] > ALIKE).count();
        let Some(middle) = (0..n).max_by_key(|i| followers(*i)) else { return Self::default() };
        let passage_id =
            (0..n).filter(|j| alike[(middle, *j)] <= ALIKE).map(|j| observed[j].passage_id).collect();
        Self { passage_id, of: n }
    }

    /// Too many to be chance.
    pub fn matter(&self) -> bool {
        self.of > 2 && self.passage_id.len() as f64 > PART * self.of as f64
    }
}

/// What the wheels do to the sleeper is shorter than this, metres of travel; slow shifts of the baseline are the recorder's.
const SLOW_M: f64 = 1.2;

/// What a passage does to the sleeper along the travel of the front axle.
struct Curve {
    /// Mean of its bogies, less what is slow in it, m/s².
    mean: Vec<f64>,
    /// Part of its squares that is not what single wheels make of it by chance.
    common: f64,
}

/// Where less of two mean windows is common to their bogies, geometric mean, they tell nothing of one another.
const LEAST_COMMON: f64 = 0.2;

impl Curve {
    fn of(o: &Observed) -> Self {
        let bogies: Vec<Vec<f64>> = o.windows.iter().map(|w| without_slow(&along(o, w))).collect();
        let mean = without_slow(&along(o, &o.mean));
        Self { mean, common: common(&bogies) }
    }

    /// Correlation of what is common to the bogies of either passage.
    fn resembles(&self, other: &Self) -> f64 {
        let common = (self.common * other.common).sqrt();
        if common < LEAST_COMMON { 1.0 } else { resemblance(&self.mean, &other.mean) / common }
    }
}

/// Part of their mean's squares that is not what chance makes of it.
fn common(bogies: &[Vec<f64>]) -> f64 {
    let inside = energies(bogies);
    let by_chance = own_energy(inside, bogies.len()) / bogies.len().max(1) as f64;
    (1.0 - by_chance / inside.1.max(f64::MIN_POSITIVE)).max(0.0)
}

fn without_slow(curve: &[f64]) -> Vec<f64> {
    let half = (0.5 * SLOW_M / TRAVEL_M.2) as usize;
    (0..curve.len()).map(|i| curve[i] - crate::signal::mean_around(curve, i, half)).collect()
}

fn along(o: &Observed, window: &[f64]) -> Vec<f64> {
    let count = ((TRAVEL_M.1 - TRAVEL_M.0) / TRAVEL_M.2) as usize;
    (0..count)
        .map(|i| {
            let t = (TRAVEL_M.0 + i as f64 * TRAVEL_M.2) / o.speed_m_s - o.first_s;
            between(window, t * RATE_HZ).unwrap_or(0.0)
        })
        .collect()
}

/// Largest correlation within the shift allowed.
fn resemblance(a: &[f64], b: &[f64]) -> f64 {
    let norm = |v: &[f64]| dot(v, v).sqrt();
    let scale = (norm(a) * norm(b)).max(f64::MIN_POSITIVE);
    (-SHIFT..=SHIFT)
        .map(|s| {
            let (x, y) = if s >= 0 { (&a[s as usize..], b) } else { (a, &b[-s as usize..]) };
            dot(x, y) / scale
        })
        .fold(f64::NEG_INFINITY, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_resemblance_of_a_shifted_and_of_another_curve() {
        let wave = |shift: f64, k: f64| -> Vec<f64> {
            (0..350)
                .map(|i| {
                    let x = i as f64 - 170.0 - shift;
                    (k * x).sin() * (-x * x / 2000.0).exp()
                })
                .collect()
        };
        assert!(resemblance(&wave(0.0, 0.2), &wave(20.0, 0.2)) > 0.99);
        assert!(resemblance(&wave(0.0, 0.2), &wave(0.0, 0.7)) < 0.2);
    }

    /// Two bogies that differ by 2 n about a mean m, here (3, −1, 2): n² of it is chance.
    #[test]
    fn analytic_part_of_a_mean_that_is_common() {
        let bogies = [vec![4.0, -1.0, 1.0], vec![2.0, -1.0, 3.0]];
        assert!((common(&bogies) - (1.0 - 2.0 / 14.0)).abs() < 1e-12);
        // Of two means that are half chance a correlation of a half is all there can be; of such that are chance nothing is told.
        let of = |common: f64, turn: f64| {
            let mean = (0..200).map(|i| (turn * f64::from(i)).sin()).collect();
            Curve { mean, common }
        };
        assert!((of(0.5, 0.3).resembles(&of(0.5, 0.3)) - 2.0).abs() < 1e-9);
        assert!(of(0.5, 0.3).resembles(&of(0.5, 0.8)) < 0.3);
        assert_eq!(of(0.1, 0.3).resembles(&of(0.1, 0.8)), 1.0);
    }

    /// Baselines of a transducer that drift by several times the signal: the curves under them are the same.
    #[test]
    fn regress_slow_shifts_make_no_stranger() {
        let drifting = |slope: f64| -> Vec<f64> {
            (0..350)
                .map(|i| {
                    let x = f64::from(i) - 170.0;
                    (0.2 * x).sin() * (-x * x / 2000.0).exp() + slope * (-f64::from(i) / 200.0).exp()
                })
                .collect()
        };
        let (up, down) = (drifting(4.0), drifting(-4.0));
        assert!(resemblance(&up, &down) < 0.0);
        assert!(resemblance(&without_slow(&up), &without_slow(&down)) > 0.8);
    }
}
