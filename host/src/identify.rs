//! A site from recordings to calibrated model: speeds, ballast, axle times, common force profile.

use rayon::prelude::*;

use crate::ballast::BallastParameters;
use crate::ballast::evidence::{Calibration, DIFFERENCE, EvidenceFit, EvidenceProblem, TEMPERATURE, realign};
use crate::ballast::quasi_static::{QuasiStatic, QuasiStaticFit};
use crate::greens::{Chain, GreensFunctions, GreensSampling, Quantity};
use crate::inverse::hierarchy::{SiteModel, SitePassage, SitePosterior};
use crate::inverse::hyper::{FORCE, refine};
use crate::inverse::{CommonProfile, Estimator, Excitation, InverseError, Prior, ProfileGrids, TrackModel};
use crate::progress::Progress;
use crate::reconstruct::{Recording, SPEEDS_M_S, SpeedSearch, Timing, comb, estimate_speed, flat_top_m_s2};
use crate::recording::Site;
use crate::signal::mean;
use crate::track::{Mesh, Track};
use crate::vehicle::{AxlePattern, static_wheel_force_n};

/// Why a site cannot be identified.
#[derive(Debug, thiserror::Error)]
pub enum IdentifyError {
    /// Nothing to work on.
    #[error("the site has no usable passage; see the list of skipped ones")]
    NoPassage,
    /// No train in a recording.
    #[error("passage {passage_id}: no train found, the recording is silent; leave the passage out")]
    Silent {
        /// Which recording.
        passage_id: i32,
    },
    /// The estimate broke down.
    #[error(transparent)]
    Inverse(#[from] InverseError),
}

/// A site with everything estimated that its passages share.
pub struct IdentifiedSite<'s> {
    /// Input.
    pub site: &'s Site,
    /// Track with nominal design values.
    pub track: Track,
    /// Axle pattern of the trains.
    pub pattern: AxlePattern,
    /// +1 facing, -1 trailing.
    pub direction: f64,
    /// Corrected recordings, in the order of the site's passages.
    pub recordings: Vec<Recording>,
    /// Where the transducer clips, by where values pile up, m/s².
    pub clips_at_m_s2: Option<f64>,
    /// Speeds and axle times.
    pub timings: Vec<Timing>,
    /// Static wheel force per passage, newtons.
    pub static_force_n: Vec<f64>,
    /// Quasi-static calibration (paper, eq. 2), the start of the calibration by evidence.
    pub quasi_static: QuasiStaticFit,
    /// Calibration by evidence.
    pub ballast: EvidenceFit,
    /// State of the calibration: ballast, common irregularity, prior at the low sampling.
    pub calibration: Calibration,
    /// Prior of the forces at the full band.
    pub prior: Prior,
    /// Green's functions of the calibrated track.
    pub greens: GreensFunctions,
    /// The same with each of (ln p1, ln p2, p3) moved by a step.
    pub nearby_greens: [(GreensFunctions, f64); 3],
    /// Force deviation that all wheels share.
    pub profile: CommonProfile,
    /// Posterior at the full band.
    pub posterior: SitePosterior,
}

impl IdentifiedSite<'_> {
    /// Window of a passage as an estimator expects it, for the group of axles that begins with axle `first`, m/s².
    pub fn window(&self, index: usize, estimator: &Estimator, first: usize) -> Vec<f64> {
        let rate = estimator.rate_hz;
        let start_s =
            self.timings[index].axle_s(self.pattern.offset_m[first]) - estimator.before as f64 / rate;
        let band = self.greens.sampling.band_hz;
        self.recordings[index].window(start_s, rate, estimator.len(), band)
    }

    /// The same site with other values of the ballast than the calibrated ones: forces that all wheels share and axle times found
    /// anew; the state of the calibration and its covariance stay.
    pub fn on_ballast(
        mut self,
        ballast: BallastParameters,
        progress: &dyn Progress,
    ) -> Result<Self, IdentifyError> {
        self.ballast.parameters = ballast;
        (self.greens, self.nearby_greens) = calibrated_greens(&self.track, &ballast);
        let mut passages = site_passages(&self.recordings, &self.timings, &self.static_force_n);
        (self.prior, self.posterior) =
            common_force(&self.greens, self.direction, &self.pattern, &mut passages, progress)?;
        self.timings = passages.iter().map(|p| p.timing).collect();
        self.profile = self.posterior.profile.clone();
        Ok(self)
    }
}

/// Passages used for the search over ballast; all are used for everything else.
const CALIBRATION_PASSAGES: usize = 8;
/// Passages used for the hyper-parameters.
const HYPER_PASSAGES: usize = 3;
/// Spacing of the common force profile on the two rails, metres: three knots per wavelength of 250 Hz at 30 m/s.
const PROFILE_STEP_M: (f64, f64) = (0.04, 0.064);
/// Position uncertainty left after the calibration, metres: common and per passage; relative error of the speed.
const SHIFT_SD_M: (f64, f64) = (0.0003, 0.001);
const SPEED_SD: f64 = 1e-4;

/// Runs the identification.
pub fn identify<'s>(site: &'s Site, progress: &dyn Progress) -> Result<IdentifiedSite<'s>, IdentifyError> {
    let crossing = &site.crossing;
    if site.passages.is_empty() {
        return Err(IdentifyError::NoPassage);
    }
    let direction = crossing.traffic_direction.sign();
    let track = Track::of_crossing(crossing, Mesh::default());
    let pattern = AxlePattern::of_vehicle(&crossing.vehicle);
    progress.begin("speed of the trains", site.passages.len() as u64);
    let recordings: Vec<Recording> =
        site.passages.par_iter().map(|p| Recording::new(p, &crossing.sensor)).collect();
    let speeds = speeds(site, &recordings, &pattern, progress)?;
    let static_force_n: Vec<f64> = site
        .passages
        .iter()
        .map(|p| static_wheel_force_n(p.axle_load_kg, crossing.vehicle.gravity_m_s2))
        .collect();
    progress.begin("ballast, quasi-static", 1);
    let inputs: Vec<(&Recording, f64, f64)> =
        (0..recordings.len()).map(|i| (&recordings[i], speeds[i], static_force_n[i])).collect();
    let quasi_static = QuasiStatic::new(&track, direction, &pattern, &inputs).fit(BallastParameters::NOMINAL);
    progress.step();
    let found = speeds.iter().zip(&quasi_static.first_axle_s);
    let timings: Vec<Timing> = found.map(|(v, t)| Timing { speed_m_s: *v, first_axle_s: *t }).collect();
    let mut passages = site_passages(&recordings, &timings, &static_force_n);
    let problem = EvidenceProblem::new(&track, direction, &pattern, &crossing.vehicle);
    let (calibration, ballast) = calibrate(&problem, &quasi_static, &mut passages, progress)?;
    let (greens, nearby_greens) = calibrated_greens(&track, &ballast.parameters);
    let (prior, posterior) = common_force(&greens, direction, &pattern, &mut passages, progress)?;
    let timings = passages.iter().map(|p| p.timing).collect();
    Ok(IdentifiedSite {
        site,
        timings,
        static_force_n,
        quasi_static,
        ballast,
        calibration,
        prior,
        profile: posterior.profile.clone(),
        posterior,
        track,
        pattern,
        direction,
        recordings,
        clips_at_m_s2: flat_top_m_s2(site).map(|(range, _)| range),
        greens,
        nearby_greens,
    })
}

fn site_passages<'r>(
    recordings: &'r [Recording],
    timings: &[Timing],
    static_force_n: &[f64],
) -> Vec<SitePassage<'r>> {
    let known = timings.iter().zip(static_force_n);
    let passage = |(recording, (timing, force)): (&'r Recording, (&Timing, &f64))| SitePassage {
        recording,
        timing: *timing,
        static_force_n: *force,
    };
    recordings.iter().zip(known).map(passage).collect()
}

/// Green's functions on a ballast, and on ballast with each of (ln p1, ln p2, p3) moved by a step.
fn calibrated_greens(
    track: &Track,
    ballast: &BallastParameters,
) -> (GreensFunctions, [(GreensFunctions, f64); 3]) {
    let nearby = |k: usize| (wide_greens(track, &ballast.moved(k, DIFFERENCE[k])), DIFFERENCE[k]);
    let ((greens, first), (second, third)) = rayon::join(
        || rayon::join(|| wide_greens(track, ballast), || nearby(0)),
        || rayon::join(|| nearby(1), || nearby(2)),
    );
    (greens, [first, second, third])
}

fn wide_greens(track: &Track, ballast: &BallastParameters) -> GreensFunctions {
    let distribution = ballast.bed(track);
    GreensFunctions::new(
        track,
        &distribution,
        GreensSampling::wide(),
        Quantity::Acceleration,
        &Chain::Corrected,
    )
}

fn speeds(
    site: &Site,
    recordings: &[Recording],
    pattern: &AxlePattern,
    progress: &dyn Progress,
) -> Result<Vec<f64>, IdentifyError> {
    recordings
        .par_iter()
        .zip(&site.passages)
        .map(|(recording, passage)| {
            progress.step();
            let of_envelope = || comb(recording, pattern, SPEEDS_M_S).map(|(speed, _)| speed);
            let search =
                SpeedSearch { about_m_s: passage.speed_m_s.or_else(of_envelope), ..SpeedSearch::default() };
            estimate_speed(recording, pattern, search)
                .ok_or(IdentifyError::Silent { passage_id: passage.passage_id })
        })
        .collect()
}

/// Every n-th passage, `count` of them or a few less.
fn spread_out<'p>(passages: &[SitePassage<'p>], count: usize) -> Vec<SitePassage<'p>> {
    passages.iter().step_by(passages.len().div_ceil(count).max(1)).copied().collect()
}

fn calibrate(
    problem: &EvidenceProblem,
    quasi_static: &QuasiStaticFit,
    passages: &mut [SitePassage],
    progress: &dyn Progress,
) -> Result<(Calibration, EvidenceFit), IdentifyError> {
    progress.begin("ballast by evidence", 4);
    let mut state = Calibration::starting(quasi_static.start_of_evidence(), problem.direction);
    let mut some = spread_out(passages, CALIBRATION_PASSAGES);
    problem.converge(&mut state, &mut some, 3)?;
    progress.step();
    state.prior = problem.refined(&state, &spread_out(&some, HYPER_PASSAGES))?;
    progress.step();
    problem.converge(&mut state, &mut some, 10)?;
    progress.step();
    // Axle times first: they are far off where the search has not used a passage, and cheap without the derivatives.
    problem.align(&state, passages)?;
    let fit = problem.finish(&mut state, passages)?;
    progress.step();
    Ok((state, fit))
}

/// Force profile that all wheels share at the full band, with the axle times.
fn common_force(
    greens: &GreensFunctions,
    direction: f64,
    pattern: &AxlePattern,
    passages: &mut [SitePassage],
    progress: &dyn Progress,
) -> Result<(Prior, SitePosterior), InverseError> {
    progress.begin("common force profile", 3);
    let start = Prior::common_force(direction);
    let mean_speed = mean(&passages.iter().map(|p| p.timing.speed_m_s).collect::<Vec<_>>());
    let grids = ProfileGrids::force(start.half_m, PROFILE_STEP_M.0, PROFILE_STEP_M.1, mean_speed);
    let zero = CommonProfile::zero(grids);
    let model = SiteModel {
        model: TrackModel { greens, excitation: Excitation::Force },
        moved: Vec::new(),
        direction,
        pattern,
        prior: &start,
        profile: &zero,
        common_shift_sd_m: SHIFT_SD_M.0,
        passage_shift_sd_m: SHIFT_SD_M.1,
        speed_sd: SPEED_SD,
        temperature: TEMPERATURE,
    };
    let some = spread_out(passages, HYPER_PASSAGES);
    let prepared = model.prepared(&some)?;
    let evidence = |prior: &Prior| SiteModel { prior, ..model.clone() }.log_evidence(&prepared);
    let prior = refine(&start, &FORCE, &evidence)?;
    progress.step();
    // The profile that a few passages show is good enough to linearise about.
    let model = SiteModel { prior: &prior, ..model };
    let rough = model.posterior_profile(&prepared)?;
    drop(prepared);
    progress.step();
    let all = SiteModel { profile: &rough, ..model }.posterior(passages)?;
    realign(passages, &all);
    progress.step();
    Ok((prior, all))
}
