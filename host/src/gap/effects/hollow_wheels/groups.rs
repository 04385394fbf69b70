//! Two groups of wheelsets, by the depth and shift that each shows.

use rayon::prelude::*;

use super::Hollow;
use super::own::Own;
use crate::gap::variation::MOST_NATURAL_DEPTH;

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
/// What is simulated over a track that is not known is not known better: depth beyond 1 and shift, relative.
const LINEAR_ERROR: f64 = 0.2;
/// Shifts are told no finer than this, metres.
const LEAST_SHIFT_M: f64 = 2.5e-3;
/// Shares of the groups differ by less than twice this from one half: neither is the majority for sure.
const EVEN: f64 = 0.12;

/// Two groups of wheelsets, and what they gain over natural wheels in log evidence, nats. Where all together differ by more than those
/// do, beyond chance, two spreads about one mean are no alternative that must lose by far.
pub(super) fn grouped(list: &[Own]) -> Option<(f64, Mixture)> {
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

/// Two groups of wheelsets; a single one has share 0.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mixture {
    mean: [[f64; 2]; 2],
    /// Natural standard deviations of each group.
    sd: [[f64; 2]; 2],
    pub(super) share: f64,
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

    /// By how much the second group's depth and shift differ from the first's.
    pub(super) fn off(&self) -> [f64; 2] {
        [0, 1].map(|k| self.mean[1][k] - self.mean[0][k])
    }

    /// What the second group is, beside the first, as parameters with how well `count` wheelsets tell it.
    pub(super) fn parameters(&self, count: usize, hollow: Hollow) -> Vec<(&'static str, f64, f64, f64)> {
        let Hollow { depth_factor, shift_m, share } = hollow;
        let members = (share * count as f64).max(1.0);
        // By how much more a wheel does than it shows; what all wheels show beside the scan may be depth or not.
        let scale = ((depth_factor - 1.0).abs() / self.off()[0].abs().max(f64::MIN_POSITIVE)).clamp(1.0, 3.0);
        let depth_half = LINEAR_ERROR * (depth_factor - 1.0).abs()
            + scale * (1.645 * self.sd[1][0] / members.sqrt() + self.mean[0][0].abs());
        let shift_half =
            LINEAR_ERROR * shift_m.abs() + LEAST_SHIFT_M + 1.645 * self.sd[1][1] / members.sqrt();
        let share_half = 1.645 * (share * (1.0 - share) / count as f64).sqrt() + 0.05;
        vec![
            ("depth_factor", depth_factor, (depth_factor - depth_half).max(0.0), depth_factor + depth_half),
            ("shift_m", shift_m, shift_m - shift_half, shift_m + shift_half),
            ("share", share, (share - share_half).max(0.0), (share + share_half).min(1.0)),
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
            .map(|_| {
                let off = if random.unit() < hollow { 1.0 } else { 0.0 };
                let value = [0.6 * off + spread * random.normal(), 0.03 * off + 0.01 * random.normal()];
                Own { value, covariance: [1e-4, 0.0, 1e-6] }
            })
            .collect()
    }

    #[test]
    fn property_two_groups_are_found_and_one_is_not_split() {
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
            .map(|_| {
                let [depth, shift_m] = if random.unit() < 0.18 { [0.27, 0.015] } else { [0.059, 0.007] };
                let value = [depth * random.normal(), shift_m * random.normal()];
                Own { value, covariance: [1e-4, 0.0, 1e-6] }
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
