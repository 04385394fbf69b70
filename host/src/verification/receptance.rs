//! Receptances against other programs: one rail on rigid half sleepers (T1), two rails on sleeper beams.

use faer::c64;

use super::reference::{self, MID, PadCase, SOFT, STIFF, reference};
use super::{Case, Curves, VerifyError, largest, tolerance};
use crate::track::{Mesh, Side, Track};

type File = (&'static str, &'static str);

const T1: [(PadCase, File, File); 3] = [
    (SOFT, reference!("T1_receptance_rolland_TSB_soft.csv"), reference!("T1_receptance_fe_dx0.075_soft.csv")),
    (MID, reference!("T1_receptance_rolland_TSB_mid.csv"), reference!("T1_receptance_fe_dx0.075_mid.csv")),
    (
        STIFF,
        reference!("T1_receptance_rolland_TSB_stiff.csv"),
        reference!("T1_receptance_fe_dx0.075_stiff.csv"),
    ),
];

const PANEL: [(PadCase, File); 2] =
    [(SOFT, reference!("cpcm_receptance_soft.csv")), (STIFF, reference!("cpcm_receptance_stiff.csv"))];

/// T1 with the paper's 0.3 m mesh against the semi-analytic infinite track and fine finite elements.
pub fn t1() -> Result<Vec<Case>, VerifyError> {
    let mut cases = Vec::new();
    for (pads, semi_analytic, fine) in T1 {
        let track = reference::t1(pads, 0.3);
        for (source, file) in [
            ("rolland 26.8, TSBDiscr2L (semi-analytic, endless rail)", semi_analytic),
            ("finite elements 0.075 m (numpy)", fine),
        ] {
            cases.extend(t1_against(&track, pads, source, file)?);
        }
    }
    Ok(cases)
}

fn t1_against(
    track: &Track,
    pads: PadCase,
    source: &str,
    (name, text): File,
) -> Result<Vec<Case>, VerifyError> {
    let known = reference::columns(name, text)?;
    let [f, between, _, over, _] = known.as_slice() else {
        return Err(VerifyError::Reference { file: name, line: 1 });
    };
    let seat = track.seat_node(50);
    let nodes = [seat + 1, seat];
    let h = track.rail_receptance(f, &reference::ballast(track), Side::Crossing, &nodes, &nodes);
    let found_between: Vec<f64> = h.iter().map(|h| h[0][0].norm()).collect();
    let found_over: Vec<f64> = h.iter().map(|h| h[1][1].norm()).collect();
    let (low, high) = (f.partition_point(|f| *f <= 200.0), f.partition_point(|f| *f <= 300.0));
    let joined = |a: &[f64], b: &[f64], part: std::ops::Range<usize>| -> Vec<f64> {
        a[part.clone()].iter().chain(&b[part]).copied().collect()
    };
    let case = |part: std::ops::Range<usize>, band: &str, tolerance: f64| {
        Case::new(&format!("T1 receptance, {}, {band}", pads.name), source, "m/N").worst(
            &joined(between, over, part.clone()),
            &joined(&found_between, &found_over, part),
            tolerance,
        )
    };
    let curves = Curves {
        x_caption: "frequency, Hz",
        y_caption: "receptance between two sleepers, m/N",
        x: f[..high].to_vec(),
        expected: between[..high].to_vec(),
        found: found_between[..high].to_vec(),
    };
    Ok(vec![
        case(0..low, "to 200 Hz", tolerance::T1_LOW).with(curves),
        case(low..high, "250 and 300 Hz", tolerance::T1_HIGH),
    ])
}

/// Two-rail panel with the mesh of the published script: magnitude and phase, 1 … 1500 Hz.
pub fn panel() -> Result<Vec<Case>, VerifyError> {
    let mut cases = Vec::new();
    for (pads, (name, text)) in PANEL {
        let known = reference::columns(name, text)?;
        if known.len() != 13 {
            return Err(VerifyError::Reference { file: name, line: 1 });
        }
        let mut track = reference::panel(pads, Mesh::default());
        // The elements of the published script, so that nothing but the program differs.
        track.rail_halvings = 0;
        let found = panel_receptances(&track, &known[0]);
        let labels = [
            "crossing rail, over the sensor",
            "crossing rail, between sleepers",
            "sensor to rail over it",
            "sensor to rail between sleepers",
            "stock rail",
            "sensor",
        ];
        for (k, label) in labels.iter().enumerate() {
            let expected: Vec<c64> = known[2 * k + 1]
                .iter()
                .zip(&known[2 * k + 2])
                .map(|(size, degrees)| c64::from_polar(*size, degrees.to_radians()))
                .collect();
            let errors = expected.iter().zip(&found[k]).map(|(a, b)| (a - b).norm() / a.norm());
            let error = if expected.len() == found[k].len() { largest(errors) } else { f64::NAN };
            cases.push(
                Case::new(
                    &format!("panel receptance, {}, {label}", pads.name),
                    "sparse finite elements (scipy), 13 frequencies to 1500 Hz, complex, relative",
                    "1",
                )
                .values(0.0, error, tolerance::PANEL),
            );
        }
    }
    Ok(cases)
}

/// In the order of the columns of the file.
fn panel_receptances(track: &Track, f: &[f64]) -> [Vec<c64>; 6] {
    let ballast = reference::ballast(track);
    let over = track.seat_node(track.sensor_sleeper);
    let nodes = [over, over - 1];
    let crossing = track.rail_receptance(f, &ballast, Side::Crossing, &nodes, &nodes);
    let stock = track.rail_receptance(f, &ballast, Side::Stock, &[over], &[over]);
    let sensor = track.sensor_receptance(f, &ballast);
    [
        crossing.iter().map(|h| h[0][0]).collect(),
        crossing.iter().map(|h| h[1][1]).collect(),
        sensor.crossing.iter().map(|h| h[over][0]).collect(),
        sensor.crossing.iter().map(|h| h[over - 1][0]).collect(),
        stock.iter().map(|h| h[0][0]).collect(),
        track.sensor_point_receptance(f, &ballast),
    ]
}
