//! How far the results of a site follow an error in crossing.toml, one line per entry and change, and whether the analysis says so:
//!
//!     cargo run --release --example described -- tests/data/field/reference-1
//!
//! Changes are what drawings, tape measures and data sheets may be wrong by; results follow about in proportion.

use std::path::Path;

use cpcm::analysis::Analysis;
use cpcm::limits::{MODEL_GAP, UNLIKE_MODEL};
use cpcm::pipeline::{AnalyseOptions, analyse};
use cpcm::progress::Silent;
use cpcm::recording::{Site, read_site};
use cpcm::signal::mean;

/// An entry, how it is changed, and by what.
struct Change {
    entry: &'static str,
    by: By,
    place: fn(&mut Site) -> &mut f64,
}

enum By {
    /// Metres, either way.
    Metres(f64),
    /// A factor, and its inverse.
    Factor(f64),
}

impl By {
    fn changed(&self, value: f64, up: bool) -> f64 {
        match self {
            Self::Metres(m) => value + if up { *m } else { -m },
            Self::Factor(f) => value * if up { *f } else { 1.0 / f },
        }
    }

    fn told(&self, up: bool) -> String {
        match self {
            Self::Metres(m) => format!("{}{:.0} mm", if up { '+' } else { '−' }, 1e3 * m),
            Self::Factor(f) => format!("× {:.2}", if up { *f } else { 1.0 / f }),
        }
    }
}

fn changes() -> Vec<Change> {
    let metres = |entry, m, place| Change { entry, by: By::Metres(m), place };
    let factor = |entry, f, place| Change { entry, by: By::Factor(f), place };
    vec![
        factor("ballast.damping_ns_m2", 1.4, |s| &mut s.crossing.ballast.damping_ns_m2),
        factor("rail.crossing_part_stiffness_factor", 1.25, |s| {
            &mut s.crossing.rail.crossing_part_stiffness_factor
        }),
        factor("rail.crossing_part_mass_factor", 1.25, |s| &mut s.crossing.rail.crossing_part_mass_factor),
        metres("rail.crossing_part_x0_m", 0.3, |s| &mut s.crossing.rail.crossing_part_x0_m),
        metres("rail.crossing_part_x1_m", 0.3, |s| &mut s.crossing.rail.crossing_part_x1_m),
        factor("rail.second_moment_m4", 1.05, |s| &mut s.crossing.rail.second_moment_m4),
        factor("rail.mass_per_metre_kg", 1.05, |s| &mut s.crossing.rail.mass_per_metre_kg),
        factor("pad.stiffness_n_m", 1.25, |s| &mut s.crossing.pad.stiffness_n_m),
        factor("pad.damping_ns_m", 1.25, |s| &mut s.crossing.pad.damping_ns_m),
        factor("sleeper.youngs_modulus_pa", 1.25, |s| &mut s.crossing.sleeper.youngs_modulus_pa),
        factor("sleeper.density_kg_m3", 1.05, |s| &mut s.crossing.sleeper.density_kg_m3),
        metres("sleeper.length_m", 0.05, |s| &mut s.crossing.sleeper.length_m),
        metres("sleeper.seat_crossing_y_m", 0.03, |s| &mut s.crossing.sleeper.seat_crossing_y_m),
        metres("sleeper.seat_stock_y_m", 0.03, |s| &mut s.crossing.sleeper.seat_stock_y_m),
        metres("sensor.y_m", 0.05, |s| &mut s.crossing.sensor.y_m),
        factor("track.sleeper_spacing_m", 1.02, |s| &mut s.crossing.track.sleeper_spacing_m),
        metres("track.crossing_sleeper_x_m", 0.05, |s| &mut s.crossing.track.crossing_sleeper_x_m),
        factor("vehicle.wheelset_mass_kg", 1.1, |s| &mut s.crossing.vehicle.wheelset_mass_kg),
        metres("vehicle.axle_spacing_m", 0.02, |s| &mut s.crossing.vehicle.axle_spacing_m),
        metres("vehicle.bogie_centres_m", 0.05, |s| &mut s.crossing.vehicle.bogie_centres_m),
    ]
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    if std::env::args().len() < 2 {
        return Err("name one site directory, or more".into());
    }
    for arg in std::env::args().skip(1) {
        let site = read_site(Path::new(&arg))?;
        let known = analyse(&site, &AnalyseOptions::default(), &Silent)?;
        println!("{arg}: change of the results, %");
        println!(
            "entry                               change     force peak  irregularity     p1     p2  said"
        );
        for change in changes() {
            for up in [false, true] {
                let mut other = site.clone();
                let value = (change.place)(&mut other);
                *value = change.by.changed(*value, up);
                let line = match analyse(&other, &AnalyseOptions::default(), &Silent) {
                    Ok(found) => compared(&known, &found),
                    Err(error) => format!("refused: {error}"),
                };
                println!("{:<36}{:<10} {line}", change.entry, change.by.told(up));
            }
        }
    }
    Ok(())
}

fn compared(known: &Analysis, found: &Analysis) -> String {
    let percent = |ratio: f64| 100.0 * (ratio - 1.0);
    let peaks = |a: &Analysis| -> Vec<f64> {
        a.passages.iter().flat_map(|p| p.wheelsets.iter().map(|w| w.peak_force_n.value)).collect()
    };
    let ratios: Vec<f64> = peaks(found).iter().zip(peaks(known)).map(|(a, b)| a / b).collect();
    let rms = |a: &Analysis| a.indicators.irregularity_rms_m.mean;
    let (b, k) = (&found.ballast, &known.ballast);
    format!(
        "{:>+8.1} {:>+13.1} {:>+6.1} {:>+6.1}  {}",
        percent(mean(&ratios)),
        percent(rms(found) / rms(known)),
        percent(b.p1_n_m2.value / k.p1_n_m2.value),
        percent(b.p2_n_m2.value / k.p2_n_m2.value),
        said(found)
    )
}

/// What the analysis says of it.
fn said(found: &Analysis) -> String {
    if let Some(other) = &found.misdescription {
        return other.to_string();
    }
    let damping = &found.ballast.damping;
    if damping.contradicts_description() {
        return format!("damping {:.0} kNs/m²", 1e-3 * damping.used_ns_m2);
    }
    let flagged = |flag: &str| found.passages.iter().filter(|p| p.has_flag(flag)).count();
    match [UNLIKE_MODEL, MODEL_GAP].into_iter().find(|flag| flagged(flag) > 0) {
        Some(flag) => format!("{flag} ({} of {} passages)", flagged(flag), found.passages.len()),
        None => "nothing".into(),
    }
}
