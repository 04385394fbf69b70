//! Hollow-worn wheels: some wheels take a deeper (or shallower) path through the transition, and another place for it.
//!
//! A hollow tread is carried over by the wing rail for longer and drops farther (paper, section 3.2: two of its seventeen
//! scanned profiles are outliers). Every wheel has a depth and a shift of its own; natural ones scatter about one mean, hollow
//! ones form a group beside it. So the depth and shift that each wheelset shows are compared with one Gaussian, with two
//! Gaussians of the same mean, and with two groups.

use faer::Mat;
use faer::linalg::solvers::Solve as _;
use rayon::prelude::*;

use crate::gap::effect::Stage;
use crate::gap::fit::whitened;
use crate::gap::latent::{Latent, LatentFit, Scene};
use crate::gap::variation::Variation;

/// See the module.
pub struct HollowWheels;

/// Natural depth and shift are left out of the covariance that weighs a wheelset's own.
const WITHOUT: (f64, f64) = (1e-3, 1e-3);
/// Sizes of the natural variation are not taken beyond this: hollow wheels have inflated them all.
const NATURAL: Variation = Variation {
    noise_m_s2: 0.1,
    load: 0.02,
    side_load: 0.01,
    depth: WITHOUT.0,
    shift_m: WITHOUT.1,
    own_m: 10e-6,
    own_stock_m: 10e-6,
};
/// Cost of a second group's place and share, nats.
const CHOICE: f64 = 10.0;
/// By how much two groups must be better than two spreads about one mean, which waves and flats make as well, nats. A
/// simulated site with natural wheels reaches 0.3, the shallowest hollow wheels of the trials 25.
const GROUPED: f64 = 6.0;
/// Steps of the fit of a mixture.
const STEPS: usize = 60;
/// Shares of the second group from which it starts.
const START_SHARES: [f64; 3] = [0.15, 0.3, 0.45];
/// Least spread of natural wheels: depth (relative), shift (metres).
const LEAST_SD: [f64; 2] = [0.01, 2e-3];
/// Loss of contact makes a deep path's response less than linear: depth beyond 1 and shift are not known better, relative.
const LINEAR_ERROR: f64 = 0.2;

/// Depth (relative) and shift (metres, later in x) of one wheelset, with their covariance.
#[derive(Clone, Copy, Debug)]
struct Own {
    passage: usize,
    bogie: usize,
    axle: usize,
    value: [f64; 2],
    covariance: [f64; 3],
}

impl Latent for HollowWheels {
    fn name(&self) -> &'static str {
        "hollow-wheels"
    }

    fn stage(&self) -> Stage {
        Stage::Vehicle
    }

    fn explore(&self, scene: &Scene) -> Option<LatentFit> {
        let all: Vec<Own> =
            (0..scene.observed.len()).into_par_iter().flat_map_iter(|i| own(scene, i)).collect();
        let learnt: Vec<Own> = all.iter().copied().filter(|o| scene.train.contains(&o.passage)).collect();
        if learnt.len() < 24 {
            return None;
        }
        let plain = Mixture::one(&learnt);
        let wide = Mixture::scales(&plain, &learnt);
        let two = Mixture::groups(&plain, &learnt)?;
        let score = two.score(&learnt);
        if score - wide.score(&learnt) < CHOICE + GROUPED {
            return None;
        }
        let gain = score - plain.score(&learnt) - CHOICE;
        let windows: Vec<Vec<Vec<f64>>> = (0..scene.observed.len())
            .map(|i| {
                let mut list = vec![vec![0.0; scene.observed[i].mean.len()]; scene.residuals[i].len()];
                for o in all.iter().filter(|o| o.passage == i) {
                    let second = two.second(o);
                    let mean = |k: usize| second * two.mean[1][k] + (1.0 - second) * two.mean[0][k];
                    let columns = plain_columns(scene, i, o.axle);
                    for (k, value) in list[o.bogie].iter_mut().enumerate() {
                        *value += mean(0) * columns[(k, 0)] + mean(1) * columns[(k, 1)];
                    }
                }
                list
            })
            .collect();
        Some(LatentFit {
            gain,
            parameters: two.parameters(learnt.len()),
            wheel_share: Some(two.share),
            traces: scene.spread(&windows),
            windows,
        })
    }
}

/// What a path deeper by its own depth and shifted by 1 m adds to a window: two columns.
fn plain_columns(scene: &Scene, passage: usize, axle: usize) -> Mat<f64> {
    let moves = &scene.shapes[passage].moves[axle];
    Mat::from_fn(moves.depth.len(), 2, |k, c| if c == 0 { moves.depth[k] } else { moves.shift[k] })
}

/// Depth and shift of all wheelsets of a passage, both axles of a bogie together.
fn own(scene: &Scene, passage: usize) -> Vec<Own> {
    let v = &scene.variation;
    let variation = Variation {
        depth: WITHOUT.0,
        shift_m: WITHOUT.1,
        noise_m_s2: v.noise_m_s2.max(NATURAL.noise_m_s2),
        load: v.load.min(NATURAL.load),
        side_load: v.side_load.min(NATURAL.side_load),
        own_m: v.own_m.min(NATURAL.own_m),
        own_stock_m: v.own_stock_m.min(NATURAL.own_stock_m),
    };
    let Some(factor) = scene.shapes[passage].factor(&variation) else { return Vec::new() };
    let columns = [0, 1].map(|axle| plain_columns(scene, passage, axle));
    let n = columns[0].nrows();
    let x = whitened(&factor, &Mat::from_fn(n, 4, |k, c| columns[c / 2][(k, c % 2)]));
    let residuals = &scene.residuals[passage];
    let y = whitened(&factor, &Mat::from_fn(n, residuals.len(), |k, b| residuals[b][k]));
    let gram = x.transpose() * &x;
    // A wheel is not shifted by more than some decimetres; that also keeps a level path solvable.
    let gram = Mat::from_fn(4, 4, |i, j| gram[(i, j)] + if i == j { [0.25, 25.0][i % 2] } else { 0.0 });
    let Ok(solver) = gram.llt(faer::Side::Lower) else { return Vec::new() };
    let values = solver.solve(x.transpose() * &y);
    let covariance = solver.solve(Mat::<f64>::identity(4, 4));
    (0..residuals.len())
        .flat_map(|bogie| {
            [0, 1].map(|axle| {
                let (a, b) = (2 * axle, 2 * axle + 1);
                Own {
                    passage,
                    bogie,
                    axle,
                    value: [values[(a, bogie)], values[(b, bogie)]],
                    covariance: [covariance[(a, a)], covariance[(a, b)], covariance[(b, b)]],
                }
            })
        })
        .collect()
}

/// Two groups of wheelsets; a single one has share 0.
#[derive(Clone, Copy, Debug)]
struct Mixture {
    mean: [[f64; 2]; 2],
    /// Natural standard deviations of each group.
    sd: [[f64; 2]; 2],
    share: f64,
}

impl Mixture {
    fn one(list: &[Own]) -> Self {
        let start = Self { mean: [[0.0; 2]; 2], sd: [[0.1, 0.02]; 2], share: 0.0 };
        start.fitted(list, Tie::SameSpread)
    }

    /// Same mean, more spread in a part.
    fn scales(plain: &Self, list: &[Own]) -> Self {
        let wide = plain.sd[0].map(|s| 3.0 * s);
        Self { mean: plain.mean, sd: [plain.sd[0], wide], share: 0.2 }.fitted(list, Tie::SameMean)
    }

    /// A second group, from the outer part of the wheelsets in either direction of depth or shift.
    fn groups(plain: &Self, list: &[Own]) -> Option<Self> {
        let mut starts = Vec::new();
        for direction in 0..2 {
            let mut sorted: Vec<&Own> = list.iter().collect();
            sorted.sort_by(|a, b| a.value[direction].total_cmp(&b.value[direction]));
            for share in START_SHARES {
                let count = ((share * sorted.len() as f64) as usize).max(1);
                let mean = |part: &[&Own]| {
                    [0, 1].map(|k| crate::signal::mean(&part.iter().map(|o| o.value[k]).collect::<Vec<_>>()))
                };
                let sd = plain.sd[0].map(|s| 0.5 * s);
                let n = sorted.len();
                let split =
                    [(&sorted[..n - count], &sorted[n - count..]), (&sorted[count..], &sorted[..count])];
                for (inner, outer) in split {
                    starts.push(Self { mean: [mean(inner), mean(outer)], sd: [sd; 2], share });
                }
            }
        }
        starts
            .into_par_iter()
            .map(|s| s.fitted(list, Tie::SameSpread).fitted(list, Tie::Free))
            .filter(|m| m.share > 0.02 && m.share < 0.75)
            .max_by(|a, b| a.score(list).total_cmp(&b.score(list)))
            .map(Self::minority_second)
    }

    /// Natural wheels are the majority.
    fn minority_second(self) -> Self {
        let swapped = |[a, b]: [[f64; 2]; 2]| [b, a];
        match self.share > 0.5 {
            true => Self { mean: swapped(self.mean), sd: swapped(self.sd), share: 1.0 - self.share },
            false => self,
        }
    }

    fn log_density(&self, group: usize, o: &Own) -> f64 {
        let [sd, mean] = [self.sd[group], self.mean[group]];
        let [a, b, c] = [o.covariance[0] + sd[0] * sd[0], o.covariance[1], o.covariance[2] + sd[1] * sd[1]];
        let (x, y) = (o.value[0] - mean[0], o.value[1] - mean[1]);
        let det = (a * c - b * b).max(f64::MIN_POSITIVE);
        -0.5 * (c * x * x - 2.0 * b * x * y + a * y * y) / det - 0.5 * det.ln()
    }

    /// Probability that a wheelset belongs to the second group.
    fn second(&self, o: &Own) -> f64 {
        if self.share <= 0.0 {
            return 0.0;
        }
        crate::gap::latent::responsibility(self.share, self.log_density(1, o) - self.log_density(0, o))
    }

    fn score(&self, list: &[Own]) -> f64 {
        list.iter()
            .map(|o| {
                let first = self.log_density(0, o);
                first + crate::gap::latent::mixed(self.share, self.log_density(1, o) - first)
            })
            .sum()
    }

    /// Expectation-maximisation.
    fn fitted(mut self, list: &[Own], tie: Tie) -> Self {
        for _ in 0..STEPS {
            let second: Vec<f64> = list.iter().map(|o| self.second(o)).collect();
            let n = list.len() as f64;
            let weight = |o: usize, g: usize| if g == 1 { second[o] } else { 1.0 - second[o] };
            let mut moments = [[[0.0; 2]; 2]; 3];
            for (i, o) in list.iter().enumerate() {
                for g in 0..2 {
                    for k in 0..2 {
                        let noise = [o.covariance[0], o.covariance[2]][k];
                        let w = weight(i, g) / (noise + self.sd[g][k].powi(2));
                        moments[0][g][k] += w;
                        moments[1][g][k] += w * o.value[k];
                        // Spread beyond noise.
                        let off = (o.value[k] - self.mean[g][k]).powi(2) - noise;
                        moments[2][g][k] += weight(i, g) * off;
                    }
                }
            }
            let groups: f64 = second.iter().sum();
            let size = [n - groups, groups];
            for k in 0..2 {
                let at = |m: usize| [moments[m][0][k], moments[m][1][k]];
                let [w, v, s] = [at(0), at(1), at(2)];
                for g in 0..2 {
                    self.mean[g][k] = match tie {
                        Tie::SameMean => (v[0] + v[1]) / (w[0] + w[1]).max(1e-12),
                        Tie::SameSpread | Tie::Free => v[g] / w[g].max(1e-12),
                    };
                    let variance = match tie {
                        Tie::SameMean | Tie::Free => s[g] / size[g].max(1e-9),
                        Tie::SameSpread => (s[0] + s[1]) / n,
                    };
                    self.sd[g][k] = variance.max(0.0).sqrt().max(LEAST_SD[k]);
                }
            }
            if self.share > 0.0 {
                self.share = (groups / n).clamp(1e-3, 0.999);
            }
        }
        self
    }

    /// Depth and shift of the second group beside the first, and its share.
    fn parameters(&self, count: usize) -> Vec<(&'static str, f64, f64, f64)> {
        let off = |k: usize| self.mean[1][k] - self.mean[0][k];
        let members = self.share * count as f64;
        let half = |k: usize| 1.645 * self.sd[1][k] / members.max(1.0).sqrt() + LINEAR_ERROR * off(k).abs();
        let depth = 1.0 + off(0);
        let share_half = 1.645 * (self.share * (1.0 - self.share) / count as f64).sqrt() + 0.05;
        vec![
            ("depth_factor", depth, depth - half(0), depth + half(0)),
            ("shift_m", off(1), off(1) - half(1), off(1) + half(1)),
            ("share", self.share, (self.share - share_half).max(0.0), (self.share + share_half).min(1.0)),
        ]
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Tie {
    SameMean,
    SameSpread,
    Free,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::passage::random::Random;

    fn wheels(hollow: f64, spread: f64) -> Vec<Own> {
        let mut random = Random::new(3, 0);
        (0..300)
            .map(|bogie| {
                let off = if random.unit() < hollow { 1.0 } else { 0.0 };
                let value = [0.6 * off + spread * random.normal(), 0.03 * off + 0.01 * random.normal()];
                Own { passage: 0, bogie, axle: 0, value, covariance: [1e-4, 0.0, 1e-6] }
            })
            .collect()
    }

    fn gain(list: &[Own]) -> (f64, Mixture) {
        let plain = Mixture::one(list);
        let two = Mixture::groups(&plain, list).unwrap_or(plain);
        let wide = Mixture::scales(&plain, list);
        (two.score(list) - plain.score(list).max(wide.score(list)) - CHOICE, two)
    }

    #[test]
    fn analytic_two_groups_are_found_and_one_is_not_split() {
        let (found, two) = gain(&wheels(0.3, 0.06));
        assert!(found > 50.0, "{found}");
        assert!((two.mean[1][0] - two.mean[0][0] - 0.6).abs() < 0.03, "{two:?}");
        assert!((two.share - 0.3).abs() < 0.05, "{two:?}");
        let (none, _) = gain(&wheels(0.0, 0.2));
        assert!(none < 0.0, "{none}");
    }
}
