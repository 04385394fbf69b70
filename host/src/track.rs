//! Finite-element track: two Timoshenko rails on pads, sleeper beams and ballast; receptances in the frequency
//! domain by direct solution of the block-tridiagonal system (paper, section 3).
//!
//! Time factor e^{+iωt}; displacement and force positive downwards.

mod benchmark;
mod block;
mod check;
mod grid;
mod sleeper;
mod slopes;

use faer::c64;
use rayon::prelude::*;

use crate::beam;
use crate::recording::Crossing;
use crate::section::BeamSection;
use block::{Block, Factor, ZERO, invert};
pub use check::TrackError;
pub use grid::RailGrid;
pub use sleeper::{Sleeper, SleeperBeam, SleeperLayout};

/// Element lengths of the mesh, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mesh {
    /// Rail element; rounded so that a sleeper bay holds a whole number of elements.
    pub rail_step_m: f64,
    /// Sleeper element.
    pub sleeper_step_m: f64,
}

impl Default for Mesh {
    /// The paper's mesh: 0.3 m along the rails, 0.25 m along the sleepers.
    fn default() -> Self {
        Self { rail_step_m: 0.3, sleeper_step_m: 0.25 }
    }
}

/// Which rail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The rail that carries the crossing.
    Crossing,
    /// The other rail.
    Stock,
}

/// Linear Kelvin element.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct Kelvin {
    pub stiffness: f64,
    pub damping: f64,
}

impl Kelvin {
    /// Complex stiffness at angular frequency `omega`.
    pub fn dynamic(&self, omega: f64) -> c64 {
        c64::new(self.stiffness, omega * self.damping)
    }
}

/// Track with everything but the ballast stiffness fixed.
#[derive(Clone, Debug)]
pub struct Track {
    /// Rail node positions, metres, equidistant.
    pub node_x_m: Vec<f64>,
    /// Sleeper positions, metres.
    pub sleeper_x_m: Vec<f64>,
    /// Rail element length, metres.
    pub step_m: f64,
    /// Plain rail and crossing part.
    pub plain: BeamSection,
    /// Section of the crossing rail between `crossing_part_m`.
    pub crossing_rail: BeamSection,
    /// Extent of the crossing part, metres.
    pub crossing_part_m: [f64; 2],
    /// How often a rail element is halved before it is condensed back to its two nodes, which takes the error of the
    /// element's inertia down by 4 each time at no cost to speak of. 0 is the plain element.
    pub rail_halvings: u32,
    /// Stiffness-proportional damping of the rails, s.
    pub rail_damping_s: f64,
    /// Rail pads, per seat, N/m and Ns/m.
    pub pad: Kelvin,
    /// Sleeper type, the same everywhere.
    pub sleeper: Sleeper,
    /// Ballast damping, Ns/m per metre of sleeper.
    pub ballast_damping_ns_m2: f64,
    /// Index of the instrumented sleeper.
    pub sensor_sleeper: usize,
    /// Factor on the ballast stiffness of single sleepers, counted from the instrumented one.
    pub support_factor: Vec<(i64, f64)>,
    /// Static force of wheels on the crossing and on the stock rail, of half an axle's.
    pub load_factor: [f64; 2],
    nodes_per_bay: usize,
}

/// Displacement at the sensor per force on the rails, for every rail node: `[deflection, rotation]` degrees of
/// freedom, i.e. per vertical force (m/N) and per moment (m/(N m)).
pub struct SensorReceptance {
    /// Frequencies, Hz.
    pub frequency_hz: Vec<f64>,
    /// `[frequency][node]`, crossing rail.
    pub crossing: Vec<Vec<[c64; 2]>>,
    /// `[frequency][node]`, stock rail.
    pub stock: Vec<Vec<[c64; 2]>>,
}

/// Receptances between all pairs i ≤ j of neighbouring rail nodes, m/N: `[frequency][pair]`, pairs row by row of i; each
/// entry is `[read][loaded]` for (crossing, stock), read at node i and loaded at node j.
pub type RailReceptances = Vec<Vec<[[c64; 2]; 2]>>;

impl SensorReceptance {
    /// From the degrees of freedom of both rails, `[frequency][node]`.
    fn of<'a>(frequency_hz: &[f64], solved: impl Iterator<Item = &'a Vec<[c64; 4]>> + Clone) -> Self {
        let rail =
            |dof: usize| solved.clone().map(|x| x.iter().map(|v| [v[dof], v[dof + 1]]).collect()).collect();
        Self { frequency_hz: frequency_hz.to_vec(), crossing: rail(0), stock: rail(2) }
    }
}

impl Track {
    /// Track of a site with its nominal design values.
    pub fn of_crossing(crossing: &Crossing, mesh: Mesh) -> Self {
        let (layout, s) = (&crossing.track, &crossing.sleeper);
        let first = crossing.sleeper_x_m(0);
        let sleeper_layout = SleeperLayout {
            length_m: s.length_m,
            seat_crossing_y_m: s.seat_crossing_y_m,
            seat_stock_y_m: s.seat_stock_y_m,
            sensor_y_m: crossing.sensor.y_m,
        };
        let beam = SleeperBeam::new(
            BeamSection::sleeper(s),
            s.damping_stiffness_proportional_s,
            sleeper_layout,
            mesh.sleeper_step_m,
        );
        let nodes_per_bay = (layout.sleeper_spacing_m / mesh.rail_step_m).round().max(1.0) as usize;
        let step_m = layout.sleeper_spacing_m / nodes_per_bay as f64;
        let n_nodes = layout.n_sleepers.saturating_sub(1) * nodes_per_bay + 1;
        Self {
            node_x_m: (0..n_nodes).map(|i| first + i as f64 * step_m).collect(),
            sleeper_x_m: (0..layout.n_sleepers).map(|i| crossing.sleeper_x_m(i)).collect(),
            step_m,
            plain: BeamSection::plain_rail(&crossing.rail),
            crossing_rail: BeamSection::crossing_rail(&crossing.rail),
            crossing_part_m: [crossing.rail.crossing_part_x0_m, crossing.rail.crossing_part_x1_m],
            rail_halvings: RAIL_HALVINGS,
            rail_damping_s: crossing.rail.damping_stiffness_proportional_s,
            pad: Kelvin { stiffness: crossing.pad.stiffness_n_m, damping: crossing.pad.damping_ns_m },
            sleeper: Sleeper::Beam(beam),
            ballast_damping_ns_m2: crossing.ballast.damping_ns_m2,
            sensor_sleeper: crossing.sensor.sleeper_index,
            support_factor: crossing.ballast.support_factor.clone(),
            load_factor: layout.load_factor(),
            nodes_per_bay,
        }
    }

    /// Rail node above a sleeper.
    pub fn seat_node(&self, sleeper: usize) -> usize {
        sleeper * self.nodes_per_bay
    }

    /// Section of element `e` of a rail; where the crossing part ends within the element, what bends and weighs as much.
    pub fn element_section(&self, side: Side, e: usize) -> BeamSection {
        if side == Side::Stock {
            return self.plain;
        }
        let (first, last) = (self.node_x_m[e], self.node_x_m[e] + self.step_m);
        let inside_m = last.min(self.crossing_part_m[1]) - first.max(self.crossing_part_m[0]);
        // Sleepers often stand where the part ends: then the element is of one kind but for rounding.
        match inside_m / self.step_m {
            share if share < SAME_SECTION => self.plain,
            share if share > 1.0 - SAME_SECTION => self.crossing_rail,
            share => self.plain.in_a_row_with(&self.crossing_rail, share),
        }
    }

    /// Ratio of bending to shear flexibility of element `e` of a rail.
    pub fn shear_ratio(&self, side: Side, e: usize) -> f64 {
        beam::shear_ratio(&self.element_section(side, e), self.step_m)
    }

    /// Receptance between the sensor and all rail nodes, by reciprocity from one unit force at the sensor.
    /// `ballast_n_m2`: stiffness per sleeper.
    pub fn sensor_receptance(&self, frequency_hz: &[f64], ballast_n_m2: &[f64]) -> SensorReceptance {
        let solved = |f: &f64| self.sensor_solution(&self.system(std::f64::consts::TAU * f, ballast_n_m2));
        let solved: Vec<_> = frequency_hz.par_iter().map(solved).collect();
        SensorReceptance::of(frequency_hz, solved.iter())
    }

    /// Deflection of the rail nodes `read` of one rail per unit vertical force on each of the nodes `loaded` of the
    /// same rail: `[frequency][loaded][read]`, m/N.
    pub fn rail_receptance(
        &self,
        frequency_hz: &[f64],
        ballast_n_m2: &[f64],
        side: Side,
        loaded: &[usize],
        read: &[usize],
    ) -> Vec<Vec<Vec<c64>>> {
        let dof = if side == Side::Crossing { 0 } else { 2 };
        frequency_hz
            .par_iter()
            .map(|f| {
                let system = self.system(std::f64::consts::TAU * f, ballast_n_m2);
                let column = |node: &usize| {
                    let mut x = vec![[ZERO; 4]; self.node_x_m.len()];
                    x[*node][dof] = c64::new(1.0, 0.0);
                    system.factor.solve(&mut x);
                    read.iter().map(|r| x[*r][dof]).collect()
                };
                loaded.iter().map(column).collect()
            })
            .collect()
    }

    /// Receptances between all pairs of neighbouring nodes `first` … `last` of both rails.
    pub fn rail_receptances(
        &self,
        frequency_hz: &[f64],
        ballast_n_m2: &[f64],
        [first, last]: [usize; 2],
    ) -> RailReceptances {
        frequency_hz
            .par_iter()
            .map(|f| self.system(std::f64::consts::TAU * f, ballast_n_m2).rail_pairs(first, last))
            .collect()
    }

    /// [`Self::sensor_receptance`] and [`Self::rail_receptances`] of the same factors.
    pub fn sensor_and_rail_receptances(
        &self,
        frequency_hz: &[f64],
        ballast_n_m2: &[f64],
        [first, last]: [usize; 2],
    ) -> (SensorReceptance, RailReceptances) {
        let both = |f: &f64| {
            let system = self.system(std::f64::consts::TAU * f, ballast_n_m2);
            (self.sensor_solution(&system), system.rail_pairs(first, last))
        };
        let (sensor, rails): (Vec<_>, _) = frequency_hz.par_iter().map(both).unzip();
        (SensorReceptance::of(frequency_hz, sensor.iter()), rails)
    }

    /// Deflections and rotations of all rail nodes per unit force at the sensor.
    fn sensor_solution(&self, system: &System) -> Vec<[c64; 4]> {
        let mut x = vec![[ZERO; 4]; self.node_x_m.len()];
        let seat = self.seat_node(self.sensor_sleeper);
        x[seat][0] = system.sensor_load[0];
        x[seat][2] = system.sensor_load[1];
        system.factor.solve(&mut x);
        x
    }

    /// Static deflection of both rails at `nodes` under an axle at each of them, per half its load, m/N:
    /// `[loaded][crossing, stock][read]`.
    pub fn static_deflections_under_axle(&self, ballast_n_m2: &[f64], nodes: &[usize]) -> Vec<[Vec<f64>; 2]> {
        let system = self.system(0.0, ballast_n_m2);
        nodes
            .iter()
            .map(|node| {
                let mut x = vec![[ZERO; 4]; self.node_x_m.len()];
                x[*node][0] = c64::new(self.load_factor[0], 0.0);
                x[*node][2] = c64::new(self.load_factor[1], 0.0);
                system.factor.solve(&mut x);
                [0, 2].map(|dof| nodes.iter().map(|n| x[*n][dof].re).collect())
            })
            .collect()
    }

    /// Receptance at the sensor itself (force and displacement there), m/N.
    pub fn sensor_point_receptance(&self, frequency_hz: &[f64], ballast_n_m2: &[f64]) -> Vec<c64> {
        let seat = self.seat_node(self.sensor_sleeper);
        frequency_hz
            .iter()
            .map(|f| {
                let system = self.system(std::f64::consts::TAU * f, ballast_n_m2);
                let mut x = vec![[ZERO; 4]; self.node_x_m.len()];
                x[seat][0] = system.sensor_load[0];
                x[seat][2] = system.sensor_load[1];
                system.factor.solve(&mut x);
                system.sensor_free + system.sensor_load[0] * x[seat][0] + system.sensor_load[1] * x[seat][2]
            })
            .collect()
    }

    /// Assembles and factorises the rails with the condensed sleepers at one angular frequency.
    fn system(&self, omega: f64, ballast_n_m2: &[f64]) -> System {
        let (mut diagonal, upper) = self.rails(omega);
        let mut known: Vec<(f64, CondensedSleeper)> = Vec::new();
        let (mut sensor_load, mut sensor_free) = ([ZERO; 2], ZERO);
        for (sleeper, stiffness) in ballast_n_m2.iter().enumerate().take(self.sleeper_x_m.len()) {
            let condensed = once_per(&mut known, *stiffness, |k| self.condense(omega, *k));
            let node = self.seat_node(sleeper);
            for (i, row) in condensed.seat_stiffness.iter().enumerate() {
                for (j, value) in row.iter().enumerate() {
                    diagonal[node][2 * i][2 * j] += value;
                }
            }
            if sleeper == self.sensor_sleeper {
                sensor_load = condensed.sensor_load;
                sensor_free = condensed.sensor_free;
            }
        }
        System { factor: Factor::new(diagonal, &upper), sensor_load, sensor_free }
    }

    /// Dynamic stiffness of the two free rails.
    fn rails(&self, omega: f64) -> (Vec<Block<4>>, Vec<Block<4>>) {
        let n = self.node_x_m.len();
        let dynamic = |section: &BeamSection| -> [[c64; 4]; 4] {
            let length_m = self.step_m / f64::from(1u32 << self.rail_halvings.min(16));
            let (k, m) = (beam::stiffness(section, length_m), beam::mass(section, length_m));
            let elastic = c64::new(1.0, omega * self.rail_damping_s);
            let part =
                std::array::from_fn(|i| std::array::from_fn(|j| elastic * k[i][j] - omega * omega * m[i][j]));
            (0..self.rail_halvings.min(16)).fold(part, |part, _| joined(&part))
        };
        let mut known: Vec<(BeamSection, Block<4>)> = Vec::new();
        let mut diagonal: Vec<Block<4>> = vec![[[ZERO; 4]; 4]; n];
        let mut upper: Vec<Block<4>> = vec![[[ZERO; 4]; 4]; n.saturating_sub(1)];
        for e in 0..n.saturating_sub(1) {
            for (rail, side) in [(0, Side::Crossing), (1, Side::Stock)] {
                let d = once_per(&mut known, self.element_section(side, e), dynamic);
                for i in 0..2 {
                    for j in 0..2 {
                        diagonal[e][2 * rail + i][2 * rail + j] += d[i][j];
                        diagonal[e + 1][2 * rail + i][2 * rail + j] += d[i + 2][j + 2];
                        upper[e][2 * rail + i][2 * rail + j] += d[i][j + 2];
                    }
                }
            }
        }
        (diagonal, upper)
    }

    /// Sleeper with pads, seen from the two rails.
    fn condense(&self, omega: f64, ballast_n_m2: f64) -> CondensedSleeper {
        // A sleeper that does not touch its bed is not damped by it either.
        let damping = if ballast_n_m2 == 0.0 { 0.0 } else { self.ballast_damping_ns_m2 };
        let ballast = c64::new(ballast_n_m2, omega * damping);
        let c = self.sleeper.compliance(omega, ballast);
        let pad = c64::new(1.0, 0.0) / self.pad.dynamic(omega);
        let seat_stiffness = invert([[c[0][0] + pad, c[0][1]], [c[1][0], c[1][1] + pad]]);
        let sensor_load =
            std::array::from_fn(|i| seat_stiffness[i][0] * c[0][2] + seat_stiffness[i][1] * c[1][2]);
        let sensor_free = c[2][2] - c[2][0] * sensor_load[0] - c[2][1] * sensor_load[1];
        CondensedSleeper { seat_stiffness, sensor_load, sensor_free }
    }
}

/// What `make` makes of a key, once for each that is equal: a track has a handful of kinds.
fn once_per<K: PartialEq, V: Copy>(known: &mut Vec<(K, V)>, key: K, make: impl FnOnce(&K) -> V) -> V {
    if let Some((_, value)) = known.iter().find(|(k, _)| *k == key) {
        return *value;
    }
    let value = make(&key);
    known.push((key, value));
    value
}

/// Share of an element below which a section in it is not worth an element of its own.
const SAME_SECTION: f64 = 1e-6;
/// Without it, elements of 0.3 m are 0.2 % wrong at 200 Hz on soft pads; with two halvings 0.01 %.
const RAIL_HALVINGS: u32 = 2;

/// Two equal elements in a row, the node between them condensed: exact at the frequency of `part`.
fn joined(part: &Block<4>) -> Block<4> {
    let middle: Block<2> =
        invert(std::array::from_fn(|i| std::array::from_fn(|j| part[i + 2][j + 2] + part[i][j])));
    // Forces at the outer nodes per motion of the one between: left (rows 0, 1) and right (rows 2, 3).
    let outer: [[c64; 2]; 4] =
        std::array::from_fn(|i| std::array::from_fn(|j| if i < 2 { part[i][j + 2] } else { part[i][j] }));
    std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            let own = if i / 2 == j / 2 { part[i][j] } else { ZERO };
            let through: c64 = (0..2)
                .flat_map(|a| (0..2).map(move |b| (a, b)))
                .fold(ZERO, |sum, (a, b)| sum + outer[i][a] * middle[a][b] * outer[j][b]);
            own - through
        })
    })
}

#[derive(Clone, Copy)]
struct CondensedSleeper {
    /// Force on the rails per rail deflection at the seats, N/m.
    seat_stiffness: [[c64; 2]; 2],
    /// Forces on the two rails (held still) per unit force at the sensor; by reciprocity the sensor's motion per rail deflection.
    sensor_load: [c64; 2],
    /// Compliance at the sensor with both rails held still, m/N.
    sensor_free: c64,
}

struct System {
    factor: Factor<4>,
    sensor_load: [c64; 2],
    sensor_free: c64,
}

impl System {
    /// One frequency of [`RailReceptances`].
    fn rail_pairs(&self, first: usize, last: usize) -> Vec<[[c64; 2]; 2]> {
        // Forces are vertical: the columns of rotations are left out.
        let blocks = self.factor.inverse_columns([first, last], [0, 2]);
        blocks.iter().flatten().map(|deflections| [deflections[0], deflections[2]]).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use faer::Mat;
    use faer::linalg::solvers::Solve as _;

    use super::*;
    use crate::verification::reference::{SOFT, ballast, panel_of_length};

    /// Dynamic stiffness of the whole track in one dense matrix, nothing condensed: rails, then sleepers. Degrees of
    /// freedom of rail r, node i: 2(r n + i); of sleeper s, node i: 4n + 2(s m + i).
    fn full_system(track: &Track, sleeper_y_m: &[f64], section: &BeamSection, f_hz: f64) -> Mat<c64> {
        let (n, m) = (track.node_x_m.len(), sleeper_y_m.len());
        let omega = TAU * f_hz;
        let mut a = Mat::<c64>::zeros(
            4 * n + 2 * m * track.sleeper_x_m.len(),
            4 * n + 2 * m * track.sleeper_x_m.len(),
        );
        let mut element = |first: usize, section: &BeamSection, length: f64| {
            let (k, mass) = (beam::stiffness(section, length), beam::mass(section, length));
            for i in 0..4 {
                for j in 0..4 {
                    a[(first + i, first + j)] += c64::new(k[i][j] - omega * omega * mass[i][j], 0.0);
                }
            }
        };
        for e in 0..n - 1 {
            element(2 * e, &track.element_section(Side::Crossing, e), track.step_m);
            element(2 * (n + e), &track.element_section(Side::Stock, e), track.step_m);
        }
        for s in 0..track.sleeper_x_m.len() {
            for e in 0..m - 1 {
                element(4 * n + 2 * (s * m + e), section, sleeper_y_m[e + 1] - sleeper_y_m[e]);
            }
        }
        let bed = c64::new(30e6, omega * track.ballast_damping_ns_m2);
        let pad = track.pad.dynamic(omega);
        let at = |y: f64| sleeper_y_m.iter().position(|v| (v - y).abs() < 1e-9).unwrap();
        for s in 0..track.sleeper_x_m.len() {
            let dof = |i: usize| 4 * n + 2 * (s * m + i);
            for i in 0..m {
                let below = if i == 0 { 0.0 } else { sleeper_y_m[i] - sleeper_y_m[i - 1] };
                let above = if i + 1 == m { 0.0 } else { sleeper_y_m[i + 1] - sleeper_y_m[i] };
                a[(dof(i), dof(i))] += bed * (0.5 * (below + above));
            }
            for (rail, seat) in [(0, at(2.0)), (1, at(0.5))] {
                let (r, d) = (2 * (rail * n + track.seat_node(s)), dof(seat));
                a[(r, r)] += pad;
                a[(d, d)] += pad;
                a[(r, d)] -= pad;
                a[(d, r)] -= pad;
            }
        }
        a
    }

    #[test]
    fn property_condensed_solution_equals_the_full_system() {
        let mut track = panel_of_length(SOFT, Mesh { rail_step_m: 0.3, sleeper_step_m: 0.5 }, 5);
        track.rail_halvings = 0;
        let y: Vec<f64> = (0..6).map(|i| 0.5 * i as f64).collect();
        let section = BeamSection {
            bending_n_m2: 30e9 * 0.25 * 0.2f64.powi(3) / 12.0,
            shear_n: 30e9 / 2.4 * 0.05 * 5.0 / 6.0,
            mass_kg_m: 2400.0 * 0.05,
            rotary_kg_m: 2400.0 * 0.25 * 0.2f64.powi(3) / 12.0,
        };
        let (n, m) = (track.node_x_m.len(), y.len());
        let sensor = 4 * n + 2 * (track.sensor_sleeper * m + 4);
        for f in [3.0, 60.0, 240.0] {
            let a = full_system(&track, &y, &section, f);
            let unit = Mat::from_fn(a.nrows(), 1, |i, _| c64::new(if i == sensor { 1.0 } else { 0.0 }, 0.0));
            let x = a.partial_piv_lu().solve(&unit);
            let found = track.sensor_receptance(&[f], &ballast(&track));
            let scale = x[(sensor, 0)].norm();
            for i in 0..n {
                for dof in 0..2 {
                    assert!((found.crossing[0][i][dof] - x[(2 * i + dof, 0)]).norm() < 1e-9 * scale);
                    assert!((found.stock[0][i][dof] - x[(2 * (n + i) + dof, 0)]).norm() < 1e-9 * scale);
                }
            }
            let point = track.sensor_point_receptance(&[f], &ballast(&track))[0];
            assert!((point - x[(sensor, 0)]).norm() < 1e-9 * scale);
        }
    }

    #[test]
    fn analytic_section_of_an_element_in_which_the_crossing_part_ends() {
        let mut track = panel_of_length(SOFT, Mesh::default(), 9);
        let sections = |track: &Track| -> Vec<BeamSection> {
            (0..track.node_x_m.len() - 1).map(|e| track.element_section(Side::Crossing, e)).collect()
        };
        // At nodes, give or take rounding, every element is of one kind.
        let of_one_kind = |s: &BeamSection| *s == track.plain || *s == track.crossing_rail;
        assert!(sections(&track).iter().all(of_one_kind));
        let inside = sections(&track).iter().filter(|s| **s == track.crossing_rail).count() as f64;
        // As flexible and as heavy as before where the part is a third of an element shorter.
        let whole = |of: &dyn Fn(&BeamSection) -> f64| sections(&track).iter().map(of).sum::<f64>();
        let (flexible, heavy) = (whole(&|s| 1.0 / s.bending_n_m2), whole(&|s| s.mass_kg_m));
        track.crossing_part_m[1] -= track.step_m / 3.0;
        let (plain, stiff) = (track.plain, track.crossing_rail);
        let whole = |of: &dyn Fn(&BeamSection) -> f64| sections(&track).iter().map(of).sum::<f64>();
        let more = whole(&|s| 1.0 / s.bending_n_m2) - flexible;
        assert!((more / ((1.0 / plain.bending_n_m2 - 1.0 / stiff.bending_n_m2) / 3.0) - 1.0).abs() < 1e-9);
        let less = heavy - whole(&|s| s.mass_kg_m);
        assert!((less / ((stiff.mass_kg_m - plain.mass_kg_m) / 3.0) - 1.0).abs() < 1e-9);
        assert!(inside > 2.0);
        // A part that is shorter than an element is there all the same.
        let node = track.node_x_m[4];
        track.crossing_part_m = [node + 0.1 * track.step_m, node + 0.6 * track.step_m];
        assert!(
            (track.element_section(Side::Crossing, 4).mass_kg_m * 2.0 - plain.mass_kg_m - stiff.mass_kg_m)
                .abs()
                < 1e-9
        );
        assert_eq!(track.element_section(Side::Stock, 4), plain);
    }

    #[test]
    fn property_halved_elements_are_those_of_a_finer_mesh() {
        let f = [20.0, 250.0, 700.0];
        let mut halved = panel_of_length(SOFT, Mesh { rail_step_m: 0.3, sleeper_step_m: 0.25 }, 9);
        halved.rail_halvings = 1;
        let mut fine = panel_of_length(SOFT, Mesh { rail_step_m: 0.15, sleeper_step_m: 0.25 }, 9);
        fine.rail_halvings = 0;
        let (a, b) =
            (halved.sensor_receptance(&f, &ballast(&halved)), fine.sensor_receptance(&f, &ballast(&fine)));
        for k in 0..f.len() {
            for i in 0..halved.node_x_m.len() {
                let (one, other) = (a.crossing[k][i], b.crossing[k][2 * i]);
                for dof in 0..2 {
                    assert!((one[dof] - other[dof]).norm() <= 1e-9 * a.crossing[k][8][dof].norm().max(1e-12));
                }
            }
        }
    }
}
