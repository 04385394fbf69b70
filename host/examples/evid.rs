use cpcm::ballast::BallastParameters;
use cpcm::ballast::quasi_static::QuasiStatic;
use cpcm::greens::{Chain, GreensFunctions, GreensSampling, Quantity};
use cpcm::inverse::hierarchy::{SiteModel, SitePassage, kinds};
use cpcm::inverse::{CommonProfile, Estimator, Prior, ProfileGrids};
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
    eprintln!("qs fit {:?}", fit.parameters);
    let arg = |i: usize| std::env::args().nth(i).and_then(|s| s.parse::<f64>().ok());
    let b0 = BallastParameters {
        p1_n_m2: arg(2).unwrap() * 1e6,
        p2_n_m2: arg(3).unwrap() * 1e6,
        p3: arg(4).unwrap(),
    };
    let t0: Vec<f64> = match std::env::var("TT") {
        Ok(f) => std::fs::read_to_string(f)
            .unwrap()
            .lines()
            .map(|l| l.split_whitespace().next().unwrap().parse().unwrap())
            .collect(),
        _ => qs.align(&b0),
    };
    let use_n = arg(5).unwrap_or(24.0) as usize;
    let half = 4.0;
    let vm = cpcm::signal::mean(&speeds);
    let low = ProfileGrids::new(half, 0.09, 0.18, vm);
    let mut passages: Vec<SitePassage> = (0..recs.len())
        .step_by(24 / use_n)
        .map(|i| SitePassage {
            recording: &recs[i],
            timing: Timing { speed_m_s: speeds[i], first_axle_s: t0[i] },
            static_force_n: q[i],
        })
        .collect();
    let mut prior = Prior::starting(dirn);
    if let Some(x) = arg(6) {
        prior.own.region_n = x;
    }
    if let Some(x) = arg(7) {
        prior.noise_m_s2 = x;
    }
    if let Some(x) = arg(8) {
        prior.own.outside_n = x;
    }
    if let Some(x) = arg(9) {
        prior.own.stock_n = x;
    }
    let eval = |b: &BallastParameters, ps: &[SitePassage]| {
        let dist = b.distribution(track.sleeper_x_m.len(), track.sensor_sleeper);
        let g = GreensFunctions::new(
            &track,
            &dist,
            GreensSampling::low(),
            Quantity::Acceleration,
            &Chain::Corrected,
        );
        SiteModel {
            greens: &g,
            direction: dirn,
            pattern: &pattern,
            prior: &prior,
            grids: low.clone(),
            common_shift_sd_m: 0.05,
            passage_shift_sd_m: 0.02,
        }
        .posterior(ps)
        .unwrap()
    };
    for it in 0..3 {
        let clock = Instant::now();
        let p = eval(&b0, &passages);
        let m = p.covariance.nrows();
        eprintln!(
            "iter {it} evidence {:.1} common shift {:.1} mm sd {:.1} shift sd {:.2} mm {:?}",
            p.log_evidence,
            p.common_shift_m * 1e3,
            p.covariance[(m - 1, m - 1)].sqrt() * 1e3,
            p.shift_sd_m[0] * 1e3,
            clock.elapsed()
        );
        for (a, s) in passages.iter_mut().zip(&p.shift_m) {
            a.timing.first_axle_s += s / a.timing.speed_m_s;
        }
    }
    for (k, f) in [(0, 0.93), (0, 1.07), (1, 0.93), (1, 1.07), (2, -0.1), (2, 0.1)] {
        let mut b = b0;
        match k {
            0 => b.p1_n_m2 *= f,
            1 => b.p2_n_m2 *= f,
            _ => b.p3 += f,
        }
        let p = eval(&b, &passages);
        eprintln!("  {k} {f}: {:.1} X {:.1} mm", p.log_evidence, p.common_shift_m * 1e3);
    }
    // wide estimate
    let dist = b0.distribution(track.sleeper_x_m.len(), track.sensor_sleeper);
    let g = GreensFunctions::new(
        &track,
        &dist,
        GreensSampling::wide(),
        Quantity::Acceleration,
        &Chain::Corrected,
    );
    let wide = ProfileGrids::new(half, 0.05, 0.08, vm);
    let model = SiteModel {
        greens: &g,
        direction: dirn,
        pattern: &pattern,
        prior: &prior,
        grids: wide.clone(),
        common_shift_sd_m: 0.001,
        passage_shift_sd_m: 0.01,
    };
    let mut all: Vec<SitePassage> = (0..recs.len())
        .map(|i| SitePassage {
            recording: &recs[i],
            timing: Timing { speed_m_s: speeds[i], first_axle_s: t0[i] },
            static_force_n: q[i],
        })
        .collect();
    if passages.len() == 24 {
        all = passages.clone();
    }
    let mut profile = CommonProfile::zero(wide);
    for _ in 0..2 {
        let clock = Instant::now();
        let p = model.posterior(&all).unwrap();
        let m = p.covariance.nrows();
        eprintln!(
            "wide evidence {:.1} X {:.2} mm sd {:.1} shift sd {:.2} mm {:?}",
            p.log_evidence,
            p.common_shift_m * 1e3,
            p.covariance[(m - 1, m - 1)].sqrt() * 1e3,
            p.shift_sd_m[0] * 1e3,
            clock.elapsed()
        );
        for (a, s) in all.iter_mut().zip(&p.shift_m) {
            a.timing.first_axle_s += s / a.timing.speed_m_s;
        }
        profile = p.profile;
    }
    let grid: Vec<f64> = (0..241).map(|i| prior.region_m[0] + 0.01 * i as f64).collect();
    println!("grid {}", grid.iter().map(|x| format!("{x:.3}")).collect::<Vec<_>>().join(" "));
    for (i, ps) in all.iter().enumerate() {
        for kind in kinds(&pattern) {
            let est = Estimator::new(&g, &model.geometry(&kind.offsets, ps), &prior, &profile).unwrap();
            let gains = est.gains(&grid, 250.0);
            for grp in &kind.groups {
                let y = ps.recording.window(
                    ps.timing.axle_s(pattern.offset_m[grp.first]) - est.before as f64 / est.rate_hz,
                    est.rate_hz,
                    est.len(),
                    g.sampling.band_hz,
                );
                for (a, gain) in gains.iter().enumerate() {
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
                        speeds[i],
                        f.iter().map(|x| format!("{x:.1}")).collect::<Vec<_>>().join(" ")
                    );
                    println!(
                        "s {} {} {} {}",
                        site.passages[i].passage_id,
                        grp.first + a,
                        speeds[i],
                        gain.sd_n.iter().map(|x| format!("{x:.1}")).collect::<Vec<_>>().join(" ")
                    );
                }
            }
        }
    }
}
