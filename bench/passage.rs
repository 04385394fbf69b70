//! CPU time of one train passage in the time domain: three cars, 24 wheels, two rails, 61 sleepers, Hertz contact, 0.1 ms.
//!
//! `cargo bench -p cpcm-benches --bench passage`

use std::path::Path;

use cpcm::passage::contact::ContactLaw;
use cpcm::passage::{
    Journey, Profile, RunningSurface, SLEEPER_MODES, Start, Stepper, Support, SupportLaw, TimeStep,
    TrackModel, Train, run,
};
use cpcm::recording::{Site, read_site};
use cpcm::track::{Mesh, Track};
use cpcm::vehicle::AxlePattern;
use cpcm_benches::CpuTime;
use criterion::{Criterion, criterion_group, criterion_main};

const SPEED_M_S: f64 = 45.0;
const STATIC_WHEEL_FORCE_N: f64 = 76_027.5;

fn site() -> Site {
    read_site(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field/reference-1")).unwrap()
}

/// Nominal ballast, with `voids` sleepers around the sensor hanging 0.5 mm above theirs.
fn stepper(site: &Site, voids: usize) -> Stepper {
    let (track, ballast) = (Track::of_crossing(&site.crossing, Mesh::default()), &site.crossing.ballast);
    let n = track.sleeper_x_m.len();
    let mut supports = vec![Support::linear(ballast.stiffness_n_m2, ballast.damping_ns_m2); n];
    let first = track.sensor_sleeper - voids / 2;
    for support in &mut supports[first..first + voids] {
        support.law = SupportLaw::Unilateral { gap_m: 0.5e-3, preload_n_m: 0.0 };
    }
    let model = TrackModel::new(&track, supports, SLEEPER_MODES).unwrap();
    Stepper::new(model, TimeStep::default()).unwrap()
}

/// The whole train from before the panel to behind it, with the quiet time that a recording has.
fn journey(site: &Site) -> Journey {
    let length = AxlePattern::of_vehicle(&site.crossing.vehicle).length_m();
    Journey {
        direction: site.crossing.traffic_direction.sign(),
        speed_m_s: SPEED_M_S,
        acceleration_m_s2: 0.0,
        first_m: -8.0 - 0.4 * SPEED_M_S,
        duration_s: 0.8 + (16.0 + length) / SPEED_M_S,
        start: Start::Quiet,
    }
}

fn passages(c: &mut Criterion<CpuTime>) {
    let site = site();
    let train = Train::of_vehicle(&site.crossing.vehicle, STATIC_WHEEL_FORCE_N).unwrap();
    assert_eq!(train.wheels.len(), 24);
    let scan = site.scan.as_ref().unwrap();
    let path = Profile::of_scan(&scan.position_m, &scan.irregularity_m, 0.3).unwrap();
    let surface = RunningSurface { paths: vec![path], ..RunningSurface::level() };
    let law = ContactLaw::Hertz(site.crossing.vehicle.hertz_constant_n_m15);
    let journey = journey(&site);
    let mut group = c.benchmark_group("passage");
    group.sample_size(20);
    for (name, voids) in [("linear ballast", 0), ("9 voided sleepers", 9), ("61 sleepers that may lift", 61)]
    {
        let track = stepper(&site, voids);
        group.bench_function(name, |b| {
            b.iter(|| run(&track, &train, (&surface, law), &journey, [-4.5, 4.5]).unwrap())
        });
    }
    group.bench_function("factorise", |b| b.iter(|| stepper(&site, 0)));
    group.finish();
}

criterion_group!(name = benches; config = cpcm_benches::criterion(); targets = passages);
criterion_main!(benches);
