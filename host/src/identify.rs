//! A site from recordings to calibrated model: speeds, ballast, axle times, common force profile.

mod classes;
mod described;
mod directions;
mod hits;
mod known;
mod sound;

use rayon::prelude::*;

use crate::ballast::BallastParameters;
use crate::ballast::damping::Damping;
use crate::ballast::evidence::{
    Calibration, DIFFERENCE, EvidenceFit, EvidenceProblem, Unknown, realign, temperature,
};
use crate::ballast::quasi_static::QuasiStaticFit;
use crate::greens::{Chain, GreensFunctions, GreensSampling, Quantity};
use crate::inverse::hierarchy::{SiteModel, SitePassage, SitePosterior};
use crate::inverse::hyper::{FORCE, refine};
use crate::inverse::{CommonProfile, Estimator, Excitation, InverseError, Prior, ProfileGrids, TrackModel};
use crate::progress::Progress;
use crate::reconstruct::{Recording, SPEEDS_M_S, SpeedSearch, Timing, comb, estimate_speed, flat_top_m_s2};
use crate::recording::Site;
use crate::signal::{mean, quantile};
use crate::track::Track;
use crate::vehicle::{AxleGroup, AxlePattern, static_wheel_force_n};

use self::classes::{class_of, forces_of_classes};
use self::directions::OneWay;
use self::hits::Hit;
use self::known::{Found, Known};
use self::sound::explained;

pub use self::classes::ForceClass;
pub use self::described::{Descriptions, Heard, Misdescription};
pub use self::sound::UNLIKE;

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
    /// Axles that follow one another closely are estimated together, and memory grows with the square of their window.
    #[error(
        "passage {passage_id}: {axles} axles less than 10 m apart at {speed_m_s:.1} m/s want a window of {samples} samples, {limit} at \
         most; leave such trains out"
    )]
    LongWindow {
        /// Which recording.
        passage_id: i32,
        /// Axles of the longest row.
        axles: usize,
        /// Speed of the train, m/s.
        speed_m_s: f64,
        /// Samples of their window.
        samples: usize,
        /// Most that are allowed.
        limit: usize,
    },
    /// The sensor is mounted upside down, or the recorder's sign is not that of the format.
    #[error(
        "the sleeper rises under the wheels in {rising} of {passages} passages: acceleration must be positive down; multiply the \
         recordings by -1"
    )]
    UpsideDown {
        /// Passages in which it does.
        rising: usize,
        /// All passages.
        passages: usize,
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
    /// Mean static force of the wheels of an axle per passage, newtons; `track` tells how the rails share it.
    pub static_force_n: Vec<f64>,
    /// Quasi-static calibration (paper, eq. 2), the start of the calibration by evidence.
    pub quasi_static: QuasiStaticFit,
    /// Calibration by evidence.
    pub ballast: EvidenceFit,
    /// What the recordings say of the damping, whether it was taken from crossing.toml or found.
    pub damping: Damping,
    /// State of the calibration: ballast, common irregularity, prior at the low sampling.
    pub calibration: Calibration,
    /// Forces that trains of about the same speed share, slowest class first.
    pub classes: Vec<ForceClass>,
    /// Green's functions of the calibrated track.
    pub greens: GreensFunctions,
    /// The same with each entry of the ballast's vector that was unknown moved by a step.
    pub nearby_greens: Vec<(GreensFunctions, f64)>,
    /// What crossing.toml has otherwise than the recordings: then all of this means nothing.
    pub misdescription: Option<Misdescription>,
    /// Passages that the site was identified from, by their place in the site.
    pub used: Vec<usize>,
    /// What the model leaves of every passage, squared, per value and in units of what it expects to leave.
    pub misfit: Vec<f64>,
    explained: Vec<bool>,
    /// Passages of trains that run in the other direction than crossing.toml has it, by their place in the site.
    pub other_way: Vec<usize>,
    /// Median noise of quiet track, RMS, m/s².
    quiet_m_s2: f64,
}

impl IdentifiedSite<'_> {
    /// Whether the model explains a passage: its forces mean something.
    pub fn explains(&self, index: usize) -> bool {
        self.explained[index]
    }

    /// The same of the usual passage, newtons: a node does not know the load of the next train.
    pub fn usual_force_n(&self) -> f64 {
        quantile(&self.static_force_n, 0.5)
    }

    /// Number of the class of a speed.
    pub fn class_of(&self, speed_m_s: f64) -> usize {
        class_of(&self.classes, speed_m_s)
    }

    /// Number of a passage's class.
    pub fn class_of_passage(&self, index: usize) -> usize {
        self.class_of(self.timings[index].speed_m_s)
    }

    /// Stretch in which forces deviate from the static one, x in metres; the same for all classes.
    pub fn region_m(&self) -> [f64; 2] {
        self.classes[0].prior.region_m
    }

    /// Forces are unknown while a wheel is this near x = 0, metres; the same for all classes.
    pub fn half_m(&self) -> f64 {
        self.classes[0].prior.half_m
    }

    /// Noise that the model needs to explain recordings like this one, over that of quiet track: what it leaves is more than the
    /// sensor's.
    pub fn excess_noise(&self, index: usize) -> f64 {
        let prior = &self.classes[self.class_of_passage(index)].prior;
        // Recordings of good sensors seldom want less noise than the search for the prior begins with.
        prior.noise_m_s2 / self.quiet_m_s2.max(Prior::common_force(self.direction).noise_m_s2)
    }

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
        (self.greens, self.nearby_greens) =
            calibrated_greens(&self.track, &ballast, self.calibration.unknown);
        let timings: Vec<Timing> = self.used.iter().map(|i| self.timings[*i]).collect();
        let mut passages = some_of(&self.used, &timings, &self.recordings, &self.static_force_n);
        (self.classes, _) =
            forces_of_classes(&self.greens, self.direction, &self.pattern, &mut passages, progress)?;
        for (passage, index) in passages.iter().zip(&self.used) {
            self.timings[*index] = passage.timing;
        }
        Ok(self)
    }
}

/// Passages used for the hyper-parameters.
const HYPER_PASSAGES: usize = 3;
/// Spacing of the common force profile on the two rails, metres: three knots per wavelength of 250 Hz at 30 m/s.
const PROFILE_STEP_M: (f64, f64) = (0.04, 0.064);
/// Position uncertainty left after the calibration, metres: common and per passage; relative error of the speed.
const SHIFT_SD_M: (f64, f64) = (0.0003, 0.001);
const SPEED_SD: f64 = 1e-4;

/// Longest window, samples; one of 1050 takes 1.6 GB on two cores, and memory grows with the square.
const MOST_SAMPLES: usize = 1800;

/// Refuses trains whose windows would not fit into memory.
fn check_windows(
    site: &Site,
    pattern: &AxlePattern,
    prior: &Prior,
    speed_m_s: &[f64],
) -> Result<(), IdentifyError> {
    let length_m = |g: &AxleGroup| pattern.offset_m[g.first + g.len - 1] - pattern.offset_m[g.first];
    let groups = pattern.groups();
    let Some(longest) = groups.iter().max_by(|a, b| length_m(a).total_cmp(&length_m(b))) else {
        return Ok(());
    };
    let rate_hz = GreensSampling::wide().rate_hz;
    for (passage, speed) in site.passages.iter().zip(speed_m_s) {
        let samples = ((length_m(longest) + 2.0 * prior.window_m) / speed * rate_hz) as usize;
        if samples > MOST_SAMPLES {
            let (passage_id, axles, speed_m_s, limit) =
                (passage.passage_id, longest.len, *speed, MOST_SAMPLES);
            return Err(IdentifyError::LongWindow { passage_id, axles, speed_m_s, samples, limit });
        }
    }
    Ok(())
}

/// Runs the identification.
pub fn identify<'s>(site: &'s Site, progress: &dyn Progress) -> Result<IdentifiedSite<'s>, IdentifyError> {
    let crossing = &site.crossing;
    if site.passages.is_empty() {
        return Err(IdentifyError::NoPassage);
    }
    let direction = crossing.traffic_direction.sign();
    let pattern = AxlePattern::of_vehicle(&crossing.vehicle);
    progress.begin("speed of the trains", site.passages.len() as u64);
    let recordings: Vec<Recording> =
        site.passages.par_iter().map(|p| Recording::new(p, &crossing.sensor)).collect();
    let speed_m_s = speeds(site, &recordings, &pattern, progress)?;
    check_windows(site, &pattern, &Prior::common_force(direction), &speed_m_s)?;
    let static_force_n: Vec<f64> = site
        .passages
        .iter()
        .map(|p| static_wheel_force_n(p.axle_load_kg, crossing.vehicle.gravity_m_s2))
        .collect();
    let descriptions = Descriptions::new(crossing, &pattern);
    let problem = EvidenceProblem {
        track: descriptions.track(),
        direction,
        pattern: &pattern,
        temperature: temperature(&pattern),
    };
    let hits = recordings.par_iter().zip(&speed_m_s).map(|(r, v)| Hit::of(r, &pattern, *v)).collect();
    let known = Known {
        problem: &problem,
        recordings: &recordings,
        speed_m_s,
        hits,
        static_force_n: &static_force_n,
    };
    let all: Vec<usize> = (0..site.passages.len()).collect();
    let start = known.start(&all, progress);
    let rough = start.ballast();
    // Both begin there.
    problem.low_model(&Calibration::starting(rough, direction));
    let (found, suspicion) = rayon::join(
        || known.of_sound_passages(&all, start, progress),
        || descriptions.suspicion(&known.heard(&all), &rough),
    );
    let found = found?;
    known.check_sign(&found.1, &descriptions)?;
    let OneWay { used, described, other, found } = known.one_way(found, &descriptions, progress)?;
    let misdescription = suspicion.filter(|s| descriptions.confirmed(*s, &known.heard(&used)));
    let Found { start, calibration, ballast, damping, greens, nearby_greens, classes, timings, misfit } =
        found;
    let track = descriptions.track().track.clone();
    let quiet: Vec<f64> = used.iter().map(|i| recordings[*i].quiet_rms_m_s2).collect();
    Ok(IdentifiedSite {
        site,
        timings,
        static_force_n,
        quasi_static: start.quasi_static,
        ballast,
        damping,
        calibration,
        classes,
        explained: explained(&used, &described, &misfit),
        other_way: other,
        quiet_m_s2: quantile(&quiet, 0.5),
        misdescription,
        used,
        misfit,
        pattern,
        direction,
        clips_at_m_s2: flat_top_m_s2(site).map(|(range, _)| range),
        greens,
        nearby_greens,
        recordings,
        track,
    })
}

/// Some passages of a site, with a timing each.
fn some_of<'r>(
    which: &[usize],
    timings: &[Timing],
    recordings: &'r [Recording],
    static_force_n: &[f64],
) -> Vec<SitePassage<'r>> {
    let passage = |(i, timing): (&usize, &Timing)| SitePassage {
        recording: &recordings[*i],
        timing: *timing,
        static_force_n: static_force_n[*i],
    };
    which.iter().zip(timings).map(passage).collect()
}

/// Green's functions on a ballast, and on ballast with each entry of its vector that was unknown moved by a step.
fn calibrated_greens(
    track: &Track,
    ballast: &BallastParameters,
    unknown: Unknown,
) -> (GreensFunctions, Vec<(GreensFunctions, f64)>) {
    let nearby = |k: usize| (wide_greens(track, &ballast.moved(k, DIFFERENCE[k])), DIFFERENCE[k]);
    rayon::join(|| wide_greens(track, ballast), || (0..unknown.count()).into_par_iter().map(nearby).collect())
}

fn wide_greens(track: &Track, ballast: &BallastParameters) -> GreensFunctions {
    GreensFunctions::new(
        &ballast.under(track),
        &ballast.bed(track),
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
pub(crate) fn spread_out<T: Copy>(passages: &[T], count: usize) -> Vec<T> {
    passages.iter().step_by(passages.len().div_ceil(count).max(1)).copied().collect()
}

/// Model of the forces at the full band.
fn force_model<'a>(
    greens: &'a GreensFunctions,
    direction: f64,
    pattern: &'a AxlePattern,
    prior: &'a Prior,
    profile: &'a CommonProfile,
) -> SiteModel<'a> {
    SiteModel {
        model: TrackModel { greens, excitation: Excitation::Force },
        moved: Vec::new(),
        direction,
        pattern,
        prior,
        profile,
        common_shift_sd_m: SHIFT_SD_M.0,
        passage_shift_sd_m: SHIFT_SD_M.1,
        speed_sd: SPEED_SD,
        temperature: temperature(pattern),
    }
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
    let model = force_model(greens, direction, pattern, &start, &zero);
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
