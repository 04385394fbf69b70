//! Time loop of one passage.

mod driven;

pub use driven::driven;

use pulp::Simd;

use super::contact::{ContactLaw, Contacts};
use super::error::{SimulationError, in_range};
use super::model::{CHUNK, Lanes, RailPoint};
use super::stepper::{Stepper, TrackState};
use super::surface::{RunningSurface, smooth_step};
use super::unit::{CONTACTS, Train, UnitState, UnitStepper, Wheel};

/// How the train moves. Position of axle i: x = direction · (first + speed t + acceleration t²/2 − offset of i).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Journey {
    /// +1 facing, −1 trailing.
    pub direction: f64,
    /// Speed at t = 0, m/s.
    pub speed_m_s: f64,
    /// m/s².
    pub acceleration_m_s2: f64,
    /// Distance run by the first axle at t = 0, measured from x = 0 in the direction of travel, m.
    pub first_m: f64,
    /// Simulated time, s.
    pub duration_s: f64,
    /// Initial state.
    pub start: Start,
}

impl Journey {
    /// Distance run by the first axle at a time, m.
    fn travelled_m(&self, time_s: f64) -> f64 {
        self.first_m + (self.speed_m_s + 0.5 * self.acceleration_m_s2 * time_s) * time_s
    }

    fn steps(&self, dt_s: f64) -> usize {
        (self.duration_s / dt_s).round() as usize
    }
}

/// State at t = 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Start {
    /// Wheels roll onto an unloaded track, which takes them over within `LEAD_IN_M` from its end.
    Quiet,
    /// Track and wheels in static equilibrium, then rolling at full speed at once.
    Static,
}

/// Length over which the track takes a wheel over from rigid ground, m: long enough not to shake the bogie.
pub const LEAD_IN_M: f64 = 3.0;

/// Contact force of one wheel along the track.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ContactTrace {
    /// x, in order of time, m.
    pub position_m: Vec<f64>,
    /// N.
    pub force_n: Vec<f64>,
}

/// What a passage leaves behind.
#[derive(Clone, Debug, PartialEq)]
pub struct PassageRecord {
    /// Step of `sensor_m`, s.
    pub dt_s: f64,
    /// Displacement of the sleeper at the sensor at t = 0, dt, …, m.
    pub sensor_m: Vec<f64>,
    /// One per wheel, as in [`Train::wheels`]; where the wheel is inside the asked range.
    pub contacts: Vec<ContactTrace>,
}

/// Everything constant during one passage.
struct Passage<'a> {
    stepper: &'a Stepper,
    train: &'a Train,
    surface: &'a RunningSurface,
    law: ContactLaw,
    journey: &'a Journey,
    /// Contact forces are kept here, x in m.
    range_m: [f64; 2],
    /// Static deflection of the track's end part under each wheel, m.
    ground_m: Vec<f64>,
}

/// A passage on its way, and what it has left behind so far.
#[derive(Clone)]
pub struct Underway {
    /// Steps done.
    step: usize,
    track: TrackState,
    units: Vec<Running>,
    at_rest: bool,
    record: PassageRecord,
}

/// One bogie on its way.
#[derive(Clone)]
struct Running {
    stepper: UnitStepper,
    state: UnitState,
    /// Rates that the static forces of the wheels add in every step.
    of_static: Lanes,
    first_wheel: usize,
    wheels: usize,
    force_n: [f64; CONTACTS],
    /// Of the step that has begun.
    contacts: [Contact; CONTACTS],
    phase: Phase,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Phase {
    Before,
    On,
    Behind,
}

/// A wheel over the rail at t + θ dt.
#[derive(Clone, Copy, Default)]
struct Contact {
    point: Option<RailPoint>,
    x_m: f64,
    /// Share of the track in carrying the wheel.
    share: f64,
    /// Approach without contact force, m.
    free_m: f64,
    /// Decrease of the approach per newton through the rail, m/N.
    rail_m_n: f64,
}

/// Share of the track in carrying a wheel: rises from its ends inwards.
#[inline(always)]
fn share([first_m, last_m]: [f64; 2], x_m: f64) -> f64 {
    smooth_step((x_m - first_m).min(last_m - x_m) / LEAD_IN_M)
}

/// Below this deflection the track has come to rest, m.
const QUIET_M: f64 = 1e-12;
/// How often rest and finiteness are looked at, steps.
const LOOK_EVERY: usize = 64;
/// Bogies whose contacts are solved at once, in neighbouring lanes.
const AT_ONCE: usize = CHUNK / CONTACTS;
/// Newton steps over the wheels of a bogie; two do unless a wheel comes back from the air.
const NEWTON_STEPS: usize = 30;
/// Change of the approach at which they stop, part of the free one. Convergence is quadratic, and a wheel feels a
/// thousandth of what changes at the others: 1e-7 of the force is left.
const APPROACH_TOLERANCE: f64 = 1e-4;

/// Simulates one passage; contact forces are kept for `range_m`.
pub fn run(
    stepper: &Stepper,
    train: &Train,
    (surface, law): (&RunningSurface, ContactLaw),
    journey: &Journey,
    range_m: [f64; 2],
) -> Result<PassageRecord, SimulationError> {
    let passage = Passage::new(stepper, train, (surface, law), journey, range_m)?;
    passage.finish(passage.start()?)
}

/// The same, halted before the first axle reaches every one of `halts_m`, travel in ascending order, metres; no contact forces.
pub fn halt(
    stepper: &Stepper,
    train: &Train,
    (surface, law): (&RunningSurface, ContactLaw),
    journey: &Journey,
    halts_m: &[f64],
) -> Result<Vec<Underway>, SimulationError> {
    let passage = Passage::new(stepper, train, (surface, law), journey, NOWHERE_M)?;
    let mut underway = passage.start()?;
    halts_m.iter().map(|at_m| passage.advance(&mut underway, *at_m).map(|()| underway.clone())).collect()
}

/// The rest of a halted passage. What the wheels have rolled over so far must be as it was; what comes may be another surface.
pub fn resume(
    stepper: &Stepper,
    train: &Train,
    (surface, law): (&RunningSurface, ContactLaw),
    journey: &Journey,
    underway: Underway,
) -> Result<PassageRecord, SimulationError> {
    Passage::new(stepper, train, (surface, law), journey, NOWHERE_M)?.finish(underway)
}

/// A range that no wheel is in.
const NOWHERE_M: [f64; 2] = [f64::INFINITY, f64::NEG_INFINITY];

fn check(
    train: &Train,
    surface: &RunningSurface,
    law: ContactLaw,
    journey: &Journey,
) -> Result<(), SimulationError> {
    train.check(surface.paths.len())?;
    match law {
        ContactLaw::Hertz(c) => in_range("Hertz constant", c, [1e8, 1e13], "N/m^1.5")?,
        ContactLaw::Linear(k) => in_range("contact stiffness", k, [1e6, 1e12], "N/m")?,
    }
    in_range("speed", journey.speed_m_s, [1.0, 150.0], "m/s")?;
    in_range("acceleration of the train", journey.acceleration_m_s2, [-5.0, 5.0], "m/s2")?;
    in_range("duration", journey.duration_s, [1e-3, 600.0], "s")?;
    let last = journey.speed_m_s + journey.acceleration_m_s2 * journey.duration_s;
    in_range("speed at the end", last, [1.0, 150.0], "m/s")
}

impl<'a> Passage<'a> {
    fn new(
        stepper: &'a Stepper,
        train: &'a Train,
        (surface, law): (&'a RunningSurface, ContactLaw),
        journey: &'a Journey,
        range_m: [f64; 2],
    ) -> Result<Self, SimulationError> {
        check(train, surface, law, journey)?;
        let wheels = train.wheels.iter().enumerate();
        let ground_m = wheels.map(|(i, w)| w.static_force_n * stepper.ground_m_n[i % 2]).collect();
        Ok(Self { stepper, train, surface, law, journey, range_m, ground_m })
    }

    fn start(&self) -> Result<Underway, SimulationError> {
        let track = self.initial_track()?;
        let mut sensor_m = vec![0.0; self.steps() + 1];
        sensor_m[0] = self.stepper.sensor_m(&track);
        let contacts = vec![ContactTrace::default(); self.train.wheels.len()];
        Ok(Underway {
            step: 0,
            track,
            units: self.initial_units()?,
            at_rest: self.journey.start == Start::Quiet,
            record: PassageRecord { dt_s: self.stepper.step.dt_s, sensor_m, contacts },
        })
    }

    /// Steps on until the first axle would be at `until_m` (travel) or the end.
    fn advance(&self, on: &mut Underway, until_m: f64) -> Result<(), SimulationError> {
        let (dt, theta) = (self.stepper.step.dt_s, self.stepper.step.theta);
        let early = self.steps_before_record();
        let end = early + self.steps();
        while on.step < end {
            let step = on.step;
            let time = (step as f64 - early as f64) * dt;
            let travelled = self.journey.travelled_m(time + theta * dt);
            if travelled >= until_m {
                break;
            }
            on.step += 1;
            let any = self.update_phases(&mut on.units, travelled);
            if on.at_rest && !any {
                continue;
            }
            on.at_rest = false;
            self.stepper.begin(&mut on.track);
            self.stepper.arch.dispatch(AllContacts {
                passage: self,
                track: &mut on.track,
                units: &mut on.units,
                travelled_m: travelled,
                traces: &mut on.record.contacts,
            });
            self.stepper.finish(&mut on.track);
            if step + 1 >= early {
                on.record.sensor_m[step + 1 - early] = self.stepper.sensor_m(&on.track);
            }
            if step.is_multiple_of(LOOK_EVERY) {
                let largest = self.stepper.largest_m(&on.track);
                if !largest.is_finite() {
                    return Err(SimulationError::Diverged { time_s: time });
                }
                on.at_rest = !any && largest < QUIET_M;
            }
        }
        Ok(())
    }

    fn finish(&self, mut on: Underway) -> Result<PassageRecord, SimulationError> {
        self.advance(&mut on, f64::INFINITY)?;
        Ok(on.record)
    }

    /// Of the record.
    fn steps(&self) -> usize {
        self.journey.steps(self.stepper.step.dt_s)
    }

    /// Steps needed before t = 0 when the first axle is already on the track by then.
    fn steps_before_record(&self) -> usize {
        if self.journey.start == Start::Static {
            return 0;
        }
        let on_track = self.journey.first_m - self.entry_m();
        (on_track.max(0.0) / self.journey.speed_m_s / self.stepper.step.dt_s).ceil() as usize
    }

    /// Distance in the direction of travel at which the track begins.
    fn entry_m(&self) -> f64 {
        let [first, last] = self.stepper.model.extent_m();
        if self.journey.direction > 0.0 { first } else { -last }
    }

    /// Whether any unit is on the track.
    fn update_phases(&self, units: &mut [Running], travelled_m: f64) -> bool {
        let [first, last] = self.stepper.model.extent_m();
        let (entry, exit) = (self.entry_m(), self.entry_m() + last - first);
        let mut any = false;
        for unit in units {
            if unit.phase == Phase::Before && travelled_m - unit.stepper.offset_m(0) >= entry {
                unit.phase = Phase::On;
            }
            if unit.phase == Phase::On && travelled_m - unit.stepper.offset_m(unit.wheels - 1) > exit {
                unit.phase = Phase::Behind;
            }
            any |= unit.phase == Phase::On;
        }
        any
    }

    /// Begins the step of one unit: its motion without contact forces, and how far each wheel would then be in the rail.
    #[inline(always)]
    fn approach<S: Simd>(&self, simd: S, track: &TrackState, unit: &mut Running, travelled_m: f64) {
        unit.stepper.begin(simd, &mut unit.state, &unit.of_static);
        for i in 0..unit.wheels {
            unit.contacts[i] = self.contact(simd, track, unit, i, travelled_m);
        }
    }

    /// Ends the step of one unit, whose contact forces are known; loads the track.
    #[inline(always)]
    fn roll_on<S: Simd>(
        &self,
        simd: S,
        track: &mut TrackState,
        unit: &mut Running,
        traces: &mut [ContactTrace],
    ) {
        unit.stepper.finish(simd, &mut unit.state, &unit.force_n[..unit.wheels]);
        for (i, contact) in unit.contacts.iter().enumerate().take(unit.wheels) {
            if let Some(point) = &contact.point {
                self.stepper.load(track, point, contact.share * unit.force_n[i]);
            }
            if contact.x_m >= self.range_m[0] && contact.x_m <= self.range_m[1] {
                let trace = &mut traces[unit.first_wheel + i];
                trace.position_m.push(contact.x_m);
                trace.force_n.push(unit.force_n[i]);
            }
        }
    }

    #[inline(always)]
    fn contact<S: Simd>(
        &self,
        simd: S,
        track: &TrackState,
        unit: &Running,
        i: usize,
        travelled_m: f64,
    ) -> Contact {
        let (wheel, side) = (unit.first_wheel + i, i % 2);
        let along = travelled_m - unit.stepper.offset_m(i);
        let x_m = self.journey.direction * along;
        let share = self.share(x_m);
        let point = if share > 0.0 { self.stepper.model.point_on(side, x_m) } else { None };
        let ahead = self.stepper.step.theta * self.stepper.step.dt_s;
        let (mut rail_m, mut rail_m_n) = (0.0, 0.0);
        if let Some(p) = &point {
            rail_m = share * (self.stepper.rail_m(track, p) + ahead * self.stepper.free_rate(simd, track, p));
            rail_m_n = share * share * (ahead * self.stepper.compliance(p) + p.local_m_n);
        }
        let surface = share * self.surface_m(&self.train.wheels[wheel], side, x_m, along);
        let ground = (1.0 - share) * self.ground_m[wheel];
        let free_m = unit.stepper.free_m(&unit.state, i) - rail_m - ground - surface;
        Contact { point, x_m, share, free_m, rail_m_n }
    }

    #[inline(always)]
    fn share(&self, x_m: f64) -> f64 {
        share(self.stepper.model.extent_m(), x_m)
    }

    /// Depth of everything the wheel rolls over, m.
    #[inline(always)]
    fn surface_m(&self, wheel: &Wheel, side: usize, x_m: f64, along_m: f64) -> f64 {
        let rail = if side == 0 {
            wheel.depth_factor * self.surface.paths[wheel.path].at(x_m - wheel.shift_m)
                + self.surface.crossing_roughness.at(x_m)
        } else {
            self.surface.stock.at(x_m)
        };
        let radius = self.train.wheel_radius_m;
        let waves: f64 = wheel
            .out_of_roundness
            .iter()
            .map(|o| o.amplitude_m * (f64::from(o.order) * along_m / radius + o.phase_rad).sin())
            .sum();
        rail + waves + wheel.flat.map_or(0.0, |f| f.at(along_m, radius))
    }

    /// Contact forces of at most [`AT_ONCE`] units, each coupled through its wheelsets.
    #[inline(always)]
    fn solve_forces<S: Simd>(&self, simd: S, units: &mut [Running]) {
        let ahead = self.stepper.step.theta * self.stepper.step.dt_s;
        let mut lanes = Contacts::default();
        for (u, unit) in units.iter().enumerate() {
            for i in 0..CONTACTS {
                let lane = u * CONTACTS + i;
                lanes.force_n[lane] = unit.force_n[i];
                lanes.compliance_m_n[lane] =
                    ahead * unit.stepper.compliance[i][i] + unit.contacts[i].rail_m_n;
            }
        }
        for newton_step in 0..NEWTON_STEPS {
            for (u, unit) in units.iter().enumerate() {
                for i in 0..CONTACTS {
                    let lane = u * CONTACTS + i;
                    let through_others: f64 = (0..CONTACTS)
                        .map(|j| unit.stepper.others[i][j] * lanes.force_n[u * CONTACTS + j])
                        .sum();
                    lanes.free_m[lane] = unit.contacts[i].free_m - ahead * through_others;
                    if newton_step == 0 {
                        lanes.approach_m[lane] =
                            lanes.free_m[lane] - lanes.compliance_m_n[lane] * lanes.force_n[lane];
                    }
                }
            }
            let before = lanes.approach_m;
            self.law.newton(simd, &mut lanes);
            let still = |i: usize| {
                (lanes.approach_m[i] - before[i].max(0.0)).abs() <= APPROACH_TOLERANCE * lanes.free_m[i].abs()
            };
            if (0..CHUNK).all(still) {
                break;
            }
        }
        for (unit, force_n) in units.iter_mut().zip(lanes.force_n.chunks_exact(CONTACTS)) {
            unit.force_n.copy_from_slice(force_n);
        }
    }

    fn initial_track(&self) -> Result<TrackState, SimulationError> {
        if self.journey.start == Start::Quiet {
            return Ok(self.stepper.at_rest());
        }
        let mut loads = Vec::new();
        let mut first_wheel = 0;
        for unit in &self.train.units {
            for i in 0..unit.wheels() {
                let x = self.journey.direction * (self.journey.first_m - unit.contact_offset_m(i));
                if let Some(point) = self.stepper.model.point_on(i % 2, x) {
                    loads.push((point, self.share(x) * self.train.wheels[first_wheel + i].static_force_n));
                }
            }
            first_wheel += unit.wheels();
        }
        self.stepper.static_state(&loads)
    }

    fn initial_units(&self) -> Result<Vec<Running>, SimulationError> {
        let track = self.initial_track()?;
        let mut first_wheel = 0;
        let mut units = Vec::with_capacity(self.train.units.len());
        for unit in &self.train.units {
            let stepper = UnitStepper::new(unit, self.stepper.step)?;
            let mut height = [0.0; CONTACTS];
            let mut force_n = [0.0; CONTACTS];
            for i in 0..unit.wheels() {
                let wheel = &self.train.wheels[first_wheel + i];
                force_n[i] = wheel.static_force_n;
                height[i] = self.law.approach_m(wheel.static_force_n) + self.ground_m[first_wheel + i];
                if self.journey.start == Start::Static {
                    let along = self.journey.first_m - unit.contact_offset_m(i);
                    let x = self.journey.direction * along;
                    let share = self.share(x);
                    let rail = self
                        .stepper
                        .model
                        .point_on(i % 2, x)
                        .map_or(0.0, |p| self.stepper.rail_m(&track, &p));
                    height[i] += share
                        * (rail - self.ground_m[first_wheel + i] + self.surface_m(wheel, i % 2, x, along));
                }
            }
            let wheels = unit.wheels();
            let state = stepper.at_rest(&height[..wheels]);
            // Before anything rolls the contacts carry what rests on them.
            let of_static = stepper.rates_of(&force_n[..wheels]);
            let contacts = [Contact::default(); CONTACTS];
            units.push(Running {
                stepper,
                state,
                of_static,
                first_wheel,
                wheels,
                force_n,
                contacts,
                phase: Phase::Before,
            });
            first_wheel += wheels;
        }
        Ok(units)
    }
}

/// The contacts of one step, compiled for the widest vectors of the machine like the rest of the step.
struct AllContacts<'a, 'b> {
    passage: &'a Passage<'b>,
    track: &'a mut TrackState,
    units: &'a mut [Running],
    travelled_m: f64,
    traces: &'a mut [ContactTrace],
}

impl pulp::WithSimd for AllContacts<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        // Front to rear, so that those on the track follow one another.
        let on = |unit: &Running| unit.phase == Phase::On;
        let first = self.units.iter().position(on).unwrap_or(0);
        let units = &mut self.units[first..];
        let count = units.iter().position(|unit| !on(unit)).unwrap_or(units.len());
        let units = &mut units[..count];
        // All approaches before any load: what one bogie does to the rail under another within a step is below the cut of the
        // influence, and looking for it would make each wait for the one before.
        for unit in &mut *units {
            self.passage.approach(simd, self.track, unit, self.travelled_m);
        }
        for some in units.chunks_mut(AT_ONCE) {
            self.passage.solve_forces(simd, some);
        }
        for unit in units {
            self.passage.roll_on(simd, self.track, unit, self.traces);
        }
    }
}

impl UnitStepper {
    fn offset_m(&self, contact: usize) -> f64 {
        self.unit().contact_offset_m(contact)
    }
}

#[cfg(test)]
mod tests;
