use cpcm::ballast::BallastParameters;
use cpcm::ballast::evidence::EvidenceProblem;
use cpcm::ballast::quasi_static::QuasiStatic;
use cpcm::inverse::Prior;
use cpcm::inverse::hierarchy::SitePassage;
use cpcm::reconstruct::{Recording, SpeedSearch, Timing, estimate_speed};
use cpcm::track::{Mesh, Track};
use cpcm::vehicle::{AxlePattern, static_wheel_force_n};
use std::time::Instant;
fn main() {
    let dir = std::env::args().nth(1).unwrap();
    let site = cpcm::recording::read_site(std::path::Path::new(&dir)).unwrap();
    let c = &site.crossing;
    let dirn = c.traffic_direction.sign();
    let track = Track::of_crossing(
        c,
        Mesh {
            rail_step_m: std::env::var("RM").map_or(0.3, |s| s.parse().unwrap()),
            sleeper_step_m: std::env::var("SM").map_or(0.25, |s| s.parse().unwrap()),
        },
    );
    let pattern = AxlePattern::of_vehicle(&c.vehicle);
    let recs: Vec<Recording> = site.passages.iter().map(|p| Recording::new(p, &c.sensor)).collect();
    let speeds: Vec<f64> =
        recs.iter().map(|r| estimate_speed(r, &pattern, SpeedSearch::default()).unwrap()).collect();
    let q: Vec<f64> =
        site.passages.iter().map(|p| static_wheel_force_n(p.axle_load_kg, c.vehicle.gravity_m_s2)).collect();
    let input: Vec<(&Recording, f64, f64)> = (0..recs.len()).map(|i| (&recs[i], speeds[i], q[i])).collect();
    let qs = QuasiStatic::new(&track, dirn, &pattern, &input);
    let fit = qs.fit(BallastParameters { p1_n_m2: 30e6, p2_n_m2: 25e6, p3: 0.4 });
    println!("qs fit {:?}", fit.parameters);
    let arg = |i: usize| std::env::args().nth(i).and_then(|s| s.parse::<f64>().ok());
    let mut prior = Prior::starting(dirn);
    let every = arg(2).unwrap_or(3.0) as usize;
    if let Some(x) = arg(3) {
        prior.own.region_n = x;
    }
    if let Some(x) = arg(4) {
        prior.noise_m_s2 = x;
    }
    if let Some(x) = arg(5) {
        prior.own.outside_n = x;
    }
    if let Some(x) = arg(6) {
        prior.own.stock_n = x;
    }
    if let Some(x) = arg(7) {
        prior.slow_n = x;
    }
    if arg(8).is_some() {
        prior = prior.independent();
        prior.common.region_n = 1.0;
        prior.common.outside_n = 1.0;
        prior.common.stock_n = 1.0;
    }
    let mut passages: Vec<SitePassage> = (0..recs.len())
        .step_by(every)
        .map(|i| SitePassage {
            recording: &recs[i],
            timing: Timing { speed_m_s: speeds[i], first_axle_s: fit.first_axle_s[i] },
            static_force_n: q[i],
        })
        .collect();
    let vm = cpcm::signal::mean(&speeds);
    let problem =
        EvidenceProblem { track: &track, direction: dirn, pattern: &pattern, prior, mean_speed_m_s: vm };
    let mut start =
        BallastParameters { p3: 0.5, p2_n_m2: fit.parameters.p2_n_m2.max(5e6) * 1.3, ..fit.parameters };
    for _ in 0..2 {
        for _ in 0..2 {
            let p = problem.posterior(&start, &passages).unwrap();
            for (a, s) in passages.iter_mut().zip(&p.shift_m) {
                a.timing.first_axle_s += s / a.timing.speed_m_s;
            }
        }
        for b in [
            (start.p1_n_m2, start.p2_n_m2, start.p3),
            (arg(9).unwrap_or(30.0) * 1e6, arg(10).unwrap_or(18.0) * 1e6, arg(11).unwrap_or(0.35)),
        ] {
            let p = problem
                .posterior(&BallastParameters { p1_n_m2: b.0, p2_n_m2: b.1, p3: b.2 }, &passages)
                .unwrap();
            println!("   at {b:?} evidence {:.1} X {:.1} mm", p.log_evidence, p.common_shift_m * 1e3);
        }
        let clock = Instant::now();
        let f = problem.fit(&[start], &passages).unwrap();
        let sd: Vec<f64> = (0..3).map(|i| f.covariance[i][i].sqrt()).collect();
        println!(
            "  {:.2} {:.2} {:.3} sd {:.3} {:.3} {:.3} evidence {:.1} evals {} {:?}",
            f.parameters.p1_n_m2 / 1e6,
            f.parameters.p2_n_m2 / 1e6,
            f.parameters.p3,
            sd[0],
            sd[1],
            sd[2],
            f.log_evidence,
            f.evaluations,
            clock.elapsed()
        );
        start = f.parameters;
    }
}
