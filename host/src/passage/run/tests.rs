//! A bogie over a track against closed forms and itself.

use super::super::{Profile, Support, SupportLaw, TimeStep, TrackModel, VehicleUnit};
use super::*;
use crate::track::{Kelvin, Mesh, Side, Track};

/// Static wheel force of the benchmark: half of 15 500 kg.
const Q: f64 = 76_027.5;
/// Pads of the benchmark: name, N/m, Ns/m.
const PADS: [(&str, f64, f64); 3] = [("soft", 60e6, 6e3), ("mid", 200e6, 28e3), ("stiff", 1200e6, 25e3)];
const LINEAR: ContactLaw = ContactLaw::Linear(1.2e9);

fn t1(pad: (f64, f64), rail_step_m: f64, step: TimeStep, support: Support) -> Stepper {
    let mesh = Mesh { rail_step_m, sleeper_step_m: 0.25 };
    let track = Track::benchmark_t1(Kelvin { stiffness: pad.0, damping: pad.1 }, mesh);
    Stepper::new(TrackModel::new(&track, vec![support; 101], 2).unwrap(), step).unwrap()
}

fn bed() -> Support {
    Support::linear(30e6, 125e3)
}

/// One wheel of 670 kg on each of the two rails, which do not feel each other.
fn wheelset() -> Train {
    let unit = VehicleUnit::wheelset(1340.0, 1340.0 * 0.75 * 0.75, 0.75, 0.0).unwrap();
    Train { units: vec![unit], wheels: vec![Wheel::nominal(Q); 2], wheel_radius_m: 0.46 }
}

fn both_rails(profile: &Profile) -> RunningSurface {
    RunningSurface {
        paths: vec![profile.clone()],
        crossing_roughness: Profile::level(),
        stock: profile.clone(),
    }
}

fn cosine_dip(depth_m: f64, length_m: f64) -> RunningSurface {
    both_rails(
        &Profile::of([29.0, 31.0], 0.0025, |x| {
            let s = ((x - 30.0) / length_m).clamp(-0.5, 0.5);
            0.5 * depth_m * (1.0 + (std::f64::consts::TAU * s).cos())
        })
        .unwrap(),
    )
}

fn journey(speed_m_s: f64, duration_s: f64) -> Journey {
    Journey {
        direction: 1.0,
        speed_m_s,
        acceleration_m_s2: 0.0,
        first_m: 15.0,
        duration_s,
        start: Start::Static,
    }
}

fn largest(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
}

fn smallest(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::INFINITY, f64::min)
}

fn reference(case: &str) -> Vec<Vec<f64>> {
    let dir = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/reference");
    let text = std::fs::read_to_string(dir.join(format!("T1_{case}.csv"))).unwrap();
    let rows = text.lines().filter(|l| !l.starts_with('#'));
    rows.map(|l| l.split(',').map(|v| v.parse().unwrap()).collect()).collect()
}

fn column(rows: &[Vec<f64>], i: usize) -> Vec<f64> {
    rows.iter().map(|r| r[i]).collect()
}

#[test]
fn reference_wheel_over_a_dip_within_3_percent() {
    for (name, k, c) in PADS {
        let stepper = t1((k, c), 0.3, TimeStep::default(), bed());
        let record =
            run(&stepper, &wheelset(), (&cosine_dip(1e-3, 0.6), LINEAR), &journey(50.0, 0.4), [0.0, 60.0])
                .unwrap();
        let expected = reference(&format!("dip_fe_{name}"));
        let (force, sleeper) = (&record.contacts[0].force_n, &record.sensor_m);
        let ratio = largest(force) / largest(&column(&expected, 1));
        assert!((ratio - 1.0).abs() < 0.03, "{name}: largest force {ratio}");
        let ratio = largest(sleeper) / largest(&column(&expected, 2));
        assert!((ratio - 1.0).abs() < 0.003, "{name}: sleeper {ratio}");
        // The smallest force is a small difference: 3 % of the static force.
        let difference = smallest(force) - smallest(&column(&expected, 1));
        assert!(difference.abs() < 0.03 * Q, "{name}: smallest force {difference}");
    }
}

#[test]
fn reference_moving_force_within_half_a_percent() {
    for (name, k, c) in PADS {
        let stepper = t1((k, c), 0.3, TimeStep::default(), bed());
        let mut state = stepper.at_rest();
        let read = stepper.model.point(Side::Crossing, 30.0).unwrap();
        let (mut sleeper, mut rail) = (0.0_f64, 0.0_f64);
        for step in 0..9000 {
            let time = (f64::from(step) + 0.5) * 1e-4;
            stepper.begin(&mut state);
            let point = stepper.model.point(Side::Crossing, 7.5 + 50.0 * time).unwrap();
            stepper.load(&mut state, &point, Q * (time / 0.05).min(1.0));
            stepper.finish(&mut state);
            sleeper = sleeper.max(stepper.sensor_m(&state));
            rail = rail.max(stepper.rail_m(&state, &read));
        }
        let expected = reference(&format!("moving_fe_full_{name}"));
        for (what, found, i) in [("sleeper", sleeper, 1), ("rail", rail, 2)] {
            let ratio = found / largest(&column(&expected, i));
            assert!((ratio - 1.0).abs() < 0.005, "{name}: {what} {ratio}");
        }
    }
}

#[test]
fn property_error_falls_with_the_square_of_the_step_and_mesh_hardly_matters() {
    let (surface, train) = (cosine_dip(1e-3, 0.6), wheelset());
    let peak = |rail_step_m, dt_s| {
        let stepper = t1((1200e6, 25e3), rail_step_m, TimeStep { dt_s, theta: 0.5 }, bed());
        let record = run(&stepper, &train, (&surface, LINEAR), &journey(50.0, 0.4), [0.0, 60.0]).unwrap();
        largest(&record.sensor_m)
    };
    let (coarse, middle, fine) = (peak(0.3, 2e-4), peak(0.3, 1e-4), peak(0.3, 5e-5));
    assert!((coarse - middle).abs() > 2.5 * (middle - fine).abs(), "{coarse} {middle} {fine}");
    assert!((peak(0.15, 1e-4) / middle - 1.0).abs() < 5e-4);
}

#[test]
fn property_static_start_is_an_equilibrium() {
    let stepper = t1((200e6, 28e3), 0.3, TimeStep::default(), bed());
    let slow = Journey { speed_m_s: 1.0, ..journey(1.0, 0.05) };
    let record = run(&stepper, &wheelset(), (&RunningSurface::level(), LINEAR), &slow, [0.0, 60.0]).unwrap();
    let force = &record.contacts[0].force_n;
    assert!((force[0] / Q - 1.0).abs() < 1e-3, "{}", force[0]);
    assert!(force.iter().all(|f| (f / Q - 1.0).abs() < 0.01));
}

#[test]
fn property_quiet_start_carries_the_static_load_and_leaves_a_quiet_track() {
    let stepper = t1((200e6, 28e3), 0.3, TimeStep::default(), bed());
    let trip = Journey { first_m: -5.0, start: Start::Quiet, ..journey(50.0, 1.8) };
    let record = run(&stepper, &wheelset(), (&RunningSurface::level(), LINEAR), &trip, [10.0, 50.0]).unwrap();
    let force = &record.contacts[0].force_n;
    assert!((crate::signal::mean(force) / Q - 1.0).abs() < 1e-3, "{}", crate::signal::mean(force));
    assert_eq!(record.sensor_m[0], 0.0);
    assert!(record.sensor_m.last().unwrap().abs() < 1e-9);
}

#[test]
fn property_wheel_that_leaves_the_rail_feels_no_force_and_comes_back() {
    let stepper = t1((1200e6, 25e3), 0.3, TimeStep::default(), bed());
    let surface = cosine_dip(3e-3, 0.5);
    for law in [LINEAR, ContactLaw::Hertz(9.3e10)] {
        let record = run(&stepper, &wheelset(), (&surface, law), &journey(70.0, 0.28), [0.0, 60.0]).unwrap();
        let force = &record.contacts[0].force_n;
        assert!(force.iter().all(|f| *f >= 0.0));
        let airborne = force.iter().filter(|f| **f == 0.0).count();
        assert!(airborne > 10, "{airborne} steps without contact");
        assert!(largest(force) > 3.0 * Q);
        assert!((force[force.len() - 1] / Q - 1.0).abs() < 0.3, "{}", force[force.len() - 1]);
    }
}

#[test]
fn property_both_directions_mirror_each_other() {
    let stepper = t1((200e6, 28e3), 0.3, TimeStep::default(), bed());
    let surface = cosine_dip(1e-3, 0.6);
    let go = |direction: f64, first_m| {
        let trip = Journey { direction, first_m, ..journey(50.0, 0.4) };
        run(&stepper, &wheelset(), (&surface, LINEAR), &trip, [0.0, 60.0]).unwrap().sensor_m
    };
    let (there, back) = (go(1.0, 15.0), go(-1.0, -45.0));
    assert!(there.iter().zip(&back).all(|(a, b)| (a - b).abs() < 1e-12));
}

#[test]
fn paper_p2_force_is_below_jenkins() {
    // Jenkins et al. 1974: P2 = P0 + 2αv √(Mu/(Mu+Mt)) [1 − πCt/(4 √(Kt(Mu+Mt)))] √(Kt Mu); track constants of a beam
    // on continuous support: Kt = 2k/β, Mt = 3m/2β, Ct = 3c/2β, β = (k/4EI)^¼. Light ballast damping, because the formula
    // holds for little damping only.
    let (k_pad, k_bed, c_bed) = (200e6, 37.5e6, 20e3);
    let support = Support::linear(k_bed / 1.25, c_bed / 1.25);
    let stepper = t1((k_pad, 28e3), 0.3, TimeStep::default(), support);
    let (alpha, v, mu) = (0.005, 40.0, 670.0);
    let joint = both_rails(
        &Profile::of([28.5, 31.5], 0.0025, |x| alpha * (1.0 - (x - 30.0f64).abs()).max(0.0)).unwrap(),
    );
    let record =
        run(&stepper, &wheelset(), (&joint, ContactLaw::Hertz(9.3e10)), &journey(v, 0.5), [0.0, 60.0])
            .unwrap();
    let excess: Vec<f64> = record.contacts[0].force_n.iter().map(|f| f - Q).collect();
    // P2 is below 100 Hz; above it is P1.
    let low = crate::signal::brick_band(&excess, 1e4, 0.0, 150.0);
    let after = record.contacts[0].position_m.iter().position(|x| *x > 30.02).unwrap();
    let p2 = largest(&low[after..after + 600]);
    let k = k_bed * k_pad / (k_bed + k_pad) / 0.6;
    let beta = (k / (4.0 * 210e9 * 3.037e-5f64)).powf(0.25);
    let (kt, mt, ct) = (2.0 * k / beta, 1.5 * (60.2 + 150.0 / 0.6) / beta, 1.5 * c_bed / 0.6 / beta);
    let damping = 1.0 - std::f64::consts::PI * ct / (4.0 * (kt * (mu + mt)).sqrt());
    let jenkins = 2.0 * alpha * v * (mu / (mu + mt)).sqrt() * damping * (kt * mu).sqrt();
    assert!(p2 < jenkins && p2 > 0.5 * jenkins, "simulated {p2}, Jenkins {jenkins}");
}

#[test]
fn property_void_softens_and_contact_law_without_gap_is_linear() {
    let with = |law, dt_s| {
        let support = Support { law, ..bed() };
        let mesh = Mesh { rail_step_m: 0.3, sleeper_step_m: 0.25 };
        let track = Track::benchmark_t1(Kelvin { stiffness: 200e6, damping: 28e3 }, mesh);
        let mut supports = vec![bed(); 101];
        supports[50] = support;
        let model = TrackModel::new(&track, supports, 2).unwrap();
        let stepper = Stepper::new(model, TimeStep { dt_s, theta: 0.5 }).unwrap();
        let trip = Journey { first_m: 18.0, start: Start::Quiet, ..journey(50.0, 0.4) };
        largest(
            &run(&stepper, &wheelset(), (&RunningSurface::level(), LINEAR), &trip, [0.0, 60.0])
                .unwrap()
                .sensor_m,
        )
    };
    let linear = with(SupportLaw::Linear, 1e-4);
    // A preload beyond every uplift: never apart, only integrated explicitly.
    let touching = with(SupportLaw::Unilateral { gap_m: 0.0, preload_n_m: 1e6 }, 1e-4);
    assert!((touching / linear - 1.0).abs() < 1e-3, "{touching} {linear}");
    let gap = |gap_m, dt_s| with(SupportLaw::Unilateral { gap_m, preload_n_m: 0.0 }, dt_s);
    let (small, large) = (gap(0.3e-3, 1e-4), gap(5e-3, 1e-4));
    assert!(linear < small && small < linear + 0.3e-3, "{linear} {small}");
    assert!(small < large && large < 2e-3, "rails carry a sleeper that hangs freely: {large}");
    let fine = gap(0.3e-3, 2.5e-5);
    assert!((small / fine - 1.0).abs() < 2e-3, "explicit ballast converges: {small} {fine}");
    let stiffer = with(SupportLaw::Quadratic { doubling_m: 1e-3 }, 1e-4);
    let bilinear = with(SupportLaw::Bilinear { from_m: 0.3e-3, factor: 3.0 }, 1e-4);
    assert!(stiffer < linear && bilinear < linear);
}

#[test]
fn property_impossible_input_is_refused_with_the_value() {
    let refused = |dt_s, theta| TimeStep { dt_s, theta }.check().unwrap_err();
    assert_eq!(refused(1e-4, 0.49), SimulationError::Theta { theta: 0.49 });
    assert!(matches!(refused(1e-4, f64::NAN), SimulationError::Theta { theta } if theta.is_nan()));
    assert!(matches!(refused(1e-3, 0.5), SimulationError::TimeStep { dt_s, .. } if dt_s == 1e-3));
    assert!(matches!(refused(f64::NAN, 0.5), SimulationError::TimeStep { .. }));
    let stepper = t1((200e6, 28e3), 0.6, TimeStep::default(), bed());
    let level = RunningSurface::level();
    let go = |train: &Train, law, trip: &Journey| run(&stepper, train, (&level, law), trip, [0.0, 1.0]);
    let mut headless = wheelset();
    headless.wheels.pop();
    assert_eq!(
        go(&headless, LINEAR, &journey(50.0, 0.1)).unwrap_err(),
        SimulationError::Wheels { axles: 1, wheels: 1 }
    );
    let mut lost = wheelset();
    lost.wheels[0].path = 3;
    assert_eq!(
        go(&lost, LINEAR, &journey(50.0, 0.1)).unwrap_err(),
        SimulationError::Path { path: 3, wheel: 0, paths: 1 }
    );
    let mut backwards = wheelset();
    let behind = VehicleUnit::wheelset(1340.0, 700.0, 0.75, -2.9).unwrap();
    (backwards.units, backwards.wheels) =
        ([backwards.units, vec![behind]].concat(), [backwards.wheels.clone(), backwards.wheels].concat());
    assert_eq!(
        go(&backwards, LINEAR, &journey(50.0, 0.1)).unwrap_err(),
        SimulationError::Order { before_m: 0.0, after_m: -2.9 }
    );
    let negative = go(&wheelset(), ContactLaw::Linear(-1.0), &journey(50.0, 0.1)).unwrap_err();
    assert!(negative.to_string().contains("-1"), "{negative}");
    let standing = go(&wheelset(), LINEAR, &journey(0.0, 0.1)).unwrap_err();
    assert!(matches!(standing, SimulationError::OutOfRange { what: "speed", value: 0.0, .. }));
    let mut gaping = bed();
    gaping.law = SupportLaw::Unilateral { gap_m: 1e-3, preload_n_m: 0.0 };
    let voided = t1((200e6, 28e3), 0.6, TimeStep::default(), gaping);
    let start = run(&voided, &wheelset(), (&level, LINEAR), &journey(50.0, 0.1), [0.0, 1.0]).unwrap_err();
    assert_eq!(start, SimulationError::StaticStart { sleeper: 0 });
}

/// The same forces at the same places move the same track the same way; those of another journey are refused.
#[test]
fn property_a_track_under_the_forces_of_a_passage_moves_as_in_it() {
    let step = TimeStep { dt_s: 2e-4, theta: 0.5 };
    let stepper = t1((PADS[2].1, PADS[2].2), 0.3, step, bed());
    let train = wheelset();
    let surface = cosine_dip(1e-3, 0.5);
    let [first_m, last_m] = stepper.model.extent_m();
    let whole = |speed_m_s: f64| Journey {
        first_m,
        duration_s: (last_m - first_m) / speed_m_s,
        start: Start::Quiet,
        ..journey(speed_m_s, 1.0)
    };
    let record = run(&stepper, &train, (&surface, LINEAR), &whole(40.0), [first_m, last_m]).unwrap();
    let again = driven(&stepper, &train, &whole(40.0), &record.contacts).unwrap();
    let size = largest(&record.sensor_m);
    assert_eq!(again.len(), record.sensor_m.len());
    for (a, b) in record.sensor_m.iter().zip(&again) {
        assert!((a - b).abs() < 1e-9 * size, "{a:e} {b:e} of {size:e}");
    }
    let other = driven(&stepper, &train, &whole(41.0), &record.contacts);
    assert!(matches!(other, Err(SimulationError::OutOfRange { unit: "m", .. })));
    let fewer: Vec<ContactTrace> = vec![ContactTrace::default(); 2];
    assert!(driven(&stepper, &train, &whole(40.0), &fewer).is_err());
}
