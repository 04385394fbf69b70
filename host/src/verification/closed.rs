//! Closed forms: beams on foundation, two-layer track, simply supported beam, oscillator.

use std::f64::consts::TAU;

use super::reference::{self, WHEEL_N};
use super::{Case, Curves, Table, largest, tolerance};
use crate::closed_form::{
    BeamCrossing, TwoLayer, oscillator_impulse, pinned_pinned_hz, point_receptance, winkler_euler_m,
    winkler_timoshenko_m,
};
use crate::greens::moving_response::RailGreens;
use crate::greens::{Chain, GreensFunctions, GreensSampling, Quantity};
use crate::section::BeamSection;
use crate::track::{Kelvin, Side, Sleeper, Track};

/// 60E1 with the numbers of the paper's table 1 and κ = 0.4.
fn rail() -> BeamSection {
    reference::panel(reference::SOFT, crate::track::Mesh::default()).plain
}

/// Deflection of the rail under a static wheel for a foundation of 40 MN/m², with and without shear.
pub fn winkler() -> Vec<Case> {
    let foundation = 40e6;
    let support = |k: f64| TwoLayer {
        pad_n_m2: 1e14,
        pad_ns_m2: 0.0,
        ballast_n_m2: k,
        ballast_ns_m2: 0.0,
        sleeper_kg_m: 0.0,
    };
    // 5 cm between supports: a twentieth of the length over which the rail bends.
    let deflections = |section: BeamSection| {
        let track = reference::continuous(section, support(foundation), 0.05);
        let supports = vec![foundation; track.sleeper_x_m.len()];
        let middle = track.node_x_m.len() / 2;
        let nodes: Vec<usize> = (middle..middle + 81).collect();
        let read = track.rail_receptance(&[0.0], &supports, Side::Crossing, &[middle], &nodes);
        let w: Vec<f64> = read[0][0].iter().map(|h| WHEEL_N * h.re).collect();
        (nodes.iter().map(|n| track.node_x_m[*n]).collect::<Vec<f64>>(), w)
    };
    // A rail that cannot shear is an Euler beam.
    let euler = BeamSection { shear_n: 1e16, ..rail() };
    let (x, found) = deflections(euler);
    let expected: Vec<f64> =
        x.iter().map(|x| winkler_euler_m(WHEEL_N, foundation, euler.bending_n_m2, *x)).collect();
    let curves = Curves {
        x_caption: "distance from the wheel, m",
        y_caption: "deflection, m",
        x,
        expected: expected.clone(),
        found: found.clone(),
    };
    let (_, timoshenko) = deflections(rail());
    vec![
        Case::new("static wheel on Winkler foundation, Euler rail", "Hetényi (1946), ch. 1", "m")
            .values(expected[0], found[0], tolerance::WINKLER_EULER)
            .with(curves),
        Case::new("static wheel on Winkler foundation, Timoshenko rail", "Fourier transform, closed", "m")
            .values(
                winkler_timoshenko_m(WHEEL_N, foundation, &rail()),
                timoshenko[0],
                tolerance::WINKLER_TIMOSHENKO,
            ),
    ]
}

/// Point receptance on a continuous two-layer support: finite elements on dense supports and on sleepers.
pub fn two_layer() -> Vec<Case> {
    let pads = [reference::SOFT, reference::STIFF];
    let mut cases = Vec::new();
    for pad in pads {
        let d = 0.6;
        let layers = TwoLayer {
            pad_n_m2: pad.pad.stiffness / d,
            pad_ns_m2: pad.pad.damping / d,
            ballast_n_m2: 39e6 / d,
            ballast_ns_m2: 162.5e3 / d,
            sleeper_kg_m: 130.0 / d,
        };
        let f: Vec<f64> = (0..=60).map(|k| 5.0 * k as f64).collect();
        let expected: Vec<f64> =
            f.iter().map(|f| point_receptance(&rail(), layers.dynamic(TAU * f), TAU * f).norm()).collect();
        // On sleepers the wheel finds another stiffness over a sleeper than between two: their mean is compared.
        for (what, spacing, tolerance) in [
            ("dense supports", 0.05, tolerance::TWO_LAYER_DENSE),
            ("sleepers", d, tolerance::TWO_LAYER_SLEEPERS),
        ] {
            let track = reference::continuous(rail(), layers, spacing);
            let found = mean_receptance(&track, layers.ballast_n_m2, &f);
            cases.push(
                Case::new(
                    &format!("two-layer track, {}, {what}, 0-250 Hz", pad.name),
                    "closed form by residues (Knothe & Grassie 1993)",
                    "m/N",
                )
                .worst(&expected[..=50], &found[..=50], tolerance)
                .with(Curves {
                    x_caption: "frequency, Hz",
                    y_caption: "receptance, m/N",
                    x: f.clone(),
                    expected: expected.clone(),
                    found,
                }),
            );
        }
    }
    cases
}

/// Magnitude of the point receptance, mean of over a support and between two.
fn mean_receptance(track: &Track, ballast_n_m2: f64, f: &[f64]) -> Vec<f64> {
    let supports = vec![ballast_n_m2; track.sleeper_x_m.len()];
    let seat = track.seat_node(track.sleeper_x_m.len() / 2);
    let between = seat + (track.seat_node(1) / 2).max(1);
    let loaded = [seat, between];
    track
        .rail_receptance(f, &supports, Side::Crossing, &loaded, &loaded)
        .iter()
        .map(|h| if track.seat_node(1) > 1 { 0.5 * (h[0][0] + h[1][1]).norm() } else { h[0][0].norm() })
        .collect()
}

/// Pinned–pinned frequency at 0.6 m with its convergence over the elements per bay.
pub fn pinned_pinned() -> (Vec<Case>, Table) {
    let (span, section) = (0.6, rail());
    let exact = pinned_pinned_hz(&section, span);
    let mut table = Table::new(
        "Pinned\u{2013}pinned frequency of a 60E1 rail, 0.6 m between supports",
        "Plain elements with consistent mass: the error falls with the square of the element length. The track uses \
         them halved twice and condensed, which is worth four times as many.",
        &["elements per bay", "frequency, Hz", "error"],
    );
    let mut errors = Vec::new();
    for elements in [2, 4, 6, 8, 12] {
        let mut track = reference::simple_beam(section, span, elements, 0.0);
        track.rail_halvings = 0;
        let hz = first_resonance_hz(&track, exact);
        errors.push(hz / exact - 1.0);
        table.row(&[
            elements.to_string(),
            format!("{hz:.1}"),
            format!("{:+.2} %", 100.0 * (hz / exact - 1.0)),
        ]);
    }
    let order = (errors[1] / errors[3]).log2();
    let cases = vec![
        Case::new("pinned\u{2013}pinned frequency, 12 elements per bay", "Timoshenko (1921)", "Hz").values(
            exact,
            exact * (1.0 + errors[4]),
            tolerance::PINNED_PINNED,
        ),
        Case::new("pinned\u{2013}pinned frequency, order of convergence", "4 and 8 elements per bay", "1")
            .values(2.0, order, tolerance::ORDER),
    ];
    (cases, table)
}

/// Frequency near `guess_hz` at which the undamped midspan receptance changes sign through infinity, Hz.
fn first_resonance_hz(track: &Track, guess_hz: f64) -> f64 {
    let middle = track.node_x_m.len() / 2;
    let below = |hz: f64| {
        let h =
            track.rail_receptance(&[hz], &reference::rigid_ballast(), Side::Crossing, &[middle], &[middle]);
        h[0][0][0].re > 0.0
    };
    let (mut low, mut high) = (0.8 * guess_hz, 1.2 * guess_hz);
    for _ in 0..50 {
        let hz = 0.5 * (low + high);
        if below(hz) { low = hz } else { high = hz }
    }
    0.5 * (low + high)
}

/// A wheel rolls over a simply supported rail: deflection under the wheel by the moving-response kernel.
pub fn moving_on_simple_beam() -> Case {
    // Damping of 20 % in the first mode lets the response die within the memory of the kernel.
    let crossing =
        BeamCrossing { section: rail(), span_m: 3.6, damping_s: 1.6e-3, force_n: WHEEL_N, speed_m_s: 20.0 };
    let track = reference::simple_beam(crossing.section, crossing.span_m, 24, crossing.damping_s);
    let rate_hz = 1000.0;
    let sampling = GreensSampling { rate_hz, len: 512, band_hz: [300.0, 400.0] };
    let rail = RailGreens::of_crossing_rail(&track, &reference::rigid_ballast(), 1.8, sampling);
    let time: Vec<f64> =
        (0..=(crossing.span_m / crossing.speed_m_s * rate_hz) as usize).map(|k| k as f64 / rate_hz).collect();
    let x: Vec<f64> = time.iter().map(|t| crossing.speed_m_s * t - 0.5 * crossing.span_m).collect();
    let found = under_constant_force(&rail, &x, crossing.force_n);
    let expected: Vec<f64> =
        time.iter().map(|t| crossing.deflection_m(crossing.speed_m_s * t, *t, 60)).collect();
    Case::new(
        "wheel over a simply supported rail, largest difference",
        "Frýba (1972), ch. 1.3, modal sum; relative to the largest deflection",
        "1",
    )
    .values(0.0, largest_difference(&expected, &found), tolerance::SIMPLE_BEAM)
    .with(Curves {
        x_caption: "position of the wheel, m",
        y_caption: "deflection under the wheel, m",
        x,
        expected,
        found,
    })
}

/// Impulse response of a sleeper on ballast: the inverse transform of the receptance.
pub fn oscillator() -> Case {
    let (mass, stiffness, damping) = (150.0, 37.5e6, 20e3);
    let mut track = reference::simple_beam(rail(), 0.6, 2, 0.0);
    // Two sleepers carry a light, rigid rail: a force in its middle moves both by half.
    track.plain = BeamSection { bending_n_m2: 1e12, shear_n: 1e13, mass_kg_m: 1e-6, rotary_kg_m: 1e-9 };
    track.crossing_rail = track.plain;
    track.pad = Kelvin { stiffness: 1e13, damping: 0.0 };
    track.sleeper = Sleeper::RigidHalves { mass_kg: mass, length_m: 1.25 };
    track.ballast_damping_ns_m2 = damping / 1.25;
    let sampling = GreensSampling { rate_hz: 40_000.0, len: 16_384, band_hz: [18_000.0, 19_900.0] };
    let greens = GreensFunctions::new(
        &track,
        &[stiffness / 1.25; 2],
        sampling,
        Quantity::Displacement,
        &Chain::Corrected,
    );
    let mut response = vec![0.0; sampling.len];
    greens.at(Side::Crossing, 0.0, &mut response);
    let x: Vec<f64> = (0..2000).map(|k| k as f64 / sampling.rate_hz).collect();
    let expected: Vec<f64> =
        x.iter().map(|t| 0.5 * oscillator_impulse(mass, stiffness, damping, *t)).collect();
    let found = response[..x.len()].to_vec();
    Case::new(
        "impulse response of a sleeper on ballast, largest difference",
        "damped oscillator; relative to the largest displacement",
        "1",
    )
    .values(0.0, largest_difference(&expected, &found), tolerance::OSCILLATOR)
    .with(Curves { x_caption: "time, s", y_caption: "displacement, m/(N s)", x, expected, found })
}

/// Deflection under a constant force at the positions of a wheel, one per time step.
pub(super) fn under_constant_force(rail: &RailGreens, position_m: &[f64], force_n: f64) -> Vec<f64> {
    let kernel = rail.kernel(position_m);
    (0..position_m.len())
        .map(|k| force_n * (0..position_m.len()).map(|j| kernel[(k, j)]).sum::<f64>())
        .collect()
}

/// Largest difference of two curves relative to the largest expected value.
pub(super) fn largest_difference(expected: &[f64], found: &[f64]) -> f64 {
    let scale = largest(expected.iter().map(|v| v.abs()));
    let difference = largest(expected.iter().zip(found).map(|(a, b)| (a - b).abs()));
    if expected.len() == found.len() { difference / scale } else { f64::NAN }
}
