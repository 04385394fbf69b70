//! Whether the panel is as crossing.toml has it. Forces are estimated on any description, with narrow intervals and without a large
//! residual: ballast, profile and prior take over what does not fit. The evidence of one train tells the descriptions apart.

use std::fmt;

use rayon::prelude::*;

use crate::ballast::BallastParameters;
use crate::ballast::evidence::{Calibration, EvidenceProblem};
use crate::ballast::quasi_static::QuasiStatic;
use crate::inverse::hierarchy::SitePassage;
use crate::reconstruct::{Recording, Timing};
use crate::recording::{Crossing, TrafficDirection};
use crate::signal::mean;
use crate::track::{Mesh, Track};
use crate::vehicle::AxlePattern;

/// What crossing.toml has otherwise than the recordings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Misdescription {
    /// Trains run in this direction.
    Direction(TrafficDirection),
    /// The sleeper with the sensor is at this x and not at that of crossing.toml, metres.
    SensorSleeper {
        /// By the recordings.
        x_m: f64,
        /// In crossing.toml.
        described_m: f64,
    },
}

impl fmt::Display for Misdescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Direction(TrafficDirection::Facing) => f.write_str(
                "trains run facing (towards +x), not trailing: see traffic_direction in crossing.toml",
            ),
            Self::Direction(TrafficDirection::Trailing) => f.write_str(
                "trains run trailing (towards -x), not facing: see traffic_direction in crossing.toml",
            ),
            Self::SensorSleeper { x_m, described_m } => write!(
                f,
                "the sensor is on a sleeper near x = {x_m:.1} m, not at {described_m:.1} m: see crossing_sleeper_x_m and sleeper_index in \
                 crossing.toml"
            ),
        }
    }
}

/// How much more evidence of a train, nats, another description must have to be preferred. On 72 recorded and simulated sites that are as
/// described, whatever acts on them, no other one that explains the train comes nearer to the right one than 45.
const PLAIN: f64 = 20.0;
/// What a description that explains a train leaves of it at most, squared, per value and in units of what it expects to leave. Right ones
/// leave 0.1 to 0.5 before anything is known of the site, those that are preferred by chance (noise, voids, interference) 0.9 and more.
const EXPLAINS: f64 = 0.7;
/// Trains that are asked once one prefers another description, and the share of them that must.
const JURY: usize = 8;
const AGREED: f64 = 0.8;

/// A train to judge by: its recording, speed in m/s and static wheel force in newtons.
pub type Heard<'r> = (&'r Recording, f64, f64);

/// Descriptions of a panel that are to be told apart.
pub struct Descriptions<'a> {
    pattern: &'a AxlePattern,
    described: Crossing,
    others: Vec<(Misdescription, Crossing)>,
}

/// What a train says of a description.
#[derive(Clone, Copy)]
struct Evidence {
    log_evidence: f64,
    misfit: f64,
}

impl Evidence {
    fn preferred_to(&self, described: &Self) -> bool {
        self.misfit <= EXPLAINS && self.log_evidence > described.log_evidence + PLAIN
    }
}

impl<'a> Descriptions<'a> {
    /// The panel of crossing.toml, and those that it could have been meant to be.
    pub fn new(crossing: &Crossing, pattern: &'a AxlePattern) -> Self {
        Self { pattern, described: crossing.clone(), others: others(crossing) }
    }

    /// What the usual train would have otherwise, if that is plain.
    pub fn suspicion(&self, trains: &[Heard]) -> Option<Misdescription> {
        let evidence = self.of_all(usual(trains)?);
        let (described, others) = evidence.split_first()?;
        let preferred = self.others.iter().zip(others).filter(|(_, other)| other.preferred_to(described));
        preferred
            .max_by(|(_, a), (_, b)| a.log_evidence.total_cmp(&b.log_evidence))
            .map(|((what, _), _)| *what)
    }

    /// Whether the usual train makes sense, on whichever panel, with the sensor upside down.
    pub fn explain_inverted(&self, trains: &[Heard]) -> bool {
        let Some((recording, speed_m_s, static_force_n)) = usual(trains) else { return false };
        let evidence = self.of_all((&recording.inverted(), speed_m_s, static_force_n));
        evidence.iter().any(|e| e.misfit <= EXPLAINS)
    }

    /// Evidence of one train for the panel of crossing.toml and for the others.
    fn of_all(&self, train: Heard) -> Vec<Evidence> {
        let start = self.rough_ballast(train);
        let panels: Vec<&Crossing> =
            std::iter::once(&self.described).chain(self.others.iter().map(|(_, panel)| panel)).collect();
        panels.par_iter().map(|panel| self.evidence(panel, &start, train)).collect()
    }

    /// Whether most trains would have it like that, too; one may be spoilt.
    pub fn confirmed(&self, suspicion: Misdescription, trains: &[Heard]) -> bool {
        let Some((_, other)) = self.others.iter().find(|(what, _)| *what == suspicion) else { return false };
        let jury: Vec<Heard> = trains.iter().step_by(trains.len().div_ceil(JURY).max(1)).copied().collect();
        let for_it = |train: &&Heard| {
            let start = self.rough_ballast(**train);
            let of = |panel| self.evidence(panel, &start, **train);
            of(other).preferred_to(&of(&self.described))
        };
        jury.par_iter().filter(for_it).count() as f64 >= AGREED * jury.len() as f64
    }

    /// Ballast on which the sleeper sinks as deep: much the same whatever the description.
    fn rough_ballast(&self, train: Heard) -> BallastParameters {
        let track = Track::of_crossing(&self.described, Mesh::default());
        let direction = self.described.traffic_direction.sign();
        let fit = QuasiStatic::new(&track, direction, self.pattern, &[train]).fit(BallastParameters::NOMINAL);
        fit.start_of_evidence()
    }

    /// Evidence of one train near a ballast, with nothing known of the forces; none where the estimate breaks down.
    fn evidence(&self, panel: &Crossing, start: &BallastParameters, train: Heard) -> Evidence {
        let direction = panel.traffic_direction.sign();
        let track = Track::of_crossing(panel, Mesh::default());
        let first_axle_s = QuasiStatic::new(&track, direction, self.pattern, &[train]).align(start);
        let (recording, speed_m_s, static_force_n) = train;
        let passage = |first_axle_s: &f64| SitePassage {
            recording,
            timing: Timing { speed_m_s, first_axle_s: *first_axle_s },
            static_force_n,
        };
        let passages: Vec<SitePassage> = first_axle_s.iter().map(passage).collect();
        let state = Calibration::starting(*start, direction);
        let problem = EvidenceProblem::new(&track, direction, self.pattern, &panel.vehicle);
        match problem.posterior(&state, &passages) {
            Ok(p) => Evidence { log_evidence: p.log_evidence, misfit: mean(&p.misfit) },
            Err(_) => Evidence { log_evidence: f64::NEG_INFINITY, misfit: f64::INFINITY },
        }
    }
}

/// The train that shakes the sleeper as much as most do: one that is spoilt says nothing.
fn usual<'r>(trains: &[Heard<'r>]) -> Option<Heard<'r>> {
    let mut sorted = trains.to_vec();
    sorted.sort_by(|a, b| a.0.max_m_s2.total_cmp(&b.0.max_m_s2));
    sorted.get(sorted.len() / 2).copied()
}

fn others(crossing: &Crossing) -> Vec<(Misdescription, Crossing)> {
    let direction = match crossing.traffic_direction {
        TrafficDirection::Facing => TrafficDirection::Trailing,
        TrafficDirection::Trailing => TrafficDirection::Facing,
    };
    let other_way = Crossing { traffic_direction: direction, ..crossing.clone() };
    let described_m = crossing.sensor_x_m();
    let spacing_m = crossing.track.sleeper_spacing_m;
    let on_next = [-spacing_m, spacing_m].map(|along_m| {
        let mut next = crossing.clone();
        next.track.crossing_sleeper_x_m += along_m;
        (Misdescription::SensorSleeper { x_m: described_m + along_m, described_m }, next)
    });
    std::iter::once((Misdescription::Direction(direction), other_way)).chain(on_next).collect()
}
