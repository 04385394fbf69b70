//! Track as the time integration sees it: rails by bays, sleepers in generalised coordinates.
//!
//! Rail values are stored in rows of equal local node and degree of freedom, so that the same operation runs over all
//! sleeper bays of both rails at once: `row = 2 · node in bay + (0 deflection, 1 rotation)`, and within a row
//! `lane = side · stride + sleeper` (side 0 = crossing rail). Sleeper values are stored as
//! `[sleeper / 8 · coordinates + coordinate][sleeper % 8]`.

use super::basis::SleeperBasis;
use super::error::{SimulationError, in_range};
use super::support::Support;
use crate::beam::{self, Matrix4};
use crate::section::BeamSection;
use crate::track::{Kelvin, Side, Track};

/// Values handled together in the inner loops.
pub(super) const CHUNK: usize = 8;
/// Coordinates of a sleeper handled together: the modes of [`SLEEPER_MODES`] and the two static shapes.
pub(super) const BLOCK: usize = SLEEPER_MODES + 2;
/// The same value of neighbouring sleepers.
pub(super) type Lanes = [f64; CHUNK];

/// Most rail elements between two sleepers.
pub(super) const MOST_ELEMENTS: usize = 16;

/// Where rail and sleeper values are in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Layout {
    pub sleepers: usize,
    pub nodes_per_bay: usize,
    /// Lanes per side: at least one more than sleepers, a multiple of [`CHUNK`].
    pub stride: usize,
    /// Length of a row of rail values; the lane after the last one is read.
    pub row: usize,
}

impl Layout {
    fn new(sleepers: usize, nodes_per_bay: usize) -> Self {
        let stride = (sleepers / CHUNK + 1) * CHUNK;
        Self { sleepers, nodes_per_bay, stride, row: 2 * stride + CHUNK }
    }

    /// Rows of rail values.
    pub fn rows(&self) -> usize {
        2 * self.nodes_per_bay
    }

    /// Lanes in use by the inner loops.
    pub fn lanes(&self) -> usize {
        2 * self.stride
    }

    /// Place of degree of freedom `a` (w₁, θ₁, w₂, θ₂) of an element.
    pub fn dof(&self, side: usize, bay: usize, element: usize, a: usize) -> usize {
        let node = element + a / 2;
        let lane = side * self.stride + bay;
        if node < self.nodes_per_bay {
            (2 * node + a % 2) * self.row + lane
        } else {
            (a % 2) * self.row + lane + 1
        }
    }
}

/// A place on a rail: element and the weights of its four degrees of freedom.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RailPoint {
    pub(super) side: usize,
    pub(super) bay: usize,
    pub(super) element: usize,
    pub(super) weights: [f64; 4],
    /// Static deflection per newton beyond the interpolated one, m/N.
    pub(super) local_m_n: f64,
}

/// What the deflection inside an element needs.
#[derive(Clone, Copy, Debug)]
struct ElementShape {
    shear_ratio: f64,
    /// L³/12EI, m/N.
    flexibility_m_n: f64,
}

impl ElementShape {
    fn new(section: &BeamSection, length_m: f64) -> Self {
        Self {
            shear_ratio: beam::shear_ratio(section, length_m),
            flexibility_m_n: length_m.powi(3) / (12.0 * section.bending_n_m2),
        }
    }
}

/// Deflection under a unit load at `xi` of a Timoshenko beam clamped at both ends, in units of L³/12EI.
///
/// An element's nodes move exactly under a load inside it, but its shape functions leave this part out: 23 µm under
/// 76 kN in the middle of 0.3 m of rail 60E1. Without it every element is a bump for the wheel, and the mesh must be four
/// times finer for the same error.
#[inline(always)]
fn clamped_flexibility(shear_ratio: f64, xi: f64) -> f64 {
    let p = xi * (1.0 - xi);
    let skew = 1.0 - 2.0 * xi;
    p * p * (1.0 - skew * skew / (1.0 + shear_ratio)) + shear_ratio * p
}

/// Track with supports, ready to be integrated with any step.
#[derive(Clone, Debug)]
pub struct TrackModel {
    pub(super) layout: Layout,
    pub(super) first_x_m: f64,
    pub(super) step_m: f64,
    sections: [Vec<BeamSection>; 2],
    shapes: [Vec<ElementShape>; 2],
    pub(super) rail_damping_s: f64,
    pub(super) pad: Kelvin,
    pub(super) basis: SleeperBasis,
    pub(super) supports: Vec<Support>,
    pub(super) sensor_sleeper: usize,
}

/// Number of sleeper modes beside the two static shapes: error against the full model in the tests of `stepper`.
pub const SLEEPER_MODES: usize = 6;

impl TrackModel {
    /// `supports`: one per sleeper.
    pub fn new(track: &Track, supports: Vec<Support>, sleeper_modes: usize) -> Result<Self, SimulationError> {
        let sleepers = track.sleeper_x_m.len();
        if supports.len() != sleepers {
            return Err(SimulationError::Supports { supports: supports.len(), sleepers });
        }
        in_range("number of sleepers", sleepers as f64, [2.0, 1000.0], "")?;
        in_range("rail elements per bay", track.seat_node(1) as f64, [1.0, MOST_ELEMENTS as f64], "")?;
        for support in &supports {
            in_range("ballast stiffness", support.stiffness_n_m2, [0.0, 1e10], "N/m2")?;
            in_range("ballast damping", support.damping_ns_m2, [0.0, 1e8], "Ns/m2")?;
            in_range("moving ballast mass", support.mass_kg_m, [0.0, 1e5], "kg/m")?;
        }
        in_range("pad stiffness", track.pad.stiffness, [1e5, 1e11], "N/m")?;
        in_range("pad damping", track.pad.damping, [0.0, 1e8], "Ns/m")?;
        let typical = supports.iter().map(|s| s.stiffness_n_m2).sum::<f64>() / sleepers as f64;
        let elements = track.node_x_m.len() - 1;
        let sections =
            |side| (0..elements).map(|e| track.element_section(side, e)).collect::<Vec<BeamSection>>();
        let sections = [sections(Side::Crossing), sections(Side::Stock)];
        let shapes = sections.each_ref().map(|s| {
            s.iter().map(|section| ElementShape::new(section, track.step_m)).collect::<Vec<ElementShape>>()
        });
        Ok(Self {
            layout: Layout::new(sleepers, track.seat_node(1)),
            first_x_m: track.node_x_m[0],
            step_m: track.step_m,
            sections,
            shapes,
            rail_damping_s: track.rail_damping_s,
            pad: track.pad,
            basis: SleeperBasis::new(&track.sleeper, sleeper_modes, typical.max(1e6))?,
            supports,
            sensor_sleeper: track.sensor_sleeper,
        })
    }

    /// First and last position of the rails, m.
    pub fn extent_m(&self) -> [f64; 2] {
        let elements = (self.layout.sleepers - 1) * self.layout.nodes_per_bay;
        [self.first_x_m, self.first_x_m + elements as f64 * self.step_m]
    }

    /// The point at `x_m` on a rail; `None` beyond the rail ends.
    pub fn point(&self, side: Side, x_m: f64) -> Option<RailPoint> {
        self.point_on(usize::from(side == Side::Stock), x_m)
    }

    #[inline(always)]
    pub(super) fn point_on(&self, side: usize, x_m: f64) -> Option<RailPoint> {
        let position = (x_m - self.first_x_m) / self.step_m;
        let elements = self.sections[side].len();
        if !(position >= 0.0 && position <= elements as f64) {
            return None;
        }
        let e = (position as usize).min(elements - 1);
        let ElementShape { shear_ratio, flexibility_m_n } = self.shapes[side][e];
        let xi = position - e as f64;
        Some(RailPoint {
            side,
            bay: e / self.layout.nodes_per_bay,
            element: e % self.layout.nodes_per_bay,
            weights: beam::shape(shear_ratio, self.step_m, xi),
            local_m_n: flexibility_m_n * clamped_flexibility(shear_ratio, xi),
        })
    }

    /// Section of an element; `None` for the bay behind the last sleeper, which has no rail.
    pub(super) fn section(&self, side: usize, bay: usize, element: usize) -> Option<&BeamSection> {
        self.sections[side].get(bay * self.layout.nodes_per_bay + element)
    }

    /// a_m M + a_k' K of a rail element, where `stiffness` already includes the damping share.
    pub(super) fn element_matrix(&self, section: &BeamSection, mass: f64, stiffness: f64) -> Matrix4 {
        let (k, m) = (beam::stiffness(section, self.step_m), beam::mass(section, self.step_m));
        std::array::from_fn(|i| std::array::from_fn(|j| mass * m[i][j] + stiffness * k[i][j]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_clamped_beam() {
        // Euler, middle: L³/192EI. Shear only: ab/(κGA L) in units of L³/12EI is Φ ξ(1 − ξ).
        assert!((clamped_flexibility(0.0, 0.5) - 12.0 / 192.0).abs() < 1e-15);
        assert!((clamped_flexibility(1e9, 0.3) / (1e9 * 0.21) - 1.0).abs() < 1e-8);
        // The same from two elements with a node under the load.
        let section = BeamSection::rail_60e1_benchmark();
        let (a, b) = (0.11, 0.19);
        let (left, right) = (beam::stiffness(&section, a), beam::stiffness(&section, b));
        let (k, c, m) = (left[2][2] + right[0][0], left[2][3] + right[0][1], left[3][3] + right[1][1]);
        let expected = m / (k * m - c * c);
        let shape = ElementShape::new(&section, a + b);
        let found = shape.flexibility_m_n * clamped_flexibility(shape.shear_ratio, a / (a + b));
        assert!((found / expected - 1.0).abs() < 1e-12, "{found} {expected}");
    }
}
