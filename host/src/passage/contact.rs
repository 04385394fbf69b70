//! Wheel-rail contact: force as a function of the approach of wheel and rail; no tension.

/// Law of the normal contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ContactLaw {
    /// F = C δ^1.5 (Hertz), C in N/m^1.5.
    Hertz(f64),
    /// F = k δ, k in N/m.
    Linear(f64),
}

/// Newton stops when the approach changes by less than this part; convergence is quadratic, so that the error left is of the
/// order of its square.
const TOLERANCE: f64 = 3e-6;
const NEWTON_STEPS: usize = 30;

impl ContactLaw {
    /// Force at approach `delta_m`; zero when wheel and rail are apart.
    #[inline(always)]
    pub fn force_n(self, delta_m: f64) -> f64 {
        let delta = delta_m.max(0.0);
        match self {
            ContactLaw::Hertz(c) => c * delta * delta.sqrt(),
            ContactLaw::Linear(k) => k * delta,
        }
    }

    /// Approach under a force.
    pub fn approach_m(self, force_n: f64) -> f64 {
        let force = force_n.max(0.0);
        match self {
            ContactLaw::Hertz(c) => (force / c).powf(2.0 / 3.0),
            ContactLaw::Linear(k) => force / k,
        }
    }

    /// Force when the approach is `free_m` without a force and `compliance_m_n` less per newton:
    /// F = law(free − compliance · F). `guess_n` speeds it up.
    #[inline(always)]
    pub fn solve_n(self, free_m: f64, compliance_m_n: f64, guess_n: f64) -> f64 {
        if free_m <= 0.0 {
            return 0.0;
        }
        let c = match self {
            ContactLaw::Linear(k) => return k * free_m / (1.0 + k * compliance_m_n),
            ContactLaw::Hertz(c) => c,
        };
        // g(δ) = δ + a δ^1.5 − free is increasing and convex: Newton converges from any positive start.
        let a = c * compliance_m_n;
        let mut delta = (free_m - compliance_m_n * guess_n).clamp(1e-3 * free_m, free_m);
        for _ in 0..NEWTON_STEPS {
            let root = delta.sqrt();
            let change = (delta + a * delta * root - free_m) / (1.0 + 1.5 * a * root);
            delta = (delta - change).max(0.0);
            if change.abs() <= TOLERANCE * free_m {
                break;
            }
        }
        self.force_n(delta)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_approach_of_steel_wheel_on_rail() {
        // Hertz for a wheel of 0.46 m on a rail head of 0.30 m: 9.41e10 N/m^1.5, 87 µm at 76 kN.
        let approach = ContactLaw::Hertz(9.41e10).approach_m(76e3);
        assert!((approach - 87e-6).abs() < 0.5e-6, "{approach}");
        assert!((ContactLaw::Hertz(9.41e10).force_n(approach) / 76e3 - 1.0).abs() < 1e-12);
    }

    #[test]
    fn property_solution_satisfies_the_law_and_never_pulls() {
        let law = ContactLaw::Hertz(9.3e10);
        for free in [1e-9, 1e-6, 1e-4, 1e-3] {
            for compliance in [0.0, 1e-12, 1e-10, 1e-8] {
                for guess in [0.0, 1e3, 1e6] {
                    let f = law.solve_n(free, compliance, guess);
                    assert!(
                        (law.force_n(free - compliance * f) / f - 1.0).abs() < 1e-6,
                        "{free} {compliance}"
                    );
                }
            }
        }
        assert_eq!(law.solve_n(-1e-3, 1e-9, 5e4), 0.0);
        assert_eq!(law.force_n(-1e-6), 0.0);
        assert!((ContactLaw::Linear(1e9).solve_n(1e-4, 1e-9, 0.0) - 5e4).abs() < 1e-6);
    }
}
