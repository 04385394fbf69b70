//! Derivatives of the receptance with respect to ballast stiffness: forward sensitivities of the same factorisation.
//!
//! A x = b holds the sleepers condensed to their seats. With one stiffness moved, A dx = db − dA x: one more back
//! substitution per direction instead of two more systems.

use faer::c64;
use rayon::prelude::*;

use super::block::ZERO;
use super::sleeper::Compliance;
use super::{CondensedSleeper, SensorReceptance, Track, once_per};

/// Derivative of a condensed sleeper by its ballast stiffness.
#[derive(Clone, Copy)]
struct SleeperSlope {
    seat_stiffness: [[c64; 2]; 2],
    sensor_load: [c64; 2],
}

impl Track {
    /// Receptance as [`Track::sensor_receptance`] gives it, and its derivative along each of `directions`: change of the
    /// stiffness of every sleeper, N/m² per unit of a parameter.
    pub fn sensor_receptance_and_slopes(
        &self,
        frequency_hz: &[f64],
        ballast_n_m2: &[f64],
        directions: &[Vec<f64>],
    ) -> (SensorReceptance, Vec<SensorReceptance>) {
        let lines: Vec<Vec<Vec<[c64; 4]>>> = frequency_hz
            .par_iter()
            .map(|f| self.solution_and_slopes(std::f64::consts::TAU * f, ballast_n_m2, directions))
            .collect();
        let receptance = |which: usize| SensorReceptance::of(frequency_hz, lines.iter().map(|l| &l[which]));
        (receptance(0), (1..=directions.len()).map(receptance).collect())
    }

    /// Rail motion under a unit force at the sensor, then its derivatives.
    fn solution_and_slopes(
        &self,
        omega: f64,
        ballast_n_m2: &[f64],
        directions: &[Vec<f64>],
    ) -> Vec<Vec<[c64; 4]>> {
        let system = self.system(omega, ballast_n_m2);
        let x = self.sensor_solution(&system);
        let slopes = self.sleeper_slopes(omega, ballast_n_m2);
        let mut out = vec![x];
        for direction in directions {
            let mut rhs = vec![[ZERO; 4]; self.node_x_m.len()];
            for (sleeper, (slope, by)) in slopes.iter().zip(direction).enumerate() {
                if *by == 0.0 {
                    continue;
                }
                let node = self.seat_node(sleeper);
                let at = [out[0][node][0], out[0][node][2]];
                for i in 0..2 {
                    let mut value =
                        -(slope.seat_stiffness[i][0] * at[0] + slope.seat_stiffness[i][1] * at[1]);
                    if sleeper == self.sensor_sleeper {
                        value += slope.sensor_load[i];
                    }
                    rhs[node][2 * i] += value * *by;
                }
            }
            system.factor.solve(&mut rhs);
            out.push(rhs);
        }
        out
    }

    fn sleeper_slopes(&self, omega: f64, ballast_n_m2: &[f64]) -> Vec<SleeperSlope> {
        let mut known: Vec<(f64, SleeperSlope)> = Vec::new();
        ballast_n_m2
            .iter()
            .take(self.sleeper_x_m.len())
            .map(|stiffness| once_per(&mut known, *stiffness, |k| self.sleeper_slope(omega, *k)))
            .collect()
    }

    /// S = (C + 1/pad)⁻¹ and the load S c, differentiated: dS = −S dC S, d(S c) = dS c + S dc.
    fn sleeper_slope(&self, omega: f64, ballast_n_m2: f64) -> SleeperSlope {
        let ballast = c64::new(ballast_n_m2, omega * self.ballast_damping_ns_m2);
        let (c, dc): (Compliance, Compliance) = self.sleeper.compliance_and_slope(omega, ballast);
        let CondensedSleeper { seat_stiffness: s, .. } = self.condense(omega, ballast_n_m2);
        let product = |a: &[[c64; 2]; 2], b: &[[c64; 2]; 2]| -> [[c64; 2]; 2] {
            std::array::from_fn(|i| std::array::from_fn(|j| a[i][0] * b[0][j] + a[i][1] * b[1][j]))
        };
        let seats: [[c64; 2]; 2] = std::array::from_fn(|i| std::array::from_fn(|j| -dc[i][j]));
        let ds = product(&product(&s, &seats), &s);
        let sensor_load = std::array::from_fn(|i| {
            (0..2).fold(ZERO, |sum, j| sum + ds[i][j] * c[j][2] + s[i][j] * dc[j][2])
        });
        SleeperSlope { seat_stiffness: ds, sensor_load }
    }
}

#[cfg(test)]
mod tests {
    use crate::track::Mesh;
    use crate::verification::reference::{SOFT, STIFF, panel, t1};

    /// Against central differences, whose own error is of the second order in the step.
    #[test]
    fn property_slopes_are_those_of_finite_differences() {
        let f = [0.0, 8.0, 19.0, 60.0];
        for track in [panel(SOFT, Mesh::default()), panel(STIFF, Mesh::default()), t1(STIFF, 0.3)] {
            let n = track.sleeper_x_m.len();
            let ballast: Vec<f64> = (0..n).map(|i| 20e6 + 1e6 * (i % 5) as f64).collect();
            let middle = track.sensor_sleeper;
            let all = vec![1e6; n];
            let one: Vec<f64> = (0..n).map(|i| if i == middle { 1e6 } else { 0.0 }).collect();
            let beside: Vec<f64> = (0..n).map(|i| if i == middle + 2 { 1e6 } else { 0.0 }).collect();
            let directions = [all, one, beside];
            let (value, slopes) = track.sensor_receptance_and_slopes(&f, &ballast, &directions);
            assert_eq!(value.crossing, track.sensor_receptance(&f, &ballast).crossing);
            for (direction, slope) in directions.iter().zip(&slopes) {
                let at = |step: f64| {
                    let moved: Vec<f64> = ballast.iter().zip(direction).map(|(k, d)| k + step * d).collect();
                    track.sensor_receptance(&f, &moved)
                };
                let (above, below) = (at(0.01), at(-0.01));
                for k in 0..f.len() {
                    let largest =
                        slope.crossing[k].iter().map(|v| v[0].norm()).fold(f64::MIN_POSITIVE, f64::max);
                    for i in 0..track.node_x_m.len() {
                        for dof in 0..2 {
                            let difference = (above.crossing[k][i][dof] - below.crossing[k][i][dof]) / 0.02;
                            assert!((difference - slope.crossing[k][i][dof]).norm() < 1e-5 * largest);
                            let difference = (above.stock[k][i][dof] - below.stock[k][i][dof]) / 0.02;
                            assert!((difference - slope.stock[k][i][dof]).norm() < 1e-5 * largest);
                        }
                    }
                }
            }
        }
    }
}
