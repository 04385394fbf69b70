//! What this program does in a comparison, each job as its user would have it done.

use std::fs::File;
use std::path::Path;

use faer::Mat;
use serde_json::{Value, json};

use crate::ballast::BallastParameters;
use crate::ballast::quasi_static::QuasiStatic;
use crate::greens::moving::{WheelPath, kernel};
use crate::greens::moving_response::RailGreens;
use crate::greens::{Chain, GreensFunctions, GreensSampling, Quantity};
use crate::inverse::displacement::{DisplacementModel, Rule, RuleSolver};
use crate::passage::contact::ContactLaw;
use crate::passage::{
    Journey, Profile, RunningSurface, SLEEPER_MODES, Start, Stepper, Support, TimeStep, TrackModel, Train,
    run,
};
use crate::reconstruct::Recording;
use crate::recording::{Passage, Sensor, read_crossing_file, read_scan_file};
use crate::signal::{brick_band, quantile, resample, rms};
use crate::track::{Mesh, Side, Track};
use crate::vehicle::AxlePattern;
use crate::verification::passages::{Passages, read_published};
use crate::verification::reference::{BOGIE_M, MID, SOFT, SPEED_M_S, WHEEL_N, panel};

/// Jobs of the comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Job {
    /// Ballast, forces and irregularity of 100 passages, each with its own kernels
    Whole,
    /// A constant force over benchmark T1 in the time domain
    MovingForce,
    /// One three-car train over a crossing in the time domain
    Passage,
}

/// Failure of a job, in words.
pub type JobError = Box<dyn std::error::Error + Send + Sync>;

impl Job {
    /// Does the job; `input` is the file or directory it works on.
    pub fn run(self, input: &Path) -> Result<Value, JobError> {
        match self {
            Job::Whole => whole(input),
            Job::MovingForce => moving_force(),
            Job::Passage => passage(input),
        }
    }
}

/// Rate of the identification, Hz, and the rails' ends, m from the sensor.
const RATE_HZ: f64 = 1000.0;
const END_M: f64 = 10.8;
/// Rate of the published displacement, Hz, and its samples.
const PUBLISHED_HZ: f64 = 5000.0;
const PUBLISHED: usize = 2160;
const SAMPLES: usize = 432;
/// Half of the transition region, m (paper, fig. 13).
const REGION_M: f64 = 1.2;
const LOW_PASS_HZ: f64 = 250.0;
/// Passages that calibrate.
const CALIBRATING: usize = 10;

/// Ballast from ten passages, force of every passage with kernels of its own, rail deflection and wheel path.
fn whole(input: &Path) -> Result<Value, JobError> {
    let published = read_published(input, File::open(input)?, PUBLISHED)?;
    let mut track = panel(SOFT, Mesh::default());
    track.rail_halvings = 0;
    let found = calibrate(&track, &published);
    let ballast = found.bed(&track);
    let sampling = GreensSampling { rate_hz: RATE_HZ, len: 512, band_hz: [300.0, 400.0] };
    let greens =
        GreensFunctions::try_new(&track, &ballast, sampling, Quantity::Displacement, &Chain::Corrected)?;
    let rail = RailGreens::of_crossing_rail(&track, &ballast, END_M, sampling);
    let moving = rail.kernel(&(0..SAMPLES).map(|k| paths()[0].x_m(k as f64 / RATE_HZ)).collect::<Vec<f64>>());
    let (mut peak, mut waveform) = (Vec::new(), Vec::new());
    let (mut deflection, mut all_paths): (f64, Vec<f64>) = (0.0, Vec::new());
    for (displacement, force) in published.displacement_m.iter().zip(&published.force_n) {
        let (first, identified) = identify(&greens, &resample(displacement, SAMPLES))?;
        let low = brick_band(force, PUBLISHED_HZ, 0.0, LOW_PASS_HZ);
        let known: Vec<f64> = (first..first + identified.len()).map(|k| low[5 * k]).collect();
        let largest = |v: &[f64]| v.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let smallest = |v: &[f64]| v.iter().copied().fold(f64::INFINITY, f64::min);
        let difference: Vec<f64> = known.iter().zip(&identified).map(|(a, b)| a - b).collect();
        peak.push((largest(&identified) / largest(&known) - 1.0).abs());
        waveform.push(rms(&difference) / (largest(&known) - smallest(&known)));
        let (rail_m, path) = irregularity(&moving, first, &identified);
        deflection = deflection.max(rail_m);
        all_paths.extend(path);
    }
    Ok(json!({
        "ballast_mn_m2": [1e-6 * found.p1_n_m2, 1e-6 * found.p2_n_m2, found.p3],
        "peak_error": quantile(&peak, 0.5), "waveform_error": quantile(&waveform, 0.5),
        "deflection_mm": 1e3 * deflection, "irregularity_rms_mm": 1e3 * rms(&all_paths),
    }))
}

/// Paths of the two wheels of the bogie; the front one is at the sensor 10.8 m after the start.
fn paths() -> [WheelPath; 2] {
    [0.0, BOGIE_M].map(|behind_m| WheelPath {
        direction: 1.0,
        speed_m_s: SPEED_M_S,
        time_at_origin_s: (END_M + behind_m) / SPEED_M_S,
    })
}

/// Quasi-static fit. It works on accelerations, so the published displacement is differentiated.
fn calibrate(track: &Track, published: &Passages) -> BallastParameters {
    let sensor = Sensor {
        sleeper_index: 18,
        y_m: 2.0,
        sample_rate_hz: PUBLISHED_HZ,
        range_m_s2: 500.0,
        bits: 16,
        antialias_order: 0,
        antialias_hz: 2500.0,
        noise_rms_m_s2: 0.0,
        bias_max_m_s2: 0.0,
    };
    let recordings: Vec<Recording> = published
        .displacement_m
        .iter()
        .take(CALIBRATING)
        .map(|d| Recording::new(&accelerations(d), &sensor))
        .collect();
    let pattern = AxlePattern { offset_m: vec![0.0, BOGIE_M] };
    let of_passages: Vec<(&Recording, f64, f64)> =
        recordings.iter().map(|r| (r, SPEED_M_S, WHEEL_N)).collect();
    let start = BallastParameters::stiffness([40e6, 30e6, 0.5]);
    QuasiStatic::new(track, 1.0, &pattern, &of_passages).fit(start).parameters
}

/// Second difference, with a second of quiet before and after.
fn accelerations(displacement_m: &[f64]) -> Passage {
    let quiet = vec![0.0f32; PUBLISHED_HZ as usize];
    let scale = PUBLISHED_HZ * PUBLISHED_HZ;
    let moving = displacement_m.windows(3).map(|w| (scale * (w[0] - 2.0 * w[1] + w[2])) as f32).collect();
    Passage {
        passage_id: 0,
        train_type: "bogie".into(),
        axle_load_kg: 15_500.0,
        speed_m_s: Some(SPEED_M_S),
        temperature_c: 10.0,
        sample_rate_hz: PUBLISHED_HZ,
        acceleration_m_s2: [quiet.clone(), moving, quiet].concat(),
    }
}

/// First sample of the region and the force in it, with kernels made for this passage alone.
fn identify(greens: &GreensFunctions, displacement_m: &[f64]) -> Result<(usize, Vec<f64>), JobError> {
    let half_sample_m = 0.5 * SPEED_M_S / RATE_HZ;
    let mut known = vec![0.0; SAMPLES];
    for path in paths() {
        for side in [Side::Crossing, Side::Stock] {
            let all = kernel(greens, side, &path, END_M + half_sample_m, SAMPLES);
            for column in 0..all.ncols() {
                known.iter_mut().zip(all.col_as_slice(column)).for_each(|(s, k)| *s += WHEEL_N * k);
            }
        }
    }
    let [front, rear] =
        paths().map(|p| kernel(greens, Side::Crossing, &p, REGION_M + half_sample_m, SAMPLES));
    let n = front.ncols();
    let first = *paths()[0].samples_within(REGION_M + half_sample_m, RATE_HZ).start() as usize;
    // From the moment the front wheel enters until the response to the rear one has died away.
    let window = first..SAMPLES.min(first + 2 * n + (BOGIE_M / SPEED_M_S * RATE_HZ) as usize);
    let model = DisplacementModel {
        kernel: Mat::from_fn(window.len(), n, |i, j| front[(first + i, j)] + rear[(first + i, j)]),
        rate_hz: RATE_HZ,
        static_force_n: WHEEL_N,
        surround: [first, SAMPLES - first - n],
        low_pass_hz: LOW_PASS_HZ,
    };
    let inside = |i: usize| (0..n).map(|j| model.kernel[(i, j)]).sum::<f64>();
    let data: Vec<f64> =
        window.enumerate().map(|(i, k)| displacement_m[k] - known[k] + WHEEL_N * inside(i)).collect();
    Ok((first, RuleSolver::new(&model)?.solve(Rule::PinvDeviation, &data)?.force_n))
}

/// Largest rail deflection and the wheel's path without the rail, both of the whole passage, m.
fn irregularity(moving: &Mat<f64>, first: usize, force_n: &[f64]) -> (f64, Vec<f64>) {
    let mut force = vec![WHEEL_N; SAMPLES];
    force[first..first + force_n.len()].copy_from_slice(force_n);
    let rail = moving * Mat::from_fn(SAMPLES, 1, |i, _| force[i]);
    let (dt, mass) = (1.0 / RATE_HZ, 670.0);
    let (mut velocity, mut height) = (0.0, 0.0);
    let path: Vec<f64> = (0..SAMPLES)
        .map(|i| {
            velocity -= (force[i] - WHEEL_N) / mass * dt;
            height += velocity * dt;
            height - rail[(i, 0)]
        })
        .collect();
    let banded = brick_band(&path, RATE_HZ, SPEED_M_S, LOW_PASS_HZ);
    let deepest = (0..SAMPLES).map(|i| rail[(i, 0)]).fold(0.0, f64::max);
    (deepest, banded[first..first + force_n.len()].to_vec())
}

/// T1 with the mesh, step, force and ramp of the script: 0.15 m, 0.1 ms, 9000 steps.
fn moving_force() -> Result<Value, JobError> {
    let track = Track::benchmark_t1(MID.pad, Mesh { rail_step_m: 0.15, sleeper_step_m: 0.25 });
    let model = TrackModel::new(&track, vec![Support::linear(30e6, 125e3); 101], 2)?;
    let stepper = Stepper::new(model, TimeStep::default())?;
    let read = stepper.model.point(Side::Crossing, 30.0).ok_or("the rail ends before 30 m")?;
    let mut state = stepper.at_rest();
    let (mut sleeper, mut rail) = (0.0_f64, 0.0_f64);
    for step in 0..9000 {
        let time = (f64::from(step) + 0.5) * stepper.step.dt_s;
        stepper.begin(&mut state);
        if let Some(point) = stepper.model.point(Side::Crossing, 7.5 + SPEED_M_S * time) {
            stepper.load(&mut state, &point, WHEEL_N * (time / 0.05).min(1.0));
        }
        stepper.finish(&mut state);
        sleeper = sleeper.max(stepper.sensor_m(&state));
        rail = rail.max(stepper.rail_m(&state, &read));
    }
    Ok(json!({ "sleeper_mm": 1e3 * sleeper, "rail_mm": 1e3 * rail }))
}

/// Speed of the simulated passage, m/s.
const PASSAGE_M_S: f64 = 45.0;

/// The train of a site over its scanned crossing, with nominal ballast.
fn passage(input: &Path) -> Result<Value, JobError> {
    let crossing = read_crossing_file(&input.join("crossing.toml"))?;
    let scan = read_scan_file(&input.join("irregularity.csv"))?;
    let ballast = &crossing.ballast;
    let track = Track::of_crossing(&crossing, Mesh::default());
    let bed = Support::linear(ballast.stiffness_n_m2, ballast.damping_ns_m2);
    let model = TrackModel::new(&track, vec![bed; track.sleeper_x_m.len()], SLEEPER_MODES)?;
    let stepper = Stepper::new(model, TimeStep::default())?;
    let train = Train::of_vehicle(&crossing.vehicle, WHEEL_N)?;
    let path = Profile::of_scan(&scan.position_m, &scan.irregularity_m, 0.3)?;
    let surface = RunningSurface { paths: vec![path], ..RunningSurface::level() };
    let journey = Journey {
        direction: crossing.traffic_direction.sign(),
        speed_m_s: PASSAGE_M_S,
        acceleration_m_s2: 0.0,
        first_m: -8.0 - 0.4 * PASSAGE_M_S,
        duration_s: 0.8 + (16.0 + AxlePattern::of_vehicle(&crossing.vehicle).length_m()) / PASSAGE_M_S,
        start: Start::Quiet,
    };
    let law = ContactLaw::Hertz(crossing.vehicle.hertz_constant_n_m15);
    let begin = thread_cpu_s();
    let record = run(&stepper, &train, (&surface, law), &journey, [-4.5, 4.5])?;
    let simulated_s = thread_cpu_s() - begin;
    let peak = record.contacts.iter().flat_map(|c| &c.force_n).copied().fold(0.0, f64::max);
    Ok(json!({ "wheels": record.contacts.len(), "peak_n": peak, "simulation_alone_cpu_s": simulated_s }))
}

/// CPU time of this thread, s.
fn thread_cpu_s() -> f64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    now.tv_sec as f64 + 1e-9 * now.tv_nsec as f64
}
