//! Ballast under one sleeper: Kelvin bed with the nonlinear laws that a real one shows.

/// Winkler bed per metre of sleeper. Displacement w is positive downwards, zero in the unloaded track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Support {
    /// Tangent stiffness at first contact k, N/m².
    pub stiffness_n_m2: f64,
    /// Damping c, Ns/m².
    pub damping_ns_m2: f64,
    /// Part of the damping that stays while a bed that opens is open: the sleeper rubs along the crib, Ns/m².
    pub open_damping_ns_m2: f64,
    /// Ballast that moves with the sleeper, kg/m.
    pub mass_kg_m: f64,
    /// Departure from the linear bed.
    pub law: SupportLaw,
}

/// Force per metre of sleeper as a function of the displacement beyond the gap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SupportLaw {
    /// F = k w + c ẇ, both ways.
    Linear,
    /// Contact only: with w' = w − gap, F = max(k w' + c ẇ, −preload) while w' > −preload/k, else −preload: the bed pushes,
    /// it never pulls.
    Unilateral {
        /// Void under the unloaded sleeper, m.
        gap_m: f64,
        /// Pressure of the unloaded sleeper on the bed, N/m; zero where there is a gap.
        preload_n_m: f64,
    },
    /// F = k w (1 + w/w₀) + c ẇ for w > 0.
    Quadratic {
        /// Displacement w₀ at which the secant stiffness has doubled, m.
        doubling_m: f64,
    },
    /// F = k w + (factor − 1) k max(0, w − from) + c ẇ.
    Bilinear {
        /// Displacement at which the second stiffness begins, m.
        from_m: f64,
        /// Second over first stiffness.
        factor: f64,
    },
}

impl Support {
    /// Linear bed.
    pub fn linear(stiffness_n_m2: f64, damping_ns_m2: f64) -> Self {
        Self {
            stiffness_n_m2,
            damping_ns_m2,
            open_damping_ns_m2: 0.0,
            mass_kg_m: 0.0,
            law: SupportLaw::Linear,
        }
    }

    /// Stiffness and damping that the constant system matrix holds. Of a bed that opens there is only what stays while it is open, so
    /// that an open one needs no correction; a bed that stiffens is in with its first stiffness.
    pub(super) fn implicit(&self) -> (f64, f64) {
        match self.law {
            SupportLaw::Unilateral { .. } => (0.0, self.open_damping_ns_m2),
            _ => (self.stiffness_n_m2, self.damping_ns_m2),
        }
    }

    /// Damping of a bed that opens beyond what stays while it is open, Ns/m².
    pub(super) fn closed_damping_ns_m2(&self) -> f64 {
        self.damping_ns_m2 - self.open_damping_ns_m2
    }

    /// Force per metre on the sleeper beyond what the constant matrices hold (what stays of a bed that opens, the first stiffness of
    /// one that stiffens), positive downwards, N/m.
    pub fn correction(&self, w_m: f64, rate_m_s: f64) -> f64 {
        let k = self.stiffness_n_m2;
        match self.law {
            SupportLaw::Linear => 0.0,
            SupportLaw::Unilateral { gap_m, preload_n_m } => {
                let elastic = k * (w_m - gap_m);
                let force = if elastic > -preload_n_m {
                    (elastic + self.closed_damping_ns_m2() * rate_m_s).max(-preload_n_m)
                } else {
                    -preload_n_m
                };
                -force
            }
            SupportLaw::Quadratic { doubling_m } => {
                let w = w_m.max(0.0);
                -k * w * w / doubling_m
            }
            SupportLaw::Bilinear { from_m, factor } => -(factor - 1.0) * k * (w_m - from_m).max(0.0),
        }
    }

    /// Whether the bed follows F = k w + c ẇ.
    pub fn is_linear(&self) -> bool {
        self.law == SupportLaw::Linear
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_laws_at_hand_picked_points() {
        let bed = |law| Support { law, ..Support::linear(30e6, 1e5) };
        let void = bed(SupportLaw::Unilateral { gap_m: 1e-3, preload_n_m: 0.0 });
        assert_eq!(void.correction(0.9e-3, 1.0), 0.0, "open: no damping either");
        assert!((void.correction(1.5e-3, 0.0) + 15e3).abs() < 1e-6);
        assert_eq!(void.correction(1.1e-3, -1.0), 0.0, "damping may cancel contact but not pull");
        let rubbing = Support { open_damping_ns_m2: 4e4, ..void };
        assert_eq!(rubbing.implicit(), (0.0, 4e4));
        assert_eq!(rubbing.correction(0.9e-3, 1.0), 0.0, "what stays is in the matrices");
        assert!(
            (rubbing.correction(1.5e-3, 0.1) + 15e3 + 6e3).abs() < 1e-6,
            "all of the damping where it is closed"
        );
        let resting = bed(SupportLaw::Unilateral { gap_m: 0.0, preload_n_m: 1500.0 });
        assert_eq!(resting.correction(-1e-3, 0.0), 1500.0, "lifted: the missing reaction of the weight");
        assert!((resting.correction(-1e-5, 0.0) - 300.0).abs() < 1e-9);
        let quadratic = bed(SupportLaw::Quadratic { doubling_m: 1e-3 });
        assert!((quadratic.correction(1e-3, 0.0) + 30e3).abs() < 1e-6);
        assert_eq!(quadratic.correction(-1e-3, 0.0), 0.0);
        let bilinear = bed(SupportLaw::Bilinear { from_m: 0.5e-3, factor: 3.0 });
        assert!((bilinear.correction(1e-3, 0.0) + 30e3).abs() < 1e-6);
    }
}
