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
    let track = Track::of_crossing(c, Mesh::default());
    let pattern = AxlePattern::of_vehicle(&c.vehicle);
    let recs: Vec<Recording> = site.passages.iter().map(|p| Recording::new(p, &c.sensor)).collect();
    let speeds: Vec<f64> =
        recs.iter().map(|r| estimate_speed(r, &pattern, SpeedSearch::default()).unwrap()).collect();
    let q: Vec<f64> =
        site.passages.iter().map(|p| static_wheel_force_n(p.axle_load_kg, c.vehicle.gravity_m_s2)).collect();
    let input: Vec<(&Recording, f64, f64)> = (0..recs.len()).map(|i| (&recs[i], speeds[i], q[i])).collect();
    let qs = QuasiStatic::new(&track, dirn, &pattern, &input);
    let fit = qs.fit(BallastParameters { p1_n_m2: 30e6, p2_n_m2: 25e6, p3: 0.4 });
    let arg = |k: &str| std::env::var(k).ok().map(|s| s.parse::<f64>().unwrap());
    let tr: Vec<f64> = std::env::args().skip(2).map(|a| a.parse().unwrap()).collect();
    let mut prior = Prior::starting(dirn);
    let every = arg("EVERY").unwrap_or(3.0) as usize;
    if let Some(x) = arg("NOISE") {
        prior.noise_m_s2 = x;
    }
    if let Some(x) = arg("SLOW") {
        prior.slow_n = x;
    }
    if let Some(x) = arg("REG") {
        prior.common.region = x;
    }
    if let Some(x) = arg("OUT") {
        prior.common.outside = x;
        prior.common.stock = x;
    }
    if let Some(x) = arg("COR") {
        prior.correlation_m = x;
    }
    let tt: Option<Vec<f64>> = std::env::var("TT").ok().map(|f| {
        std::fs::read_to_string(f)
            .unwrap()
            .lines()
            .map(|l| l.split_whitespace().next().unwrap().parse().unwrap())
            .collect()
    });
    let mut passages: Vec<SitePassage> = (0..recs.len())
        .step_by(every)
        .map(|i| SitePassage {
            recording: &recs[i],
            timing: Timing {
                speed_m_s: speeds[i],
                first_axle_s: tt.as_ref().map_or(fit.first_axle_s[i], |t| t[i]),
            },
            static_force_n: q[i],
        })
        .collect();
    let mut problem =
        EvidenceProblem { track: &track, direction: dirn, pattern: &pattern, prior, vehicle: &c.vehicle };
    let truth = BallastParameters { p1_n_m2: tr[0] * 1e6, p2_n_m2: tr[1] * 1e6, p3: tr[2] };
    let clock = Instant::now();
    let p = problem.posterior(&truth, &passages).unwrap();
    println!(
        "   at truth evidence {:.1} X {:.1} mm {:?}",
        p.log_evidence,
        p.common_shift_m * 1e3,
        clock.elapsed()
    );
    let mut start = BallastParameters {
        p3: 0.5,
        p2_n_m2: (fit.parameters.p2_n_m2 * 1.5).max(0.3 * fit.parameters.p1_n_m2),
        ..fit.parameters
    };
    for round in 0..3 {
        if std::env::var("HYP").is_ok() {
            let mut best = problem.posterior(&start, &passages).unwrap().log_evidence;
            for _ in 0..2 {
                for k in 0..9 {
                    for f in [0.6, 1.7, 0.6, 1.7] {
                        let mut p = problem.prior.clone();
                        let x = match k {
                            0 => &mut p.own.region,
                            1 => &mut p.own.outside,
                            2 => &mut p.own.stock,
                            3 => &mut p.noise_m_s2,
                            4 => &mut p.slow_n,
                            5 => &mut p.common.region,
                            6 => &mut p.common.outside,
                            7 => &mut p.common.stock,
                            _ => &mut p.correlation_s,
                        };
                        *x *= f;
                        let old = std::mem::replace(&mut problem.prior, p);
                        match problem.posterior(&start, &passages) {
                            Ok(e) if e.log_evidence > best => best = e.log_evidence,
                            _ => problem.prior = old,
                        }
                    }
                }
            }
            let p = &problem.prior;
            println!(
                "   hyper {round}: own {:.0} {:.0} {:.0} noise {:.3} slow {:.0} common {:.3} {:.3} {:.3} mm corr {:.2} ms  evidence {best:.1}",
                p.own.region,
                p.own.outside,
                p.own.stock,
                p.noise_m_s2,
                p.slow_n,
                p.common.region * 1e3,
                p.common.outside * 1e3,
                p.common.stock * 1e3,
                p.correlation_s * 1e3
            );
        }
        for _ in 0..2 {
            let p = problem.posterior(&start, &passages).unwrap();
            for (a, s) in passages.iter_mut().zip(&p.shift_m) {
                a.timing.first_axle_s += s / a.timing.speed_m_s;
            }
        }
        let clock = Instant::now();
        let f = problem.fit(&[start], &passages).unwrap();
        let sd: Vec<f64> = (0..3).map(|i| f.covariance[i][i].sqrt()).collect();
        let p = problem.posterior(&truth, &passages).unwrap();
        println!(
            "  {:.2} {:.2} {:.3} sd {:.3} {:.3} {:.3} evidence {:.1} (truth {:.1}) evals {} {:?}",
            f.parameters.p1_n_m2 / 1e6,
            f.parameters.p2_n_m2 / 1e6,
            f.parameters.p3,
            sd[0],
            sd[1],
            sd[2],
            f.log_evidence,
            p.log_evidence,
            f.evaluations,
            clock.elapsed()
        );
        start = f.parameters;
    }
}
