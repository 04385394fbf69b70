//! What `verify` checks: numbers and curves of the model against closed forms, other programs and the paper.

mod closed;
mod convergence;
mod identities;
mod moving;
mod p2;
pub(crate) mod passages;
mod receptance;
pub mod reference;
mod site;
pub(crate) mod tolerance;

pub use site::{Baseline, PeakLimits, SiteAnalyses, SiteMethods, site_analyses, site_methods};

use crate::gap::GapError;
use crate::greens::GreensError;
use crate::inverse::displacement::DisplacementError;
use crate::passage::SimulationError;
use crate::pipeline::PipelineError;
use crate::progress::Progress;
use crate::recording::truth::Truth;
use crate::recording::{RecordingError, Site};
use crate::track::TrackError;

/// All checks in the order of the method.
#[derive(Clone, Debug, Default)]
pub struct Verification {
    /// One per line of the table of checks.
    pub cases: Vec<Case>,
    /// Studies and comparisons that need more than one number per line.
    pub tables: Vec<Table>,
}

/// One check.
#[derive(Clone, Debug)]
pub struct Case {
    /// What is compared, e.g. `static deflection of a beam on elastic foundation`.
    pub name: String,
    /// Where the expected value comes from: closed form with its source, program with its version, paper with its
    /// equation.
    pub source: String,
    /// Unit of both values.
    pub unit: &'static str,
    /// Expected value.
    pub expected: f64,
    /// Value of this program.
    pub found: f64,
    /// Largest relative difference allowed; how far beyond it for an upper bound.
    pub tolerance: f64,
    /// Whether the expected value is an upper bound: less is no error.
    pub at_most: bool,
    /// The curves behind the two values, where there are any.
    pub curves: Option<Curves>,
}

/// Expected and found curve on the same abscissa.
#[derive(Clone, Debug)]
pub struct Curves {
    /// Caption with unit.
    pub x_caption: &'static str,
    /// Caption with unit.
    pub y_caption: &'static str,
    /// Abscissa, ascending.
    pub x: Vec<f64>,
    /// Expected.
    pub expected: Vec<f64>,
    /// Found.
    pub found: Vec<f64>,
}

/// A study: text cells, the first column is what the line is about.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Heading.
    pub title: String,
    /// What the numbers are and what follows from them.
    pub note: String,
    /// Captions.
    pub columns: Vec<String>,
    /// Lines, each with as many cells as there are columns.
    pub rows: Vec<Vec<String>>,
}

/// Why the checks cannot be run.
#[derive(Debug, thiserror::Error)]
pub enum VerifyError {
    /// Nothing to compare with.
    #[error("truth.parquet holds no wheelset of the passages of this site; is it of another site?")]
    NoTruth,
    /// A shipped curve does not read.
    #[error("reference curve {file} is damaged in line {line}")]
    Reference {
        /// File in `tests/data/reference`.
        file: &'static str,
        /// Line, counted from 1; 0 for the whole file.
        line: usize,
    },
    /// A shipped table of passages does not read.
    #[error("reference passages {file} are damaged: {reason}")]
    Passages {
        /// File in `tests/data/reference`.
        file: &'static str,
        /// What the reader says.
        reason: String,
    },
    /// A computation gave nothing to compare.
    #[error("the {0} is empty")]
    Empty(&'static str),
    /// Force from displacement.
    #[error(transparent)]
    Displacement(#[from] DisplacementError),
    /// Wheel over a dip.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
    /// Track of a reference case or a site.
    #[error(transparent)]
    Track(#[from] TrackError),
    /// Green's functions of a reference case or a site.
    #[error(transparent)]
    Greens(#[from] GreensError),
    /// Site or truth.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// Analysis of a site.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// Simulation of a site.
    #[error(transparent)]
    Gap(#[from] GapError),
}

impl Case {
    /// A check whose values follow.
    fn new(name: &str, source: &str, unit: &'static str) -> Self {
        Self {
            name: name.into(),
            source: source.into(),
            unit,
            expected: f64::NAN,
            found: f64::NAN,
            tolerance: 0.0,
            at_most: false,
            curves: None,
        }
    }

    fn values(self, expected: f64, found: f64, tolerance: f64) -> Self {
        Self { expected, found, tolerance, ..self }
    }

    /// The expected value is an upper bound.
    fn bounded(self) -> Self {
        Self { at_most: true, ..self }
    }

    /// The pair of values with the largest relative difference.
    fn worst(self, expected: &[f64], found: &[f64], tolerance: f64) -> Self {
        let error = |i: usize| (found[i] / expected[i] - 1.0).abs();
        let worst = (0..expected.len().min(found.len())).max_by(|a, b| error(*a).total_cmp(&error(*b)));
        match worst {
            Some(i) => self.values(expected[i], found[i], tolerance),
            None => self,
        }
    }

    fn with(self, curves: Curves) -> Self {
        Self { curves: Some(curves), ..self }
    }

    /// Difference relative to the expected value; absolute where zero is expected; zero below an upper bound.
    pub fn error(&self) -> f64 {
        let difference = self.found - self.expected;
        if self.at_most && difference <= 0.0 {
            return 0.0;
        }
        if self.expected == 0.0 { difference.abs() } else { (difference / self.expected).abs() }
    }

    /// Whether the difference is allowed; NaN never is.
    pub fn passed(&self) -> bool {
        self.error() <= self.tolerance
    }
}

impl Table {
    pub(crate) fn new(title: &str, note: &str, columns: &[&str]) -> Self {
        let columns = columns.iter().map(|c| c.to_string()).collect();
        Self { title: title.into(), note: note.into(), columns, rows: Vec::new() }
    }

    pub(crate) fn row(&mut self, cells: &[String]) {
        self.rows.push(cells.to_vec());
    }
}

impl Verification {
    /// Number of checks that failed.
    pub fn failures(&self) -> usize {
        self.cases.iter().filter(|c| !c.passed()).count()
    }

    fn add(&mut self, (cases, table): (Vec<Case>, Table)) {
        self.cases.extend(cases);
        self.tables.push(table);
    }
}

/// The largest of some values; NaN where one is NaN, which `f64::max` would drop and a check would pass, and of nothing at all.
fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    let larger = |a: f64, b: f64| if a.is_nan() || a > b { a } else { b };
    values.into_iter().reduce(larger).unwrap_or(f64::NAN)
}

/// Scores the analysis and two chains of methods on a site with truth, and adds the table; with it the numpy baseline,
/// where there is one. A second table says what noise and spread allow.
pub fn add_site(
    out: &mut Verification,
    site: &Site,
    truth: &Truth,
    baseline: Option<&Baseline>,
    progress: &dyn Progress,
) -> Result<(), VerifyError> {
    let found = site_methods(site, truth, progress)?;
    out.tables.extend([found.table(baseline), found.limits.table(&found.site)]);
    Ok(())
}

/// Runs all checks that need no recordings.
pub fn run(progress: &dyn Progress) -> Result<Verification, VerifyError> {
    let mut out = Verification::default();
    progress.begin("closed forms", 3);
    out.cases.extend(closed::winkler());
    out.cases.extend(closed::two_layer());
    progress.step();
    out.add(closed::pinned_pinned());
    progress.step();
    out.cases.extend([closed::moving_on_simple_beam(), closed::oscillator()]);
    out.cases.extend(identities::all());
    progress.step();
    progress.begin("reference curves", 3);
    out.cases.extend(receptance::t1()?);
    progress.step();
    out.cases.extend(receptance::panel()?);
    progress.step();
    out.cases.extend(moving::t1()?);
    progress.step();
    progress.begin("convergence", 4);
    for study in [convergence::mesh, convergence::sampling, convergence::length, convergence::interpolation] {
        out.add(study());
        progress.step();
    }
    progress.begin("wheel over a dipped joint", 1);
    out.add(p2::all()?);
    progress.step();
    let (cases, tables) = passages::all(progress)?;
    out.cases.extend(cases);
    out.tables.extend(tables);
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_relative_error_and_verdict() {
        let case = |expected, found| Case::new("", "", "m").values(expected, found, 0.01);
        assert!(case(-2.0, -2.01).passed());
        assert!(!case(2.0, 2.1).passed());
        assert!(!case(2.0, f64::NAN).passed());
        assert!(case(0.0, 0.005).passed());
        let bound = |found| Case::new("", "", "N").values(100.0, found, 0.01).bounded();
        assert!(bound(20.0).passed() && bound(100.5).passed() && !bound(102.0).passed());
        assert!(!bound(f64::NAN).passed());
        let worst = Case::new("", "", "m").worst(&[1.0, 2.0], &[1.001, 2.5], 0.01);
        assert_eq!((worst.expected, worst.found), (2.0, 2.5));
        assert!(!Case::new("", "", "m").worst(&[], &[], 0.01).passed(), "nothing compared is no pass");
    }

    #[test]
    fn property_the_largest_is_nan_where_a_value_is_or_none_is_there() {
        assert_eq!(largest([1.0, 3.0, -4.0]), 3.0);
        for spoilt in [[f64::NAN, 1.0], [1.0, f64::NAN], [1.0, -f64::NAN]] {
            assert!(largest(spoilt).is_nan(), "{spoilt:?}");
        }
        assert!(largest([0.0; 0]).is_nan());
    }
}
