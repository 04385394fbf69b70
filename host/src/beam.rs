//! Two-node Timoshenko beam element, free of shear locking, with consistent mass and rotary inertia
//! (Friedman & Kosmatka, Computers & Structures 47, 1993). Degrees of freedom: w₁, θ₁, w₂, θ₂.

use crate::section::BeamSection;

/// Real 4×4 element matrix.
pub type Matrix4 = [[f64; 4]; 4];

/// Ratio of bending to shear flexibility of an element, Φ = 12 EI / (κGA L²).
pub fn shear_ratio(section: &BeamSection, length_m: f64) -> f64 {
    12.0 * section.bending_n_m2 / (section.shear_n * length_m * length_m)
}

/// Stiffness matrix, units N/m, N, N m.
pub fn stiffness(section: &BeamSection, length_m: f64) -> Matrix4 {
    let (l, phi) = (length_m, shear_ratio(section, length_m));
    let c = section.bending_n_m2 / ((1.0 + phi) * l * l * l);
    let (a, b) = ((4.0 + phi) * l * l, (2.0 - phi) * l * l);
    scaled(
        c,
        [
            [12.0, 6.0 * l, -12.0, 6.0 * l],
            [6.0 * l, a, -6.0 * l, b],
            [-12.0, -6.0 * l, 12.0, -6.0 * l],
            [6.0 * l, b, -6.0 * l, a],
        ],
    )
}

/// Consistent mass matrix: translational plus rotary inertia.
pub fn mass(section: &BeamSection, length_m: f64) -> Matrix4 {
    let (l, phi) = (length_m, shear_ratio(section, length_m));
    let norm = (1.0 + phi) * (1.0 + phi);
    let t = section.mass_kg_m * l / 840.0 / norm;
    let m1 = 312.0 + 588.0 * phi + 280.0 * phi * phi;
    let m2 = (44.0 + 77.0 * phi + 35.0 * phi * phi) * l;
    let m3 = 108.0 + 252.0 * phi + 140.0 * phi * phi;
    let m4 = -(26.0 + 63.0 * phi + 35.0 * phi * phi) * l;
    let m5 = (8.0 + 14.0 * phi + 7.0 * phi * phi) * l * l;
    let m6 = -(6.0 + 14.0 * phi + 7.0 * phi * phi) * l * l;
    let translational =
        scaled(t, [[m1, m2, m3, m4], [m2, m5, -m4, m6], [m3, -m4, m1, -m2], [m4, m6, -m2, m5]]);
    let r = section.rotary_kg_m / (30.0 * l) / norm;
    let (n1, n2) = (36.0, (3.0 - 15.0 * phi) * l);
    let n5 = (4.0 + 5.0 * phi + 10.0 * phi * phi) * l * l;
    let n6 = (-1.0 - 5.0 * phi + 5.0 * phi * phi) * l * l;
    let rotary = scaled(r, [[n1, n2, -n1, n2], [n2, n5, -n2, n6], [-n1, -n2, n1, -n2], [n2, n6, -n2, n5]]);
    std::array::from_fn(|i| std::array::from_fn(|j| translational[i][j] + rotary[i][j]))
}

/// Shape functions of the deflection at the relative position `xi` in 0 … 1: a point load there acts on the four
/// degrees of freedom with these weights, and a deflection there is their weighted sum.
pub fn shape(phi: f64, length_m: f64, xi: f64) -> [f64; 4] {
    let (x2, x3) = (xi * xi, xi * xi * xi);
    let n = 1.0 / (1.0 + phi);
    [
        n * (1.0 - 3.0 * x2 + 2.0 * x3 + phi * (1.0 - xi)),
        n * length_m * (xi - 2.0 * x2 + x3 + 0.5 * phi * (xi - x2)),
        n * (3.0 * x2 - 2.0 * x3 + phi * xi),
        n * length_m * (x3 - x2 + 0.5 * phi * (x2 - xi)),
    ]
}

fn scaled(factor: f64, matrix: Matrix4) -> Matrix4 {
    matrix.map(|row| row.map(|v| v * factor))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn section() -> BeamSection {
        BeamSection::rail_60e1_benchmark()
    }

    fn apply(m: &Matrix4, v: [f64; 4]) -> [f64; 4] {
        std::array::from_fn(|i| (0..4).map(|j| m[i][j] * v[j]).sum())
    }

    #[test]
    fn analytic_rigid_body_motion_costs_no_force_and_carries_the_whole_mass() {
        let (s, l) = (section(), 0.3);
        for motion in [[1.0, 0.0, 1.0, 0.0], [0.0, 1.0, l, 1.0]] {
            assert!(apply(&stiffness(&s, l), motion).iter().all(|f| f.abs() < 1e-3));
        }
        let lift = apply(&mass(&s, l), [1.0, 0.0, 1.0, 0.0]);
        assert!((lift[0] + lift[2] - s.mass_kg_m * l).abs() < 1e-9);
        let spin = apply(&mass(&s, l), [-l / 2.0, 1.0, l / 2.0, 1.0]);
        let inertia = -l / 2.0 * spin[0] + spin[1] + l / 2.0 * spin[2] + spin[3];
        assert!((inertia - (s.mass_kg_m * l.powi(3) / 12.0 + s.rotary_kg_m * l)).abs() < 1e-9);
    }

    #[test]
    fn analytic_cantilever_with_shear() {
        let (s, l, p) = (section(), 1.2, 1000.0);
        // Clamped at node 1: solve the 2×2 system of node 2 for a tip force.
        let k = stiffness(&s, l);
        let det = k[2][2] * k[3][3] - k[2][3] * k[3][2];
        let tip = p * k[3][3] / det;
        let exact = p * l.powi(3) / (3.0 * s.bending_n_m2) + p * l / s.shear_n;
        assert!((tip / exact - 1.0).abs() < 1e-12);
    }

    #[test]
    fn property_shape_functions_reproduce_nodes_and_rigid_motion() {
        let (l, phi) = (0.3, shear_ratio(&section(), 0.3));
        assert_eq!(shape(phi, l, 0.0), [1.0, 0.0, 0.0, 0.0]);
        for xi in [0.0, 0.2, 0.5, 0.9, 1.0] {
            let n = shape(phi, l, xi);
            assert!((n[0] + n[2] - 1.0).abs() < 1e-12);
            assert!((n[1] + n[3] + l * n[2] - l * xi).abs() < 1e-12);
        }
    }
}
