//! What some passages of a site say of it, and the others follow.

use super::classes::{ForceClass, class_of, forces_of_classes};
use super::described::{Descriptions, Heard};
use super::hits::{Hit, back_to_hits, together_m, usual_m};
use super::sound::UNLIKE;
use super::{HYPER_PASSAGES, IdentifyError, calibrated_greens, force_model, some_of, spread_out};
use crate::ballast::BallastParameters;
use crate::ballast::damping::Damping;
use crate::ballast::evidence::{Calibration, EvidenceFit, EvidenceProblem, Unknown, Until, realign};
use crate::ballast::quasi_static::{QuasiStatic, QuasiStaticFit};
use crate::greens::{GreensFunctions, GreensSampling};
use crate::inverse::hierarchy::SitePassage;
use crate::progress::Progress;
use crate::reconstruct::{Recording, Timing};
use crate::signal::quantile;

/// Passages used for the search over ballast; all are used for everything else.
const CALIBRATION_PASSAGES: usize = 8;
/// Under the prior that the calibration begins with: near enough for the evidence to choose another. The next step is about a tenth of
/// the last one (Gauss-Newton).
const ROUGH: Until = Until { change: 0.1, shift_m: f64::INFINITY, rounds: 12 };
/// Under that one: far below the parameters' spread.
const SEARCH: Until = Until { change: 0.03, shift_m: f64::INFINITY, rounds: 12 };
/// Over all passages, which may be far off where the search has not used them.
const LAST: Until = Until { change: 0.03, shift_m: 0.005, rounds: 6 };
/// Share of the passages in which the sleeper seems to rise from which on the sensor is taken to be upside down.
const UPSIDE_DOWN: f64 = 0.8;

/// What is known of a site's recordings before the track is.
pub(super) struct Known<'a> {
    pub(super) problem: &'a EvidenceProblem<'a>,
    pub(super) recordings: &'a [Recording],
    pub(super) speed_m_s: Vec<f64>,
    pub(super) hits: Vec<Hit>,
    pub(super) static_force_n: &'a [f64],
}

/// What some of the passages say of the site; times and misfits are those of these passages.
pub(super) struct Found {
    pub(super) start: Start,
    pub(super) calibration: Calibration,
    pub(super) ballast: EvidenceFit,
    pub(super) damping: Damping,
    pub(super) greens: GreensFunctions,
    pub(super) nearby_greens: Vec<(GreensFunctions, f64)>,
    pub(super) classes: Vec<ForceClass>,
    pub(super) timings: Vec<Timing>,
    pub(super) misfit: Vec<f64>,
}

/// Where the calibration by evidence begins.
pub(super) struct Start {
    /// With the times that it begins with.
    pub(super) quasi_static: QuasiStaticFit,
    /// Noise hides the deflection: trains are at one place behind their hits, and of the ballast nothing is known.
    pub(super) hidden: bool,
}

impl Start {
    pub(super) fn ballast(&self) -> BallastParameters {
        if self.hidden { BallastParameters::NOMINAL } else { self.quasi_static.start_of_evidence() }
    }
}

impl Known<'_> {
    /// What is known of each of some passages.
    pub(super) fn heard(&self, which: &[usize]) -> Vec<Heard<'_>> {
        which.iter().map(|i| (&self.recordings[*i], self.speed_m_s[*i], self.static_force_n[*i])).collect()
    }

    fn quasi_static(&self, which: &[usize]) -> QuasiStatic<'_> {
        let EvidenceProblem { track, direction, pattern, .. } = self.problem;
        QuasiStatic::new(&track.track, *direction, pattern, &self.heard(which))
    }

    fn passages(&self, which: &[usize], first_axle_s: &[f64]) -> Vec<SitePassage<'_>> {
        let timing =
            |(i, time): (&usize, &f64)| Timing { speed_m_s: self.speed_m_s[*i], first_axle_s: *time };
        let timings: Vec<Timing> = which.iter().zip(first_axle_s).map(timing).collect();
        some_of(which, &timings, self.recordings, self.static_force_n)
    }

    /// Ballast and axle times on which the sleeper sinks as recorded in some passages.
    pub(super) fn start(&self, which: &[usize], progress: &dyn Progress) -> Start {
        progress.begin("ballast, quasi-static", 1);
        let model = self.quasi_static(which);
        let mut quasi_static = model.fit(BallastParameters::NOMINAL);
        // A sensor upside down is to be noticed, not explained.
        let hidden =
            model.is_hidden(&quasi_static) && model.rising(&BallastParameters::NOMINAL) < UPSIDE_DOWN;
        if hidden {
            let sinking = model.sinking(&BallastParameters::NOMINAL);
            let behind_m = together_m(&self.hits_of(which), &sinking, self.problem.direction);
            self.by_hits(which, behind_m, &mut quasi_static.first_axle_s);
        } else {
            back_to_hits(&self.hits_of(which), &mut quasi_static.first_axle_s);
        }
        progress.step();
        Start { quasi_static, hidden }
    }

    fn hits_of(&self, which: &[usize]) -> Vec<Hit> {
        which.iter().map(|i| self.hits[*i]).collect()
    }

    /// Puts trains so far behind their hits.
    fn by_hits(&self, which: &[usize], behind_m: f64, first_axle_s: &mut [f64]) {
        for (i, time_s) in which.iter().zip(first_axle_s) {
            *time_s = self.hits[*i].first_axle_s(behind_m).unwrap_or(*time_s);
        }
    }

    /// Identifies the site from some of its passages and where they begin.
    pub(super) fn find(
        &self,
        which: &[usize],
        start: Start,
        progress: &dyn Progress,
    ) -> Result<Found, IdentifyError> {
        let mut passages = self.passages(which, &start.quasi_static.first_axle_s);
        let (calibration, ballast, damping) = calibrate(self.problem, &start, &mut passages, progress)?;
        let EvidenceProblem { track, direction, pattern, .. } = self.problem;
        let (greens, nearby_greens) =
            calibrated_greens(&track.track, &ballast.parameters, calibration.unknown);
        let (classes, misfit) = forces_of_classes(&greens, *direction, pattern, &mut passages, progress)?;
        let timings = passages.iter().map(|p| p.timing).collect();
        Ok(Found { start, calibration, ballast, damping, greens, nearby_greens, classes, timings, misfit })
    }

    /// Where the model explains next to nothing, it may be the sign; what clips hard seems to rise as well.
    pub(super) fn check_sign(&self, found: &Found, descriptions: &Descriptions) -> Result<(), IdentifyError> {
        let unlike = found.misfit.iter().filter(|m| **m > UNLIKE).count();
        if 2 * unlike <= found.misfit.len() {
            return Ok(());
        }
        let passages = self.recordings.len();
        let all: Vec<usize> = (0..passages).collect();
        let share = self.quasi_static(&all).rising(&BallastParameters::NOMINAL);
        if share < UPSIDE_DOWN || !descriptions.explain_inverted(&self.heard(&all)) {
            return Ok(());
        }
        Err(IdentifyError::UpsideDown { rising: (share * passages as f64).round() as usize, passages })
    }

    /// Times and misfits of all passages: those that were not used follow what the others have found.
    pub(super) fn with_the_others(&self, used: &[usize], mut found: Found) -> Result<Found, IdentifyError> {
        let others: Vec<usize> = (0..self.recordings.len()).filter(|i| !used.contains(i)).collect();
        if others.is_empty() {
            return Ok(found);
        }
        let mut first_axle_s = self.quasi_static(&others).align(&found.ballast.parameters);
        let of_used: Vec<f64> = found.timings.iter().map(|t| t.first_axle_s).collect();
        match usual_m(&self.hits_of(used), &of_used) {
            Some(behind_m) if found.start.hidden => {
                self.by_hits(&others, behind_m, &mut first_axle_s);
            }
            _ => back_to_hits(&self.hits_of(&others), &mut first_axle_s),
        }
        let mut passages = self.passages(&others, &first_axle_s);
        self.problem.follow(&found.calibration, &mut passages)?;
        let EvidenceProblem { direction, pattern, .. } = self.problem;
        let mut misfit = Vec::new();
        for passage in &mut passages {
            let class = &found.classes[class_of(&found.classes, passage.timing.speed_m_s)];
            let model = force_model(&found.greens, *direction, pattern, &class.prior, class.profile());
            let followed = model.follow(std::slice::from_ref(passage))?;
            realign(std::slice::from_mut(passage), &followed);
            misfit.extend(followed.misfit);
        }
        let timings: Vec<Timing> = passages.iter().map(|p| p.timing).collect();
        let merge = |of_used: &[f64], of_others: &[f64]| merged(used, of_used, &others, of_others);
        found.misfit = merge(&found.misfit, &misfit);
        found.start.quasi_static.first_axle_s = merge(&found.start.quasi_static.first_axle_s, &first_axle_s);
        found.timings = merged(used, &found.timings, &others, &timings);
        Ok(found)
    }
}

/// Passages that hyper-parameters are learnt from: of the calibration, and of every class of speed.
pub(super) fn hyper_passages(used: &[usize], classes: impl Iterator<Item = Vec<usize>>) -> Vec<usize> {
    let mut all = spread_out(&spread_out(used, CALIBRATION_PASSAGES), HYPER_PASSAGES);
    all.extend(classes.flat_map(|of_class| spread_out(&of_class, HYPER_PASSAGES)));
    all
}

/// Values of some passages and of the others, in the order of the site.
fn merged<T: Copy>(some: &[usize], of_some: &[T], others: &[usize], of_others: &[T]) -> Vec<T> {
    let mut all: Vec<(usize, T)> =
        some.iter().chain(others).copied().zip(of_some.iter().chain(of_others).copied()).collect();
    all.sort_by_key(|(i, _)| *i);
    all.into_iter().map(|(_, value)| value).collect()
}

/// With the damping as described, unless recordings contradict that. Noise and spread then hold what it leaves, so that all is found anew.
fn calibrate(
    problem: &EvidenceProblem,
    start: &Start,
    passages: &mut [SitePassage],
    progress: &dyn Progress,
) -> Result<(Calibration, EvidenceFit, Damping), IdentifyError> {
    let mut described = passages.to_vec();
    let (state, fit) = calibrate_unknown(problem, (start, Unknown::Stiffness), &mut described, progress)?;
    let mut damping = problem.damping(&state, &described)?;
    if damping.is_worth_a_look() {
        let mut found = passages.to_vec();
        let unknown = Unknown::StiffnessAndDamping;
        let (free, free_fit) = calibrate_unknown(problem, (start, unknown), &mut found, progress)?;
        let priors = [&state.prior, &free.prior];
        let gained = problem.evidence_under(&priors, &free, &found)?
            - problem.evidence_under(&priors, &state, &described)?;
        damping = damping.borne_out(&free_fit, gained);
        if damping.is_denied() {
            passages.copy_from_slice(&found);
            return Ok((free, free_fit.contradicting_the_description(), damping));
        }
    }
    passages.copy_from_slice(&described);
    Ok((state, fit, damping))
}

fn calibrate_unknown(
    problem: &EvidenceProblem,
    (start, unknown): (&Start, Unknown),
    passages: &mut [SitePassage],
    progress: &dyn Progress,
) -> Result<(Calibration, EvidenceFit), IdentifyError> {
    progress.begin("ballast by evidence", 4);
    let slowest_m_s = passages.iter().map(|p| p.timing.speed_m_s).fold(f64::INFINITY, f64::min);
    let mut state = Calibration::starting(start.ballast(), problem.direction).felt_at(slowest_m_s);
    state.unknown = unknown;
    if start.hidden {
        state.prior.noise_m_s2 = state.prior.noise_m_s2.max(sensor_noise_m_s2(passages));
    }
    let all: Vec<usize> = (0..passages.len()).collect();
    let searched = spread_out(&all, CALIBRATION_PASSAGES);
    let others: Vec<usize> = all.into_iter().filter(|i| !searched.contains(i)).collect();
    let of = |which: &[usize]| which.iter().map(|i| passages[*i]).collect::<Vec<SitePassage>>();
    let (mut some, mut followed) = (of(&searched), of(&others));
    problem.converge(&mut state, &mut some, ROUGH)?;
    progress.step();
    state.prior = problem.refined(&state, &spread_out(&some, HYPER_PASSAGES))?;
    progress.step();
    problem.converge(&mut state, &mut some, SEARCH)?;
    progress.step();
    // Axle times of the others first: they are far off, as the search has not used them.
    problem.follow(&state, &mut followed)?;
    passages.copy_from_slice(&merged(&searched, &some, &others, &followed));
    let fit = problem.converge(&mut state, passages, LAST)?;
    progress.step();
    Ok((state, fit))
}

/// Noise of quiet track as the calibration samples it, in the median, m/s². Where it hides the deflection it is more than the prior begins
/// with; what is more would be taken for something, and lead the ballast astray before the evidence has its say on the noise.
fn sensor_noise_m_s2(passages: &[SitePassage]) -> f64 {
    let density: Vec<f64> = passages.iter().map(|p| p.recording.quiet_density_m2_s3()).collect();
    (0.5 * GreensSampling::low().rate_hz * quantile(&density, 0.5)).sqrt()
}
