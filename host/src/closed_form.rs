//! Closed forms that the model is checked against: each a small function with its source, used by the tests and by
//! `verify` alike. SI units; displacement and force positive downwards; time factor e^{+iωt}.

use faer::c64;

use crate::section::BeamSection;

/// Deflection in metres at distance `x_m` from a static force on an endless Euler beam on a Winkler foundation.
///
/// w = P β/(2k) e^{−βx}(cos βx + sin βx), β = (k/4EI)^¼. Hetényi, Beams on Elastic Foundation (1946), ch. 1.
pub fn winkler_euler_m(force_n: f64, foundation_n_m2: f64, bending_n_m2: f64, x_m: f64) -> f64 {
    let beta = (foundation_n_m2 / 4.0 / bending_n_m2).powf(0.25);
    let u = beta * x_m.abs();
    force_n * beta / (2.0 * foundation_n_m2) * (-u).exp() * (u.cos() + u.sin())
}

/// Deflection in metres under a static force on an endless Timoshenko beam on a Winkler foundation.
///
/// w₀ = P/(2EI √(2(r+p))) (1/r + EI/S), r = √(k/EI), p = k/2S, S = κGA; follows from the Fourier transform of the
/// static beam equations.
pub fn winkler_timoshenko_m(force_n: f64, foundation_n_m2: f64, section: &BeamSection) -> f64 {
    let (bending, shear) = (section.bending_n_m2, section.shear_n);
    let r = (foundation_n_m2 / bending).sqrt();
    let p = foundation_n_m2 / (2.0 * shear);
    force_n / (2.0 * bending * (2.0 * (r + p)).sqrt()) * (1.0 / r + bending / shear)
}

/// Track as the one mass, spring and damper that a slow wheel feels at a point of the rail.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LumpedTrack {
    /// kg.
    pub mass_kg: f64,
    /// N/m.
    pub stiffness_n_m: f64,
    /// Ns/m.
    pub damping_ns_m: f64,
}

impl LumpedTrack {
    /// A rail (EI) on a continuous support: energies of the static deflection, K = 2k/β, M = 3m/2β, C = 3c/2β with
    /// β = (k/4EI)^¼. Jenkins et al., The effect of track and vehicle parameters on wheel/rail vertical dynamic forces,
    /// Railway Engineering Journal 3 (1974).
    pub fn of_beam(bending_n_m2: f64, support_n_m2: f64, damping_ns_m2: f64, mass_kg_m: f64) -> Self {
        let beta = (support_n_m2 / (4.0 * bending_n_m2)).powf(0.25);
        Self {
            mass_kg: 1.5 * mass_kg_m / beta,
            stiffness_n_m: 2.0 * support_n_m2 / beta,
            damping_ns_m: 1.5 * damping_ns_m2 / beta,
        }
    }

    /// Constants of the British standard for the P2 force (GM/TT0088).
    pub fn gm_tt_0088() -> Self {
        Self { mass_kg: 245.0, stiffness_n_m: 62e6, damping_ns_m: 55.4e3 }
    }
}

/// Dynamic part of the P2 force in newtons: an unsprung mass that meets a dip of total angle 2α at speed v.
///
/// P2 − P0 = 2αv √(Mu/(Mu+Mt)) [1 − πCt/(4 √(Kt(Mu+Mt)))] √(Kt Mu), Jenkins et al. (1974). The bracket is the first term
/// in light damping; with the damping of ballast it becomes too small, so an upper bound takes Ct = 0.
pub fn jenkins_p2_n(track: &LumpedTrack, unsprung_kg: f64, angle_rad: f64, speed_m_s: f64) -> f64 {
    let (m, k) = (unsprung_kg + track.mass_kg, track.stiffness_n_m);
    let damping = 1.0 - std::f64::consts::PI * track.damping_ns_m / (4.0 * (k * m).sqrt());
    angle_rad * speed_m_s * (unsprung_kg / m).sqrt() * damping * (k * unsprung_kg).sqrt()
}

/// Natural angular frequencies squared (rad²/s²) of a simply supported Timoshenko beam for the wave number nπ/L:
/// bending branch, shear branch.
///
/// a ω⁴ − b ω² + c = 0, with the mass m and the rotary inertia J per metre:
/// a = mJ, b = S(m + k²J) + m k² EI, c = S EI k⁴. Timoshenko, Phil. Mag. 41 (1921).
pub fn simply_supported_omega2(section: &BeamSection, span_m: f64, n: usize) -> [f64; 2] {
    let k2 = (n as f64 * std::f64::consts::PI / span_m).powi(2);
    let BeamSection { bending_n_m2: ei, shear_n: s, mass_kg_m: m, rotary_kg_m: j } = *section;
    let (a, b, c) = (m * j, s * (m + k2 * j) + m * k2 * ei, s * ei * k2 * k2);
    let root = (b * b - 4.0 * a * c).sqrt();
    // The small root by the product of the roots: no cancellation.
    let high = (b + root) / (2.0 * a);
    [c / (a * high), high]
}

/// First bending frequency of a rail between two supports that only hold it down, Hz: the pinned–pinned frequency.
pub fn pinned_pinned_hz(section: &BeamSection, span_m: f64) -> f64 {
    simply_supported_omega2(section, span_m, 1)[0].sqrt() / std::f64::consts::TAU
}

/// The same without shear deformation and rotary inertia, Hz: π/(2L²) √(EI/m).
pub fn pinned_pinned_euler_hz(section: &BeamSection, span_m: f64) -> f64 {
    std::f64::consts::FRAC_PI_2 / (span_m * span_m) * (section.bending_n_m2 / section.mass_kg_m).sqrt()
}

/// Two-layer support, everything per metre of rail: pads, sleepers as a mass layer, ballast.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct TwoLayer {
    pub pad_n_m2: f64,
    pub pad_ns_m2: f64,
    pub ballast_n_m2: f64,
    pub ballast_ns_m2: f64,
    pub sleeper_kg_m: f64,
}

impl TwoLayer {
    /// Dynamic stiffness under the rail, N/m²: pad in series with sleeper on ballast.
    pub fn dynamic(&self, omega: f64) -> c64 {
        let pad = c64::new(self.pad_n_m2, omega * self.pad_ns_m2);
        let below =
            c64::new(self.ballast_n_m2 - omega * omega * self.sleeper_kg_m, omega * self.ballast_ns_m2);
        pad * below / (pad + below)
    }
}

/// Point receptance (m/N) of an endless Timoshenko beam on a continuous support of dynamic stiffness `support`.
///
/// Inverse Fourier transform over the wave number by residues, S EI (ξ²−z₁)(ξ²−z₂) = (Sξ²+D)(EIξ²+B) − S²ξ² with
/// D = k_f − mω², B = S − Jω². Knothe & Grassie, Vehicle System Dynamics 22 (1993), section 3.
pub fn point_receptance(section: &BeamSection, support: c64, omega: f64) -> c64 {
    let (ei, s) = (section.bending_n_m2, section.shear_n);
    let d = support - omega * omega * section.mass_kg_m;
    let b = c64::new(s - omega * omega * section.rotary_kg_m, 0.0);
    let (quadratic, linear, constant) = (c64::new(s * ei, 0.0), b * s + d * ei - s * s, d * b);
    let root = (linear * linear - quadratic * constant * 4.0).sqrt();
    let z = [(-linear + root) / (quadratic * 2.0), (-linear - root) / (quadratic * 2.0)];
    let mut sum = c64::new(0.0, 0.0);
    for (this, other) in [(z[0], z[1]), (z[1], z[0])] {
        let xi = this.sqrt();
        // The pole in the upper half plane belongs to the wave that decays away from the force.
        let xi = if xi.im < 0.0 { -xi } else { xi };
        sum += (this * ei + b) / (quadratic * (this - other) * xi * 2.0);
    }
    sum * c64::new(0.0, 1.0)
}

/// Receptance of a mass on a spring and a damper, m/N.
pub fn oscillator_receptance(mass_kg: f64, stiffness_n_m: f64, damping_ns_m: f64, omega: f64) -> c64 {
    c64::new(1.0, 0.0) / c64::new(stiffness_n_m - omega * omega * mass_kg, omega * damping_ns_m)
}

/// Displacement of a resting, less than critically damped oscillator at `t_s` after a unit impulse, m/(N s).
pub fn oscillator_impulse(mass_kg: f64, stiffness_n_m: f64, damping_ns_m: f64, t_s: f64) -> f64 {
    if t_s < 0.0 {
        return 0.0;
    }
    let decay = damping_ns_m / (2.0 * mass_kg);
    let damped = (stiffness_n_m / mass_kg - decay * decay).sqrt();
    (-decay * t_s).exp() * (damped * t_s).sin() / (mass_kg * damped)
}

/// A constant force that crosses a simply supported Timoshenko beam, which rests when the force arrives at its end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BeamCrossing {
    /// Beam.
    pub section: BeamSection,
    /// Span, metres.
    pub span_m: f64,
    /// Damping matrix = this × stiffness matrix, s.
    pub damping_s: f64,
    /// Force, newtons.
    pub force_n: f64,
    /// Speed, m/s.
    pub speed_m_s: f64,
}

impl BeamCrossing {
    /// Deflection at `x_m` at the time `t_s` after the force came on, metres; `modes` sine terms of both branches.
    ///
    /// Frýba, Vibration of Solids and Structures under Moving Loads (1972), ch. 1.3, with modal damping.
    pub fn deflection_m(&self, x_m: f64, t_s: f64, modes: usize) -> f64 {
        (1..=modes)
            .map(|n| {
                let k = n as f64 * std::f64::consts::PI / self.span_m;
                let branches = simply_supported_omega2(&self.section, self.span_m, n);
                let sum: f64 = branches.iter().map(|w2| self.branch(k, *w2, t_s)).sum();
                (k * x_m).sin() * sum
            })
            .sum()
    }

    /// Modal coordinate of one branch under the force P sin(kvt), at rest at first.
    fn branch(&self, k: f64, omega2: f64, t_s: f64) -> f64 {
        let s = &self.section;
        let rotation = s.shear_n * k / (s.bending_n_m2 * k * k + s.shear_n - s.rotary_kg_m * omega2);
        let mass = 0.5 * self.span_m * (s.mass_kg_m + s.rotary_kg_m * rotation * rotation);
        let (drive, decay) = (k * self.speed_m_s, 0.5 * self.damping_s * omega2);
        let difference = omega2 - drive * drive;
        let spread = difference.powi(2) + (2.0 * decay * drive).powi(2);
        let (sine, cosine) = (difference / spread, -2.0 * decay * drive / spread);
        // Free part that puts displacement and velocity to zero at first; complex so that any damping is allowed.
        let damped = c64::new(omega2 - decay * decay, 0.0).sqrt();
        let start = (-decay * cosine - sine * drive) / damped;
        let z = damped * t_s;
        // e^{−decay t} goes into the exponentials: cosh of an overdamped mode alone would overflow.
        let (plus, minus) =
            ((z * c64::new(0.0, 1.0) - decay * t_s).exp(), (z * c64::new(0.0, -1.0) - decay * t_s).exp());
        let cos = (plus + minus) * 0.5;
        let sin = (plus - minus) * c64::new(0.0, -0.5);
        let free = cos * (-cosine) + sin * start;
        self.force_n / mass * (sine * (drive * t_s).sin() + cosine * (drive * t_s).cos() + free.re)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 60E1, E 210 GPa, ν 0.3, κ 0.4, I 3038 cm⁴, A 76.70 cm², 7850 kg/m³.
    fn rail() -> BeamSection {
        let (i, area, mass) = (3.038e-5, 76.70e-4, 7850.0 * 76.70e-4);
        BeamSection {
            bending_n_m2: 210e9 * i,
            shear_n: 210e9 / 2.6 * area * 0.4,
            mass_kg_m: mass,
            rotary_kg_m: mass / area * i,
        }
    }

    #[test]
    fn reference_winkler_deflections_of_a_60e1_rail() {
        let p = 76_027.5;
        let known = [
            (20e6, 1.78835e-3, 1.84891e-3),
            (40e6, 1.06336e-3, 1.11409e-3),
            (60e6, 0.78453e-3, 0.83024e-3),
            (100e6, 0.53484e-3, 0.57489e-3),
        ];
        for (k, euler, timoshenko) in known {
            assert!((winkler_euler_m(p, k, rail().bending_n_m2, 0.0) / euler - 1.0).abs() < 1e-5);
            assert!((winkler_timoshenko_m(p, k, &rail()) / timoshenko - 1.0).abs() < 1e-5, "{k}");
        }
    }

    /// Forces that the standard's constants give for an axle of 15.5 t.
    #[test]
    fn reference_p2_forces_of_the_standard() {
        let known =
            [(130.0, [102e3, 128e3, 179e3]), (160.0, [108e3, 139e3, 203e3]), (200.0, [116e3, 155e3, 234e3])];
        for (km_h, forces) in known {
            for (force, angle) in forces.into_iter().zip([5e-3, 10e-3, 20e-3]) {
                let found = 76_027.5 + jenkins_p2_n(&LumpedTrack::gm_tt_0088(), 670.0, angle, km_h / 3.6);
                assert!((found / force - 1.0).abs() < 5e-3, "{km_h} km/h, {angle}: {found}");
            }
        }
    }

    #[test]
    fn reference_pinned_pinned_frequencies() {
        for (span, euler, timoshenko) in [(0.60, 1420.0, 1067.0), (0.65, 1210.0, 939.0)] {
            assert!((pinned_pinned_euler_hz(&rail(), span) - euler).abs() < 1.0);
            assert!((pinned_pinned_hz(&rail(), span) - timoshenko).abs() < 1.0);
        }
    }

    #[test]
    fn reference_two_layer_receptances() {
        let per_seat = |kp: f64, cp: f64, kb: f64, cb: f64, ms: f64| TwoLayer {
            pad_n_m2: kp / 0.6,
            pad_ns_m2: cp / 0.6,
            ballast_n_m2: kb / 0.6,
            ballast_ns_m2: cb / 0.6,
            sleeper_kg_m: ms / 0.6,
        };
        let tracks = [
            (
                per_seat(60e6, 6e3, 39e6, 162.5e3, 130.0),
                [14.8175, 14.2258, 12.1073, 9.6861, 14.8312, 11.5998],
            ),
            (
                per_seat(1200e6, 25e3, 39e6, 162.5e3, 130.0),
                [10.5476, 10.0244, 8.0394, 4.9445, 2.1530, 1.5468],
            ),
            (per_seat(200e6, 28e3, 40e6, 47e3, 140.0), [11.5455, 12.0044, 14.9525, 9.5285, 1.8951, 2.1669]),
        ];
        for (support, known) in tracks {
            for (f, h) in [0.0, 20.0, 50.0, 100.0, 200.0, 250.0].into_iter().zip(known) {
                let omega = std::f64::consts::TAU * f;
                let found = point_receptance(&rail(), support.dynamic(omega), omega);
                assert!((found.norm() * 1e9 / h - 1.0).abs() < 1e-4, "{f} Hz: {} {h}", found.norm() * 1e9);
                assert!(found.im <= 0.0, "a damped track takes up power");
            }
        }
    }

    #[test]
    fn analytic_receptance_at_rest_is_the_winkler_deflection() {
        let found = point_receptance(&rail(), c64::new(40e6, 0.0), 0.0);
        assert!((found.re / winkler_timoshenko_m(1.0, 40e6, &rail()) - 1.0).abs() < 1e-10);
    }

    #[test]
    fn analytic_slow_force_bends_the_beam_statically() {
        let beam =
            BeamCrossing { section: rail(), span_m: 3.6, damping_s: 1e-3, force_n: 1e4, speed_m_s: 1e-2 };
        let middle = beam.deflection_m(1.8, 180.0, 400);
        let s = rail();
        let statics = 1e4 * (3.6f64.powi(3) / (48.0 * s.bending_n_m2) + 3.6 / (4.0 * s.shear_n));
        // The shear term of the sine series converges as 1/n.
        assert!((middle / statics - 1.0).abs() < 1e-3, "{middle} {statics}");
    }
}
