use cpcm::ballast::BallastParameters;
use cpcm::ballast::quasi_static::QuasiStatic;
use cpcm::greens::{Chain, GreensFunctions, GreensSampling, Quantity};
use cpcm::inverse::{Estimator, GroupGeometry, Prior};
use cpcm::reconstruct::{Recording, SpeedSearch, estimate_speed};
use cpcm::track::{Mesh, Track};
use cpcm::vehicle::{AxlePattern, static_wheel_force_n};
use std::time::Instant;
fn main() {
    let dir = std::env::args().nth(1).unwrap();
    let clock = Instant::now();
    let site = cpcm::recording::read_site(std::path::Path::new(&dir)).unwrap();
    let c = &site.crossing;
    let dirn = c.traffic_direction.sign();
    let track = Track::of_crossing(c, Mesh::default());
    let pattern = AxlePattern::of_vehicle(&c.vehicle);
    let recs: Vec<Recording> = site.passages.iter().map(|p| Recording::new(p, &c.sensor)).collect();
    eprintln!("prep {:?}", clock.elapsed());
    let speeds: Vec<f64> =
        recs.iter().map(|r| estimate_speed(r, &pattern, SpeedSearch::default()).unwrap()).collect();
    eprintln!("speed {:?}", clock.elapsed());
    let q: Vec<f64> =
        site.passages.iter().map(|p| static_wheel_force_n(p.axle_load_kg, c.vehicle.gravity_m_s2)).collect();
    let input: Vec<(&Recording, f64, f64)> = (0..recs.len()).map(|i| (&recs[i], speeds[i], q[i])).collect();
    let qs = QuasiStatic::new(&track, dirn, &pattern, &input);
    let fit = qs.fit(BallastParameters { p1_n_m2: 30e6, p2_n_m2: 25e6, p3: 0.4 });
    eprintln!(
        "qs fit {:?} misfit {} evals {} {:?}",
        fit.parameters,
        fit.misfit,
        fit.evaluations,
        clock.elapsed()
    );
    let arg = |i: usize| std::env::args().nth(i).and_then(|s| s.parse::<f64>().ok());
    let b = match (arg(2), arg(3), arg(4)) {
        (Some(a), Some(b), Some(c)) => BallastParameters { p1_n_m2: a * 1e6, p2_n_m2: b * 1e6, p3: c },
        _ => fit.parameters,
    };
    let dist = b.distribution(track.sleeper_x_m.len(), track.sensor_sleeper);
    let g = GreensFunctions::new(
        &track,
        &dist,
        GreensSampling::wide(),
        Quantity::Acceleration,
        &Chain::Corrected,
    );
    eprintln!("greens {:?}", clock.elapsed());
    let prior = Prior::starting(dirn);
    let grid: Vec<f64> = (0..241).map(|i| prior.region_m[0] + 0.01 * i as f64).collect();
    let shift = arg(5).unwrap_or(0.0);
    println!("grid {}", grid.iter().map(|x| format!("{x:.3}")).collect::<Vec<_>>().join(" "));
    for i in 0..recs.len() {
        let mut t_axles = vec![];
        let v = speeds[i];
        let t0 = fit.first_axle_s[i] + shift / v;
        let mut lml = 0.0;
        for grp in pattern.groups() {
            let base = pattern.offset_m[grp.first];
            let own: Vec<f64> =
                pattern.offset_m[grp.first..grp.first + grp.len].iter().map(|o| o - base).collect();
            let all: Vec<f64> = pattern.offset_m.iter().map(|o| o - base).collect();
            let geo = GroupGeometry {
                direction: dirn,
                speed_m_s: v,
                axle_offset_m: &own,
                train_offset_m: &all,
                static_force_n: q[i],
            };
            let est = Estimator::new(&g, &geo, &prior, &|_| 0.0).unwrap();
            let y = recs[i].window(
                t0 + base / v - est.before as f64 / est.rate_hz,
                est.rate_hz,
                est.len(),
                g.sampling.band_hz,
            );
            lml += est.log_evidence(&y);
            for (a, gain) in est.gains(&grid, 250.0).iter().enumerate() {
                let f: Vec<f64> = (0..grid.len())
                    .map(|k| {
                        gain.base_n[k]
                            + (0..est.len())
                                .map(|j| gain.gain[(k, j)] * (y[j] - est.expected_m_s2[j]))
                                .sum::<f64>()
                    })
                    .collect();
                println!(
                    "f {} {} {} {}",
                    site.passages[i].passage_id,
                    grp.first + a,
                    v,
                    f.iter().map(|x| format!("{x:.1}")).collect::<Vec<_>>().join(" ")
                );
                println!(
                    "s {} {} {} {}",
                    site.passages[i].passage_id,
                    grp.first + a,
                    v,
                    gain.sd_n.iter().map(|x| format!("{x:.1}")).collect::<Vec<_>>().join(" ")
                );
                t_axles.push(t0 + (base + own[a]) / v);
            }
        }
        eprintln!(
            "passage {i} t0 {t0:.5} v {v:.4} lml {lml:.1} quiet {:.4} {:?}",
            recs[i].quiet_rms_m_s2,
            clock.elapsed()
        );
    }
}
