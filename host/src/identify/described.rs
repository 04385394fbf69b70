//! Whether the panel is as crossing.toml has it. Forces are estimated on any description, with narrow intervals and without a large
//! residual: ballast, profile and prior take over what does not fit. The evidence of one train tells the descriptions apart.

use std::fmt;
use std::sync::Arc;

use rayon::prelude::*;

use super::spread_out;
use crate::ballast::BallastParameters;
use crate::ballast::evidence::{Calibration, EvidenceProblem, USUAL_TEMPERATURE};
use crate::ballast::low_track::LowTrack;
use crate::ballast::quasi_static::{QuasiStatic, QuasiStaticFit};
use crate::inverse::hierarchy::SitePassage;
use crate::reconstruct::{Recording, Timing};
use crate::recording::{Crossing, TrafficDirection};
use crate::signal::mean;
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
            Self::Direction(way) => {
                let towards = if way.sign() > 0.0 { '+' } else { '-' };
                let described = way.reversed();
                write!(
                    f,
                    "trains run {way} (towards {towards}x), not {described}: see traffic_direction in crossing.toml"
                )
            }
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
/// What it leaves at most of that which the description of crossing.toml leaves. Where both explain a train alike, what speaks for the
/// other is only that forces are where the prior has them: up to 91 nats on six simulated panels whose rail is the same everywhere, or
/// whose sleepers stand elsewhere than on the 72 sites, with 0.95 to 1.7 of it left; a seventh left 0.5 to 1.1 to the other direction. Of
/// wrong descriptions of the reference recordings the right one leaves 0.07 to 0.59.
const LEAVES: f64 = 0.7;
/// A glance, with the rough ballast held, rules another description out that has this much less evidence than the one of crossing.toml,
/// nats: the first where that one leaves no more of the train than stands beside it, the second whatever it leaves. Right descriptions
/// are at most 63 and 207 behind wrong ones that are found on these sites.
const GLANCE_EXPLAINED: (f64, f64) = (100.0, 1.0);
const GLANCE_PLAIN: f64 = 300.0;
/// Trains that are asked once one prefers another description, and the share of them that must.
const JURY: usize = 8;
const AGREED: f64 = 0.8;

/// A train to judge by: its recording, speed in m/s and static wheel force in newtons.
pub type Heard<'r> = (&'r Recording, f64, f64);

/// Descriptions of a panel that are to be told apart.
pub struct Descriptions<'a> {
    pub(super) pattern: &'a AxlePattern,
    pub(super) described: Panel,
    others: Vec<Other>,
}

/// A panel as it may be described.
pub(super) struct Panel {
    /// Track on any ballast.
    pub(super) track: Arc<LowTrack>,
    /// Of traffic.
    pub(super) direction: TrafficDirection,
}

/// What would be otherwise, and the panel with it.
type Other = (Misdescription, Panel);

/// Ballast while a train is asked: as it is, or to be found with everything else, which costs four times as much.
#[derive(Clone, Copy)]
enum Ballast {
    Held,
    Free,
}

/// What a train says of a description.
#[derive(Clone, Copy)]
struct Evidence {
    log_evidence: f64,
    misfit: f64,
}

impl Evidence {
    /// Of descriptions on which the estimate breaks down.
    const NONE: Self = Self { log_evidence: f64::NEG_INFINITY, misfit: f64::INFINITY };

    fn preferred_to(&self, described: &Self) -> bool {
        self.misfit <= EXPLAINS
            && self.misfit <= LEAVES * described.misfit
            && self.log_evidence > described.log_evidence + PLAIN
    }

    fn rules_out(&self, other: &Self) -> bool {
        let (explained, misfit) = GLANCE_EXPLAINED;
        let plain = if self.misfit <= misfit { explained } else { GLANCE_PLAIN };
        self.log_evidence > other.log_evidence + plain
    }
}

impl<'a> Descriptions<'a> {
    /// The panel of crossing.toml, and those that it could have been meant to be.
    pub fn new(crossing: &Crossing, pattern: &'a AxlePattern) -> Self {
        let track = Arc::new(LowTrack::of_crossing(crossing));
        let others = others(crossing, &track);
        Self { pattern, described: Panel { track, direction: crossing.traffic_direction }, others }
    }

    /// The track of crossing.toml on any ballast.
    pub fn track(&self) -> &LowTrack {
        &self.described.track
    }

    /// What the usual train would have otherwise on about this ballast, if that is plain.
    pub fn suspicion(&self, trains: &[Heard], rough: &BallastParameters) -> Option<Misdescription> {
        let train = usual(trains)?;
        let all: Vec<&Other> = self.others.iter().collect();
        let (described, glances) = self.of_each(Ballast::Held, &all, rough, train);
        let left = all.into_iter().zip(&glances).filter(|(_, other)| !described.rules_out(other));
        let left: Vec<&Other> = left.map(|(other, _)| other).collect();
        if left.is_empty() {
            return None;
        }
        let (described, others) = self.of_each(Ballast::Free, &left, rough, train);
        let preferred = left.iter().zip(&others).filter(|(_, other)| other.preferred_to(&described));
        preferred.max_by(|(_, a), (_, b)| a.log_evidence.total_cmp(&b.log_evidence)).map(|(other, _)| other.0)
    }

    /// Whether the usual train makes sense, on whichever panel, with the sensor upside down.
    pub fn explain_inverted(&self, trains: &[Heard]) -> bool {
        let Some((recording, speed_m_s, static_force_n)) = usual(trains) else { return false };
        let inverted = recording.inverted();
        let train = (&inverted, speed_m_s, static_force_n);
        let others: Vec<&Other> = self.others.iter().collect();
        let start = self.quasi_static(&[train]).start_of_evidence();
        let (described, others) = self.of_each(Ballast::Free, &others, &start, train);
        others.iter().chain([&described]).any(|e| e.misfit <= EXPLAINS)
    }

    /// Evidence of one train for the panel of crossing.toml and for some others.
    fn of_each(
        &self,
        ballast: Ballast,
        others: &[&Other],
        start: &BallastParameters,
        train: Heard,
    ) -> (Evidence, Vec<Evidence>) {
        let of = |panel: &Panel| self.evidence(ballast, panel, start, train);
        rayon::join(|| of(&self.described), || others.par_iter().map(|(_, panel)| of(panel)).collect())
    }

    /// Whether most trains would have it like that, too; one may be spoilt.
    pub fn confirmed(&self, suspicion: Misdescription, trains: &[Heard]) -> bool {
        let Some(other) = self.others.iter().find(|(what, _)| *what == suspicion) else { return false };
        let jury = spread_out(trains, JURY);
        let agreed = jury.par_iter().filter(|train| self.prefers(other, **train)).count();
        agreed as f64 >= AGREED * jury.len() as f64
    }

    /// Whether a train runs in the direction of crossing.toml on about this ballast, where that is plain.
    pub(super) fn runs_as_described(&self, train: Heard, rough: &BallastParameters) -> Option<bool> {
        let other = self.others.iter().find(|(what, _)| matches!(what, Misdescription::Direction(_)))?;
        let [described, other] = self.pair(other, rough, train);
        match (described.preferred_to(&other), other.preferred_to(&described)) {
            (false, false) => None,
            (as_described, _) => Some(as_described),
        }
    }

    /// Whether a train prefers another description plainly.
    fn prefers(&self, other: &Other, train: Heard) -> bool {
        let start = self.quasi_static(&[train]).start_of_evidence();
        let [described, other] = self.pair(other, &start, train);
        other.preferred_to(&described)
    }

    /// Evidence of one train for the panel of crossing.toml and for another.
    fn pair(&self, (_, other): &Other, start: &BallastParameters, train: Heard) -> [Evidence; 2] {
        let of = |panel: &Panel| self.evidence(Ballast::Free, panel, start, train);
        rayon::join(|| of(&self.described), || of(other)).into()
    }

    /// Ballast and axle times on which the sleeper sinks as under some trains: much the same whatever the description.
    pub fn quasi_static(&self, trains: &[Heard]) -> QuasiStaticFit {
        let Panel { track, direction } = &self.described;
        QuasiStatic::new(&track.track, direction.sign(), self.pattern, trains).fit(BallastParameters::NOMINAL)
    }

    /// Evidence of one train near a ballast, with nothing known of the forces; none where the estimate breaks down.
    fn evidence(&self, ballast: Ballast, panel: &Panel, start: &BallastParameters, train: Heard) -> Evidence {
        let (track, direction) = (panel.track.as_ref(), panel.direction.sign());
        let first_axle_s = QuasiStatic::new(&track.track, direction, self.pattern, &[train]).align(start);
        let (recording, speed_m_s, static_force_n) = train;
        let passage = |first_axle_s: &f64| SitePassage {
            recording,
            timing: Timing { speed_m_s, first_axle_s: *first_axle_s },
            static_force_n,
        };
        let passages: Vec<SitePassage> = first_axle_s.iter().map(passage).collect();
        let state = Calibration::starting(*start, direction);
        let problem =
            EvidenceProblem { track, direction, pattern: self.pattern, temperature: USUAL_TEMPERATURE };
        let found = match ballast {
            Ballast::Held => problem.posterior_held(&state, &passages),
            Ballast::Free => problem.posterior(&state, &passages),
        };
        found.map_or(Evidence::NONE, |p| Evidence { log_evidence: p.log_evidence, misfit: mean(&p.misfit) })
    }
}

/// The train that shakes the sleeper as much as most do: one that is spoilt says nothing.
fn usual<'r>(trains: &[Heard<'r>]) -> Option<Heard<'r>> {
    let mut sorted = trains.to_vec();
    sorted.sort_by(|a, b| a.0.max_m_s2.total_cmp(&b.0.max_m_s2));
    sorted.get(sorted.len() / 2).copied()
}

fn others(crossing: &Crossing, track: &Arc<LowTrack>) -> Vec<Other> {
    let described = crossing.traffic_direction;
    let direction = described.reversed();
    let other_way = Panel { track: Arc::clone(track), direction };
    let described_m = crossing.sensor_x_m();
    let spacing_m = crossing.track.sleeper_spacing_m;
    let on_next = [-spacing_m, spacing_m].map(|along_m| {
        let mut next = crossing.clone();
        next.track.crossing_sleeper_x_m += along_m;
        let panel = Panel { track: Arc::new(LowTrack::of_crossing(&next)), direction: described };
        (Misdescription::SensorSleeper { x_m: described_m + along_m, described_m }, panel)
    });
    std::iter::once((Misdescription::Direction(direction), other_way)).chain(on_next).collect()
}
