//! What the peaks cannot be known better than: noise, what wheels have of their own, and what looks alike to one sensor.

use super::super::{Table, VerifyError};
use crate::analysis::Analysis;
use crate::ballast::BallastParameters;
use crate::forces::{Causes, Spread};
use crate::identify::IdentifiedSite;
use crate::inverse::hierarchy::kinds;
use crate::pipeline::{PipelineError, evaluate};
use crate::progress::Progress;
use crate::recording::truth::Truth;
use crate::scoring::{Score, StockInfluence, score, stock_influence};
use crate::signal::{mean, quantile};

/// Median of |e| over the standard deviation of a normal e.
const MEDIAN_OF_NORMAL: f64 = 0.6745;

/// Standard deviations of a peak force that the posterior states, relative to the peak, and what was reached.
pub struct PeakLimits {
    /// Noise of the recording, what a wheel has of its own, its load.
    pub own: f64,
    /// Force profile that all wheels share: mostly, a force on the stock rail looks like one on the crossing rail.
    pub profile: f64,
    /// Ballast.
    pub ballast: f64,
    /// Score of the analysis.
    reached: Score,
    /// What the stock rail's force does to them, where it is known.
    stock: Option<StockInfluence>,
    /// Score with the true ballast instead of the calibrated one, where it is of the calibrated form.
    on_true_ballast: Option<Score>,
}

impl PeakLimits {
    /// Of a site; `analysis` is that of `identified`, which is used up, `reached` its score.
    pub(super) fn new(
        identified: IdentifiedSite,
        analysis: &Analysis,
        reached: Score,
        truth: &Truth,
        progress: &dyn Progress,
    ) -> Result<Self, VerifyError> {
        let [own, profile, ballast] = relative(&identified, analysis)?;
        let on_true_ballast = match reached.ballast_truth {
            Some(stiffness) => {
                let known = BallastParameters::stiffness(stiffness);
                let identified = identified.on_ballast(known, progress).map_err(PipelineError::from)?;
                Some(score(&evaluate(&identified, progress)?, truth))
            }
            None => None,
        };
        let stock = stock_influence(analysis, truth);
        Ok(Self { own, profile, ballast, reached, stock, on_true_ballast })
    }

    /// What all wheels of the site share: it moves the errors of all its peaks together.
    pub fn shared(&self) -> f64 {
        self.profile.hypot(self.ballast)
    }

    /// Median error to be expected of a peak.
    pub fn median(&self) -> f64 {
        MEDIAN_OF_NORMAL * self.own.hypot(self.shared())
    }

    /// Mean error of the peaks with its sign, relative: what all wheels have wrong alike.
    pub fn mean_error(&self) -> f64 {
        mean(&self.reached.peak_signed)
    }

    /// One line: what is allowed, and what was reached.
    pub fn table(&self, site: &str) -> Table {
        let mut table = Table::new(
            &format!("What noise and spread allow for the peaks, site {site}"),
            "Standard deviations of a wheelset's peak force in the posterior, in % of the peak: of each wheel by itself; of what all \
             wheels of the site share, with its parts (the common profile mostly because a force on the stock rail looks like one on \
             the crossing rail); the median error to be expected from both, and the one reached; the mean \
             error with its sign, which is the shared part's; the same two with the true ballast put in; the time by which all forces come too \
             late; the true force on the stock rail, less the static one, where the crossing's peaks, mean of all wheels; and by how much \
             the mean error on the crossing rail changes per newton of it, along the track.",
            &[
                "own",
                "shared",
                "common profile",
                "ballast",
                "median expected",
                "median",
                "mean, signed",
                "true ballast: median",
                "mean, signed",
                "late, \u{b5}s",
                "stock at peak, kN",
                "error per stock force",
            ],
        );
        let percent = |v: f64| format!("{:.2} %", 100.0 * v);
        let scored = |s: Option<&Score>| match s {
            Some(s) => [percent(Score::median(&s.peak)), percent(mean(&s.peak_signed))],
            None => ["-".into(), "-".into()],
        };
        let sds = [self.own, self.shared(), self.profile, self.ballast, self.median()];
        let mut row = sds.map(percent).to_vec();
        row.extend([Some(&self.reached), self.on_true_ballast.as_ref()].map(scored).concat());
        row.push(format!("{:.0}", 1e6 * self.reached.late_s));
        row.extend(match self.stock {
            Some(s) => [format!("{:.1}", 1e-3 * s.at_peak_n), format!("{:.2}", s.error_per_newton)],
            None => ["-".into(), "-".into()],
        });
        table.row(&row);
        table
    }
}

/// Standard deviations by cause at the peak, relative to it, root mean square over the kinds of axles.
fn relative(identified: &IdentifiedSite, analysis: &Analysis) -> Result<[f64; 3], VerifyError> {
    let wheels = || analysis.passages.iter().flat_map(|p| &p.wheelsets);
    let at_m = quantile(&wheels().map(|w| w.peak_position_m).collect::<Vec<_>>(), 0.5);
    let peak_n = quantile(&wheels().map(|w| w.peak_force_n.value).collect::<Vec<_>>(), 0.5);
    let usual = quantile(&identified.timings.iter().map(|t| t.speed_m_s).collect::<Vec<_>>(), 0.5);
    let spread = Spread::new(identified, identified.class_of(usual)).map_err(PipelineError::from)?;
    let of_kinds = kinds(&identified.pattern);
    let axles =
        of_kinds.iter().enumerate().flat_map(|(k, kind)| (0..kind.offsets.own.len()).map(move |a| (k, a)));
    let (mut squares, mut count) = ([0.0; 3], 0usize);
    for (kind, axle) in axles {
        let Causes { own_n, profile_n, ballast_n, .. } = spread.causes(kind, axle, &[at_m]);
        for (sum, sd_n) in squares.iter_mut().zip([own_n, profile_n, ballast_n]) {
            *sum += sd_n.iter().map(|s| (s / peak_n).powi(2)).sum::<f64>();
        }
        count += 1;
    }
    Ok(squares.map(|s| (s / count.max(1) as f64).sqrt()))
}
