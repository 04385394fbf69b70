//! What every linear track must obey, whatever its numbers: reciprocity, equilibrium, conservation of energy.

use std::f64::consts::TAU;

use faer::c64;

use super::reference::{self, BALLAST_N_M2, SOFT, STIFF};
use super::{Case, largest, tolerance};
use crate::track::{Mesh, Side, Track};

/// Frequencies of the identities, Hz.
const FREQUENCIES_HZ: [f64; 5] = [1.0, 20.0, 80.0, 150.0, 250.0];

/// All identities on the reference tracks.
pub fn all() -> Vec<Case> {
    vec![reciprocity(), energy(), equilibrium()]
}

/// Deflection at A for a force at B equals deflection at B for a force at A.
fn reciprocity() -> Case {
    let mut errors = Vec::new();
    for pads in [SOFT, STIFF] {
        let track = reference::panel(pads, Mesh::default());
        let nodes = [3, 20, 35, 36, 41, 60];
        let h = track.rail_receptance(
            &FREQUENCIES_HZ,
            &reference::ballast(&track),
            Side::Crossing,
            &nodes,
            &nodes,
        );
        for h in &h {
            let scale = h[3][3].norm();
            let pairs = (0..nodes.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
            errors.extend(pairs.map(|(i, j)| (h[i][j] - h[j][i]).norm() / scale));
        }
    }
    Case::new("reciprocity between rail nodes, 1-250 Hz", "Maxwell & Betti", "1").values(
        0.0,
        largest(errors),
        tolerance::RECIPROCITY,
    )
}

/// Power put in by a harmonic force equals the power that pads and ballast turn into heat.
fn energy() -> Case {
    let mut errors = Vec::new();
    for pads in [SOFT, STIFF] {
        let track = reference::t1(pads, 0.3);
        let node = track.seat_node(50) + 1;
        for f in FREQUENCIES_HZ {
            let (given, taken) = power(&track, node, f);
            errors.push((taken / given - 1.0).abs());
        }
    }
    Case::new("power into the track against heat in pads and ballast", "conservation of energy", "1").values(
        0.0,
        largest(errors),
        tolerance::BALANCE,
    )
}

/// Mean power (W) of a unit force at a rail node, and the heat in all pads and half sleepers' ballast.
fn power(track: &Track, node: usize, f_hz: f64) -> (f64, f64) {
    let omega = TAU * f_hz;
    let seats: Vec<usize> = (0..track.sleeper_x_m.len()).map(|s| track.seat_node(s)).collect();
    let mut read = seats.clone();
    read.push(node);
    let h = track.rail_receptance(&[f_hz], &reference::ballast(track), Side::Crossing, &[node], &read);
    let h = &h[0][0];
    let given = -0.5 * omega * h[seats.len()].im;
    let (length, mass) = (1.25, 150.0);
    let pad = track.pad.dynamic(omega);
    let below =
        c64::new(BALLAST_N_M2 * length - omega * omega * mass, omega * track.ballast_damping_ns_m2 * length);
    let taken: f64 = h[..seats.len()]
        .iter()
        .map(|rail| {
            let sleeper = rail * pad / (pad + below);
            let (pad_m2, ballast_m2) = ((rail - sleeper).norm_sqr(), sleeper.norm_sqr());
            0.5 * omega
                * omega
                * (track.pad.damping * pad_m2 + track.ballast_damping_ns_m2 * length * ballast_m2)
        })
        .sum();
    (given, taken)
}

/// A static force is carried by the ballast, all of it.
fn equilibrium() -> Case {
    let track = reference::t1(SOFT, 0.3);
    let seats: Vec<usize> = (0..track.sleeper_x_m.len()).map(|s| track.seat_node(s)).collect();
    let node = track.seat_node(50) + 1;
    let h = track.rail_receptance(&[0.0], &reference::ballast(&track), Side::Crossing, &[node], &seats);
    let below = BALLAST_N_M2 * 1.25;
    let series = track.pad.stiffness * below / (track.pad.stiffness + below);
    let carried: f64 = h[0][0].iter().map(|w| series * w.re).sum();
    Case::new("static force carried by the ballast per newton", "equilibrium", "1").values(
        1.0,
        carried,
        tolerance::BALANCE,
    )
}
