//! `cpcm simulate`: what it writes can be read, analysed and scored.

use std::path::{Path, PathBuf};

use cpcm::gap::trial::{Panels, scenario_of};
use cpcm::identify::identify;
use cpcm::node_sim;
use cpcm::passage::contact::ContactLaw;
use cpcm::passage::{
    Journey, PassageRecord, Profile, RunningSurface, Start, Stepper, Support, TimeStep, TrackModel, Train,
    run,
};
use cpcm::pipeline::{self, AnalyseOptions, analyse};
use cpcm::progress::Silent;
use cpcm::reconstruct::{Recording, SPEEDS_M_S, SpeedSearch, comb, estimate_speed};
use cpcm::recording::truth::{Side, read_site_truth, read_truth, write_truth};
use cpcm::recording::{Format, TrafficDirection, read_site, write_site};
use cpcm::scenario::effects::{VoidedSleepers, WheelFlats};
use cpcm::scenario::{Scenario, ScenarioError, read_scenario, simulate};
use cpcm::scoring::{Score, score, score_node};
use cpcm::signal::{CubicSpline, brick_band, mean, resample, rms};
use cpcm::track::{Mesh, Track};
use cpcm::vehicle::AxlePattern;
use cpcm_tests::sample::field;
use cpcm_tests::tolerance;

fn example() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/examples/site.toml")
}

/// The example with a train of one car.
fn short(passages: usize) -> Scenario {
    let mut scenario = read_scenario(&example()).unwrap();
    scenario.crossing.vehicle.cars = 1;
    scenario.simulation.passages = passages;
    scenario
}

#[test]
fn property_simulated_site_is_read_and_analysed_with_true_force_peaks() {
    let dir = tempfile::tempdir().unwrap();
    let simulated = simulate(&short(6), &Silent).unwrap();
    write_truth(dir.path(), &simulated.truth).unwrap();
    write_site(dir.path(), &simulated.site, Format::Parquet).unwrap();
    let site = read_site(dir.path()).unwrap();
    assert!(site.skipped.is_empty(), "{:?}", site.skipped);
    assert_eq!(site.passages, simulated.site.passages);
    let truth = read_truth(dir.path()).unwrap();
    assert_eq!(truth.wheels.len(), 6 * 4 * 2);
    let analysis = analyse(&site, &AnalyseOptions::default(), &Silent).unwrap();
    let score = score(&analysis, &truth);
    assert_eq!(score.peak.len(), 6 * 4);
    let peak = Score::median(&score.peak);
    println!("six trains of one car: median peak error {:.2} %", 100.0 * peak);
    assert!(peak < tolerance::PEAK_OF_FEW_TRAINS, "median peak error {peak}");
    assert!(score.speed.iter().all(|error| *error < tolerance::SITE_SPEED), "{:?}", score.speed);
}

/// Trains of 25 and of 45 m/s over the same crossing shared one force, and peaks were 3.7 % wrong with hardly one inside its interval.
#[test]
fn regress_trains_of_two_speeds_have_their_own_forces() {
    let at = |speed_m_s: f64, first_id: i32| {
        let mut scenario = read_scenario(&example()).unwrap();
        scenario.simulation.passages = 4;
        scenario.simulation.speed_m_s = speed_m_s;
        let mut simulated = simulate(&scenario, &Silent).unwrap();
        simulated.site.passages.iter_mut().for_each(|p| p.passage_id += first_id);
        simulated.truth.wheels.iter_mut().for_each(|w| w.passage_id += first_id);
        simulated
    };
    let (mut site, slow) = (at(45.0, 0), at(25.0, 100));
    site.site.passages.extend(slow.site.passages);
    site.truth.wheels.extend(slow.truth.wheels);
    let analysis = analyse(&site.site, &AnalyseOptions::default(), &Silent).unwrap();
    let score = score(&analysis, &site.truth);
    let peak = Score::median(&score.peak);
    println!("median peak error {:.2} %", 100.0 * peak);
    assert_eq!(score.peak.len(), 8 * 12);
    assert!(peak < tolerance::PEAK_OF_FEW_TRAINS, "median peak error {peak}");
}

/// The calibration ended before it had come from where it begins: waveforms were 19 % wrong, trains 18 cm from where they were.
#[test]
fn regress_next_to_no_support_under_the_crossing_is_found() {
    let mut scenario = read_scenario(&example()).unwrap();
    scenario.crossing.sensor.range_m_s2 = 3000.0;
    scenario.crossing.sensor.bits = 20;
    let simulation = &mut scenario.simulation;
    (simulation.passages, simulation.speed_m_s, simulation.geometry.dip_m) = (9, 36.0, 2.4e-3);
    (simulation.solver.rail_step_m, simulation.solver.sleeper_step_m) = (0.15, 0.125);
    let ballast = &mut simulation.ballast;
    (ballast.p1_n_m2, ballast.p2_n_m2, ballast.p3) = (5e6, 0.5e6, 0.1);
    let simulated = simulate(&scenario, &Silent).unwrap();
    let analysis = analyse(&simulated.site, &AnalyseOptions::default(), &Silent).unwrap();
    let score = score(&analysis, &simulated.truth);
    let (peak, waveform) = (Score::median(&score.peak), Score::median(&score.waveform));
    let p1 = analysis.ballast.p1_n_m2.value;
    println!("peaks {peak:.4}, waveform {waveform:.4}, p1 {:.2} of 5 MN/m2", 1e-6 * p1);
    assert!(peak < tolerance::PEAK_MEDIAN && waveform < tolerance::WAVEFORM_ON_NO_SUPPORT);
    assert!((p1 / 5e6 - 1.0).abs() < tolerance::P1_ON_NO_SUPPORT);
}

/// A noisy sensor near the end of the sleeper sees slow and light trains press it down less than its noise does, integrated twice. Each train
/// by itself was put where noise and deflection were most alike, up to 14 m away: of 24 half were not explained, and peaks 34 % wrong.
#[test]
fn regress_trains_that_noise_hides_are_found_together() {
    let mut scenario = slow(12);
    scenario.crossing.traffic_direction = TrafficDirection::Trailing;
    scenario.crossing.sensor.noise_rms_m_s2 = 0.5;
    let vehicle = &mut scenario.crossing.vehicle;
    (vehicle.car_length_m, vehicle.bogie_centres_m) = (20.0, 14.0);
    (vehicle.axle_spacing_m, vehicle.axle_load_kg) = (1.8, 9e3);
    let score = scored(&scenario);
    assert!(Score::median(&score.peak) < tolerance::PEAK_UNDER_NOISE);
    assert!(score.peak_coverage > tolerance::INSIDE_UNDER_NOISE);
}

/// The same of two trains at 90 km/h with a usual sensor there, over ballast that is stiff under the crossing: waveforms were 23 % wrong, a
/// quarter of a metre beside their place.
#[test]
fn regress_two_trains_over_stiff_ballast_are_found_together() {
    let mut scenario = slow(2);
    scenario.crossing.sensor.sample_rate_hz = 10e3;
    let vehicle = &mut scenario.crossing.vehicle;
    (vehicle.car_length_m, vehicle.bogie_centres_m) = (26.4, 18.48);
    (vehicle.axle_spacing_m, vehicle.axle_load_kg) = (2.3, 13e3);
    let simulation = &mut scenario.simulation;
    (simulation.seed, simulation.geometry.dip_m) = (13, 0.5e-3);
    let ballast = &mut simulation.ballast;
    (ballast.p1_n_m2, ballast.p2_n_m2, ballast.p3) = (12e6, 40e6, 0.6);
    let score = scored(&scenario);
    assert!(Score::median(&score.peak) < tolerance::PEAK_UNDER_NOISE);
    assert!(Score::median(&score.waveform) < tolerance::WAVEFORM_OF_TWO_SLOW_TRAINS);
}

/// Sleepers stand 0.65 m apart, so that the crossing part ends 0.25 m from one and 0.15 m from another.
#[test]
fn regress_crossing_part_that_ends_between_sleepers_moves_no_train() {
    let mut scenario = short(8);
    let crossing = &mut scenario.crossing;
    crossing.track.sleeper_spacing_m = 0.65;
    crossing.pad.stiffness_n_m = 150e6;
    crossing.vehicle.cars = 3;
    scenario.simulation.speed_m_s = 35.0;
    let ballast = &mut scenario.simulation.ballast;
    (ballast.p1_n_m2, ballast.p2_n_m2) = (12e6, 40e6);
    let score = scored(&scenario);
    assert!(Score::median(&score.peak) < tolerance::PEAK_MEDIAN);
    assert!(Score::median(&score.waveform) < tolerance::WAVEFORM_BESIDE_NODES);
}

/// A panel of the blind trials' `--panels any`, with nothing that acts on it.
fn drawn_panel(seed: u64, index: u64, passages: usize) -> Scenario {
    let work = tempfile::tempdir().unwrap();
    let (mut scenario, _) = scenario_of(Panels::Any, seed, index, work.path()).unwrap();
    scenario.simulation.passages = passages;
    scenario
}

/// The same on ballast of p1, p2 (N/m²) and p3.
fn drawn_panel_on(ballast: [f64; 3], seed: u64, index: u64, passages: usize) -> Scenario {
    let mut scenario = drawn_panel(seed, index, passages);
    let at = &mut scenario.simulation.ballast;
    [at.p1_n_m2, at.p2_n_m2, at.p3] = ballast;
    scenario
}

/// The cusp of the transition lay between two knots of the common irregularity, and slow trains were moved to where the splines could tell
/// it: 60 mm, with waveforms 16 % wrong of which half were inside their intervals. Every transition of `tests/data/field` lies at a knot.
#[test]
fn regress_slow_trains_meet_the_transition_where_it_is() {
    let scenario = drawn_panel_on([22.9e6, 10.5e6, 0.366], 701, 11, 12);
    let score = scored(&scenario);
    assert!(Score::median(&score.waveform) < tolerance::WAVEFORM_OF_SLOW_TRAINS);
    assert!(score.waveform_coverage > tolerance::INSIDE_OF_SLOW_TRAINS);
}

/// The quasi-static fit went from nominal ballast to 485 MN/m², from where the calibration did not come back: peaks were 23 % too high and
/// none inside its interval.
#[test]
fn regress_soft_ballast_is_not_taken_for_stiff() {
    let mut scenario = drawn_panel_on([10.3e6, 4.8e6, 0.35], 701, 15, 8);
    scenario.simulation.seed = 5;
    let simulated = simulate(&scenario, &Silent).unwrap();
    let analysis = analyse(&simulated.site, &AnalyseOptions::default(), &Silent).unwrap();
    let score = score(&analysis, &simulated.truth);
    let (peak, p1) = (Score::median(&score.peak), analysis.ballast.p1_n_m2.value);
    println!("peaks {peak:.4}, p1 {:.2} of 10.3 MN/m2", 1e-6 * p1);
    assert!(peak < tolerance::PEAK_OF_FEW_TRAINS);
    assert!((p1 / 10.3e6 - 1.0).abs() < tolerance::P1_ON_SOFT_BALLAST);
}

/// Beside the sensor of this sleeper lay elements of 0.31 and 0.33 m, with the bed on their ends: the track answered 16 % too much at
/// 240 Hz, and with 16 trains peaks came 2 % too low with half of the true ones inside their intervals.
#[test]
fn regress_sleepers_with_seats_and_sensor_anywhere_bend_as_they_do() {
    let scenario = drawn_panel_on([25.0e6, 28.5e6, 0.49], 801, 6, 8);
    let score = scored(&scenario);
    println!("mean peak {:+.4}, peaks inside {:.2}", score.mean_peak[0], score.peak_coverage);
    assert!(score.mean_peak[0].abs() < score.mean_peak[1]);
    assert!(score.peak_coverage > tolerance::INSIDE_ON_ANY_SLEEPER);
}

/// The node's windows hold frequencies that the host leaves out, and its kernel trusted the model there: peaks were 0.29 % below the host's
/// here; with 16 trains on this panel 0.35 %, and one in four of those that the host's intervals hold lay outside its own.
#[test]
fn regress_node_concludes_nothing_from_beyond_the_hosts_band() {
    let scenario = drawn_panel_on([30.7e6, 17.2e6, 0.347], 801, 3, 8);
    let simulated = simulate(&scenario, &Silent).unwrap();
    let identified = identify(&simulated.site, &Silent).unwrap();
    let analysis = pipeline::evaluate(&identified, &Silent).unwrap();
    let package = pipeline::package(&identified, &Silent).unwrap();
    let records = node_sim::records(&simulated.site, &package.bytes, &Silent).unwrap();
    assert_eq!(records.len(), analysis.passages.len());
    let node = score_node(&records, &analysis, &simulated.truth);
    assert_eq!(node.missing, 0);
    let mean = mean(&node.against_host);
    println!("node's peaks above the host's: {mean:+.5}");
    assert!(mean.abs() < tolerance::NODE_BIAS_AGAINST_HOST, "{mean}");
}

/// The slower the trains, the more a speed of the kernel takes, and the node had no room for a quarter of these trains.
#[test]
fn regress_kernel_of_slow_trains_has_room_for_them_all() {
    let scenario = drawn_panel(801, 4, 12);
    let site = simulate(&scenario, &Silent).unwrap().site;
    let package = pipeline::package(&identify(&site, &Silent).unwrap(), &Silent).unwrap();
    println!("{} bytes, {:?} m/s", package.bytes.len(), package.speeds_m_s);
    assert!(package.outside_m_s.is_empty(), "{:?}", package.outside_m_s);
}

/// The rail is the same everywhere, so that nothing tells one sleeper from the next but where forces are expected.
#[test]
fn regress_panel_that_nothing_contradicts_is_as_described() {
    let mut scenario = short(4);
    let crossing = &mut scenario.crossing;
    (crossing.track.sleeper_spacing_m, crossing.track.crossing_sleeper_x_m) = (0.7, 0.5);
    let rail = &mut crossing.rail;
    (rail.crossing_part_stiffness_factor, rail.crossing_part_mass_factor) = (1.0, 1.0);
    (crossing.traffic_direction, crossing.pad.stiffness_n_m) = (TrafficDirection::Trailing, 80e6);
    crossing.vehicle.cars = 3;
    scenario.simulation.speed_m_s = 35.0;
    scenario.simulation.geometry.transition_x_m = 0.1;
    let simulated = simulate(&scenario, &Silent).unwrap();
    let analysis = analyse(&simulated.site, &AnalyseOptions::default(), &Silent).unwrap();
    assert_eq!(analysis.misdescription, None);
}

/// Trains of two cars at 25 m/s, give or take little, on soft pads, seen by a sensor near the end of the sleeper.
fn slow(passages: usize) -> Scenario {
    let mut scenario = short(passages);
    scenario.crossing.pad.stiffness_n_m = 150e6;
    scenario.crossing.sensor.y_m = 3.2;
    scenario.crossing.vehicle.cars = 2;
    (scenario.simulation.speed_m_s, scenario.simulation.speed_spread) = (25.0, 0.02);
    scenario
}

/// What an analysis of a scenario, simulated in numerics of its own, is worth.
fn scored(scenario: &Scenario) -> Score {
    let mut scenario = scenario.clone();
    let solver = &mut scenario.simulation.solver;
    (solver.dt_s, solver.rail_step_m, solver.sleeper_step_m) = (0.8e-4, 0.2, 0.2);
    let simulated = simulate(&scenario, &Silent).unwrap();
    let analysis = analyse(&simulated.site, &AnalyseOptions::default(), &Silent).unwrap();
    let score = score(&analysis, &simulated.truth);
    let (peak, waveform) = (Score::median(&score.peak), Score::median(&score.waveform));
    println!("peaks {peak:.4}, {:.2} of them inside, waveform {waveform:.4}", score.peak_coverage);
    score
}

/// Four axles stack by chance at 8 m/s, a fifth of their speed, which was taken for two trains of six.
#[test]
fn regress_speeds_of_short_trains_are_found() {
    let simulated = simulate(&short(6), &Silent).unwrap();
    let crossing = &simulated.site.crossing;
    let pattern = AxlePattern::of_vehicle(&crossing.vehicle);
    for passage in &simulated.site.passages {
        let truth = simulated.truth.wheels.iter().find(|w| w.passage_id == passage.passage_id).unwrap();
        let recording = Recording::new(passage, &crossing.sensor);
        let of_envelope = comb(&recording, &pattern, SPEEDS_M_S).map(|(speed, _)| speed);
        for about_m_s in [passage.speed_m_s, of_envelope] {
            let search = SpeedSearch { about_m_s, ..SpeedSearch::default() };
            let found = estimate_speed(&recording, &pattern, search).unwrap();
            let error = (found / truth.true_speed_m_s - 1.0).abs();
            assert!(
                error < tolerance::SITE_SPEED,
                "{found} of {}, about {about_m_s:?}",
                truth.true_speed_m_s
            );
        }
    }
}

/// A speed that an operator states in another unit, or of another train, is not believed.
#[test]
fn property_a_wrong_statement_moves_no_speed() {
    let site = read_site(&field("reference-1")).unwrap();
    let pattern = AxlePattern::of_vehicle(&site.crossing.vehicle);
    for passage in site.passages.iter().take(4) {
        let recording = Recording::new(passage, &site.crossing.sensor);
        let found = |about_m_s: Option<f64>| {
            estimate_speed(&recording, &pattern, SpeedSearch { about_m_s, ..SpeedSearch::default() })
        };
        let stated = passage.speed_m_s.unwrap();
        let unstated = found(None).unwrap();
        assert!((unstated / stated - 1.0).abs() < tolerance::SPEED_OPERATOR, "{unstated} of {stated}");
        for about in [stated / 3.6, 0.5 * stated, 0.9 * stated, 1.2 * stated, f64::NAN] {
            assert_eq!(found(Some(about)), Some(unstated), "{about} instead of {stated}");
        }
        assert_eq!(found(Some(stated)), Some(unstated));
    }
}

#[test]
fn property_same_seed_same_bits_other_seed_other_site() {
    let scenario = short(2);
    let (once, twice) = (simulate(&scenario, &Silent).unwrap(), simulate(&scenario, &Silent).unwrap());
    assert_eq!(once.site.passages, twice.site.passages);
    assert_eq!(once.truth.wheels, twice.truth.wheels);
    let mut other = scenario;
    other.simulation.seed += 1;
    assert_ne!(once.site.passages, simulate(&other, &Silent).unwrap().site.passages);
}

#[test]
fn property_effects_change_what_they_should_and_nothing_else() {
    let nominal = simulate(&short(1), &Silent).unwrap();
    let with = |change: &dyn Fn(&mut Scenario)| {
        let mut scenario = short(1);
        change(&mut scenario);
        simulate(&scenario, &Silent).unwrap()
    };
    let deepest = |s: &cpcm::scenario::SimulatedSite| {
        s.truth.wheels[0].sleeper_displacement_m.as_ref().unwrap().iter().copied().fold(0.0, f64::max)
    };
    let voided = with(&|s| {
        let sleepers = vec![(0, 1.0)];
        s.simulation.effects.voided_sleepers =
            Some(VoidedSleepers { gap_m: 0.5e-3, sleepers, crib_damping: 0.0 });
    });
    assert!(deepest(&voided) > deepest(&nominal) + 0.1e-3);
    assert_eq!(voided.truth.site.effects.as_array().unwrap()[0].as_str(), Some("voided-sleepers"));
    assert_eq!(voided.site.passages[0].temperature_c, nominal.site.passages[0].temperature_c);
    let flat = with(&|s| s.simulation.effects.wheel_flat = Some(WheelFlats { length_m: 0.05, share: 1.0 }));
    let largest = |s: &cpcm::scenario::SimulatedSite| {
        let stock = s.truth.wheels.iter().filter(|w| w.side == Side::Stock);
        stock.flat_map(|w| &w.contact_force_n).copied().fold(0.0, f64::max)
    };
    assert!(largest(&flat) > 1.2 * largest(&nominal), "{} {}", largest(&flat), largest(&nominal));
    let fewer = with(&|s| s.simulation.solver.sleepers_each_side = Some(18));
    assert!((deepest(&fewer) / deepest(&nominal) - 1.0).abs() < 5e-3, "37 sleepers do");
}

#[test]
fn property_spoilt_scenario_is_refused_by_name() {
    let text = std::fs::read_to_string(example()).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("site.toml");
    let refused = |from: &str, to: &str| {
        assert!(text.contains(from), "{from}");
        std::fs::write(&file, text.replace(from, to)).unwrap();
        match read_scenario(&file).and_then(|s| simulate(&s, &Silent).map(|_| ())) {
            Err(error) => error,
            Ok(()) => panic!("{to} is accepted"),
        }
    };
    let theta = refused("theta = 0.5", "theta = 0.4");
    assert!(matches!(&theta, ScenarioError::Simulation(e) if e.to_string().contains("0.4")), "{theta}");
    assert!(refused("passages = 12", "passages = 0").to_string().contains("passages = 0"));
    assert!(refused("dt_s = 1e-4", "dt_s = 1e-2").to_string().contains("0.01"));
    let unknown = refused("wear_m =", "ware_m =");
    assert!(matches!(&unknown, ScenarioError::Key { key, .. } if key.starts_with("geometry")), "{unknown}");
    assert!(refused("p1_n_m2 = 30e6", "p1_n_m2 = nan").to_string().contains("p1_n_m2"));
    assert!(refused("stiffness_n_m2 = 30000000.0", "stiffness_n_m2 = 30.0").to_string().contains("ballast"));
}

/// Track of a field recording with its true ballast.
fn field_stepper(name: &str, sleeper_modes: usize, mesh: Mesh, dt_s: f64) -> Stepper {
    let (site, truth) = (read_site(&field(name)).unwrap(), read_site_truth(&field(name)).unwrap());
    let damping = site.crossing.ballast.damping_ns_m2;
    let supports = truth.ballast.stiffness_n_m2.iter().map(|k| Support::linear(*k, damping)).collect();
    let track = Track::of_crossing(&site.crossing, mesh);
    let model = TrackModel::new(&track, supports, sleeper_modes).unwrap();
    Stepper::new(model, TimeStep { dt_s, theta: 0.5 }).unwrap()
}

/// First bogie over the scanned crossing.
fn bogie_passage(name: &str, stepper: &Stepper, speed_m_s: f64) -> PassageRecord {
    let site = read_site(&field(name)).unwrap();
    let vehicle = &site.crossing.vehicle;
    let mut train = Train::of_vehicle(vehicle, 76_027.5).unwrap();
    train.units.truncate(1);
    train.wheels.truncate(4);
    let scan = site.scan.unwrap();
    let path = Profile::of_scan(&scan.position_m, &scan.irregularity_m, 0.3).unwrap();
    let surface = RunningSurface { paths: vec![path], ..RunningSurface::level() };
    let direction = site.crossing.traffic_direction.sign();
    let journey = Journey {
        direction,
        speed_m_s,
        acceleration_m_s2: 0.0,
        first_m: -19.0,
        duration_s: 1.0,
        start: Start::Quiet,
    };
    let law = ContactLaw::Hertz(vehicle.hertz_constant_n_m15);
    run(stepper, &train, (&surface, law), &journey, [-4.5, 4.5]).unwrap()
}

/// Deviation of the first wheel's force from static below 250 Hz, on 10 mm in −1 … 1.6 m.
fn low_force(record: &PassageRecord, speed_m_s: f64) -> Vec<f64> {
    let trace = &record.contacts[0];
    let (mut x, mut f) = (trace.position_m.clone(), trace.force_n.clone());
    if x.first() > x.last() {
        x.reverse();
        f.reverse();
    }
    low_pass_on_grid(&x, &f, speed_m_s)
}

fn low_pass_on_grid(x: &[f64], f: &[f64], speed_m_s: f64) -> Vec<f64> {
    let spline = CubicSpline::new(x, f).unwrap();
    let deviation: Vec<f64> = (0..800).map(|i| spline.at(-4.0 + 0.01 * f64::from(i)) - 76_027.5).collect();
    brick_band(&deviation, speed_m_s / 0.01, 0.0, 250.0)[300..560].to_vec()
}

/// Acceleration at the sensor below 250 Hz.
fn low_acceleration(record: &PassageRecord) -> Vec<f64> {
    let n = record.sensor_m.len() - 1;
    let motion = resample(&record.sensor_m[..n], 4000);
    let low = brick_band(&motion, 4000.0, 0.0, 250.0);
    low.windows(3).map(|w| (w[0] - 2.0 * w[1] + w[2]) * 16e6).collect()
}

fn relative(found: &[f64], expected: &[f64]) -> f64 {
    let difference: Vec<f64> = found.iter().zip(expected).map(|(a, b)| a - b).collect();
    rms(&difference) / rms(expected)
}

/// The stated errors of reduction, mesh and step, on both designs: force and sleeper acceleration below 250 Hz.
#[test]
fn property_errors_of_reduction_mesh_and_step_are_as_stated() {
    let (modes, mesh) = (cpcm::passage::SLEEPER_MODES, Mesh::default());
    let fine = Mesh { rail_step_m: 0.075, sleeper_step_m: 0.125 };
    for name in ["reference-1", "reference-2"] {
        let go = |stepper: &Stepper| bogie_passage(name, stepper, 42.66);
        let usual = go(&field_stepper(name, modes, mesh, 1e-4));
        let full = go(&field_stepper(name, 1000, mesh, 1e-4));
        let finest = go(&field_stepper(name, modes, fine, 2.5e-5));
        let error = |a: &PassageRecord, b: &PassageRecord| {
            let force = relative(&low_force(a, 42.66), &low_force(b, 42.66));
            (force, relative(&low_acceleration(a), &low_acceleration(b)))
        };
        let (force, acceleration) = error(&usual, &full);
        assert!(
            force < tolerance::REDUCTION && acceleration < tolerance::REDUCTION,
            "reduction, {name}: {force} {acceleration}"
        );
        let (force, acceleration) = error(&usual, &finest);
        assert!(force < 6e-3 && acceleration < 1.5e-2, "mesh and step, {name}: {force} {acceleration}");
    }
}

/// An independent simulator's forces, put on our track, give its displacement at the sensor.
#[test]
fn reference_true_forces_give_the_true_displacement() {
    let name = "reference-1";
    let truth = read_truth(&field(name)).unwrap();
    let stepper = field_stepper(name, cpcm::passage::SLEEPER_MODES, Mesh::default(), 1e-4);
    let offsets =
        cpcm::vehicle::AxlePattern::of_vehicle(&read_site(&field(name)).unwrap().crossing.vehicle).offset_m;
    let wheels: Vec<_> = truth.wheels.iter().filter(|w| w.passage_id == 0).collect();
    let speed = wheels[0].true_speed_m_s;
    let expected = wheels[0].sleeper_displacement_m.clone().unwrap();
    let forces: Vec<(f64, cpcm::track::Side, CubicSpline, f64)> = wheels
        .iter()
        .map(|w| {
            let side =
                if w.side == Side::Crossing { cpcm::track::Side::Crossing } else { cpcm::track::Side::Stock };
            let spline = CubicSpline::new(&w.position_m, &w.contact_force_n).unwrap();
            (offsets[w.wheelset], side, spline, mean(&w.contact_force_n))
        })
        .collect();
    // Time zero: first axle 20 m before the nose.
    let steps = ((offsets[11] + 40.0) / speed / 1e-4) as usize;
    let mut state = stepper.at_rest();
    let mut found = Vec::with_capacity(steps);
    for n in 0..steps {
        let travelled = -20.0 + speed * (n as f64 + 0.5) * 1e-4;
        stepper.begin(&mut state);
        for (offset, side, force, static_n) in &forces {
            let x = travelled - offset;
            let Some(point) = stepper.model.point(*side, x) else { continue };
            let ramp = cpcm::passage::surface::smooth_step((17.0 - x.abs()) / 3.0);
            let value = if x.abs() < 4.0 { force.at(x) } else { *static_n };
            stepper.load(&mut state, &point, ramp * value);
        }
        stepper.finish(&mut state);
        found.push(stepper.sensor_m(&state));
    }
    let found = resample(&found, (steps as f64 * 0.4) as usize);
    // The recording's time offset is unknown: best shift by whole samples, then the remainder by interpolation.
    let ours = CubicSpline::new(&(0..found.len()).map(|i| i as f64).collect::<Vec<_>>(), &found).unwrap();
    let misfit = |shift: f64| {
        let inside = |i: &usize| (400.0..found.len() as f64 - 400.0).contains(&(*i as f64 + shift));
        let at: Vec<usize> = (0..expected.len()).filter(inside).collect();
        let a: Vec<f64> = at.iter().map(|i| ours.at(*i as f64 + shift)).collect();
        let b: Vec<f64> = at.iter().map(|i| expected[*i]).collect();
        relative(&a, &b)
    };
    let coarse =
        (-3000..3000).step_by(4).map(f64::from).min_by(|a, b| misfit(*a).total_cmp(&misfit(*b))).unwrap();
    let best = (-100..100).map(|k| coarse + 0.05 * f64::from(k)).map(misfit).fold(f64::INFINITY, f64::min);
    assert!(best < 5e-3, "relative rms difference {best}");
}
