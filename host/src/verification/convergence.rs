//! How fine is fine enough: mesh, sampling, length of the track, interpolation between rail nodes.

use faer::c64;

use super::reference::{self, SOFT, SPEED_M_S, STIFF, WHEEL_N};
use super::{Case, Table, largest, tolerance};
use crate::greens::moving::{WheelPath, constant_force_response, kernel};
use crate::greens::{Chain, GreensFunctions, GreensSampling, Quantity};
use crate::signal::{CubicSpline, brick_band, rms};
use crate::track::{Mesh, Side, Track};

/// Forces are identified up to here, Hz.
const COMPARED_HZ: f64 = 250.0;
/// Ends of a crossing part at nodes of 0.05 m elements, and within those of 0.3 m: in the middle of one, a third into another.
const ENDS_BETWEEN_M: [f64; 2] = [-1.65, 1.9];
const BOTH: [reference::PadCase; 2] = [SOFT, STIFF];
/// The identification's own sampling.
const USED: GreensSampling = GreensSampling { rate_hz: 1000.0, len: 512, band_hz: [260.0, 330.0] };

fn percent(value: f64) -> String {
    let value = 100.0 * value;
    if value < 0.0995 { format!("{value:.3} %") } else { format!("{value:.2} %") }
}

/// Sensor response at 1 kHz while a wheel within 3 m of the crossing exerts the static force and, at x = 0.1 m, an
/// impact of 0.2 m half width, the size of the static force.
fn passage(track: &Track, sampling: GreensSampling, quantity: Quantity) -> Vec<f64> {
    let greens =
        GreensFunctions::new(track, &reference::ballast(track), sampling, quantity, &Chain::Corrected);
    let path = WheelPath { direction: 1.0, speed_m_s: SPEED_M_S, time_at_origin_s: 0.2 };
    let len = (0.4 * sampling.rate_hz) as usize;
    let mut response = vec![0.0; len];
    for side in [Side::Crossing, Side::Stock] {
        let constant = constant_force_response(&greens, side, &path, len);
        response.iter_mut().zip(constant).for_each(|(r, c)| *r += WHEEL_N * c);
    }
    let half_m = 2.0;
    let impact = kernel(&greens, Side::Crossing, &path, half_m, len);
    let first = *path.samples_within(half_m, sampling.rate_hz).start();
    for j in 0..impact.ncols() {
        let x = path.x_m((first + j as i64) as f64 / sampling.rate_hz);
        let force = WHEEL_N * (-((x - 0.1) / 0.2).powi(2)).exp();
        response.iter_mut().zip(impact.col(j).iter()).for_each(|(r, k)| *r += force * k);
    }
    // Where the samplings differ in their band, nothing but the band that all share is compared.
    let response = brick_band(&response, sampling.rate_hz, 0.0, COMPARED_HZ);
    let step = (sampling.rate_hz / 1000.0).round() as usize;
    response.into_iter().step_by(step).skip(140).take(120).collect()
}

/// RMS difference relative to the RMS of the finest.
fn difference(coarse: &[f64], fine: &[f64]) -> f64 {
    let e: Vec<f64> = coarse.iter().zip(fine).map(|(a, b)| a - b).collect();
    if coarse.len() == fine.len() { rms(&e) / rms(fine) } else { f64::NAN }
}

/// Displacement and acceleration difference for both pads, worst.
fn worst_of(track: &dyn Fn(reference::PadCase) -> Track, finest: &[[Vec<f64>; 2]; 2]) -> [f64; 2] {
    worst(&BOTH.map(|pads| responses(&track(pads), USED)), finest)
}

/// The same of responses.
fn worst(found: &[[Vec<f64>; 2]; 2], finest: &[[Vec<f64>; 2]; 2]) -> [f64; 2] {
    [0, 1].map(|k| largest(found.iter().zip(finest).map(|(found, fine)| difference(&found[k], &fine[k]))))
}

fn responses(track: &Track, sampling: GreensSampling) -> [Vec<f64>; 2] {
    [Quantity::Displacement, Quantity::Acceleration].map(|q| passage(track, sampling, q))
}

/// Element lengths along rails and sleepers.
pub fn mesh() -> (Vec<Case>, Table) {
    let mut table = Table::new(
        "Mesh",
        "Sensor response to a passing wheel with an impact, RMS difference from elements of 0.05 m along rails and \
         sleepers; soft or stiff pads, whichever is worse. The paper's mesh is 0.3 m and 0.25 m. Rail elements \
         are halved twice and condensed, except in the line marked plain. In the last line the crossing part ends within elements.",
        &["rail elements, m", "sleeper elements, m", "displacement", "acceleration below 250 Hz"],
    );
    let track = |rail: f64, sleeper: f64| {
        move |pads| reference::panel(pads, Mesh { rail_step_m: rail, sleeper_step_m: sleeper })
    };
    let finest = BOTH.map(|p| responses(&track(0.05, 0.05)(p), USED));
    let mut errors = Vec::new();
    let plain = |pads| {
        let mut track = track(0.3, 0.25)(pads);
        track.rail_halvings = 0;
        track
    };
    let e = worst_of(&plain, &finest);
    table.row(&["0.3, plain".into(), "0.25".into(), percent(e[0]), percent(e[1])]);
    for (rail, sleeper) in [(0.6, 0.5), (0.3, 0.5), (0.3, 0.25), (0.2, 0.25), (0.15, 0.125), (0.1, 0.1)] {
        let e = worst_of(&track(rail, sleeper), &finest);
        table.row(&[format!("{rail}"), format!("{sleeper}"), percent(e[0]), percent(e[1])]);
        errors.push(e);
    }
    let between = |rail: f64, sleeper: f64| {
        move |pads| {
            let mut track = track(rail, sleeper)(pads);
            track.crossing_part_m = ENDS_BETWEEN_M;
            track
        }
    };
    let e = worst_of(&between(0.3, 0.25), &BOTH.map(|p| responses(&between(0.05, 0.05)(p), USED)));
    table.row(&["0.3, between".into(), "0.25".into(), percent(e[0]), percent(e[1])]);
    let cases = vec![
        Case::new("mesh 0.3 m / 0.25 m, displacement of a passage", "mesh 0.05 m", "1").values(
            0.0,
            errors[2][0],
            tolerance::MESH[0],
        ),
        Case::new("mesh 0.3 m / 0.25 m, acceleration below 250 Hz", "mesh 0.05 m", "1").values(
            0.0,
            errors[2][1],
            tolerance::MESH[1],
        ),
        Case::new("the same, crossing part ends between nodes, displacement", "mesh 0.05 m", "1").values(
            0.0,
            e[0],
            tolerance::MESH_BETWEEN[0],
        ),
        Case::new("the same, crossing part ends between nodes, acceleration", "mesh 0.05 m", "1").values(
            0.0,
            e[1],
            tolerance::MESH_BETWEEN[1],
        ),
    ];
    (cases, table)
}

/// Sampling rate of the Green's functions, with the band that goes with it.
pub fn sampling() -> (Vec<Case>, Table) {
    let mut table = Table::new(
        "Sampling of the Green's functions",
        "The same passage, difference from 20 kHz; lengths are 0.5 s or more. The paper samples at 5 kHz. The identification works at 1 kHz with a \
         band limit from 260 to 330 Hz. Compared below 250 Hz.",
        &["rate, Hz", "samples", "displacement", "acceleration"],
    );
    let wide =
        |rate_hz: f64, len: usize| GreensSampling { rate_hz, len, band_hz: [0.4 * rate_hz, 0.49 * rate_hz] };
    let tracks = BOTH.map(|p| reference::panel(p, Mesh::default()));
    let finest = [0, 1].map(|i| responses(&tracks[i], wide(20_000.0, 16_384)));
    let mut last = [0.0; 2];
    for (rate, len) in [(1000.0, 512), (2000.0, 1024), (5000.0, 4096), (10_000.0, 8192)] {
        let sampling = if rate == 1000.0 { USED } else { wide(rate, len) };
        let e = worst(&[0, 1].map(|i| responses(&tracks[i], sampling)), &finest);
        table.row(&[format!("{rate}"), len.to_string(), percent(e[0]), percent(e[1])]);
        if rate == 1000.0 {
            last = e;
        }
    }
    let case = |what: &str, value: f64, tolerance: f64| {
        Case::new(&format!("sampling at 1 kHz, {what} of a passage"), "20 kHz", "1")
            .values(0.0, value, tolerance)
    };
    (
        vec![
            case("displacement", last[0], tolerance::SAMPLING[0]),
            case("acceleration", last[1], tolerance::SAMPLING[1]),
        ],
        table,
    )
}

/// Number of sleepers.
pub fn length() -> (Vec<Case>, Table) {
    let mut table = Table::new(
        "Length of the track",
        "Displacement and acceleration while the wheel is within 3 m of the sensor, difference from 101 sleepers. The \
         paper finds 37 sleepers to be enough. On a short track the static force comes on at the end of the rails.",
        &["sleepers", "length, m", "displacement", "acceleration"],
    );
    let finest = BOTH.map(|p| responses(&reference::panel_of_length(p, Mesh::default(), 101), USED));
    let mut cases = Vec::new();
    for n in [13, 19, 25, 31, 37, 49, 61] {
        let e = worst_of(&|p| reference::panel_of_length(p, Mesh::default(), n), &finest);
        table.row(&[n.to_string(), format!("{:.1}", 0.6 * (n - 1) as f64), percent(e[0]), percent(e[1])]);
        if n == 37 {
            let case = |what: &str, e: f64| {
                Case::new(&format!("37 sleepers are enough, {what} of a passage"), "101 sleepers", "1")
                    .values(0.0, e, tolerance::LENGTH)
            };
            cases = vec![case("displacement", e[0]), case("acceleration", e[1])];
        }
    }
    (cases, table)
}

/// Green's functions between the rail nodes (paper, section 4.1: from 0.3 m to 1 cm).
pub fn interpolation() -> (Vec<Case>, Table) {
    let mut table = Table::new(
        "Interpolation between rail nodes to 1 cm",
        "Receptance from a force anywhere on the crossing rail to the sensor: largest difference along the track from \
         elements of 1 cm, relative to the largest receptance. By shape functions, as here, and by a cubic spline \
         through the nodal deflections, as the paper describes; the error of the mesh itself is in both.",
        &["nodes, m", "shape functions, to 100 Hz", "to 250 Hz", "spline, to 100 Hz", "to 250 Hz"],
    );
    let f = [1.0, 50.0, 100.0, 150.0, 200.0, 250.0];
    let exact = BOTH.map(|p| on_centimetres(&crossing_track(p, 0.01), &f, false));
    let mut used = [0.0; 2];
    for step in [0.6, 0.3, 0.2, 0.15, 0.1] {
        let mut cells = vec![format!("{step}")];
        for spline in [false, true] {
            let found = BOTH.map(|pads| on_centimetres(&crossing_track(pads, step), &f, spline));
            let worst = |k: usize| largest([0, 1].map(|i| along(&exact[i][k], &found[i][k])));
            let to = |last: usize| largest((0..last).map(worst));
            cells.extend([percent(to(3)), percent(to(6))]);
            if step == 0.3 && !spline {
                used = [to(3), to(6)];
            }
        }
        table.row(&cells);
    }
    let case = |band: &str, value: f64, tolerance: f64| {
        let name = format!("Green's functions interpolated from 0.3 m to 1 cm, to {band}");
        Case::new(&name, "elements of 1 cm", "1").values(0.0, value, tolerance)
    };
    (
        vec![
            case("100 Hz", used[0], tolerance::INTERPOLATION[0]),
            case("250 Hz", used[1], tolerance::INTERPOLATION[1]),
        ],
        table,
    )
}

fn crossing_track(pads: reference::PadCase, rail_step_m: f64) -> Track {
    reference::panel(pads, Mesh { rail_step_m, ..Mesh::default() })
}

/// Crossing-rail receptance of the sensor every centimetre, per frequency.
fn on_centimetres(track: &Track, f: &[f64], spline: bool) -> Vec<Vec<c64>> {
    let nodal = track.sensor_receptance(f, &reference::ballast(track));
    let none = vec![[c64::new(0.0, 0.0); 2]; track.node_x_m.len()];
    let grid: Vec<f64> = (0..=2160).map(|i| track.node_x_m[0] + 0.01 * i as f64).collect();
    let by_shape_functions = track.rail_grid(0.01);
    nodal
        .crossing
        .iter()
        .map(|row| {
            if !spline {
                return by_shape_functions.both_rails(row, &none);
            }
            let part = |value: fn(&[c64; 2]) -> f64| -> Vec<f64> {
                let y: Vec<f64> = row.iter().map(value).collect();
                CubicSpline::new(&track.node_x_m, &y)
                    .map_or_else(Vec::new, |s| grid.iter().map(|x| s.at(*x)).collect())
            };
            let (re, im) = (part(|v| v[0].re), part(|v| v[0].im));
            re.into_iter().zip(im).map(|(re, im)| c64::new(re, im)).collect()
        })
        .collect()
}

fn along(exact: &[c64], found: &[c64]) -> f64 {
    let scale = largest(exact.iter().map(|v| v.norm()));
    let difference = largest(exact.iter().zip(found).map(|(a, b)| (a - b).norm()));
    if exact.len() == found.len() { difference / scale } else { f64::NAN }
}
