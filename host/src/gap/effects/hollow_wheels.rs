//! Hollow-worn wheels: some wheels take a deeper (or shallower) path through the transition, and another place for it.
//!
//! A hollow tread is carried over by the wing rail for longer and drops farther (paper, section 3.2: two of its seventeen
//! scanned profiles are outliers). Every wheel has a depth and a shift of its own; natural ones scatter about one mean, hollow
//! ones form a group beside it. So the depth and shift that each wheelset shows are compared with one Gaussian, with two
//! Gaussians of the same mean, and with two groups.

use faer::Mat;
use faer::linalg::solvers::{Llt, Solve as _};
use rayon::prelude::*;

use crate::gap::data::RATE_HZ;
use crate::gap::effect::{Advice, Stage};
use crate::gap::fit::whitened;
use crate::gap::forward::Simulator;
use crate::gap::latent::{Latent, LatentFit, Scene};
use crate::gap::variation::{MOST_NATURAL_DEPTH, Variation};

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
/// By how much wheels must differ by more than natural ones do, nats: a simulated site with natural wheels, some of which lose contact,
/// reaches 0.1 with a spread of 0.122; hollow ones over soft pads 9.
const BEYOND_CHANCE: f64 = 5.0;
/// Steps of the fit of a mixture.
const STEPS: usize = 60;
/// Shares of the second group from which it starts.
const START_SHARES: [f64; 3] = [0.15, 0.3, 0.45];
/// Least spread of natural wheels: depth (relative), shift (metres).
const LEAST_SD: [f64; 2] = [0.01, 2e-3];
/// What is looked up in simulations of one speed is not known better: depth beyond 1 and shift, relative.
const LINEAR_ERROR: f64 = 0.2;
/// Shifts are looked up no finer than this, metres.
const LEAST_SHIFT_M: f64 = 2.5e-3;
/// Shares of the groups differ by less than twice this from one half: neither is the majority for sure.
const EVEN: f64 = 0.12;

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

    fn advice(&self) -> Advice {
        Advice {
            what: "some wheels are worn hollow",
            action: "Nothing to repair on the panel. Tell the vehicles' owner: have the treads of these trains measured.",
        }
    }

    fn alike(&self) -> bool {
        true
    }

    fn explore(&self, scene: &Scene) -> Option<LatentFit> {
        let all: Vec<Own> =
            (0..scene.observed.len()).into_par_iter().flat_map_iter(|i| own(scene, i)).collect();
        let learnt: Vec<Own> = all.iter().copied().filter(|o| scene.train.contains(&o.passage)).collect();
        if learnt.len() < 24 {
            return None;
        }
        let (gain, two) = grouped(&learnt)?;
        let windows: Vec<Vec<Vec<f64>>> = (0..scene.observed.len())
            .map(|i| {
                let mut list = vec![vec![0.0; scene.observed[i].mean.len()]; scene.residuals[i].len()];
                for o in all.iter().filter(|o| o.passage == i) {
                    // What natural wheels show as well is the path's.
                    let off = |k: usize| two.second(o) * (two.mean[1][k] - two.mean[0][k]);
                    let columns = plain_columns(scene, i, o.axle);
                    for (k, value) in list[o.bogie].iter_mut().enumerate() {
                        *value += off(0) * columns[(k, 0)] + off(1) * columns[(k, 1)];
                    }
                }
                list
            })
            .collect();
        let shown = Shown::simulated(scene)?;
        Some(LatentFit {
            apart: false,
            gain,
            parameters: two.parameters(learnt.len(), &shown),
            decay_s: None,
            wheel_share: Some(two.share),
            traces: scene.spread(&windows),
            windows,
        })
    }
}

/// Two groups of wheelsets, and what they gain over natural wheels in log evidence, nats. Where all together differ by more than those
/// do, beyond chance, two spreads about one mean are no alternative that must lose by far.
fn grouped(list: &[Own]) -> Option<(f64, Mixture)> {
    let plain = Mixture::one(list);
    let natural = plain.naturally_spread().score(list);
    let two = Mixture::groups(&plain, list)?;
    let score = two.score(list);
    let unnatural = plain.score(list) - natural > BEYOND_CHANCE;
    let least = if unnatural { 0.0 } else { CHOICE + GROUPED };
    if score - Mixture::scales(&plain, list).score(list) < least {
        return None;
    }
    Some((score - natural - CHOICE, two))
}

/// What a path deeper by its own depth and shifted by 1 m adds to a window: two columns.
fn plain_columns(scene: &Scene, passage: usize, axle: usize) -> Mat<f64> {
    let moves = &scene.shapes[passage].moves[axle];
    Mat::from_fn(moves.depth.len(), 2, |k, c| if c == 0 { moves.depth[k] } else { moves.shift[k] })
}

/// Least squares for depth and shift of both wheelsets of a bogie in the windows of one passage.
struct Estimator {
    factor: Llt<f64>,
    /// Whitened columns: depth and shift of the front, then of the rear wheelset.
    columns: Mat<f64>,
    solver: Llt<f64>,
}

impl Estimator {
    fn new(scene: &Scene, passage: usize) -> Option<Self> {
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
        let factor = scene.shapes[passage].factor(&variation)?;
        let plain = [0, 1].map(|axle| plain_columns(scene, passage, axle));
        let columns = whitened(&factor, &Mat::from_fn(plain[0].nrows(), 4, |k, c| plain[c / 2][(k, c % 2)]));
        let gram = columns.transpose() * &columns;
        // A wheel is not shifted by more than some decimetres; that also keeps a level path solvable.
        let gram = Mat::from_fn(4, 4, |i, j| gram[(i, j)] + if i == j { [0.25, 25.0][i % 2] } else { 0.0 });
        let solver = gram.llt(faer::Side::Lower).ok()?;
        Some(Self { factor, columns, solver })
    }

    /// Depth and shift, front and rear, of every window: four rows.
    fn values(&self, windows: &[Vec<f64>]) -> Mat<f64> {
        let n = self.columns.nrows();
        let y = whitened(&self.factor, &Mat::from_fn(n, windows.len(), |k, b| windows[b][k]));
        self.solver.solve(self.columns.transpose() * &y)
    }
}

/// Depth and shift of all wheelsets of a passage, both axles of a bogie together.
fn own(scene: &Scene, passage: usize) -> Vec<Own> {
    let Some(estimator) = Estimator::new(scene, passage) else { return Vec::new() };
    let residuals = &scene.residuals[passage];
    let values = estimator.values(residuals);
    let covariance = estimator.solver.solve(Mat::<f64>::identity(4, 4));
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

/// What wheels of known depth and shift show: a wheel that leaves the rail, or meets the transition some centimetres elsewhere, is
/// not linear in either.
struct Shown {
    /// Per depth factor and shift: depth and shift that the estimator finds.
    found: Vec<Vec<[f64; 2]>>,
}

/// Depth factors and shifts (metres) simulated.
const FACTORS: [f64; 9] = [0.3, 0.6, 1.0, 1.4, 1.8, 2.2, 2.7, 3.3, 4.0];
const SHIFTS_M: [f64; 9] = [-0.12, -0.08, -0.05, -0.025, 0.0, 0.025, 0.05, 0.08, 0.12];
/// Steps between two that are simulated.
const BETWEEN: usize = 10;
/// What differences of depth and shift weigh when a wheel is looked up.
const WEIGHED: [f64; 2] = [0.05, 5e-3];
/// Hollow wheels are carried over about this far later or earlier, metres: wheels shifted much farther can show the same.
const LIKELY_SHIFT_M: f64 = 0.05;

impl Shown {
    /// Front wheels in the training passage of middle speed.
    fn simulated(scene: &Scene) -> Option<Self> {
        let middle = scene.of_middle_speed(scene.train.to_vec());
        let o = &scene.observed[middle];
        let estimator = Estimator::new(scene, middle)?;
        let simulator = Simulator::new(scene.world, o.axle_load_kg).ok()?;
        let here = simulator.response(o.speed_m_s).ok()?;
        let found = FACTORS
            .into_par_iter()
            .map(|factor| {
                let windows = SHIFTS_M
                    .iter()
                    .map(|shift_m| {
                        let own = simulator.with_own_path(0, factor, *shift_m);
                        let added = own.response(o.speed_m_s).ok()?.less(&here, 1.0);
                        Some((0..o.mean.len()).map(|k| added.at(o.first_s + k as f64 / RATE_HZ)).collect())
                    })
                    .collect::<Option<Vec<Vec<f64>>>>()?;
                let values = estimator.values(&windows);
                Some((0..SHIFTS_M.len()).map(|j| [values[(0, j)], values[(1, j)]]).collect())
            })
            .collect::<Option<Vec<_>>>()?;
        Some(Self { found })
    }

    /// Depth factor and shift (metres) of a wheel that shows `value`.
    fn of(&self, value: [f64; 2]) -> [f64; 2] {
        let fine = |values: &[f64], i: usize| {
            let (k, t) = (i / BETWEEN, (i % BETWEEN) as f64 / BETWEEN as f64);
            if t == 0.0 { values[k] } else { values[k] + t * (values[k + 1] - values[k]) }
        };
        let along = |row: &[[f64; 2]], j: usize, c: usize| {
            let column: Vec<f64> = row.iter().map(|v| v[c]).collect();
            fine(&column, j)
        };
        let mut best = (f64::INFINITY, [1.0, 0.0]);
        for j in 0..=BETWEEN * (SHIFTS_M.len() - 1) {
            let of_factors =
                [0, 1].map(|c| -> Vec<f64> { self.found.iter().map(|row| along(row, j, c)).collect() });
            let unlikely = fine(&SHIFTS_M, j) / LIKELY_SHIFT_M;
            for i in 0..=BETWEEN * (FACTORS.len() - 1) {
                let off = |c: usize| (fine(&of_factors[c], i) - value[c]) / WEIGHED[c];
                let distance = off(0).powi(2) + off(1).powi(2) + unlikely * unlikely;
                if distance < best.0 {
                    best = (distance, [fine(&FACTORS, i), fine(&SHIFTS_M, j)]);
                }
            }
        }
        best.1
    }
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

    /// No more spread in depth than wheels without a defect have.
    fn naturally_spread(mut self) -> Self {
        self.sd.iter_mut().for_each(|sd| sd[0] = sd[0].min(MOST_NATURAL_DEPTH));
        self
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
            .map(Self::natural_first)
    }

    /// Natural wheels are the majority; where neither group clearly is, those that are nearer to what the scan says.
    fn natural_first(self) -> Self {
        let away = self.mean.map(|[depth, _]| depth.abs());
        let second_is_natural = match (self.share - 0.5).abs() < EVEN {
            true => away[1] < away[0],
            false => self.share > 0.5,
        };
        let swapped = |[a, b]: [[f64; 2]; 2]| [b, a];
        match second_is_natural {
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
    fn parameters(&self, count: usize, shown: &Shown) -> Vec<(&'static str, f64, f64, f64)> {
        let off = [0, 1].map(|k| self.mean[1][k] - self.mean[0][k]);
        let [depth, shift_m] = shown.of(off);
        let members = (self.share * count as f64).max(1.0);
        // By how much more a wheel does than it shows; what all wheels show beside the scan may be depth or not.
        let scale = ((depth - 1.0).abs() / off[0].abs().max(f64::MIN_POSITIVE)).clamp(1.0, 3.0);
        let depth_half = LINEAR_ERROR * (depth - 1.0).abs()
            + scale * (1.645 * self.sd[1][0] / members.sqrt() + self.mean[0][0].abs());
        let shift_half =
            LINEAR_ERROR * shift_m.abs() + LEAST_SHIFT_M + 1.645 * self.sd[1][1] / members.sqrt();
        let share_half = 1.645 * (self.share * (1.0 - self.share) / count as f64).sqrt() + 0.05;
        vec![
            ("depth_factor", depth, (depth - depth_half).max(0.0), depth + depth_half),
            ("shift_m", shift_m, shift_m - shift_half, shift_m + shift_half),
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

    /// Depth shows at half its size and less the farther the wheel is shifted, as simulations have it.
    #[test]
    fn analytic_wheels_are_looked_up_by_what_they_show() {
        let shows = |factor: f64, shift_m: f64| {
            let near = 1.0 - (shift_m / 0.1).powi(2);
            [(0.5 * near) * (factor - 1.0) - 0.3 * (1.0 - near), 0.4 * factor * shift_m]
        };
        let found = FACTORS.iter().map(|f| SHIFTS_M.iter().map(|s| shows(*f, *s)).collect()).collect();
        let shown = Shown { found };
        for (factor, shift_m) in [(2.45, 0.02), (1.3, -0.04), (1.0, 0.0)] {
            let [f, s] = shown.of(shows(factor, shift_m));
            assert!((f - factor).abs() < 0.06 && (s - shift_m).abs() < 0.004, "{f} {s}");
        }
    }

    #[test]
    fn analytic_two_groups_are_found_and_one_is_not_split() {
        let (found, two) = grouped(&wheels(0.3, 0.06)).unwrap();
        assert!(found > 50.0, "{found}");
        assert!((two.mean[1][0] - two.mean[0][0] - 0.6).abs() < 0.03, "{two:?}");
        assert!((two.share - 0.3).abs() < 0.05, "{two:?}");
        assert!(grouped(&wheels(0.0, 0.1)).is_none());
    }

    /// Wheels of which some lose contact show two spreads: with a deviation of 0.12 of all together, a third group of them passed for
    /// hollow ones.
    #[test]
    fn regress_two_spreads_about_one_mean_are_no_groups() {
        let mut random = Random::new(5, 0);
        let list: Vec<Own> = (0..132)
            .map(|bogie| {
                let [depth, shift_m] = if random.unit() < 0.18 { [0.27, 0.015] } else { [0.059, 0.007] };
                let value = [depth * random.normal(), shift_m * random.normal()];
                Own { passage: 0, bogie, axle: 0, value, covariance: [1e-4, 0.0, 1e-6] }
            })
            .collect();
        let spread = Mixture::one(&list).sd[0][0];
        assert!(spread > MOST_NATURAL_DEPTH, "{spread}");
        assert!(grouped(&list).is_none(), "{:?}", grouped(&list));
    }

    /// Groups that run into one another are hardly better than one wide spread, which no natural wheels have.
    #[test]
    fn regress_groups_are_told_from_what_wheels_differ_by_naturally() {
        let (found, two) = grouped(&wheels(0.3, 0.3)).unwrap();
        assert!(found > 100.0, "{found}");
        assert!((two.mean[1][0] - two.mean[0][0] - 0.6).abs() < 0.15, "{two:?}");
    }
}
