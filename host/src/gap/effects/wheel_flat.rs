//! Wheel flats: a chord ground into the tread by a locked wheel, depth ℓ²/(8R) (domain: fresh flat, rounded by rolling).
//!
//! The wheel drops into it once per turn, anywhere along the track, so the burst is tied neither to the nose nor to other
//! wheels: that tells it from everything that belongs to the panel, and its shortness from a wave around the wheel. Both
//! wheels of a wheelset lock together. A flat is shorter than the waves in the band, so only its area ℓ³/(16R) shows, and a
//! long one is not followed by the wheel; a simulation with the flat turns area into length. Lengths from 20 mm (nothing
//! shows below) to 100 mm (out of service at 60 mm in most rule books).

use rayon::prelude::*;

use crate::gap::data::RATE_HZ;
use crate::gap::effect::{Advice, Stage};
use crate::gap::forward::Simulator;
use crate::gap::latent::{Latent, LatentFit, Scene, best_share, mixed, responsibility, times};
use crate::passage::WheelFlat as Flat;
use crate::signal::dot;

/// See the module.
pub struct WheelFlat;

/// Places around the wheel that are tried.
const PLACES: usize = 48;
/// Areas tried, m²: factors of 1.15 from 0.5 mm² on (a flat of 15 mm).
const AREAS: (f64, f64, usize) = (0.5e-6, 1.15, 48);
/// Cost of choosing area and share, nats.
const CHOICE: f64 = 6.0;
/// A wheel that only differs more than usual does so over lengths like this, metres.
const BROAD_M: f64 = 0.5;
/// Through the crossing, every wheel's own path makes bursts too, beyond what is linear in its depth and shift. A flat that
/// meets the rail there says nothing: metres from x = 0 on either side of the middle of the transition.
const CROSSING_M: (f64, f64) = (0.3, 0.75);
/// Lengths simulated, metres.
const LENGTHS_M: [f64; 7] = [0.02, 0.03, 0.04, 0.05, 0.065, 0.08, 0.1];
/// The linear response and the shape of the flat let the length not be known better than this, relative.
const LENGTH_ERROR: f64 = 0.18;

/// What one wheelset shows for a flat of unit area at every place: b = cᵀy, g = cᵀc.
struct Shown {
    b: Vec<f64>,
    g: Vec<f64>,
}

impl Shown {
    /// Log likelihood ratio, averaged over the places.
    fn gain(&self, area: f64) -> f64 {
        let at = |i: usize| area * self.b[i] - 0.5 * area * area * self.g[i];
        let top = (0..self.b.len()).map(at).fold(f64::NEG_INFINITY, f64::max);
        top + ((0..self.b.len()).map(|i| (at(i) - top).exp()).sum::<f64>() / self.b.len() as f64).ln()
    }

    /// The same without what some places say.
    fn without(mut self, mute: &[bool]) -> Self {
        for (place, _) in mute.iter().enumerate().filter(|(_, m)| **m) {
            (self.b[place], self.g[place]) = (0.0, 0.0);
        }
        self
    }

    /// Probability of every place.
    fn places(&self, area: f64) -> Vec<f64> {
        let at = |i: usize| area * self.b[i] - 0.5 * area * area * self.g[i];
        let top = (0..self.b.len()).map(at).fold(f64::NEG_INFINITY, f64::max);
        let weight: Vec<f64> = (0..self.b.len()).map(|i| (at(i) - top).exp()).collect();
        let sum: f64 = weight.iter().sum();
        weight.iter().map(|w| w / sum).collect()
    }
}

impl Latent for WheelFlat {
    fn name(&self) -> &'static str {
        "wheel-flat"
    }

    fn stage(&self) -> Stage {
        Stage::Vehicle
    }

    fn advice(&self) -> Advice {
        Advice {
            what: "some wheels have flats",
            action: "Nothing to repair on the panel. Tell the vehicles' owner: have these wheels inspected and turned.",
        }
    }

    fn explore(&self, scene: &Scene) -> Option<LatentFit> {
        let paths = paths(scene, 0.0);
        let mute = inside_crossing(scene);
        let learnt = |paths: &[Vec<f64>]| -> Vec<Shown> {
            let all: Vec<Vec<Shown>> = scene.train.par_iter().map(|i| shown(scene, *i, paths)).collect();
            all.into_iter().flatten().map(|s| s.without(&mute)).collect()
        };
        let sharp = learnt(&paths);
        let (score, area, share) = best(&sharp)?;
        let broad = learnt(&self::paths(scene, BROAD_M));
        let net = score - best(&broad).map_or(0.0, |b| b.0.max(0.0)) - CHOICE;
        if net <= 0.0 {
            return None;
        }
        let (lower, upper) = interval(&sharp, area, share, score);
        let curve = areas_of_lengths(scene, &paths)?;
        let length = |area: f64| length_of(&curve, area);
        let windows: Vec<Vec<Vec<f64>>> = (0..scene.observed.len())
            .into_par_iter()
            .map(|i| windows(scene, i, &paths, area, share))
            .collect();
        let (windows, traces) = scene.around_wheels(windows);
        Some(LatentFit {
            apart: false,
            gain: net,
            parameters: vec![
                (
                    "length_m",
                    length(area),
                    length(lower).min((1.0 - LENGTH_ERROR) * length(area)),
                    length(upper).max((1.0 + LENGTH_ERROR) * length(area)),
                ),
                ("share", share, share * 0.7, (share * 1.3).min(1.0)),
            ],
            decay_s: None,
            wheel_share: Some(share),
            windows,
            traces,
        })
    }
}

fn areas() -> impl Iterator<Item = f64> {
    (0..AREAS.2).map(|i| AREAS.0 * AREAS.1.powi(i as i32))
}

/// Best score with its area and share.
fn best(shown: &[Shown]) -> Option<(f64, f64, f64)> {
    areas()
        .collect::<Vec<_>>()
        .into_par_iter()
        .map(|a| {
            let gains: Vec<f64> = shown.iter().map(|s| s.gain(a)).collect();
            let (score, share) = best_share(&gains);
            (score, a, share)
        })
        .max_by(|a, b| a.0.total_cmp(&b.0))
}

/// Places around the wheel at which a flat meets the rail inside the crossing.
fn inside_crossing(scene: &Scene) -> Vec<bool> {
    let turn_m = std::f64::consts::TAU * scene.world.crossing.vehicle.wheel_radius_m;
    let middle = scene.world.crossing.traffic_direction.sign() * CROSSING_M.0;
    (0..PLACES)
        .map(|p| {
            let at = p as f64 / PLACES as f64 * turn_m;
            let from = (at - middle + 0.5 * turn_m).rem_euclid(turn_m) - 0.5 * turn_m;
            from.abs() < CROSSING_M.1
        })
        .collect()
}

/// Coefficients of the path of a flat of unit area at every place, or of a bump `broad_m` long instead.
fn paths(scene: &Scene, broad_m: f64) -> Vec<Vec<f64>> {
    let turn_m = std::f64::consts::TAU * scene.world.crossing.vehicle.wheel_radius_m;
    let direction = scene.world.crossing.traffic_direction.sign();
    let deviation = &scene.world.path.deviation;
    let knots = deviation.knots();
    (0..PLACES)
        .map(|p| {
            let at = p as f64 / PLACES as f64 * turn_m;
            knots
                .iter()
                .map(|(side, x)| {
                    let step = deviation.step_m(*side);
                    // From the nearest of the places that are a whole turn apart.
                    let from = (direction * x - at + 0.5 * turn_m).rem_euclid(turn_m) - 0.5 * turn_m;
                    let half = step.max(0.5 * broad_m);
                    (1.0 - from.abs() / half).max(0.0) / half
                })
                .collect()
        })
        .collect()
}

/// Front wheelsets of all bogies of a passage, then rear ones.
fn shown(scene: &Scene, passage: usize, paths: &[Vec<f64>]) -> Vec<Shown> {
    scene.wheels[passage]
        .iter()
        .flat_map(|view| {
            let columns: Vec<Vec<f64>> = paths.iter().map(|p| times(&view.profile, p)).collect();
            let g: Vec<f64> = columns.iter().map(|c| dot(c, c)).collect();
            (0..view.residual.ncols())
                .map(|k| {
                    let y = view.residual.col_as_slice(k);
                    Shown { b: columns.iter().map(|c| dot(c, y)).collect(), g: g.clone() }
                })
                .collect::<Vec<_>>()
        })
        .collect()
}

/// Posterior mean of what flats add to the windows of a passage.
fn windows(scene: &Scene, passage: usize, paths: &[Vec<f64>], area: f64, share: f64) -> Vec<Vec<f64>> {
    let shown = shown(scene, passage, paths);
    let bogies = scene.residuals[passage].len();
    (0..bogies)
        .map(|bogie| {
            let mut out = vec![0.0; scene.observed[passage].mean.len()];
            for axle in 0..2 {
                let s = &shown[axle * bogies + bogie];
                let p = responsibility(share, s.gain(area));
                let mut path = vec![0.0; paths[0].len()];
                for (weight, one) in s.places(area).iter().zip(paths) {
                    path.iter_mut().zip(one).for_each(|(t, v)| *t += p * area * weight * v);
                }
                let added = times(&scene.responses[passage].profile[axle], &path);
                out.iter_mut().zip(&added).for_each(|(o, a)| *o += a);
            }
            out
        })
        .collect()
}

/// Areas within a 90 % interval of the likelihood.
fn interval(shown: &[Shown], area: f64, share: f64, score: f64) -> (f64, f64) {
    let at = |a: f64| shown.iter().map(|s| mixed(share, s.gain(a))).sum::<f64>() - score;
    let edge = |factor: f64| {
        let mut a = area;
        for _ in 0..80 {
            a *= factor;
            if at(a) < -1.35 {
                break;
            }
        }
        a
    };
    (edge(1.0 / 1.01), edge(1.01))
}

/// Area that the linear response would need for what a flat of each length does: a wheel does not follow a long flat, so it
/// grows more slowly than ℓ³.
fn areas_of_lengths(scene: &Scene, paths: &[Vec<f64>]) -> Option<Vec<(f64, f64)>> {
    let middle = scene.of_middle_speed((0..scene.observed.len()).collect());
    let o = &scene.observed[middle];
    let simulator = Simulator::new(scene.world, o.axle_load_kg).ok()?;
    let here = simulator.response(o.speed_m_s).ok()?;
    let radius_m = scene.world.crossing.vehicle.wheel_radius_m;
    // Where the flat meets the rail beside the sensor and away from the crossing's own impact.
    let places = [PLACES / 6, 3 * PLACES / 4];
    let curve = LENGTHS_M
        .into_par_iter()
        .map(|length_m| {
            let (mut product, mut power) = (0.0, 0.0);
            for place in places {
                let at_m = place as f64 / PLACES as f64 * std::f64::consts::TAU * radius_m;
                let flat = Flat { depth_m: length_m * length_m / (8.0 * radius_m), length_m, at_m };
                let changed = simulator.with_flat(0, flat).response(o.speed_m_s).ok()?.less(&here, 1.0);
                let column = times(&scene.responses[middle].profile[0], &paths[place]);
                for (k, c) in column.iter().enumerate() {
                    product += c * changed.at(o.first_s + k as f64 / RATE_HZ);
                    power += c * c;
                }
            }
            Some((length_m, (product / power.max(f64::MIN_POSITIVE)).max(0.0)))
        })
        .collect::<Option<Vec<_>>>()?;
    // Ascending, so that it can be inverted.
    let mut largest = 0.0;
    Some(
        curve
            .into_iter()
            .map(|(l, a)| {
                largest = f64::max(1.001 * largest, a);
                (l, largest)
            })
            .collect(),
    )
}

/// Length on the curve, by powers between and beyond its points.
fn length_of(curve: &[(f64, f64)], area: f64) -> f64 {
    let above = curve.iter().position(|(_, a)| *a >= area).unwrap_or(curve.len() - 1).max(1);
    let ((l0, a0), (l1, a1)) = (curve[above - 1], curve[above]);
    let slope = ((l1 / l0).ln() / (a1 / a0.max(1e-12)).ln()).clamp(0.1, 2.0);
    l1 * (area / a1).powf(slope)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_length_between_points_of_a_cubic_curve() {
        let curve: Vec<(f64, f64)> = LENGTHS_M.iter().map(|l| (*l, l.powi(3) / 7.36)).collect();
        for length in [0.025_f64, 0.047, 0.09] {
            assert!((length_of(&curve, length.powi(3) / 7.36) / length - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn analytic_gain_of_one_place() {
        // One place only: a b − a²g/2.
        let shown = Shown { b: vec![3.0], g: vec![2.0] };
        assert!((shown.gain(1.5) - (4.5 - 2.25)).abs() < 1e-12);
        assert_eq!(shown.places(1.5), vec![1.0]);
    }
}
