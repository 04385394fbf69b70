//! How far the results of a site follow what crossing.toml may be wrong by. Each entry is changed by its tolerance, either way, and the site
//! analysed anew, which tells what is worth measuring; all are changed at once, at random, which tells how wrong the results may be. What the
//! analysis would notice is not so: it has not noticed it of the site as described.

mod file;

pub use file::{ToleranceError, USUAL, of_nothing, tolerances_of};

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::analysis::{Analysis, Budget, Change, Consequence, Drawn, Outcome, Tolerance};
use crate::limits::{MODEL_GAP, UNLIKE_MODEL};
use crate::pipeline::{AnalyseOptions, analyse};
use crate::progress::{Progress, Silent};
use crate::recording::{RecordingError, Site};
use crate::signal::HALF_WIDTH_90;

/// Entries that recordings state themselves, each for its train: all of them are changed with these.
const AXLE_LOAD: &str = "vehicle.axle_load_kg";
const SAMPLE_RATE: &str = "sensor.sample_rate_hz";

/// Descriptions that are drawn: half of them may be noticed.
const DRAWS: u64 = 32;

/// What follows of tolerances for a site that was analysed as described: two analyses for each, more where errors are noticed, and one for each
/// of some descriptions that are wrong by all at once. `stated`: the text of their file.
pub fn budget(
    site: &Site,
    known: &Analysis,
    (tolerances, stated): (&[Tolerance], &str),
    progress: &dyn Progress,
) -> Budget {
    progress.begin("tolerances, one by one", 2 * tolerances.len() as u64);
    let consequence = |tolerance: &Tolerance| {
        let [smaller, larger] = [-tolerance.plus_minus, tolerance.plus_minus].map(|by| {
            let outcome = outcome(site, known, tolerance, by);
            progress.step();
            outcome
        });
        Consequence { tolerance: tolerance.clone(), smaller, larger }
    };
    let consequences = tolerances.iter().map(consequence).collect();
    let drawn = (tolerances.len() > 1).then(|| drawn(site, known, tolerances, progress));
    Budget::new(consequences, drawn, stated)
}

/// The same descriptions every time.
fn drawn(site: &Site, known: &Analysis, tolerances: &[Tolerance], progress: &dyn Progress) -> Drawn {
    progress.begin("tolerances, all at once", DRAWS);
    let mut drawn = Drawn { count: DRAWS as usize, unnoticed: Vec::new(), noticed: Vec::new() };
    for seed in 0..DRAWS {
        let Attempt { change, noticed } = attempt(&drawn_site(site, tolerances, seed), known);
        match noticed {
            None => drawn.unnoticed.extend(change),
            Some(_) => drawn.noticed.extend(change),
        }
        progress.step();
    }
    drawn
}

/// A site whose description is wrong by all tolerances, each at random; an entry that no panel can have stays as it is.
pub fn drawn_site(site: &Site, tolerances: &[Tolerance], seed: u64) -> Site {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut other = site.clone();
    for t in tolerances {
        let draw: f64 = StandardNormal.sample(&mut random);
        let _ = describe(&mut other, &t.entry, t.value + t.plus_minus / HALF_WIDTH_90 * draw);
    }
    other
}

/// Halvings of a tolerance whose error is noticed, at most.
const HALVINGS: usize = 3;

fn outcome(site: &Site, known: &Analysis, tolerance: &Tolerance, by: f64) -> Outcome {
    largest_unnoticed(by, |by| {
        let mut other = site.clone();
        describe(&mut other, &tolerance.entry, tolerance.value + by).map_err(|e| e.to_string())?;
        match attempt(&other, known) {
            Attempt { noticed: Some(words), .. } => Err(words),
            Attempt { change, .. } => change.ok_or_else(|| "the results are no numbers".into()),
        }
    })
}

/// `change_by`: how far the results follow an error, or what is said of it.
fn largest_unnoticed(by: f64, change_by: impl Fn(f64) -> Result<Change, String>) -> Outcome {
    let noticed = match change_by(by) {
        Ok(change) => return Outcome { by, change: Some(change), noticed: None },
        Err(words) => Some(words),
    };
    let mut halves = (1..=HALVINGS).map(|n| by * 0.5f64.powi(n as i32));
    match halves.find_map(|by| Some((by, change_by(by).ok()?))) {
        Some((by, change)) => Outcome { by, change: Some(change), noticed },
        None => Outcome { by: 0.0, change: None, noticed },
    }
}

/// The analysis of a site with another description.
struct Attempt {
    /// None where results are no numbers, or mean nothing.
    change: Option<Change>,
    /// What it says that it does not say of the site as described.
    noticed: Option<String>,
}

fn attempt(other: &Site, known: &Analysis) -> Attempt {
    match analyse(other, &AnalyseOptions::default(), &Silent) {
        Ok(found) => Attempt { change: change(known, &found), noticed: said(known, &found) },
        Err(error) => Attempt { change: None, noticed: Some(error.to_string()) },
    }
}

/// Puts another number into the description of a site; refused where no crossing panel can have it, and the site stays as it is.
fn describe(site: &mut Site, entry: &str, value: f64) -> Result<(), RecordingError> {
    let crossing = site.crossing.with_number(entry, value)?;
    let before = &site.crossing;
    let [load, rate] = match entry {
        AXLE_LOAD => [value / before.vehicle.axle_load_kg, 1.0],
        SAMPLE_RATE => [1.0, value / before.sensor.sample_rate_hz],
        _ => [1.0, 1.0],
    };
    for p in &mut site.passages {
        p.axle_load_kg *= load;
        p.sample_rate_hz *= rate;
    }
    site.crossing = crossing;
    Ok(())
}

fn change(known: &Analysis, found: &Analysis) -> Option<Change> {
    if !found.means_something() {
        return None;
    }
    let ratio = |of: fn(&Analysis) -> f64| of(found) / of(known) - 1.0;
    let change = Change {
        force_peak: ratio(|a| a.indicators.peak_force_n.mean),
        irregularity_rms: ratio(|a| a.indicators.irregularity_rms_m.mean),
        p1: ratio(|a| a.ballast.p1_n_m2.value),
        p2: ratio(|a| a.ballast.p2_n_m2.value),
    };
    change.is_finite().then_some(change)
}

/// What the analysis with another description says that it does not say of the site as described, of which it may say something itself.
pub fn said(known: &Analysis, found: &Analysis) -> Option<String> {
    if let Some(other) = &found.misdescription {
        return Some(other.to_string());
    }
    let [damping, before] = [found, known].map(|a| &a.ballast.damping);
    if damping.contradicts_description() && !before.contradicts_description() {
        return Some(format!("damping {:.0} kNs/m² instead", 1e-3 * damping.used_ns_m2));
    }
    let flagged = |a: &Analysis, flag: &str| a.passages.iter().filter(|p| p.has_flag(flag)).count();
    let flag = [UNLIKE_MODEL, MODEL_GAP].into_iter().find(|f| flagged(found, f) > flagged(known, f))?;
    Some(format!("{flag} ({} of {} passages)", flagged(found, flag), found.passages.len()))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::recording::read_site;
    use crate::signal::{mean, rms};

    #[test]
    fn analytic_what_would_be_noticed_is_halved() {
        let noticed_from = |least: f64| {
            move |by: f64| match by.abs() < least {
                true => Ok(Change { force_peak: 0.1 * by, ..Change::default() }),
                false => Err(format!("noticed {by}")),
            }
        };
        let counted = |by: f64, least: f64| {
            let outcome = largest_unnoticed(by, noticed_from(least));
            (outcome.by, outcome.change.map(|c| c.force_peak), outcome.noticed)
        };
        assert_eq!(counted(-4.0, 5.0), (-4.0, Some(-0.4), None));
        assert_eq!(counted(-4.0, 1.5), (-1.0, Some(-0.1), Some("noticed -4".into())));
        assert_eq!(counted(4.0, 0.1), (0.0, None, Some("noticed 4".into())));
    }

    /// A clock that may be wrong changed nothing.
    #[test]
    fn regress_what_recordings_state_themselves_is_changed_with_its_entry() {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field/reference-1");
        let mut site = read_site(&dir).unwrap();
        let load_kg = site.passages[3].axle_load_kg;
        describe(&mut site, SAMPLE_RATE, 4004.0).unwrap();
        assert!(site.passages.iter().all(|p| (p.sample_rate_hz - 4004.0).abs() < 1e-9));
        assert_eq!((site.crossing.sensor.sample_rate_hz, site.passages[3].axle_load_kg), (4004.0, load_kg));
    }

    /// Nine tenths of a normal distribution lie within its tolerance; loads are all wrong by the same part.
    #[test]
    fn property_descriptions_are_drawn_within_their_tolerances() {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field/reference-1");
        let mut site = read_site(&dir).unwrap();
        site.passages.truncate(2);
        let stated = "[sensor]\ny_m = 0.05\n[vehicle]\naxle_load_kg = \"2 %\"";
        let (tolerances, _) = tolerances_of(Path::new("stated"), stated, &site.crossing).unwrap();
        let draws: Vec<Site> = (0..400).map(|seed| drawn_site(&site, &tolerances, seed)).collect();
        let off: Vec<f64> = draws.iter().map(|s| s.crossing.sensor.y_m - site.crossing.sensor.y_m).collect();
        let inside = off.iter().filter(|d| d.abs() < 0.05).count();
        assert!((340..=380).contains(&inside) && mean(&off).abs() < 0.1 * rms(&off), "{inside}");
        for drawn in &draws {
            let part = drawn.crossing.vehicle.axle_load_kg / site.crossing.vehicle.axle_load_kg;
            for (a, b) in drawn.passages.iter().zip(&site.passages) {
                assert!((a.axle_load_kg / b.axle_load_kg / part - 1.0).abs() < 1e-12);
            }
        }
        assert_eq!(drawn_site(&site, &tolerances, 7).crossing, draws[7].crossing);
    }
}
