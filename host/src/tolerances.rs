//! How far the results of a site follow what crossing.toml may be wrong by: each entry is changed by its tolerance, either way, and the
//! site analysed anew. What the analysis would notice is not so: it has not noticed it of the site as described.

mod file;

pub use file::{ToleranceError, USUAL, tolerances_of};

use crate::analysis::{Analysis, Budget, Change, Consequence, Outcome, Tolerance};
use crate::limits::{MODEL_GAP, UNLIKE_MODEL};
use crate::pipeline::{AnalyseOptions, analyse};
use crate::progress::{Progress, Silent};
use crate::recording::{Crossing, RecordingError, Site};

/// The entry that recordings state themselves, each for its train: all of them are changed with it.
const AXLE_LOAD: &str = "vehicle.axle_load_kg";

/// What follows of tolerances for a site that was analysed as described: two analyses for each, and more where errors are noticed. `stated`:
/// the text of their file.
pub fn budget(
    site: &Site,
    known: &Analysis,
    (tolerances, stated): (&[Tolerance], &str),
    progress: &dyn Progress,
) -> Result<Budget, ToleranceError> {
    tolerances.iter().try_for_each(|t| check(&site.crossing, t))?;
    progress.begin("tolerances of crossing.toml", 2 * tolerances.len() as u64);
    let consequence = |tolerance: &Tolerance| {
        let [smaller, larger] = [-tolerance.plus_minus, tolerance.plus_minus].map(|by| {
            let outcome = outcome(site, known, tolerance, by);
            progress.step();
            outcome
        });
        Consequence { tolerance: tolerance.clone(), smaller, larger }
    };
    Ok(Budget::new(tolerances.iter().map(consequence).collect(), stated))
}

/// Refuses a tolerance that is impossible either way; one way a sensor may be beyond the end of the sleeper.
fn check(crossing: &Crossing, tolerance: &Tolerance) -> Result<(), ToleranceError> {
    let Tolerance { entry, value, plus_minus } = tolerance;
    match [-plus_minus, *plus_minus].map(|by| crossing.with_number(entry, value + by)) {
        [Err(source), Err(_)] => Err(ToleranceError::Impossible {
            entry: entry.clone(),
            value: *value,
            plus_minus: *plus_minus,
            source,
        }),
        _ => Ok(()),
    }
}

/// Halvings of a tolerance whose error is noticed, at most.
const HALVINGS: usize = 3;

fn outcome(site: &Site, known: &Analysis, tolerance: &Tolerance, by: f64) -> Outcome {
    let attempt = |by: f64| unnoticed(site, known, &tolerance.entry, tolerance.value + by);
    let noticed = match attempt(by) {
        Ok(change) => return Outcome { by, change: Some(change), noticed: None },
        Err(noticed) => Some(noticed),
    };
    let halves = (1..=HALVINGS).map(|n| by * 0.5f64.powi(n as i32));
    let less = halves.map(|by| (by, attempt(by))).find_map(|(by, change)| Some((by, change.ok()?)));
    match less {
        Some((by, change)) => Outcome { by, change: Some(change), noticed },
        None => Outcome { by: 0.0, change: None, noticed },
    }
}

/// How far the results follow an entry, or what the analysis says of it.
fn unnoticed(site: &Site, known: &Analysis, entry: &str, value: f64) -> Result<Change, String> {
    let other = described(site, entry, value).map_err(|e| e.to_string())?;
    let found = analyse(&other, &AnalyseOptions::default(), &Silent).map_err(|e| e.to_string())?;
    match said(known, &found) {
        Some(noticed) => Err(noticed),
        None => change(known, &found).ok_or_else(|| "the results are no numbers".into()),
    }
}

/// A site with another number in its description; refused where no crossing panel can have it.
pub fn described(site: &Site, entry: &str, value: f64) -> Result<Site, RecordingError> {
    let crossing = site.crossing.with_number(entry, value)?;
    let mut other = Site { crossing, ..site.clone() };
    if entry == AXLE_LOAD {
        let factor = value / site.crossing.vehicle.axle_load_kg;
        other.passages.iter_mut().for_each(|p| p.axle_load_kg *= factor);
    }
    Ok(other)
}

/// None where it is no number.
fn change(known: &Analysis, found: &Analysis) -> Option<Change> {
    let ratio = |of: fn(&Analysis) -> f64| of(found) / of(known) - 1.0;
    let change = Change {
        force_peak: ratio(|a| a.indicators.peak_force_n.mean),
        irregularity_rms: ratio(|a| a.indicators.irregularity_rms_m.mean),
        p1: ratio(|a| a.ballast.p1_n_m2.value),
        p2: ratio(|a| a.ballast.p2_n_m2.value),
    };
    change.is_finite().then_some(change)
}

/// What the analysis with another description says that it does not say of the site as described.
pub fn said(known: &Analysis, found: &Analysis) -> Option<String> {
    let now = remark(found);
    now.filter(|_| remark(known).is_none())
}

fn remark(analysis: &Analysis) -> Option<String> {
    if let Some(other) = &analysis.misdescription {
        return Some(other.to_string());
    }
    let damping = &analysis.ballast.damping;
    if damping.contradicts_description() {
        return Some(format!("damping {:.0} kNs/m² instead", 1e-3 * damping.used_ns_m2));
    }
    let flagged = |flag: &str| analysis.passages.iter().filter(|p| p.has_flag(flag)).count();
    let flag = [UNLIKE_MODEL, MODEL_GAP].into_iter().find(|flag| flagged(flag) > 0)?;
    Some(format!("{flag} ({} of {} passages)", flagged(flag), analysis.passages.len()))
}
