//! Whether intervals with the tolerances of crossing.toml hold: descriptions are drawn within usual tolerances, all entries at once, and the
//! mean force peak that the analysis then finds is compared with the true one:
//!
//!     cargo run --release --example described -- tests/data/field/reference-*

use std::path::Path;

use cpcm::pipeline::{AnalyseOptions, analyse};
use cpcm::progress::Silent;
use cpcm::recording::read_site;
use cpcm::recording::truth::read_truth;
use cpcm::scoring::score;
use cpcm::tolerances::{USUAL, budget, drawn_site, said, tolerances_of};

/// Descriptions of each site.
const DESCRIPTIONS: u64 = 20;
/// Others than those that the tolerances themselves are followed with.
const FIRST_SEED: u64 = 1000;

/// Intervals that hold the true mean.
#[derive(Default)]
struct Held {
    of: usize,
    stated: usize,
    with_tolerances: usize,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    if std::env::args().len() < 2 {
        return Err("name one site directory with truth, or more".into());
    }
    println!("site         drawn  mean force peak, error (stated 90 %; with tolerances)");
    let (mut noticed, mut unnoticed) = (Held::default(), Held::default());
    for arg in std::env::args().skip(1) {
        let dir = Path::new(&arg);
        let (site, truth) = (read_site(dir)?, read_truth(dir)?);
        let known = analyse(&site, &AnalyseOptions::default(), &Silent)?;
        let (tolerances, _) = tolerances_of(Path::new("the usual tolerances"), USUAL, &site.crossing)?;
        let further = budget(&site, &known, (&tolerances, USUAL), &Silent).total().force_peak;
        for seed in 0..DESCRIPTIONS {
            let other = drawn_site(&site, &tolerances, FIRST_SEED + seed);
            let found = analyse(&other, &AnalyseOptions::default(), &Silent)?;
            let [error, half] = score(&found, &truth).mean_peak;
            let wide = half.hypot(further);
            let said = said(&known, &found);
            println!(
                "{:<12} {seed:>5}  {:>+6.2} % (± {:.2}; ± {:.2})  {}",
                dir.file_name().unwrap_or_default().display(),
                100.0 * error,
                100.0 * half,
                100.0 * wide,
                said.as_deref().unwrap_or_default()
            );
            let group = if said.is_some() { &mut noticed } else { &mut unnoticed };
            group.of += 1;
            group.stated += usize::from(error.abs() <= half);
            group.with_tolerances += usize::from(error.abs() <= wide);
        }
    }
    for (what, held) in [("noticed", noticed), ("unnoticed", unnoticed)] {
        println!(
            "{what}: {} descriptions; the stated interval holds the true mean in {}, with tolerances in {}",
            held.of, held.stated, held.with_tolerances
        );
    }
    Ok(())
}
