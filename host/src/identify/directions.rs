//! Trains of both directions past one sensor. The sleeper moves nearly the same whichever way a train runs: identified together, they
//! leave no more of one another than those of one direction, and all forces are wrong. Those of crossing.toml's direction are a site by
//! themselves.

use rayon::prelude::*;

use super::described::{Descriptions, Heard};
use super::known::{Found, Known, hyper_passages};
use super::sound::{LEAST_PASSAGES, UNLIKE};
use super::{IdentifyError, classes, spread_out};
use crate::ballast::BallastParameters;
use crate::ballast::evidence::{Calibration, EvidenceProblem, USUAL_TEMPERATURE};
use crate::inverse::hierarchy::SitePassage;
use crate::progress::Progress;
use crate::reconstruct::Timing;
use crate::vehicle::AxlePattern;

/// How much more evidence, nats, the front bogie of a train must have for crossing.toml's direction, the rough ballast held, to be left at
/// that. On 40 recorded and simulated sites those that the model explains have 44 and more; slow trains, of 15 m/s, about none.
const PLAIN: f64 = 10.0;

/// Of the other trains as many are asked at first by all that they say, and all only where one of these runs the other way: where the
/// model explains none, it is many, and no use.
const FEW: usize = 6;

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
        let asked = self.directions(&telling(&used, &found), &found, descriptions);
        if !asked.contains(&Some(false)) {
            return Ok(OneWay { used, described: all, other: Vec::new(), found });
        }
        let answers = self.directions(&all, &found, descriptions);
        let (other, described): (Vec<usize>, Vec<usize>) =
            all.iter().partition(|i| answers[**i] == Some(false));
        let sure = answers.iter().filter(|a| **a == Some(true)).count();
        if sure < LEAST_PASSAGES {
            return Ok(OneWay { used, described: all, other: Vec::new(), found });
        }
        if !other.iter().any(|i| used.contains(i)) {
            return Ok(OneWay { used, described, other, found });
        }
        let start = self.start(&described, progress);
        let (used, found) = self.of_sound_passages(&described, start, progress)?;
        Ok(OneWay { used, described, other, found })
    }

    /// Whether each of some passages runs as described, where that is plain.
    fn directions(&self, some: &[usize], found: &Found, descriptions: &Descriptions) -> Vec<Option<bool>> {
        let first_axle_s: Vec<f64> = some.iter().map(|i| found.start.quasi_static.first_axle_s[*i]).collect();
        descriptions.directions(&self.heard(some), &first_axle_s, &found.start.ballast())
    }
}

impl Descriptions<'_> {
    /// Whether each train runs in the direction of crossing.toml, where that is plain, from the times of the first axles and about the
    /// ballast on which the sleeper sinks as deep as theirs make it.
    pub fn directions(
        &self,
        trains: &[Heard],
        first_axle_s: &[f64],
        rough: &BallastParameters,
    ) -> Vec<Option<bool>> {
        let (track, described) = (self.track(), self.described.direction);
        let bogie = front_bogie(self.pattern);
        let ways = [described, described.reversed()].map(|way| {
            let problem = EvidenceProblem {
                track,
                direction: way.sign(),
                pattern: &bogie,
                temperature: USUAL_TEMPERATURE,
            };
            (problem, Calibration::starting(*rough, way.sign()))
        });
        let sensor_x_m = track.track.sleeper_x_m[track.track.sensor_sleeper];
        let margin = |(recording, speed_m_s, static_force_n): Heard, first_axle_s: f64| {
            let [ahead, back] = ways.each_ref().map(|(problem, state)| {
                // The sleeper sinks when the wheel is over the sensor: before or after x = 0, by the direction.
                let later_s = (described.sign() - problem.direction) * sensor_x_m / speed_m_s;
                let timing = Timing { speed_m_s, first_axle_s: first_axle_s + later_s };
                let passage = SitePassage { recording, timing, static_force_n };
                let posterior = problem.posterior_held(state, &[passage]);
                posterior.map_or(f64::NEG_INFINITY, |p| p.log_evidence)
            });
            ahead - back
        };
        let plain: Vec<bool> = trains
            .par_iter()
            .zip(first_axle_s)
            .map(|(train, time_s)| margin(*train, *time_s) > PLAIN)
            .collect();
        let unsure: Vec<usize> = (0..trains.len()).filter(|i| !plain[*i]).collect();
        let ask = |i: &usize| self.runs_as_described(trains[*i], rough);
        let some_run_back = spread_out(&unsure, FEW).par_iter().any(|i| ask(i) == Some(false));
        let of = |i: usize| match plain[i] {
            true => Some(true),
            false if some_run_back => ask(&i),
            false => None,
        };
        (0..trains.len()).into_par_iter().map(of).collect()
    }
}

fn front_bogie(pattern: &AxlePattern) -> AxlePattern {
    let axles = pattern.groups().first().map_or(0, |group| group.len.min(2));
    AxlePattern { offset_m: pattern.offset_m[..axles].to_vec() }
}

/// Passages that hyper-parameters were learnt from, and those that are strange under them.
fn telling(used: &[usize], found: &Found) -> Vec<usize> {
    let explained = |i: &usize| used.contains(i) && found.misfit[*i] <= UNLIKE;
    let class = |i: &usize| classes::class_of(&found.classes, found.timings[*i].speed_m_s);
    let of_class = |c: usize| used.iter().copied().filter(|i| class(i) == c).collect::<Vec<_>>();
    let mut telling: Vec<usize> = (0..found.misfit.len()).filter(|i| !explained(i)).collect();
    telling.extend(hyper_passages(used, (0..found.classes.len()).map(of_class)));
    telling.sort_unstable();
    telling.dedup();
    telling
}
