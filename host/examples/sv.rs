use cpcm::scoring::{Score, score};
struct P;
impl cpcm::progress::Progress for P {
    fn begin(&self, s: &str, _: u64) {
        eprintln!(
            "{:?} {s}",
            std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_millis() % 1000000
        );
    }
    fn step(&self) {}
}
fn main() {
    for dir in std::env::args().skip(1) {
        let d = std::path::Path::new(&dir);
        let site = cpcm::recording::read_site(d).unwrap();
        let t = std::time::Instant::now();
        let id = cpcm::identify::identify(&site, &P).unwrap();
        let el = t.elapsed();
        let a = cpcm::pipeline::evaluate(&id, &P).unwrap();
        let truth = cpcm::recording::truth::read_truth(d).unwrap();
        let s = score(&a, &truth);
        let m = |v: &[f64]| 100.0 * Score::median(v);
        let p = |v: &[f64]| 100.0 * Score::p90(v);
        println!(
            "{dir} peak {:.2}/{:.2} bias {:+.2} wave {:.2}/{:.2} pos {:.1} mm speed {:.4} disp {:.2}/{:.2} cover peak {:.2} wave {:.2} | p1 {:.2} [{:.2} {:.2}] p2 {:.2} [{:.2} {:.2}] p3 {:.2} [{:.2} {:.2}] truth {:?} | {:?} {:?} own {:?} noise {}",
            m(&s.peak),
            p(&s.peak),
            m(&s.peak_signed),
            m(&s.waveform),
            p(&s.waveform),
            1e3 * Score::median(&s.peak_position_m),
            m(&s.speed),
            m(&s.displacement),
            p(&s.displacement),
            s.peak_coverage,
            s.waveform_coverage,
            a.ballast.p1_n_m2.value / 1e6,
            a.ballast.p1_n_m2.lower / 1e6,
            a.ballast.p1_n_m2.upper / 1e6,
            a.ballast.p2_n_m2.value / 1e6,
            a.ballast.p2_n_m2.lower / 1e6,
            a.ballast.p2_n_m2.upper / 1e6,
            a.ballast.p3.value,
            a.ballast.p3.lower,
            a.ballast.p3.upper,
            s.ballast_truth,
            el,
            t.elapsed(),
            id.prior,
            0
        );
        // irregularity vs scan
        if let Some(scan) = &a.scan {
            let g = &a.indicators.position_m;
            let sp = cpcm::signal::CubicSpline::new(&scan.position_m, &scan.irregularity_m).unwrap();
            let inside: Vec<usize> = (0..g.len())
                .filter(|i| g[*i] >= scan.position_m[0] && g[*i] <= *scan.position_m.last().unwrap())
                .collect();
            let z: Vec<f64> = inside.iter().map(|i| sp.at(g[*i])).collect();
            let all: Vec<&Vec<f64>> =
                a.passages.iter().flat_map(|p| p.wheelsets.iter().map(|w| &w.irregularity_m)).collect();
            let mean: Vec<f64> =
                inside.iter().map(|i| all.iter().map(|w| w[*i]).sum::<f64>() / all.len() as f64).collect();
            let pp = z.iter().cloned().fold(f64::MIN, f64::max) - z.iter().cloned().fold(f64::MAX, f64::min);
            let e: Vec<f64> = z.iter().zip(&mean).map(|(a, b)| a - b).collect();
            println!(
                "   irregularity mean vs scan NRMSE {:.2} % of pp {:.3} mm",
                100.0 * cpcm::signal::rms(&e) / pp,
                pp * 1e3
            );
        }
    }
}
