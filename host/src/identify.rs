//! A site from recordings to calibrated model: speeds, ballast, axle times, common force profile.

use crate::ballast::BallastParameters;
use crate::ballast::evidence::{EvidenceFit, EvidenceProblem};
use crate::ballast::quasi_static::{QuasiStatic, QuasiStaticFit};
use crate::greens::{Chain, GreensFunctions, GreensSampling, Quantity};
use crate::interaction::Interaction;
use crate::inverse::hierarchy::{SitePassage, SitePosterior};
use crate::inverse::{CommonProfile, InverseError, Prior, ProfileGrids};
use crate::progress::Progress;
use crate::reconstruct::{Recording, SpeedSearch, Timing, estimate_speed};
use crate::recording::Site;
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
    /// Speeds and axle times.
    pub timings: Vec<Timing>,
    /// Static wheel force per passage, newtons.
    pub static_force_n: Vec<f64>,
    /// Quasi-static calibration (paper, eq. 2), the start of the calibration by evidence.
    pub quasi_static: QuasiStaticFit,
    /// Calibration by evidence.
    pub ballast: EvidenceFit,
    /// Prior with the hyper-parameters that the evidence prefers.
    pub prior: Prior,
    /// Green's functions of the calibrated track.
    pub greens: GreensFunctions,
    /// Wheel-track interaction of the calibrated track.
    pub interaction: Interaction,
    /// Irregularity that all wheels share.
    pub profile: CommonProfile,
    /// Ratio of the residuals to what the model allows, 1 for a perfect model: intervals are widened by it.
    pub misfit_ratio: f64,
}

/// Passages used for the search over ballast; all are used for everything else.
const CALIBRATION_PASSAGES: usize = 8;
/// Start of the quasi-static fit: nominal outer stiffness, somewhat less under the crossing.
const NOMINAL: BallastParameters = BallastParameters { p1_n_m2: 30e6, p2_n_m2: 25e6, p3: 0.4 };
/// Spacing of the common profile on the two rails, metres; half the shortest wavelength in the band at 45 m/s.
const PROFILE_STEP_M: (f64, f64) = (0.05, 0.08);
/// Rounds of re-linearising the axle positions.
const ALIGN_ROUNDS: usize = 2;

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
        site.passages.iter().map(|p| Recording::new(p, &crossing.sensor)).collect();
    let speeds = speeds(site, &recordings, &pattern, progress)?;
    let static_force_n: Vec<f64> = site
        .passages
        .iter()
        .map(|p| static_wheel_force_n(p.axle_load_kg, crossing.vehicle.gravity_m_s2))
        .collect();
    progress.begin("ballast, quasi-static", 1);
    let inputs: Vec<(&Recording, f64, f64)> =
        (0..recordings.len()).map(|i| (&recordings[i], speeds[i], static_force_n[i])).collect();
    let quasi_static = QuasiStatic::new(&track, direction, &pattern, &inputs).fit(NOMINAL);
    progress.step();
    let mut passages: Vec<SitePassage> = (0..recordings.len())
        .map(|i| SitePassage {
            recording: &recordings[i],
            timing: Timing { speed_m_s: speeds[i], first_axle_s: quasi_static.first_axle_s[i] },
            static_force_n: static_force_n[i],
        })
        .collect();
    let prior = Prior::starting(direction);
    let mut problem = EvidenceProblem {
        track: &track,
        direction,
        pattern: &pattern,
        prior: prior.clone(),
        vehicle: &crossing.vehicle,
    };
    let ballast = calibrate(&mut problem, &quasi_static.parameters, &mut passages, progress)?;
    let distribution = ballast.parameters.distribution(track.sleeper_x_m.len(), track.sensor_sleeper);
    let greens = GreensFunctions::new(
        &track,
        &distribution,
        GreensSampling::wide(),
        Quantity::Acceleration,
        &Chain::Corrected,
    );
    let interaction =
        Interaction::new(&track, &distribution, &crossing.vehicle, prior.half_m, GreensSampling::wide());
    let prior = Prior::each_wheel_for_itself(direction);
    let profile = CommonProfile::zero(ProfileGrids::new(prior.half_m, PROFILE_STEP_M.0, PROFILE_STEP_M.1));
    let timings = passages.iter().map(|p| p.timing).collect();
    Ok(IdentifiedSite {
        site,
        timings,
        static_force_n,
        quasi_static,
        ballast,
        prior,
        profile,
        misfit_ratio: 1.0,
        track,
        pattern,
        direction,
        recordings,
        greens,
        interaction,
    })
}

fn speeds(
    site: &Site,
    recordings: &[Recording],
    pattern: &AxlePattern,
    progress: &dyn Progress,
) -> Result<Vec<f64>, IdentifyError> {
    recordings
        .iter()
        .zip(&site.passages)
        .map(|(recording, passage)| {
            progress.step();
            estimate_speed(recording, pattern, SpeedSearch::default())
                .ok_or(IdentifyError::Silent { passage_id: passage.passage_id })
        })
        .collect()
}

/// Moves the axle times of all passages to their posterior mean.
fn realign(passages: &mut [SitePassage], posterior: &SitePosterior) {
    for (passage, shift) in passages.iter_mut().zip(&posterior.shift_m) {
        passage.timing.first_axle_s += shift / passage.timing.speed_m_s;
    }
}

fn calibrate(
    problem: &mut EvidenceProblem,
    quasi_static: &BallastParameters,
    passages: &mut [SitePassage],
    progress: &dyn Progress,
) -> Result<EvidenceFit, IdentifyError> {
    progress.begin("ballast by evidence", 4);
    // The quasi-static fit errs towards a soft centre (the dynamic force leaks into its band).
    let start = BallastParameters {
        p2_n_m2: (1.5 * quasi_static.p2_n_m2).max(0.3 * quasi_static.p1_n_m2),
        p3: 0.5,
        ..*quasi_static
    };
    for _ in 0..ALIGN_ROUNDS {
        let posterior = problem.posterior(&start, passages)?;
        realign(passages, &posterior);
    }
    progress.step();
    let every = passages.len().div_ceil(CALIBRATION_PASSAGES).max(1);
    let some: Vec<SitePassage> = passages.iter().step_by(every).copied().collect();
    problem.prior = problem.refined(&start, &some)?;
    progress.step();
    let fit = problem.fit(&[start], &some)?;
    progress.step();
    for _ in 0..ALIGN_ROUNDS {
        let posterior = problem.posterior(&fit.parameters, passages)?;
        realign(passages, &posterior);
    }
    progress.step();
    Ok(fit)
}
