//! What a site does not allow to tell, and whether effects may be looked for at all.

use rayon::prelude::*;

use super::{PATH_PRIOR, Session};
use crate::ballast::evidence::Unknown;
use crate::gap::GapError;
use crate::gap::base::{Base, Given, LEAST_SPEED_M_S, base, missed_at_best};
use crate::gap::consistency::Strangers;
use crate::gap::data::{Observed, energies};
use crate::gap::fit::simulate;
use crate::gap::forward::Response;
use crate::gap::measure::ALIGN_M;
use crate::gap::world::{SensorModel, World};
use crate::identify::{Descriptions, Heard, Misdescription};
use crate::recording::{Site, TrafficDirection};
use crate::signal::quantile;
use crate::track::Side;
use crate::vehicle::{AxlePattern, static_wheel_force_n};

/// Passages needed to look for an effect.
const LEAST_PASSAGES: usize = 4;
/// A scan is another crossing's when more than this part of the residual's energy is common to all wheels, when the path
/// that fits instead differs from it by this part of its own energy, and when that leaves less than this of the common part.
const FOREIGN_SCAN: (f64, f64, f64) = (0.7, 0.3, 0.5);

/// A train runs as described, whatever its direction seems to be where the path is not known, when over the scan that leaves at most this
/// part of the squares that running the other way leaves. Trains that do leave a sixth and less, those of four recorded sites whose
/// direction is turned round in crossing.toml 1.2 times and more.
const AS_DESCRIBED: f64 = 0.5;

/// What all wheels share must fall below this part by the effects found, for a scan that another path than its own replaces well
/// to be this crossing's.
const CLEARED: f64 = 0.25;

/// What stands in for errors of a path that was estimated for want of a scan: beside clipping, voids and a wrong clock, and alone.
const OF_THE_PATH: [&str; 2] = ["stock-irregularity", "wheel-flat"];

/// Passages without which a site is to be diagnosed, and why.
pub(super) struct LeftOut {
    pub passage_id: Vec<i32>,
    pub remark: String,
}

fn other_direction(other_way: &[i32], described: TrafficDirection) -> String {
    let reversed = described.reversed();
    format!(
        "passages {other_way:?} run {reversed}, not {described}: for them, diagnose a copy of the site with these passages alone and \
         traffic_direction = \"{reversed}\" in crossing.toml"
    )
}

/// Why a scan may be another crossing's, as the search begins.
pub(super) struct Doubt {
    /// Part of the energy that the model misses which is common to all wheels.
    common: f64,
    /// Squares of it, relative to the signal.
    open: f64,
    sensor: SensorModel,
}

impl Session<'_> {
    /// What the site does not allow to tell.
    pub(super) fn remark_on(&mut self, site: &Site) {
        let spread = |v: Vec<f64>| {
            let (l, h) =
                v.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(*x), h.max(*x)));
            h - l
        };
        let observed = &self.base.frame.observed;
        let mut say = |text: &str| self.remarks.push(text.into());
        let kind = &site.crossing.vehicle.kind;
        let others = site.passages.iter().filter(|p| p.train_type != *kind);
        let others: Vec<String> = others.map(|p| format!("{} ({})", p.passage_id, p.train_type)).collect();
        if !others.is_empty() {
            say(&format!(
                "passages {} are of other trains than the {kind} of crossing.toml, by whose axles they are judged: leave them out",
                others.join(", ")
            ));
        }
        if self.base.frame.unknown == Unknown::StiffnessAndDamping {
            say(&format!(
                "the recordings contradict the damping of the ballast in crossing.toml, {:.0} kNs/m² per metre of sleeper: before any effect \
                 {:.2} times as much is found with the stiffness; state damping_ns_m2 if you know better",
                1e-3 * site.crossing.ballast.damping_ns_m2,
                self.base.fit.state.ballast().damping_factor
            ));
        }
        if observed.len() < 6 {
            say(
                "few passages: effects that vary from train to train cannot be told from chance; record at least 12",
            );
        }
        if site.scan.is_none() {
            say(
                "no laser scan: load, unsprung mass and depth of the crossing trade against each other; a scan separates them",
            );
        }
        if observed.iter().all(|o| o.operator_m_s.is_none()) {
            say(
                "no speeds from the operator: a clock error of less than 1 % cannot be told from ballast; state the speeds",
            );
        }
        if observed.len() > 1 && spread(observed.iter().map(|o| o.temperature_c).collect()) < 5.0 {
            say(
                "constant temperature: a sensitivity that depends on it cannot be seen; record on days that differ by 10 K",
            );
        }
        let v: Vec<f64> = observed.iter().map(|o| o.speed_m_s).collect();
        if observed.len() > 1 && spread(v.clone()) < 0.05 * crate::signal::mean(&v) {
            say(
                "constant speed: what is fixed in time cannot be told from what is fixed along the track; record other speeds",
            );
        }
        if observed.len() > 1 && spread(observed.iter().map(|o| o.axle_load_kg).collect()) < 100.0 {
            say(
                "one axle load: voids, axle load and stiffness are told apart by their shape only; a lighter train would separate them",
            );
        }
    }

    /// Leaves out of the catalogue what errors of an estimated path pass for, and says so.
    pub(super) fn leave_out_what_passes_for_a_path(&mut self) {
        self.common.retain(|e| !OF_THE_PATH.contains(&e.name()));
        self.latent.retain(|e| !OF_THE_PATH.contains(&e.name()));
        self.remarks.push(
            "without a laser scan the path of the wheels was estimated, from which a defect of the stock rail and flats cannot be \
             told: they are not looked for"
                .into(),
        );
    }

    /// Whether passages do not resemble one another.
    pub(super) fn mixed(&self) -> bool {
        !Strangers::among(&self.base.frame.observed).passage_id.is_empty()
    }

    /// Whether the panel is as crossing.toml has it. What is wrong is said.
    pub(super) fn well_described(&mut self, site: &Site) -> Result<bool, GapError> {
        let crossing = &site.crossing;
        let pattern = AxlePattern::of_vehicle(&crossing.vehicle);
        let force_n = |o: &Observed| static_wheel_force_n(o.axle_load_kg, crossing.vehicle.gravity_m_s2);
        let trains: Vec<Heard> =
            self.base.frame.observed.iter().map(|o| (&o.recording, o.speed_m_s, force_n(o))).collect();
        let descriptions = Descriptions::new(crossing, &pattern);
        let quasi_static = descriptions.quasi_static(&trains);
        let rough = quasi_static.start_of_evidence();
        let suspicion =
            descriptions.suspicion(&trains, &rough).filter(|s| descriptions.confirmed(*s, &trains));
        if let Some(wrong) = self.left_by_the_scan(suspicion, site)? {
            self.follows_from(format!("{wrong}; no effect is looked for, correct it and diagnose again"));
            return Ok(false);
        }
        let mut directions = descriptions.directions(&trains, &quasi_static.first_axle_s, &rough);
        let other_way: Vec<usize> = (0..directions.len()).filter(|i| directions[*i] == Some(false)).collect();
        for (i, as_described) in other_way.iter().zip(self.as_described_by_the_scan(&other_way, site)?) {
            if as_described {
                directions[*i] = Some(true);
            }
        }
        Ok(self.of_one_direction(&directions, crossing.traffic_direction))
    }

    /// What is wrong with the description, unless it is the direction and the scan shows of most passages that trains run as described.
    fn left_by_the_scan(
        &self,
        suspicion: Option<Misdescription>,
        site: &Site,
    ) -> Result<Option<Misdescription>, GapError> {
        if !matches!(suspicion, Some(Misdescription::Direction(_))) {
            return Ok(suspicion);
        }
        let answers = self.as_described_by_the_scan(self.search, site)?;
        let as_described = answers.iter().filter(|a| **a).count();
        Ok(suspicion.filter(|_| 2 * as_described <= answers.len()))
    }

    /// Of which passages the scan shows that trains run as described. Without one a train's direction is only where the forces lie on one
    /// side of the sensor, and a transition far from where they usually are looks like one that is run over from the other side.
    fn as_described_by_the_scan(&self, passages: &[usize], site: &Site) -> Result<Vec<bool>, GapError> {
        if site.scan.is_none() {
            return Ok(vec![false; passages.len()]);
        }
        let frame = &self.base.frame;
        let mut described = self.base.fit.state.world(frame, &[]);
        // What the fit has added to the scan makes up for the direction.
        described.path.deviation = frame.base.path.deviation.clone();
        let direction = described.crossing.traffic_direction;
        let mut reversed = described.clone();
        reversed.crossing.traffic_direction = direction.reversed();
        // The sleeper sinks when the wheel is over the sensor: before or after x = 0, by the direction.
        let later_m = 2.0 * direction.sign() * site.crossing.sensor_x_m();
        let runs_as_described = |i: &usize| {
            let o = &frame.observed[*i];
            let first_axle_s = o.first_axle_s + later_m / o.speed_m_s;
            let other_way = missed_at_best(&reversed, Observed { first_axle_s, ..o.clone() })?;
            Ok(missed_at_best(&described, o.clone())? <= AS_DESCRIBED * other_way)
        };
        passages.par_iter().map(runs_as_described).collect()
    }

    /// Says what all else that departs from the model follows from.
    fn follows_from(&mut self, remark: String) {
        (self.misdescribed, self.untrusted) = (true, true);
        self.remarks.insert(0, remark);
    }

    /// Whether no train plainly runs the other way. Those that do are left out where enough others plainly run as described, and named
    /// as what nothing can be told from otherwise.
    fn of_one_direction(&mut self, as_described: &[Option<bool>], described: TrafficDirection) -> bool {
        let trains = self.base.frame.observed.iter().zip(as_described);
        let other: Vec<i32> = trains
            .filter(|(_, as_described)| **as_described == Some(false))
            .map(|(o, _)| o.passage_id)
            .collect();
        if other.is_empty() {
            return true;
        }
        if as_described.iter().filter(|a| **a == Some(true)).count() >= LEAST_PASSAGES {
            let remark = format!("{}; they are left out", other_direction(&other, described));
            self.left_out = Some(LeftOut { passage_id: other, remark });
        } else {
            self.follows_from(format!("{}; no effect is looked for", other_direction(&other, described)));
        }
        false
    }

    /// Whether there is enough, and one crossing only, to look for effects in. What is wrong is said.
    pub(super) fn trustworthy(&mut self, site: &Site) -> bool {
        let observed = &self.base.frame.observed;
        if observed.len() < LEAST_PASSAGES {
            self.remarks.push(format!(
                "{} passages: no effect is looked for, chance would name one; record at least {LEAST_PASSAGES}",
                observed.len()
            ));
            return false;
        }
        let slow: Vec<i32> =
            observed.iter().filter(|o| o.speed_m_s < LEAST_SPEED_M_S).map(|o| o.passage_id).collect();
        if !slow.is_empty() {
            self.remarks.push(format!(
                "passages {slow:?} are slower than {LEAST_SPEED_M_S} m/s: wheels differ there by waves shorter than the model holds; no \
                 effect is looked for, leave them out"
            ));
            return false;
        }
        let strangers = Strangers::among(observed);
        if strangers.matter() {
            self.untrusted = true;
            self.remarks.push(format!(
                "passages {:?} do not resemble the others: recordings of more than one crossing, direction or sensor position; \
                 sort them, no effect is looked for",
                strangers.passage_id
            ));
            return false;
        }
        // Clipping makes strangers of recordings of the same trains.
        let few_left = observed.len() < LEAST_PASSAGES + strangers.passage_id.len();
        if !strangers.passage_id.is_empty() && !few_left && self.clips_at_m_s2.is_none() {
            let passage_id = strangers.passage_id;
            let remark = format!(
                "passages {passage_id:?} do not resemble the others: other trains, another place, or damaged recordings; they are left out, \
                 look at them"
            );
            self.left_out = Some(LeftOut { passage_id, remark });
            return false;
        }
        if site.scan.is_none() && observed.iter().all(|o| o.operator_m_s.is_none()) {
            self.remarks.push(
                "neither a laser scan nor speeds: path, load and clock take over from one another; no effect is looked for, add \
                 one of the two"
                    .into(),
            );
            return false;
        }
        true
    }

    /// Why the scan may be another crossing's: what the model misses over it is common to all wheels.
    pub(super) fn doubt_of_scan(&self) -> Result<Option<Doubt>, GapError> {
        let common = self.common_to_wheels(self.base).unwrap_or(0.0);
        if common < FOREIGN_SCAN.0 {
            return Ok(None);
        }
        Ok(Some(Doubt { common, open: self.shared_squares()?, sensor: self.base.frame.base.sensor }))
    }

    /// Takes back what the search has found where the scan must be another crossing's: what was found accounts for little, and another path
    /// predicts the recordings far better. `before`: the model before the search.
    pub(super) fn settle_doubt(
        &mut self,
        doubt: &Doubt,
        site: &Site,
        before: &World,
    ) -> Result<(), GapError> {
        if self.shared_squares()? < CLEARED * doubt.open || !self.scan_is_foreign(doubt, site, before) {
            return Ok(());
        }
        self.remarks.push(
            "the laser scan does not belong to these recordings: without it they are predicted far better, over another path, and \
             no effect accounts for it; scan again"
                .into(),
        );
        (self.foreign_scan, self.untrusted) = (true, true);
        self.forget_search();
        Ok(())
    }

    /// Squares of the training passages' residual that all wheels share, relative to the signal.
    pub(super) fn shared_squares(&self) -> Result<f64, GapError> {
        let [acceleration, _] = self.missed()?;
        Ok((acceleration.all - acceleration.own).max(0.0))
    }

    /// Part of the energy of what a base model misses of the searched passages that is common to all wheels, median; none where that
    /// cannot be simulated.
    fn common_to_wheels(&self, base: &Base) -> Option<f64> {
        let world = base.fit.state.world(&base.frame, &[]);
        let responses = simulate(&world, &base.frame, self.search).ok()?;
        let part = |(i, response): (&usize, &Response)| {
            let o = &base.frame.observed[*i];
            let (all, shared) = energies(&o.window_residuals(response, 1.0, o.lag(response, 1.0, ALIGN_M)));
            shared / all.max(f64::MIN_POSITIVE)
        };
        Some(quantile(&self.search.iter().zip(&responses).map(part).collect::<Vec<_>>(), 0.5))
    }

    /// Whether another path than the scan's predicts the recordings far better.
    fn scan_is_foreign(&self, doubt: &Doubt, site: &Site, before: &World) -> bool {
        let bare = Site { scan: None, ..site.clone() };
        let given = Given::recorder(doubt.sensor);
        let Ok(free) = base(&bare, self.search, self.search, &PATH_PRIOR, &given) else {
            return false;
        };
        let world = free.fit.state.world(&free.frame, &[]);
        let (mut off, mut own) = (0.0, 0.0);
        for k in -40..=40 {
            let x = 0.3 + 0.01 * f64::from(k);
            let (a, b) = (before.path.scan.at(x), world.path.at(Side::Crossing, x));
            off += (a - b).powi(2);
            own += a * a;
        }
        let better = |common: f64| common < FOREIGN_SCAN.2 * doubt.common;
        off > FOREIGN_SCAN.1 * own && self.common_to_wheels(&free).is_some_and(better)
    }
}
