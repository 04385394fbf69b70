//! Wheel-rail contact: force as a function of the approach of wheel and rail; no tension.

use pulp::Simd;

use super::model::Lanes;
use super::vectors::{parts, vectors, vectors_mut};

/// Law of the normal contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ContactLaw {
    /// F = C δ^1.5 (Hertz), C in N/m^1.5.
    Hertz(f64),
    /// F = k δ, k in N/m.
    Linear(f64),
}

/// Newton starts at this part of the free approach at least.
const LEAST_START: f64 = 1e-3;

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

    /// One Newton step of neighbouring contacts towards δ = free − compliance · F(δ), without tension. Both laws are convex
    /// and increasing, so that the steps converge from any start.
    #[inline(always)]
    pub(super) fn newton<S: Simd>(self, simd: S, contacts: &mut Contacts) {
        let (zero, one) = (simd.splat_f64s(0.0), simd.splat_f64s(1.0));
        for part in 0..parts::<S>() {
            let (free, compliance) =
                (vectors::<S>(&contacts.free_m)[part], vectors::<S>(&contacts.compliance_m_n)[part]);
            let delta = &mut vectors_mut::<S>(&mut contacts.approach_m)[part];
            let force = &mut vectors_mut::<S>(&mut contacts.force_n)[part];
            // From zero the slope of Hertz's law leads nowhere in particular.
            let start = simd.max_f64s(*delta, simd.mul_f64s(simd.splat_f64s(LEAST_START), free));
            let start = simd.max_f64s(start, zero);
            let (at_start, slope) = self.force_and_slope(simd, start);
            let misfit = simd.mul_add_f64s(compliance, at_start, simd.sub_f64s(start, free));
            let change = simd.div_f64s(misfit, simd.mul_add_f64s(compliance, slope, one));
            let after = simd.max_f64s(simd.sub_f64s(start, change), zero);
            *delta = simd.select_f64s(simd.greater_than_f64s(free, zero), after, zero);
            *force = self.force_and_slope(simd, *delta).0;
        }
    }

    #[inline(always)]
    fn force_and_slope<S: Simd>(self, simd: S, delta: S::f64s) -> (S::f64s, S::f64s) {
        match self {
            ContactLaw::Hertz(c) => {
                let per_delta = simd.mul_f64s(simd.splat_f64s(c), simd.sqrt_f64s(delta));
                (simd.mul_f64s(per_delta, delta), simd.mul_f64s(simd.splat_f64s(1.5), per_delta))
            }
            ContactLaw::Linear(k) => {
                let k = simd.splat_f64s(k);
                (simd.mul_f64s(k, delta), k)
            }
        }
    }
}

/// Neighbouring contacts on their way to a solution.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Contacts {
    /// Approach without contact force, m.
    pub free_m: Lanes,
    /// Decrease of the approach per newton, m/N.
    pub compliance_m_n: Lanes,
    /// m.
    pub approach_m: Lanes,
    /// N.
    pub force_n: Lanes,
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
        let solve = |law: ContactLaw, free: f64, compliance: f64, guess: f64| {
            let mut contacts =
                Contacts { free_m: [free; 8], compliance_m_n: [compliance; 8], ..Contacts::default() };
            contacts.approach_m = [free - compliance * guess; 8];
            for _ in 0..30 {
                law.newton(pulp::Scalar::new(), &mut contacts);
            }
            contacts.force_n[3]
        };
        let law = ContactLaw::Hertz(9.3e10);
        for free in [1e-9, 1e-6, 1e-4, 1e-3] {
            for compliance in [0.0, 1e-12, 1e-10, 1e-8] {
                for guess in [0.0, 1e3, 1e6] {
                    let f = solve(law, free, compliance, guess);
                    assert!(
                        (law.force_n(free - compliance * f) / f - 1.0).abs() < 1e-6,
                        "{free} {compliance}"
                    );
                }
            }
        }
        assert_eq!(solve(law, -1e-3, 1e-9, 5e4), 0.0);
        assert_eq!(law.force_n(-1e-6), 0.0);
        assert!((solve(ContactLaw::Linear(1e9), 1e-4, 1e-9, 0.0) - 5e4).abs() < 1e-6);
    }
}
