//! P2 force of a wheel over a dipped joint against Jenkins' closed form: an upper bound, because the lumped track neither
//! radiates along the rail nor, without damper, loses energy; the force stays near it.

use super::reference::{MID, PadCase, SOFT, STIFF, WHEEL_N};
use super::{Case, Table, VerifyError, largest, tolerance};
use crate::closed_form::{LumpedTrack, jenkins_p2_n};
use crate::passage::contact::ContactLaw;
use crate::passage::{
    Journey, Profile, RunningSurface, Start, Stepper, Support, TimeStep, TrackModel, Train, VehicleUnit,
    Wheel, run,
};
use crate::signal::brick_band;
use crate::track::{Mesh, Track};

const UNSPRUNG_KG: f64 = 670.0;
/// Total angles of the dip, rad; the standard's reference is 20 mrad.
const ANGLES_RAD: [f64; 3] = [5e-3, 10e-3, 20e-3];
const SPEED_M_S: f64 = 160.0 / 3.6;
/// The joint is in the middle of T1, over a sleeper, and its ramps are 1 m long, metres.
const JOINT_M: f64 = 30.0;
const RAMP_M: f64 = 1.0;
/// P2 lies at 30 to 70 Hz, P1 at 800 Hz: low-pass between them, Hz.
const LOW_PASS_HZ: f64 = 150.0;
/// P2 comes after the joint, within this distance, metres.
const AFTER_M: f64 = 2.0;
/// Ballast of T1 per metre of half sleeper; half sleepers of 1.25 m and 150 kg every 0.6 m.
const BALLAST: (f64, f64) = (30e6, 125e3);
const HALF_M: f64 = 1.25;
const HALF_KG: f64 = 150.0;
const SPACING_M: f64 = 0.6;

/// Dynamic part of the simulated P2 force, newtons.
fn simulated_n(pads: PadCase, angle_rad: f64) -> Result<f64, VerifyError> {
    let track = Track::benchmark_t1(pads.pad, Mesh::default());
    let supports = vec![Support::linear(BALLAST.0, BALLAST.1); track.sleeper_x_m.len()];
    let step = TimeStep::default();
    let stepper = Stepper::new(TrackModel::new(&track, supports, 2)?, step)?;
    let dip = |x: f64| 0.5 * angle_rad * (RAMP_M - (x - JOINT_M).abs()).max(0.0);
    let profile = Profile::of([JOINT_M - 1.5 * RAMP_M, JOINT_M + 1.5 * RAMP_M], 0.0025, dip)?;
    let surface =
        RunningSurface { paths: vec![profile.clone()], crossing_roughness: Profile::level(), stock: profile };
    // Two wheels of 670 kg on rails that do not feel each other: roll inertia and heave move both alike.
    let lever = 0.5 * 1.5;
    let mass = 2.0 * UNSPRUNG_KG;
    let train = Train {
        units: vec![VehicleUnit::wheelset(mass, mass * lever * lever, lever, 0.0)?],
        wheels: vec![Wheel::nominal(WHEEL_N); 2],
        wheel_radius_m: 0.46,
    };
    let journey = Journey {
        direction: 1.0,
        speed_m_s: SPEED_M_S,
        acceleration_m_s2: 0.0,
        first_m: 15.0,
        duration_s: (JOINT_M - 15.0 + 2.5 * AFTER_M) / SPEED_M_S,
        start: Start::Static,
    };
    let record = run(&stepper, &train, (&surface, ContactLaw::Hertz(9.3e10)), &journey, [0.0, 60.0])?;
    let trace = record.contacts.first().ok_or(VerifyError::Empty("contact force"))?;
    let excess: Vec<f64> = trace.force_n.iter().map(|f| f - WHEEL_N).collect();
    let low = brick_band(&excess, 1.0 / step.dt_s, 0.0, LOW_PASS_HZ);
    let after = trace.position_m.iter().zip(&low).filter(|(x, _)| **x > JOINT_M && **x < JOINT_M + AFTER_M);
    Ok(largest(after.map(|(_, f)| *f)))
}

/// The track as Jenkins lumps it, by the energies of the static deflection: a sleeper moves by the share of the pads in the
/// stiffness of its seat, and counts with the square of that.
fn lumped(pads: PadCase) -> LumpedTrack {
    let seat = HALF_M * BALLAST.0;
    let series = seat * pads.pad.stiffness / (seat + pads.pad.stiffness) / SPACING_M;
    let share = (pads.pad.stiffness / (seat + pads.pad.stiffness)).powi(2);
    let rail = crate::section::BeamSection::rail_60e1_benchmark();
    let damping = share * HALF_M * BALLAST.1 / SPACING_M;
    let mass = rail.mass_kg_m + share * HALF_KG / SPACING_M;
    LumpedTrack::of_beam(rail.bending_n_m2, series, damping, mass)
}

/// A check per pads and angle, and all variants of the closed form side by side.
pub fn all() -> Result<(Vec<Case>, Table), VerifyError> {
    let mut table = Table::new(
        "P2 force over a dipped joint",
        "Dynamic part in kN, wheel of 670 kg, 160 km/h, T1. Jenkins with the track's own stiffness and mass and no damper is the bound; \
         with the track's damper the formula leaves its range (light damping); GM/TT0088: the standard's constants.",
        &["pads", "angle, mrad", "simulated", "Jenkins, no damper", "Jenkins, with damper", "GM/TT0088"],
    );
    let mut cases = Vec::new();
    for pads in [SOFT, MID, STIFF] {
        let track = lumped(pads);
        let undamped = LumpedTrack { damping_ns_m: 0.0, ..track };
        for angle in ANGLES_RAD {
            let found = simulated_n(pads, angle)?;
            let of = |t: &LumpedTrack| jenkins_p2_n(t, UNSPRUNG_KG, angle, SPEED_M_S);
            let label = format!("P2 force over a dip of {:.0} mrad, {}", 1e3 * angle, pads.name);
            cases.extend([
                Case::new(&label, "upper bound: Jenkins 1974, no damper", "N")
                    .values(of(&undamped), found, tolerance::P2_BOUND)
                    .bounded(),
                Case::new(&format!("{label}, beside the bound"), "Jenkins 1974, no damper", "N").values(
                    of(&undamped),
                    found,
                    tolerance::P2_BESIDE_BOUND,
                ),
            ]);
            let cells = [found, of(&undamped), of(&track), of(&LumpedTrack::gm_tt_0088())];
            let mut row = vec![pads.name.to_string(), format!("{:.0}", 1e3 * angle)];
            row.extend(cells.map(|v| format!("{:.1}", 1e-3 * v)));
            table.row(&row);
        }
    }
    Ok((cases, table))
}
