//! Response of a bogie's window to a small change of the path under one of its wheels, and of their loads.
//!
//! Differences of simulations: every knot of the path is raised a little under either wheel at three speeds that span
//! the site's, and the response is interpolated to each passage's speed in time since the wheel meets the knot. That
//! keeps the coupling of the wheels through rail, wheelset and bogie, and the contact law at its operating point. Depth and
//! shift of a wheel's path are changed at each passage's own speed.

use faer::Mat;
use rayon::prelude::*;

use super::GapError;
use super::data::{Observed, RATE_HZ};
use super::forward::{Response, Simulator};
use super::world::{SensorModel, World};
use crate::track::Side;

/// Change of a knot, metres: a small part of what loses contact.
const BUMP_M: f64 = 20e-6;
/// Change of a wheel's load, relative.
const LOAD_STEP: f64 = 0.02;
/// Change of the depth of a wheel's path, relative, and of where the wheel meets it, metres: as wheels differ by nature.
const DEPTH_STEP: f64 = 0.05;
const SHIFT_STEP_M: f64 = 0.01;
/// Speeds closer than this (relative) need no interpolation.
const SAME_SPEED: f64 = 0.01;

/// Window responses of one bogie, columns as in the profile grids; loads relative to the static force.
#[derive(Clone, Debug)]
pub struct BogieResponses {
    /// Both wheelsets: window × profile, m/s² per metre.
    pub both: Mat<f64>,
    /// Front and rear wheelset, the stock side's share of each only about right.
    pub profile: [Mat<f64>; 2],
    /// Front and rear wheelset, crossing and stock side: window per relative change of load.
    pub load: [[Vec<f64>; 2]; 2],
}

/// What one wheel's own path through the crossing adds to a window.
#[derive(Clone, Debug)]
pub struct WheelMoves {
    /// Deeper: per relative change of depth.
    pub depth: Vec<f64>,
    /// Later in x: first derivative, per metre.
    pub shift: Vec<f64>,
    /// Second derivative by the shift, per square metre.
    pub curvature: Vec<f64>,
}

impl BogieResponses {
    /// A path that has no influence.
    pub fn without_path(len: usize, knots: usize) -> Self {
        let none = || Mat::zeros(len, knots);
        Self {
            both: none(),
            profile: [none(), none()],
            load: std::array::from_fn(|_| [vec![0.0; len], vec![0.0; len]]),
        }
    }

    /// The same as a sensor on its mount has them, from those of a well mounted one. What loads do is too slow for a mount, and the
    /// only thing that does not begin within the window: cut off there, it would make the mount ring.
    pub fn through_mount(&self, sensor: &SensorModel) -> Self {
        let windows = |m: &Mat<f64>| sensor.through_mount(m).into_owned();
        Self {
            both: windows(&self.both),
            profile: self.profile.each_ref().map(windows),
            load: self.load.clone(),
        }
    }
}

impl WheelMoves {
    /// The same as a sensor on its mount has them, from those of a well mounted one.
    pub fn through_mount(&self, sensor: &SensorModel) -> Self {
        let [depth, shift, curvature] =
            [&self.depth, &self.shift, &self.curvature].map(|window| mounted(sensor, window));
        Self { depth, shift, curvature }
    }
}

fn mounted(sensor: &SensorModel, window: &[f64]) -> Vec<f64> {
    let column = Mat::from_fn(window.len(), 1, |k, _| window[k]);
    sensor.through_mount(&column).col_as_slice(0).to_vec()
}

/// Differences at one speed.
struct Node {
    speed_m_s: f64,
    /// Per axle and knot; stock knots hold the response of both axles, for both.
    knots: [Vec<Response>; 2],
    loads: [Response; 4],
}

/// Linear model of a site around a world, for a well mounted sensor: mounts are put on afterwards.
pub struct Linear {
    simulator: Simulator,
    nodes: Vec<Node>,
    /// Travel at which a wheel meets each knot, metres, and whether the knot is on the stock rail.
    knots: Vec<(f64, bool)>,
    axle_spacing_m: f64,
}

impl Linear {
    /// Around a world, for the speeds of `observed`; the first passage's load stands for all.
    pub fn new(world: &World, observed: &[Observed]) -> Result<Self, GapError> {
        let mut world = world.clone();
        world.sensor.mount = None;
        let world = &world;
        let direction = world.crossing.traffic_direction.sign();
        let axle_load_kg = observed.first().map_or(world.crossing.vehicle.axle_load_kg, |o| o.axle_load_kg);
        let grids = &world.path.deviation;
        let knots: Vec<(f64, bool)> =
            grids.knots().iter().map(|(side, x)| (direction * x, *side == Side::Stock)).collect();
        let simulator = Simulator::new(world, axle_load_kg)?;
        let nodes = speeds(observed)
            .into_iter()
            .map(|speed_m_s| node(world, &simulator, axle_load_kg, speed_m_s))
            .collect::<Result<_, _>>()?;
        Ok(Self { simulator, nodes, knots, axle_spacing_m: world.crossing.vehicle.axle_spacing_m })
    }

    /// For the windows of a passage.
    pub fn responses(&self, o: &Observed) -> BogieResponses {
        let weights = weights(&self.nodes, o.speed_m_s);
        let gap_s = self.axle_spacing_m / o.speed_m_s;
        let at = |axle: usize, knot: usize, t: f64| -> f64 {
            let (travel_m, _) = self.knots[knot];
            // Time since this axle's wheel met the knot is kept.
            let behind_m = if self.knots[knot].1 { 0.0 } else { axle as f64 * self.axle_spacing_m };
            let met = (travel_m + behind_m) / o.speed_m_s;
            self.nodes
                .iter()
                .zip(&weights)
                .map(|(n, w)| w * n.knots[axle][knot].at((travel_m + behind_m) / n.speed_m_s + t - met))
                .sum()
        };
        let time = |k: usize| o.first_s + k as f64 / RATE_HZ;
        let (len, knots) = (o.mean.len(), self.knots.len());
        // Both wheels of the stock rail were over the bump: take the later ones off again.
        let one = |axle: usize, j: usize, t: f64| match self.knots[j].1 {
            false => at(axle, j, t),
            true => {
                let t = t - axle as f64 * gap_s;
                at(0, j, t) - at(0, j, t - gap_s) + at(0, j, t - 2.0 * gap_s)
            }
        };
        let profile = [0, 1].map(|axle| Mat::from_fn(len, knots, |k, j| one(axle, j, time(k))));
        let both = Mat::from_fn(len, knots, |k, j| match self.knots[j].1 {
            false => profile[0][(k, j)] + profile[1][(k, j)],
            true => at(0, j, time(k)),
        });
        let load = |wheel: usize| -> Vec<f64> {
            (0..o.mean.len())
                .map(|k| {
                    let travel_m = (o.first_s + k as f64 / RATE_HZ) * o.speed_m_s;
                    self.nodes
                        .iter()
                        .zip(&weights)
                        .map(|(n, w)| w * n.loads[wheel].at(travel_m / n.speed_m_s))
                        .sum()
                })
                .collect()
        };
        BogieResponses { both, profile, load: [[load(0), load(1)], [load(2), load(3)]] }
    }

    /// What depth and shift of the path of the front and of the rear wheel add to a window of a passage.
    pub fn moves(&self, o: &Observed) -> Result<[WheelMoves; 2], GapError> {
        let here = self.simulator.response(o.speed_m_s)?;
        Ok([self.moved(0, &here, o)?, self.moved(1, &here, o)?])
    }

    fn moved(&self, axle: usize, here: &Response, o: &Observed) -> Result<WheelMoves, GapError> {
        let moved = |depth: f64, shift_m: f64| {
            self.simulator.with_own_path(axle, 1.0 + depth, shift_m).response(o.speed_m_s)
        };
        let (deeper, shallower) = (moved(DEPTH_STEP, 0.0)?, moved(-DEPTH_STEP, 0.0)?);
        let (later, earlier) = (moved(0.0, SHIFT_STEP_M)?, moved(0.0, -SHIFT_STEP_M)?);
        let window = |f: &dyn Fn(f64) -> f64| -> Vec<f64> {
            (0..o.mean.len()).map(|k| f(o.first_s + k as f64 / RATE_HZ)).collect()
        };
        Ok(WheelMoves {
            depth: window(&|t| (deeper.at(t) - shallower.at(t)) / (2.0 * DEPTH_STEP)),
            shift: window(&|t| (later.at(t) - earlier.at(t)) / (2.0 * SHIFT_STEP_M)),
            curvature: window(&|t| {
                (later.at(t) - 2.0 * here.at(t) + earlier.at(t)) / (SHIFT_STEP_M * SHIFT_STEP_M)
            }),
        })
    }

    /// Response functions exist for this many knots.
    pub fn len(&self) -> usize {
        self.knots.len()
    }

    /// Never: a path has knots.
    pub fn is_empty(&self) -> bool {
        self.knots.is_empty()
    }
}

/// Slowest, middle and fastest speed, or one where all are the same.
fn speeds(observed: &[Observed]) -> Vec<f64> {
    let all = observed.iter().map(|o| o.speed_m_s);
    let (low, high) = all.fold((f64::INFINITY, 0.0_f64), |(l, h), v| (l.min(v), h.max(v)));
    if high / low - 1.0 < SAME_SPEED { vec![0.5 * (low + high)] } else { vec![low, 0.5 * (low + high), high] }
}

/// Lagrange weights of the nodes at a speed.
fn weights(nodes: &[Node], speed_m_s: f64) -> Vec<f64> {
    (0..nodes.len())
        .map(|i| {
            (0..nodes.len())
                .filter(|j| *j != i)
                .map(|j| (speed_m_s - nodes[j].speed_m_s) / (nodes[i].speed_m_s - nodes[j].speed_m_s))
                .product()
        })
        .collect()
}

fn node(world: &World, simulator: &Simulator, axle_load_kg: f64, speed_m_s: f64) -> Result<Node, GapError> {
    let here = simulator.response(speed_m_s)?;
    let sides = world.path.deviation.knots();
    let bumps = |axle: usize, among: Vec<usize>| bumps(world, simulator, (axle, among), (&here, speed_m_s));
    let front = bumps(0, (0..sides.len()).collect())?;
    let mut rear = bumps(1, (0..sides.len()).filter(|k| sides[*k].0 == Side::Crossing).collect())?;
    // On the stock rail, whose knots come last, a bump is under both wheels: the same for both axles.
    rear.extend_from_slice(&front[rear.len()..]);
    let knots = [front, rear];
    let load = |wheel: usize| -> Result<Response, GapError> {
        let mut moved = world.clone();
        moved.wheels.load[wheel / 2][wheel % 2] *= 1.0 + LOAD_STEP;
        Ok(Simulator::new(&moved, axle_load_kg)?.response(speed_m_s)?.less(&here, LOAD_STEP))
    };
    Ok(Node { speed_m_s, knots, loads: [load(0)?, load(1)?, load(2)?, load(3)?] })
}

/// What bumps at some knots under an axle change, per metre. Until a wheel is there, all of them are one passage.
fn bumps(
    world: &World,
    simulator: &Simulator,
    (axle, among): (usize, Vec<usize>),
    (here, speed_m_s): (&Response, f64),
) -> Result<Vec<Response>, GapError> {
    let meets_m = |k: &usize| simulator.meets_m(world, *k, axle);
    let mut halts_m: Vec<f64> = among.iter().map(meets_m).collect();
    halts_m.sort_by(f64::total_cmp);
    let halted = simulator.halted(speed_m_s, &halts_m)?;
    among
        .par_iter()
        .map(|k| {
            let before = halts_m.partition_point(|h| *h < meets_m(k));
            let bumped = simulator.with_bump(world, *k, axle, BUMP_M)?;
            Ok(bumped.response_after(halted[before].clone(), speed_m_s)?.less(here, BUMP_M))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::base::{Given, base, nominal_world};
    use super::super::diagnosis::PATH_PRIOR;
    use super::*;
    use crate::ballast::BallastParameters;
    use crate::recording::{TrafficDirection, read_site};

    /// Linearised with the mount in the world, they went through it a second time in every fit.
    #[test]
    fn regress_derivatives_are_those_of_a_well_mounted_sensor() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field");
        let mut site = read_site(&root.join("reference-1")).unwrap();
        site.passages.truncate(1);
        let base = base(&site, &[0], &[0], &PATH_PRIOR, &Given::default()).unwrap();
        let firm = nominal_world(&site, BallastParameters::NOMINAL).unwrap();
        let mut loose = firm.clone();
        loose.sensor.mount = Some((240.0, 0.15));
        let observed = &base.frame.observed;
        let both = |world: &World| Linear::new(world, observed).unwrap().responses(&observed[0]);
        let (firm, bare) = (both(&firm), both(&loose));
        assert_eq!(firm.both, bare.both);
        assert_eq!(bare.through_mount(&loose.sensor).both, *loose.sensor.through_mount(&bare.both));
    }

    /// Passages that are one until a wheel meets the bump, in both directions and on both rails.
    #[test]
    fn property_bumps_are_those_of_whole_passages() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field");
        let site = read_site(&root.join("reference-1")).unwrap();
        let mut world = nominal_world(&site, BallastParameters::NOMINAL).unwrap();
        for direction in [TrafficDirection::Facing, TrafficDirection::Trailing] {
            world.crossing.traffic_direction = direction;
            let simulator = Simulator::new(&world, world.crossing.vehicle.axle_load_kg).unwrap();
            let here = simulator.response(40.0).unwrap();
            let some: Vec<usize> = (0..world.path.deviation.len()).step_by(9).collect();
            for axle in [0, 1] {
                let resumed = bumps(&world, &simulator, (axle, some.clone()), (&here, 40.0)).unwrap();
                for (k, resumed) in some.iter().zip(&resumed) {
                    let bumped = simulator.with_bump(&world, *k, axle, BUMP_M).unwrap();
                    let whole = bumped.response(40.0).unwrap().less(&here, BUMP_M);
                    let time = |i: usize| i as f64 / 4000.0 - 0.1;
                    assert!(
                        (0..1600).all(|i| resumed.at(time(i)) == whole.at(time(i))),
                        "axle {axle}, knot {k}"
                    );
                    assert!((0..1600).any(|i| whole.at(time(i)) != 0.0), "axle {axle}, knot {k}");
                }
            }
        }
    }
}
