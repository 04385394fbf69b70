//! Trains of both directions past one sensor. The sleeper moves nearly the same whichever way a train runs: identified together, they
//! leave no more of one another than those of one direction, and all forces are wrong. Those of crossing.toml's direction are a site by
//! themselves.

use rayon::prelude::*;

use super::described::Descriptions;
use super::known::{Found, Known, hyper_passages};
use super::sound::{LEAST_PASSAGES, UNLIKE};
use super::{IdentifyError, classes};
use crate::ballast::evidence::{Calibration, EvidenceProblem};
use crate::inverse::hierarchy::SitePassage;
use crate::progress::Progress;
use crate::reconstruct::Timing;
use crate::vehicle::AxlePattern;

/// How much more evidence, nats, the front bogie of a train must have for crossing.toml's direction, the rough ballast held, to be left at
/// that.
const PLAIN: f64 = 10.0;

/// A site of trains of one direction.
pub(super) struct OneWay {
    /// Passages that it was found from.
    pub(super) used: Vec<usize>,
    /// Passages of crossing.toml's direction, and of the other one.
    pub(super) described: Vec<usize>,
    pub(super) other: Vec<usize>,
    pub(super) found: Found,
}

impl Known<'_> {
    /// Leaves the trains of the other direction out of what was found from all, where there are enough of crossing.toml's.
    pub(super) fn one_way(
        &self,
        (used, found): (Vec<usize>, Found),
        descriptions: &Descriptions,
        progress: &dyn Progress,
    ) -> Result<OneWay, IdentifyError> {
        let all: Vec<usize> = (0..self.speed_m_s.len()).collect();
        // A prior that was learnt from trains of one direction leaves much of the others: only those that it was learnt from need to be
        // asked, and what is strange under it.
        let asked = self.against(&telling(&used, &found), &found, descriptions);
        if !asked.contains(&Some(false)) {
            return Ok(OneWay { used, described: all, other: Vec::new(), found });
        }
        let answers = self.against(&all, &found, descriptions);
        let (other, described): (Vec<usize>, Vec<usize>) =
            all.iter().partition(|i| answers[**i] == Some(false));
        let sure = answers.iter().filter(|a| **a == Some(true)).count();
        if sure < LEAST_PASSAGES {
            return Ok(OneWay { used, described: all, other: Vec::new(), found });
        }
        let start = self.quasi_static_fit(&described, progress);
        let (used, found) = self.of_sound_passages(&described, start, progress)?;
        Ok(OneWay { used, described, other, found })
    }

    /// Whether each of some passages runs as described, where that is plain.
    fn against(&self, some: &[usize], found: &Found, descriptions: &Descriptions) -> Vec<Option<bool>> {
        let start = found.quasi_static.start_of_evidence();
        let bogie = self.front_bogie();
        let (ahead, back) = (self.problem.direction, -self.problem.direction);
        let state = |direction: f64| Calibration::starting(start, direction);
        let track = self.problem.low_model(&state(ahead));
        let sensor_x_m = self.problem.track.sleeper_x_m[self.problem.track.sensor_sleeper];
        let evidence = |direction: f64, i: usize| {
            // The sleeper sinks when the wheel is over the sensor, before or after x = 0 by the direction.
            let later_s = (ahead - direction) * sensor_x_m / self.speed_m_s[i];
            let first_axle_s = found.quasi_static.first_axle_s[i] + later_s;
            let passage = SitePassage {
                recording: &self.recordings[i],
                timing: Timing { speed_m_s: self.speed_m_s[i], first_axle_s },
                static_force_n: self.static_force_n[i],
            };
            let problem: EvidenceProblem = self.problem.of_trains(direction, &bogie);
            let posterior = problem.posterior_on(&track, &state(direction), &[passage]);
            posterior.map_or(f64::NEG_INFINITY, |p| p.log_evidence)
        };
        let answer = |i: &usize| {
            let margin = evidence(ahead, *i) - evidence(back, *i);
            if margin > PLAIN {
                Some(true)
            } else {
                descriptions.runs_as_described(self.heard(&[*i])[0], &start)
            }
        };
        some.par_iter().map(answer).collect()
    }

    fn front_bogie(&self) -> AxlePattern {
        let axles = self.problem.pattern.groups().first().map_or(0, |group| group.len.min(2));
        AxlePattern { offset_m: self.problem.pattern.offset_m[..axles].to_vec() }
    }
}

/// Passages that hyper-parameters were learnt from, and those that are strange under them.
fn telling(used: &[usize], found: &Found) -> Vec<usize> {
    let all = 0..found.misfit.len();
    let class = |i: &usize| classes::class_of(&found.classes, found.timings[*i].speed_m_s);
    let of_class = |c: usize| used.iter().copied().filter(|i| class(i) == c).collect::<Vec<_>>();
    let mut telling: Vec<usize> =
        all.filter(|i| !used.contains(i) || !(found.misfit[*i] <= UNLIKE)).collect();
    telling.extend(hyper_passages(used, (0..found.classes.len()).map(of_class)));
    telling.sort_unstable();
    telling.dedup();
    telling
}
