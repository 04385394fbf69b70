//! Error of the analysis against the known truth, one line per site, with the ballast and the simulated node below it:
//!
//!     cargo run --release --example accuracy -- tests/data/field/reference-*
//!     cargo run --release --example accuracy -- simulated --with-effects diagnosis.json simulated
//!
//! Sites that follow a diagnosis are analysed with its effects.

use std::path::Path;
use std::time::Instant;

use cpcm::analysis::Analysis;
use cpcm::gap::corrected::{Purpose, corrected};
use cpcm::gap::included::{read_effects, taken};
use cpcm::identify::{IdentifiedSite, identify};
use cpcm::node_sim::records;
use cpcm::pipeline::{evaluate, package};
use cpcm::progress::Silent;
use cpcm::recording::read_site;
use cpcm::recording::truth::{Truth, read_truth};
use cpcm::scoring::{Score, score, score_node};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    if std::env::args().len() < 2 {
        return Err("name one site directory with truth, or more".into());
    }
    println!(
        "site                     force peak    waveform   at peak    speed  displacement  irregularity       in interval   mean peak (90 %)   time"
    );
    println!(
        "                         median  90 %    median    median   median        median          mean  peak  curve   scan"
    );
    let mut effects = Vec::new();
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        if arg == "--with-effects" {
            let (diagnosed, _) =
                read_effects(Path::new(&args.next().ok_or("--with-effects wants a diagnosis.json")?))?;
            effects = taken(&diagnosed, &[])?;
            continue;
        }
        let dir = Path::new(&arg);
        let site = read_site(dir)?;
        let clock = Instant::now();
        let site = corrected(&site, &effects, Purpose::Analysis, &Silent)?;
        let identified = identify(&site, &Silent)?;
        let analysis = evaluate(&identified, &Silent)?;
        let seconds = clock.elapsed().as_secs_f64();
        let truth = read_truth(dir)?;
        let s = score(&analysis, &truth);
        let percent = |values: &[f64]| 100.0 * Score::median(values);
        println!(
            "{:<23} {:>5.2} % {:>5.2} % {:>5.2} % {:>6.1} mm {:>6.3} %      {:>5.2} %       {:>5.2} % {:>3.0} %  {:>3.0} %  {:>3.0} %  {:>+5.2} % (± {:.2}) {:>4.1} s",
            dir.file_name().unwrap_or_default().display(),
            percent(&s.peak),
            100.0 * Score::p90(&s.peak),
            percent(&s.waveform),
            1e3 * Score::median(&s.peak_position_m),
            percent(&s.speed),
            percent(&s.displacement),
            100.0 * s.irregularity,
            100.0 * s.peak_coverage,
            100.0 * s.waveform_coverage,
            100.0 * s.irregularity_coverage,
            100.0 * s.mean_peak[0],
            100.0 * s.mean_peak[1],
            seconds,
        );
        if let Some([p1, p2, p3]) = s.ballast_truth {
            let b = &analysis.ballast;
            println!(
                "  ballast p1 {:.1} ({:.1}), p2 {:.1} ({:.1}) MN/m², p3 {:.2} ({:.2}); in brackets the truth",
                1e-6 * b.p1_n_m2.value,
                1e-6 * p1,
                1e-6 * b.p2_n_m2.value,
                1e-6 * p2,
                b.p3.value,
                p3
            );
        }
        // A kernel may refuse effects that the analysis takes off.
        if effects.is_empty() {
            print_node(&identified, &analysis, &truth)?;
        }
    }
    Ok(())
}

/// The simulated node on the same recordings.
fn print_node(
    identified: &IdentifiedSite,
    analysis: &Analysis,
    truth: &Truth,
) -> Result<(), Box<dyn std::error::Error>> {
    let package = package(identified, &Silent)?;
    let records = records(identified.site, &package.bytes, &Silent)?;
    if records.len() != analysis.passages.len() {
        println!("  node: {} records of {} passages", records.len(), analysis.passages.len());
        return Ok(());
    }
    let s = score_node(&records, analysis, truth);
    let apart: Vec<f64> = s.against_host.iter().map(|d| d.abs()).collect();
    println!(
        "  node {:.2} / {:.2} %, from the host {:.2} / {:.2} % (mean {:+.2} %); in interval {:.0} %, without forces {} of {} wheels, trains in which it clips {}",
        100.0 * Score::median(&s.peak),
        100.0 * Score::p90(&s.peak),
        100.0 * Score::median(&apart),
        100.0 * Score::p90(&apart),
        100.0 * s.against_host.iter().sum::<f64>() / apart.len().max(1) as f64,
        100.0 * s.coverage,
        s.missing,
        s.missing + s.peak.len(),
        package.beyond_m_s2.len(),
    );
    Ok(())
}
