//! A constant force that moves over T1, against finite elements in the time domain.

use super::closed::{largest_difference, under_constant_force};
use super::reference::{self, MID, PadCase, SOFT, SPEED_M_S, STIFF, WHEEL_N, reference};
use super::{Case, Curves, VerifyError, largest, tolerance};
use crate::greens::moving::WheelPath;
use crate::greens::moving_response::RailGreens;
use crate::greens::{Chain, GreensFunctions, GreensSampling, Quantity, try_kernel};
use crate::signal::CubicSpline;
use crate::track::{Side, Track};

type File = (&'static str, &'static str);

const FILES: [(PadCase, File); 3] = [
    (SOFT, reference!("T1_moving_fe_soft.csv")),
    (MID, reference!("T1_moving_fe_mid.csv")),
    (STIFF, reference!("T1_moving_fe_stiff.csv")),
];

/// Middle sleeper in the coordinates of the file, metres.
const MIDDLE_X_M: f64 = 30.0;
/// The force comes on at this distance before the middle, over [`RAMP_M`], and leaves as far behind, metres.
const REACH_M: f64 = 22.5;
const RAMP_M: f64 = 2.5;

/// Sleeper and rail deflection of all three tracks.
pub fn t1() -> Result<Vec<Case>, VerifyError> {
    let mut cases = Vec::new();
    for (pads, (name, text)) in FILES {
        let known = reference::columns(name, text)?;
        let [x_load, sleeper, _, under_load] = known.as_slice() else {
            return Err(VerifyError::Reference { file: name, line: 1 });
        };
        let x: Vec<f64> = x_load.iter().map(|x| x - MIDDLE_X_M).collect();
        let track = reference::t1(pads, 0.3);
        cases.extend(sleeper_cases(&track, pads, &x, sleeper)?);
        cases.push(rail_case(&track, pads, &x, under_load)?);
    }
    Ok(cases)
}

const SOURCE: &str = "finite elements 0.15 m, Newmark 0.1 ms (scipy)";

fn ramp(x: f64) -> f64 {
    ((x + REACH_M) / RAMP_M).clamp(0.0, 1.0)
}

fn millimetres(values_m: &[f64]) -> Vec<f64> {
    values_m.iter().map(|v| 1e3 * v).collect()
}

/// Sleeper in the middle.
fn sleeper_cases(
    track: &Track,
    pads: PadCase,
    x: &[f64],
    expected: &[f64],
) -> Result<Vec<Case>, VerifyError> {
    let response = sleeper_response(track)?;
    let found: Vec<f64> = x.iter().map(|x| response.at(*x)).collect();
    let deepest = |v: &[f64]| largest(v.iter().copied());
    let name = |what: &str| format!("T1 moving force, {}, sleeper, {what}", pads.name);
    Ok(vec![
        Case::new(&name("peak"), SOURCE, "m")
            .values(deepest(expected), deepest(&found), tolerance::MOVING)
            .with(Curves {
                x_caption: "position of the force, m from the sleeper",
                y_caption: "deflection of the sleeper, mm",
                x: x.to_vec(),
                expected: millimetres(expected),
                found: millimetres(&found),
            }),
        Case::new(&name("largest difference over the passage"), SOURCE, "1").values(
            0.0,
            largest_difference(expected, &found),
            tolerance::MOVING,
        ),
    ])
}

/// Deflection of the middle sleeper over the position of the force, by the fixed-response kernel.
fn sleeper_response(track: &Track) -> Result<CubicSpline, VerifyError> {
    let sampling = GreensSampling { rate_hz: 2000.0, len: 2048, band_hz: [900.0, 1000.0] };
    let ballast = reference::ballast(track);
    let greens =
        GreensFunctions::try_new(track, &ballast, sampling, Quantity::Displacement, &Chain::Corrected)?;
    let path =
        WheelPath { direction: 1.0, speed_m_s: SPEED_M_S, time_at_origin_s: (REACH_M + 0.5) / SPEED_M_S };
    let samples = (2.0 * path.time_at_origin_s * sampling.rate_hz) as usize;
    let matrix = try_kernel(&greens, Side::Crossing, &path, REACH_M, samples)?;
    let first = *path.samples_within(REACH_M, sampling.rate_hz).start();
    let position = |k: i64| path.x_m(k as f64 / sampling.rate_hz);
    let mut response = vec![0.0; samples];
    for j in 0..matrix.ncols() {
        let force = WHEEL_N * ramp(position(first + j as i64));
        response.iter_mut().zip(matrix.col(j).iter()).for_each(|(r, k)| *r += force * k);
    }
    let positions: Vec<f64> = (0..samples as i64).map(position).collect();
    CubicSpline::new(&positions, &response).ok_or(VerifyError::Empty("sleeper response"))
}

/// Rail under the force at the nodes within 2 m of the middle: moving-response kernel.
fn rail_case(track: &Track, pads: PadCase, x: &[f64], under_load: &[f64]) -> Result<Case, VerifyError> {
    let rate_hz = 1000.0;
    // The kernel forgets after 0.15 s, 7.5 m: 10 m of approach are enough.
    let sampling = GreensSampling { rate_hz, len: 512, band_hz: [300.0, 400.0] };
    let rail = RailGreens::of_crossing_rail(track, &reference::ballast(track), 10.0, sampling);
    let position: Vec<f64> = (0..=300).map(|k| -9.9 + k as f64 * SPEED_M_S / rate_hz).collect();
    let deflection = under_constant_force(&rail, &position, WHEEL_N);
    let spline = CubicSpline::new(&position, &deflection).ok_or(VerifyError::Empty("rail response"))?;
    // Between its nodes every finite element beam is too stiff under the force, by up to P L/4S, 2 % here; at the nodes
    // of both meshes, 0.3 m and 0.15 m, it is exact.
    let off_node = |x: f64| (x - track.step_m * (x / track.step_m).round()).abs();
    let near: Vec<usize> = (0..x.len()).filter(|i| x[*i].abs() <= 2.0 && off_node(x[*i]) < 0.006).collect();
    let x: Vec<f64> = near.iter().map(|i| x[*i]).collect();
    let expected: Vec<f64> = near.iter().map(|i| under_load[*i]).collect();
    let found: Vec<f64> = x.iter().map(|x| spline.at(*x)).collect();
    Ok(Case::new(
        &format!("T1 moving force, {}, rail under the force at nodes, largest difference", pads.name),
        SOURCE,
        "1",
    )
    .values(0.0, largest_difference(&expected, &found), tolerance::MOVING)
    .with(Curves {
        x_caption: "position of the force, m from the sleeper",
        y_caption: "deflection of the rail, mm",
        x,
        expected: millimetres(&expected),
        found: millimetres(&found),
    }))
}
