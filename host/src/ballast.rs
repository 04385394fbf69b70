//! Ballast around the crossing: three-parameter distribution of its stiffness (paper, section 3.1), its damping, and their calibration.

pub mod damping;
pub mod evidence;
pub mod low_track;
pub mod quasi_static;

use std::borrow::Cow;

use crate::track::Track;

/// Numbers that a calibration finds: the three of the stiffness, and the damping.
pub const UNKNOWNS: usize = 4;

/// Three-parameter distribution (paper, fig. 7): outer stiffness p1, stiffness p2 of the crossing sleeper, shape p3; and the damping, alike
/// under all sleepers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BallastParameters {
    /// Outer stiffness, N/m².
    pub p1_n_m2: f64,
    /// Stiffness under the crossing sleeper, N/m².
    pub p2_n_m2: f64,
    /// Shape: share of the way from p2 to p1 that the neighbouring sleeper has gone, 0 … 1.
    pub p3: f64,
    /// Damping over that of crossing.toml: nobody measures it, and force peaks follow a third of its error.
    pub damping_factor: f64,
}

impl BallastParameters {
    /// A track in good order (paper, Table 1), somewhat softer under the crossing: where searches start.
    pub const NOMINAL: Self = Self { p1_n_m2: 30e6, p2_n_m2: 25e6, p3: 0.4, damping_factor: 1.0 };

    /// Means and standard deviations of the entries of [`Self::to_vector`] before any recording: stiffness within a factor of about three
    /// around 30 MN/m² (paper, Table 1); shape between a smooth minimum under the crossing sleeper (q = s², p3 = 0.25) and a cusp
    /// (linear, p3 = 0.5), with room on both sides; damping within a factor of about 1.6 of the one described.
    pub const PRIOR: [(f64, f64); UNKNOWNS] = [(17.2, 1.0), (17.2, 1.0), (0.4, 0.1), (0.0, 0.5)];

    /// Of given stiffness, p1 and p2 in N/m², damped as described.
    pub const fn stiffness([p1_n_m2, p2_n_m2, p3]: [f64; 3]) -> Self {
        Self { p1_n_m2, p2_n_m2, p3, damping_factor: 1.0 }
    }

    /// Stiffness of the sleeper `offset` away from the crossing sleeper, N/m²: p1 from two sleepers on, otherwise
    /// p2 + (p1 − p2) q(|offset|/2) with q(s) = (4 p3 − 1) s + (2 − 4 p3) s².
    pub fn at_offset(&self, offset: i64) -> f64 {
        let s = offset.unsigned_abs() as f64 / 2.0;
        if s >= 1.0 {
            return self.p1_n_m2;
        }
        let q = (4.0 * self.p3 - 1.0) * s + (2.0 - 4.0 * self.p3) * s * s;
        self.p2_n_m2 + (self.p1_n_m2 - self.p2_n_m2) * q
    }

    /// (ln p1, ln p2, p3, ln of the damping factor), stiffnesses in N/m²: positive, and equally uncertain at any size.
    pub fn to_vector(&self) -> [f64; UNKNOWNS] {
        [self.p1_n_m2.ln(), self.p2_n_m2.ln(), self.p3, self.damping_factor.ln()]
    }

    /// Inverse of [`Self::to_vector`], within 0.4 … 490 MN/m², 0 … 1 and a factor of ten.
    pub fn from_vector(z: &[f64; UNKNOWNS]) -> Self {
        Self {
            p1_n_m2: z[0].clamp(13.0, 20.0).exp(),
            p2_n_m2: z[1].clamp(13.0, 20.0).exp(),
            p3: z[2].clamp(0.0, 1.0),
            damping_factor: z[3].clamp(-2.3, 2.3).exp(),
        }
    }

    /// The first three of [`Self::to_vector`], which the deflection under slow loads tells.
    pub fn stiffness_vector(&self) -> [f64; 3] {
        let [p1, p2, p3, _] = self.to_vector();
        [p1, p2, p3]
    }

    /// Inverse of [`Self::stiffness_vector`], damped as described.
    pub fn from_stiffness_vector([p1, p2, p3]: [f64; 3]) -> Self {
        Self::from_vector(&[p1, p2, p3, 0.0])
    }

    /// Derivatives of the stiffness of all sleepers (N/m²) by (ln p1, ln p2, p3).
    pub fn slopes(&self, n_sleepers: usize, crossing_sleeper: usize) -> [Vec<f64>; 3] {
        let difference = self.p1_n_m2 - self.p2_n_m2;
        let at = |i: usize| {
            let s = 0.5 * (i as i64 - crossing_sleeper as i64).unsigned_abs() as f64;
            if s >= 1.0 {
                return [self.p1_n_m2, 0.0, 0.0];
            }
            let q = (4.0 * self.p3 - 1.0) * s + (2.0 - 4.0 * self.p3) * s * s;
            [self.p1_n_m2 * q, self.p2_n_m2 * (1.0 - q), difference * 4.0 * (s - s * s)]
        };
        [0, 1, 2].map(|k: usize| (0..n_sleepers).map(|i| at(i)[k]).collect())
    }

    /// With entry `k` of the vector moved by `step`.
    pub fn moved(&self, k: usize, step: f64) -> Self {
        let mut z = self.to_vector();
        z[k] += step;
        Self::from_vector(&z)
    }

    /// A track with nominal damping, damped by this ballast.
    pub fn under<'t>(&self, nominal: &'t Track) -> Cow<'t, Track> {
        if self.damping_factor == 1.0 {
            return Cow::Borrowed(nominal);
        }
        let mut damped = nominal.clone();
        damped.ballast_damping_ns_m2 *= self.damping_factor;
        Cow::Owned(damped)
    }

    /// Stiffness of all sleepers of a track, N/m², known factors included.
    pub fn bed(&self, track: &Track) -> Vec<f64> {
        factored(track, self.distribution(track.sleeper_x_m.len(), track.sensor_sleeper))
    }

    /// Derivatives of [`Self::bed`] by (ln p1, ln p2, p3).
    pub fn bed_slopes(&self, track: &Track) -> [Vec<f64>; 3] {
        self.slopes(track.sleeper_x_m.len(), track.sensor_sleeper).map(|s| factored(track, s))
    }

    /// Stiffness of all sleepers, N/m².
    pub fn distribution(&self, n_sleepers: usize, crossing_sleeper: usize) -> Vec<f64> {
        (0..n_sleepers).map(|i| self.at_offset(i as i64 - crossing_sleeper as i64)).collect()
    }
}

fn factored(track: &Track, mut of_sleepers: Vec<f64>) -> Vec<f64> {
    for (offset, factor) in &track.support_factor {
        let sleeper = usize::try_from(track.sensor_sleeper as i64 + offset).ok();
        if let Some(value) = sleeper.and_then(|i| of_sleepers.get_mut(i)) {
            *value *= factor;
        }
    }
    of_sleepers
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_distribution_at_its_three_points() {
        let p = BallastParameters::stiffness([30e6, 18e6, 0.35]);
        let d = p.distribution(7, 3);
        assert_eq!(d[0], 30e6);
        assert!((d[2] - 22.2e6).abs() < 1.0);
        assert_eq!(d[3], 18e6);
        assert_eq!(d[2], d[4]);
    }

    #[test]
    fn property_slopes_of_the_distribution() {
        let p = BallastParameters::stiffness([30e6, 18e6, 0.35]);
        let slopes = p.slopes(9, 4);
        for (k, slope) in slopes.iter().enumerate() {
            let (above, below) = (p.moved(k, 1e-4).distribution(9, 4), p.moved(k, -1e-4).distribution(9, 4));
            for i in 0..9 {
                let difference = (above[i] - below[i]) / 2e-4;
                assert!((difference - slope[i]).abs() < 1e-6 * 30e6, "{k} {i}: {difference} {}", slope[i]);
            }
        }
    }
}
