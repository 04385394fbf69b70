use cpcm::ballast::BallastParameters;
use cpcm::greens::moving::{WheelPath, constant_force_response, kernel};
use cpcm::greens::{Chain, GreensFunctions, GreensSampling, Quantity};
use cpcm::reconstruct::Recording;
use cpcm::track::{Mesh, Side, Track};
use cpcm::vehicle::{AxlePattern, static_wheel_force_n};
fn main() {
    let dir = std::env::args().nth(1).unwrap();
    let arg = |i: usize| std::env::args().nth(i).and_then(|s| s.parse::<f64>().ok());
    let site = cpcm::recording::read_site(std::path::Path::new(&dir)).unwrap();
    let truth = cpcm::recording::truth::read_truth(std::path::Path::new(&dir)).unwrap();
    let tt: Vec<f64> = std::fs::read_to_string(std::env::var("TT").unwrap())
        .unwrap()
        .lines()
        .map(|l| l.split_whitespace().next().unwrap().parse().unwrap())
        .collect();
    let c = &site.crossing;
    let dirn = c.traffic_direction.sign();
    let step = arg(5).unwrap_or(0.3);
    let track = Track::of_crossing(c, Mesh { rail_step_m: step, sleeper_step_m: 0.25 });
    let pattern = AxlePattern::of_vehicle(&c.vehicle);
    let b0 = BallastParameters {
        p1_n_m2: arg(2).unwrap() * 1e6,
        p2_n_m2: arg(3).unwrap() * 1e6,
        p3: arg(4).unwrap(),
    };
    let dist = b0.distribution(track.sleeper_x_m.len(), track.sensor_sleeper);
    for (name, s) in [("low", GreensSampling::low()), ("wide", GreensSampling::wide())] {
        let g = GreensFunctions::new(&track, &dist, s, Quantity::Acceleration, &Chain::Corrected);
        for i in 0..3 {
            let rec = Recording::new(&site.passages[i], &c.sensor);
            let q = static_wheel_force_n(site.passages[i].axle_load_kg, c.vehicle.gravity_m_s2);
            let v = truth
                .wheels
                .iter()
                .find(|w| w.passage_id == site.passages[i].passage_id)
                .unwrap()
                .true_speed_m_s;
            let n = (rec.duration_s() * s.rate_hz) as usize;
            let y = rec.window(0.0, s.rate_hz, n, s.band_hz);
            let mut m = vec![0.0; n];
            for (w, o) in pattern.offset_m.iter().enumerate() {
                let path = WheelPath { direction: dirn, speed_m_s: v, time_at_origin_s: tt[i] + o / v };
                for (side, name) in [(Side::Crossing, "crossing"), (Side::Stock, "stock")] {
                    let st = constant_force_response(&g, side, &path, n);
                    let k = kernel(&g, side, &path, 4.0, n);
                    let t = truth
                        .wheels
                        .iter()
                        .find(|x| {
                            x.passage_id == site.passages[i].passage_id
                                && x.wheelset == w
                                && format!("{:?}", x.side).to_lowercase() == name
                        })
                        .unwrap();
                    let first = *path.samples_within(4.0, s.rate_hz).start();
                    // low-pass the true force to the sampling's Nyquist: sample on a fine time axis
                    let fs = 8000.0;
                    let nf = 4096usize;
                    let fine: Vec<f64> = (0..nf)
                        .map(|j| {
                            let tau = (j as f64 - 2048.0) / fs;
                            let x = dirn * v * tau;
                            let p =
                                ((x - t.position_m[0]) / 0.01).clamp(0.0, (t.position_m.len() - 1) as f64);
                            let a = (p as usize).min(t.position_m.len() - 2);
                            let f = t.contact_force_n[a] * (1.0 - (p - a as f64))
                                + t.contact_force_n[a + 1] * (p - a as f64);
                            let e = ((4.0 - (v * tau).abs()) / 0.3).clamp(0.0, 1.0);
                            (f - q) * e
                        })
                        .collect();
                    let lp = cpcm::signal::brick_band(&fine, fs, 0.0, s.rate_hz / 2.0 * 0.98);
                    for kk in 0..n {
                        m[kk] += q * st[kk];
                    }
                    for j in 0..k.ncols() {
                        let tau = (first + j as i64) as f64 / s.rate_hz - path.time_at_origin_s;
                        let p = tau * fs + 2048.0;
                        let a = p.floor() as usize;
                        let f = lp[a] * (1.0 - (p - a as f64)) + lp[a + 1] * (p - a as f64);
                        for kk in 0..n {
                            m[kk] += f * k[(kk, j)];
                        }
                    }
                }
            }
            let r: Vec<f64> = y.iter().zip(&m).map(|(a, b)| a - b).collect();
            println!(
                "{name} passage {i}: rms y {:.4} residual {:.4}",
                cpcm::signal::rms(&y),
                cpcm::signal::rms(&r)
            );
            if i == 0 {
                std::fs::write(
                    format!("/tmp/s/fwd_{name}"),
                    (0..n)
                        .map(|k| format!("{} {} {}\n", k as f64 / s.rate_hz, y[k], m[k]))
                        .collect::<String>(),
                )
                .unwrap();
            }
        }
    }
}
