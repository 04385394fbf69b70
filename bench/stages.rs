//! CPU time of every stage of the method on a site of 24 passages, on one core.
//!
//! `cargo bench -p cpcm-benches --bench stages`

use std::hint::black_box;
use std::path::Path;

use cpcm::ballast::BallastParameters;
use cpcm::ballast::evidence::{EvidenceProblem, temperature};
use cpcm::ballast::low_track::LowTrack;
use cpcm::ballast::quasi_static::QuasiStatic;
use cpcm::forces::{Spread, wheel_forces};
use cpcm::greens::moving::{WheelPath, kernel};
use cpcm::greens::moving_response::RailGreens;
use cpcm::greens::{Chain, GreensFunctions, GreensSampling, Quantity};
use cpcm::identify::{IdentifiedSite, identify};
use cpcm::inverse::hierarchy::SitePassage;
use cpcm::irregularity::irregularity;
use cpcm::progress::Silent;
use cpcm::reconstruct::Recording;
use cpcm::recording::{Site, read_site};
use cpcm::track::{Mesh, Side, Track};
use cpcm_benches::CpuTime;
use criterion::{Criterion, criterion_group, criterion_main};

type Stages<'a> = criterion::BenchmarkGroup<'a, CpuTime>;

fn site() -> Site {
    read_site(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field/reference-1")).unwrap()
}

/// Receptances, Green's functions and kernels of the track alone.
fn of_track(group: &mut Stages, site: &Site) {
    let track = Track::of_crossing(&site.crossing, Mesh::default());
    let bed = vec![site.crossing.ballast.stiffness_n_m2; track.sleeper_x_m.len()];
    let (sampling, chain) = (GreensSampling::wide(), Chain::Corrected);
    let frequencies = sampling.frequencies_hz();
    group.bench_function("receptances at all frequencies of the identification", |b| {
        b.iter(|| track.sensor_receptance(black_box(&frequencies), &bed))
    });
    let greens = GreensFunctions::new(&track, &bed, sampling, Quantity::Acceleration, &chain);
    let path = WheelPath { direction: 1.0, speed_m_s: 43.0, time_at_origin_s: 0.25 };
    group.bench_function("kernel of one wheel for one speed", |b| {
        b.iter(|| kernel(&greens, Side::Crossing, black_box(&path), 4.0, 512))
    });
    group.bench_function("moving response of the rail, Green's functions", |b| {
        b.iter(|| RailGreens::of_both_rails(&track, &bed, 4.0, sampling))
    });
}

/// One fit and one evaluation of the evidence with the recordings of all passages.
fn of_ballast(group: &mut Stages, identified: &IdentifiedSite) {
    let inputs: Vec<(&Recording, f64, f64)> = identified
        .recordings
        .iter()
        .zip(&identified.timings)
        .zip(&identified.static_force_n)
        .map(|((recording, timing), force)| (recording, timing.speed_m_s, *force))
        .collect();
    let start = BallastParameters::NOMINAL;
    let (track, pattern) = (&identified.track, &identified.pattern);
    group.bench_function("quasi-static fit, 24 passages", |b| {
        b.iter(|| QuasiStatic::new(track, identified.direction, pattern, &inputs).fit(start))
    });
    let passages: Vec<SitePassage> = (0..8)
        .map(|i| SitePassage {
            recording: &identified.recordings[i],
            timing: identified.timings[i],
            static_force_n: identified.static_force_n[i],
        })
        .collect();
    let vehicle = &identified.site.crossing.vehicle;
    let low_track = LowTrack::new(track.clone(), vehicle);
    let problem = EvidenceProblem {
        track: &low_track,
        direction: identified.direction,
        pattern,
        temperature: temperature(pattern),
    };
    group.bench_function("one linearisation of the calibration, 8 passages", |b| {
        b.iter(|| problem.posterior(black_box(&identified.calibration), &passages).unwrap())
    });
}

/// One passage of the identified site.
fn of_passage(group: &mut Stages, identified: &IdentifiedSite) {
    let spread = Spread::new(identified, identified.class_of_passage(3)).unwrap();
    group.bench_function("inverse of one passage, 12 wheelsets", |b| {
        b.iter(|| wheel_forces(identified, black_box(3), &spread).unwrap())
    });
    let bed = identified
        .ballast
        .parameters
        .distribution(identified.track.sleeper_x_m.len(), identified.track.sensor_sleeper);
    let half_m = identified.half_m();
    let rail = RailGreens::of_crossing_rail(&identified.track, &bed, half_m, identified.greens.sampling);
    let force = &wheel_forces(identified, 3, &spread).unwrap()[0];
    let grid: Vec<f64> = (0..240).map(|i| -0.9 + 0.01 * f64::from(i)).collect();
    let (speed, static_n) = (identified.timings[3].speed_m_s, identified.static_force_n[3]);
    group.bench_function("irregularity under one wheel", |b| {
        b.iter(|| irregularity(force, speed, static_n, &rail, &identified.site.crossing.vehicle, &grid))
    });
}

fn stages(c: &mut Criterion<CpuTime>) {
    let site = site();
    // One thread, so that the thread's clock sees all the work.
    rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build_global().unwrap();
    let identified = identify(&site, &Silent).unwrap();
    let mut group = c.benchmark_group("stages");
    group.sample_size(10);
    of_track(&mut group, &site);
    of_ballast(&mut group, &identified);
    of_passage(&mut group, &identified);
    group.finish();
}

criterion_group!(name = benches; config = cpcm_benches::criterion(); targets = stages);
criterion_main!(benches);
