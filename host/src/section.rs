//! Cross sections, supports and vehicles as the physics uses them, built from the site description or from named,
//! published sets.

use crate::recording::{Rail, Sleeper};

/// Section of a Timoshenko beam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BeamSection {
    /// Bending stiffness EI, N m².
    pub bending_n_m2: f64,
    /// Shear stiffness κGA, N.
    pub shear_n: f64,
    /// Mass per metre, kg/m.
    pub mass_kg_m: f64,
    /// Rotary inertia per metre ρI, kg m.
    pub rotary_kg_m: f64,
}

impl BeamSection {
    /// Rail 60E1 as in the receptance benchmark of the rolland and railFE codes: E 210 GPa, G 80.769 GPa, κ 0.393,
    /// I 3037 cm⁴, A 76.70 cm², 60.2 kg/m.
    pub fn rail_60e1_benchmark() -> Self {
        let (i, area, mass) = (3.037e-5, 76.70e-4, 60.2);
        Self {
            bending_n_m2: 210e9 * i,
            shear_n: 0.393 * 80.769e9 * area,
            mass_kg_m: mass,
            rotary_kg_m: mass / area * i,
        }
    }

    /// Plain rail of a site.
    pub fn plain_rail(rail: &Rail) -> Self {
        let shear_modulus = rail.youngs_modulus_pa / 2.0 / (1.0 + rail.poisson);
        Self {
            bending_n_m2: rail.youngs_modulus_pa * rail.second_moment_m4,
            shear_n: shear_modulus * rail.area_m2 * rail.shear_coefficient,
            mass_kg_m: rail.mass_per_metre_kg,
            rotary_kg_m: rail.mass_per_metre_kg / rail.area_m2 * rail.second_moment_m4,
        }
    }

    /// Crossing part of the crossing-side rail: both stiffnesses and both inertias multiplied (paper, Table 1).
    pub fn crossing_rail(rail: &Rail) -> Self {
        let plain = Self::plain_rail(rail);
        Self {
            bending_n_m2: plain.bending_n_m2 * rail.crossing_part_stiffness_factor,
            shear_n: plain.shear_n * rail.crossing_part_stiffness_factor,
            mass_kg_m: plain.mass_kg_m * rail.crossing_part_mass_factor,
            rotary_kg_m: plain.rotary_kg_m * rail.crossing_part_mass_factor,
        }
    }

    /// Section of an element of which a `share` is of `other`: bends and shears as much as the two in a row, and weighs as much.
    pub fn in_a_row_with(&self, other: &Self, share: f64) -> Self {
        let mean = |own: f64, other: f64| (1.0 - share) * own + share * other;
        let in_series = |own: f64, other: f64| 1.0 / mean(1.0 / own, 1.0 / other);
        Self {
            bending_n_m2: in_series(self.bending_n_m2, other.bending_n_m2),
            shear_n: in_series(self.shear_n, other.shear_n),
            mass_kg_m: mean(self.mass_kg_m, other.mass_kg_m),
            rotary_kg_m: mean(self.rotary_kg_m, other.rotary_kg_m),
        }
    }

    /// Rectangular sleeper of a site.
    pub fn sleeper(sleeper: &Sleeper) -> Self {
        let area = sleeper.width_m * sleeper.height_m;
        let i = sleeper.width_m * sleeper.height_m.powi(3) / 12.0;
        let shear_modulus = sleeper.youngs_modulus_pa / 2.0 / (1.0 + sleeper.poisson);
        Self {
            bending_n_m2: sleeper.youngs_modulus_pa * i,
            shear_n: shear_modulus * area * sleeper.shear_coefficient,
            mass_kg_m: sleeper.density_kg_m3 * area,
            rotary_kg_m: sleeper.density_kg_m3 * i,
        }
    }
}
