//! Methods side by side on recordings with known truth: the analysis of this program, the paper's chain, and a chain
//! in between.

mod baseline;
mod chain;
mod known_geometry;
mod limits;

pub use self::baseline::Baseline;
use self::chain::{Chains, DisplacementChain};
pub use self::limits::PeakLimits;
use super::{Table, VerifyError};
use crate::analysis::{Analysis, Interval};
use crate::ballast::BallastParameters;
use crate::identify::{IdentifiedSite, identify};
use crate::pipeline::{PipelineError, evaluate};
use crate::progress::Progress;
use crate::recording::Site;
use crate::recording::truth::{Side, Truth, WheelTruth};
use crate::scoring::{Score, score};
use crate::vehicle::AxlePattern;

/// Scores of all methods on one site.
pub struct SiteMethods {
    /// Site name.
    pub site: String,
    /// Method and its score; this program's analysis comes first.
    pub methods: Vec<(&'static str, Score)>,
    /// Ballast of the analysis with intervals, and of the quasi-static fit.
    pub ballast: [[Interval; 3]; 2],
    /// Ballast by eq. 1, where there is a scan.
    pub known_geometry: Option<BallastParameters>,
    /// What the peaks cannot be known better than.
    pub limits: PeakLimits,
}

const OURS: &str = "cpcm analyse";
const PAPER: &str = "paper: high-pass, quasi-static calibration, pseudo-inverse, one force per bogie";
const BETWEEN: &str =
    "quasi-static calibration, model below 3 Hz, f \u{2212} Q, truncated SVD, GCV, per wheelset";
const KNOWN_GEOMETRY: &str = "calibration over the laser scan (eq. 1)";

/// One site analysed by all methods.
pub struct SiteAnalyses {
    /// Method and its analysis; this program's comes first, the paper's chain second. The others differ from the first in
    /// forces, displacement and irregularity only.
    pub methods: Vec<(&'static str, Analysis)>,
    /// Ballast of the other methods: quasi-static fit (eq. 2).
    pub quasi_static: BallastParameters,
}

/// Analyses a site by all methods.
pub fn site_analyses(site: &Site, progress: &dyn Progress) -> Result<SiteAnalyses, VerifyError> {
    analyses_of(&identify(site, progress).map_err(PipelineError::from)?, progress)
}

fn analyses_of(identified: &IdentifiedSite, progress: &dyn Progress) -> Result<SiteAnalyses, VerifyError> {
    let analysis = evaluate(identified, progress)?;
    let chain = DisplacementChain::new(identified)?;
    let mut others = Vec::new();
    for (name, kind) in [(PAPER, Chains::Paper), (BETWEEN, Chains::Between)] {
        progress.begin("force from displacement", identified.site.passages.len() as u64);
        others.push((name, chain.analysis(&analysis, kind, progress)?));
    }
    let mut methods = vec![(OURS, analysis)];
    methods.append(&mut others);
    Ok(SiteAnalyses { methods, quasi_static: identified.quasi_static.parameters })
}

/// Analyses a site by all methods and scores them.
pub fn site_methods(site: &Site, truth: &Truth, progress: &dyn Progress) -> Result<SiteMethods, VerifyError> {
    let axles = AxlePattern::of_vehicle(&site.crossing.vehicle).offset_m.len();
    let known = |w: &WheelTruth| {
        let of_a_train = site.passages.iter().any(|p| p.passage_id == w.passage_id);
        w.side == Side::Crossing && w.wheelset < axles && of_a_train
    };
    if !truth.wheels.iter().any(known) {
        return Err(VerifyError::NoTruth);
    }
    let identified = identify(site, progress).map_err(PipelineError::from)?;
    let all = analyses_of(&identified, progress)?;
    let p = all.quasi_static;
    let point = |value: f64| Interval { value, lower: f64::NAN, upper: f64::NAN };
    let analysis = all.methods.first().map(|m| &m.1).ok_or(VerifyError::Empty("list of methods"))?;
    let b = &analysis.ballast;
    progress.begin("calibration over the scan", 1);
    let known_geometry = known_geometry::calibrate(site, BallastParameters::NOMINAL)?;
    progress.step();
    let methods: Vec<(&str, Score)> = all.methods.iter().map(|(name, a)| (*name, score(a, truth))).collect();
    let reached = methods.first().map(|m| m.1.clone()).ok_or(VerifyError::Empty("list of methods"))?;
    Ok(SiteMethods {
        limits: PeakLimits::new(identified, analysis, reached, truth, progress)?,
        known_geometry,
        site: analysis.crossing.name.clone(),
        methods,
        ballast: [[b.p1_n_m2, b.p2_n_m2, b.p3], [point(p.p1_n_m2), point(p.p2_n_m2), point(p.p3)]],
    })
}

impl SiteMethods {
    /// All methods side by side, with the numpy baseline where there is one.
    pub fn table(&self, baseline: Option<&Baseline>) -> Table {
        let mut table = Table::new(
            &format!("Forces and ballast against the truth, site {}", self.site),
            "Error of the force below 250 Hz in the transition region: |peak| median and 90th percentile, waveform (RMS over peak \
             to peak) median, position of the peak; speed; displacement while the train passes (RMS over peak to peak); mean irregularity against the laser scan (RMS over peak to peak); share of the scan \
             inside the 90 % interval of that mean; error of the mean peak, and its interval; share of true peaks and of true samples inside the 90 % interval. p1, p2 in MN/m².",
            &[
                "method",
                "peak",
                "p90",
                "waveform",
                "position, mm",
                "speed",
                "displacement",
                "irregularity",
                "scan inside",
                "mean peak (90 %)",
                "peaks inside",
                "samples inside",
                "p1",
                "p2",
                "p3",
            ],
        );
        for (k, (name, score)) in self.methods.iter().enumerate() {
            table.row(&self.row(name, score, k));
        }
        if let Some(b) = baseline {
            table.row(&baseline_row(b));
        }
        if let Some(b) = self.known_geometry {
            table.row(&ballast_row(KNOWN_GEOMETRY, [b.p1_n_m2, b.p2_n_m2, b.p3]));
        }
        let truth = self.methods.first().and_then(|(_, score)| score.ballast_truth);
        if let Some(truth) = truth {
            table.row(&ballast_row("truth", truth));
        }
        table
    }

    fn row(&self, name: &str, score: &Score, method: usize) -> Vec<String> {
        let ballast = method.min(1);
        let percent = |v: f64, digits: usize| {
            if v.is_finite() { format!("{:.digits$} %", 100.0 * v) } else { "-".into() }
        };
        let share = |v: f64| if ballast == 0 { percent(v, 0) } else { "-".into() };
        let [p1, p2, p3] = self.ballast[ballast];
        vec![
            name.into(),
            percent(Score::median(&score.peak), 2),
            percent(Score::p90(&score.peak), 2),
            percent(Score::median(&score.waveform), 1),
            format!("{:.0}", 1e3 * Score::median(&score.peak_position_m)),
            percent(Score::median(&score.speed), 3),
            percent(Score::median(&score.displacement), 2),
            percent(score.irregularity, 1),
            share(score.irregularity_coverage),
            match (ballast, score.mean_peak) {
                (0, [error, half]) => format!("{:+.2} % (\u{b1} {:.2})", 100.0 * error, 100.0 * half),
                (_, [error, _]) => format!("{:+.2} %", 100.0 * error),
            },
            share(score.peak_coverage),
            share(score.waveform_coverage),
            cell(p1, 1e-6, 1),
            cell(p2, 1e-6, 1),
            cell(p3, 1.0, 2),
        ]
    }
}

/// Ballast alone.
fn ballast_row(name: &str, [p1, p2, p3]: [f64; 3]) -> Vec<String> {
    let mut row = vec![String::new(); 15];
    row[0] = name.into();
    row[12..].clone_from_slice(&[
        format!("{:.1}", 1e-6 * p1),
        format!("{:.1}", 1e-6 * p2),
        format!("{p3:.2}"),
    ]);
    row
}

fn baseline_row(b: &Baseline) -> Vec<String> {
    let percent =
        |v: f64, digits: usize| if v.is_finite() { format!("{:.digits$} %", 100.0 * v) } else { "-".into() };
    let none = || "-".to_string();
    let [p1, p2, p3] = b.ballast_mn_m2;
    vec![
        b.name().into(),
        percent(b.peak_error, 2),
        percent(b.peak_p90, 2),
        percent(b.waveform, 1),
        none(),
        none(),
        none(),
        percent(b.irregularity, 1),
        none(),
        none(),
        none(),
        none(),
        format!("{p1:.1}"),
        format!("{p2:.1}"),
        format!("{p3:.2}"),
    ]
}

/// A value with its interval, where it has one.
fn cell(interval: Interval, scale: f64, digits: usize) -> String {
    let [value, lower, upper] = [interval.value, interval.lower, interval.upper].map(|v| v * scale);
    match lower.is_finite() && upper.is_finite() {
        true => format!("{value:.digits$} ({lower:.digits$} \u{2026} {upper:.digits$})"),
        false => format!("{value:.digits$}"),
    }
}
