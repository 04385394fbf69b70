//! Time loop of one passage.

use pulp::Simd;

use super::contact::{ContactLaw, Contacts};
use super::error::{SimulationError, in_range};
use super::model::RailPoint;
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
    /// Static deflection of the track's end part under each wheel, m.
    ground_m: Vec<f64>,
}

/// One bogie on its way.
struct Running {
    stepper: UnitStepper,
    state: UnitState,
    first_wheel: usize,
    wheels: usize,
    force_n: [f64; CONTACTS],
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

/// Below this deflection the track has come to rest, m.
const QUIET_M: f64 = 1e-12;
/// How often rest and finiteness are looked at, steps.
const LOOK_EVERY: usize = 64;
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
    check(train, surface, law, journey)?;
    let passage = Passage { stepper, train, surface, law, journey, ground_m: ground(stepper, train)? };
    passage.run(range_m)
}

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

/// Deflection of the outer track under the static force of each wheel, both rails loaded.
fn ground(stepper: &Stepper, train: &Train) -> Result<Vec<f64>, SimulationError> {
    let [first, last] = stepper.model.extent_m();
    let x = first + (last - first) / 6.0;
    let mut compliance = [0.0; 2];
    if stepper.nonlinear_sleepers().is_empty() {
        let points: Vec<RailPoint> = (0..2).filter_map(|side| stepper.model.point_on(side, x)).collect();
        let loads: Vec<(RailPoint, f64)> = points.iter().map(|p| (*p, 1.0)).collect();
        let state = stepper.static_state(&loads)?;
        for (c, point) in compliance.iter_mut().zip(&points) {
            *c = stepper.rail_m(&state, point);
        }
    }
    Ok(train.wheels.iter().enumerate().map(|(i, w)| w.static_force_n * compliance[i % 2]).collect())
}

impl Passage<'_> {
    fn run(&self, range_m: [f64; 2]) -> Result<PassageRecord, SimulationError> {
        let (dt, theta) = (self.stepper.step.dt_s, self.stepper.step.theta);
        let steps = (self.journey.duration_s / dt).round() as usize;
        let mut track = self.initial_track()?;
        let mut units = self.initial_units()?;
        let mut record = PassageRecord {
            dt_s: dt,
            sensor_m: vec![0.0; steps + 1],
            contacts: vec![ContactTrace::default(); self.train.wheels.len()],
        };
        let early = self.steps_before_record();
        let mut at_rest = self.journey.start == Start::Quiet;
        record.sensor_m[0] = self.stepper.sensor_m(&track);
        for step in 0..early + steps {
            let time = (step as f64 - early as f64) * dt;
            let travelled = self.travelled_m(time + theta * dt);
            let any = self.update_phases(&mut units, travelled);
            if at_rest && !any {
                continue;
            }
            at_rest = false;
            self.stepper.begin(&mut track);
            self.stepper.arch.dispatch(AllContacts {
                passage: self,
                track: &mut track,
                units: &mut units,
                travelled_m: travelled,
                traces: (&mut record.contacts, range_m),
            });
            self.stepper.finish(&mut track);
            if step + 1 >= early {
                record.sensor_m[step + 1 - early] = self.stepper.sensor_m(&track);
            }
            if step % LOOK_EVERY == 0 {
                let largest = self.stepper.largest_m(&track);
                if !largest.is_finite() {
                    return Err(SimulationError::Diverged { time_s: time });
                }
                at_rest = !any && largest < QUIET_M;
            }
        }
        Ok(record)
    }

    fn travelled_m(&self, time_s: f64) -> f64 {
        let j = self.journey;
        j.first_m + (j.speed_m_s + 0.5 * j.acceleration_m_s2 * time_s) * time_s
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

    /// Contacts of one unit, then its motion; loads the track.
    #[inline(always)]
    fn unit_step<S: Simd>(
        &self,
        simd: S,
        track: &mut TrackState,
        unit: &mut Running,
        travelled_m: f64,
        (traces, range_m): (&mut [ContactTrace], [f64; 2]),
    ) {
        let wheels = &self.train.wheels[unit.first_wheel..unit.first_wheel + unit.wheels];
        let mut static_n = [0.0; CONTACTS];
        for (force, wheel) in static_n.iter_mut().zip(wheels) {
            *force = wheel.static_force_n;
        }
        unit.stepper.begin(&mut unit.state, &static_n[..unit.wheels]);
        let mut contacts = [Contact::default(); CONTACTS];
        for (i, contact) in contacts.iter_mut().enumerate().take(unit.wheels) {
            *contact = self.contact(simd, track, unit, i, travelled_m);
        }
        self.solve_forces(simd, unit, &contacts);
        unit.stepper.finish(&mut unit.state, &unit.force_n[..unit.wheels]);
        for (i, contact) in contacts.iter().enumerate().take(unit.wheels) {
            if let Some(point) = &contact.point {
                self.stepper.load(track, point, contact.share * unit.force_n[i]);
            }
            if contact.x_m >= range_m[0] && contact.x_m <= range_m[1] {
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

    /// Share of the track in carrying a wheel: rises from its ends inwards.
    #[inline(always)]
    fn share(&self, x_m: f64) -> f64 {
        let [first, last] = self.stepper.model.extent_m();
        smooth_step((x_m - first).min(last - x_m) / LEAD_IN_M)
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

    /// Contact forces of one unit, coupled through the wheelsets.
    #[inline(always)]
    fn solve_forces<S: Simd>(&self, simd: S, unit: &mut Running, contacts: &[Contact; CONTACTS]) {
        let ahead = self.stepper.step.theta * self.stepper.step.dt_s;
        let mut lanes = Contacts::default();
        for i in 0..unit.wheels {
            lanes.force_n[i] = unit.force_n[i];
            lanes.compliance_m_n[i] = ahead * unit.stepper.compliance[i][i] + contacts[i].rail_m_n;
        }
        for newton_step in 0..NEWTON_STEPS {
            for i in 0..unit.wheels {
                let through_others: f64 =
                    (0..CONTACTS).map(|j| unit.stepper.others[i][j] * lanes.force_n[j]).sum();
                lanes.free_m[i] = contacts[i].free_m - ahead * through_others;
                if newton_step == 0 {
                    lanes.approach_m[i] = lanes.free_m[i] - lanes.compliance_m_n[i] * lanes.force_n[i];
                }
            }
            let before = lanes.approach_m;
            self.law.newton(simd, &mut lanes);
            let still = |i: usize| {
                (lanes.approach_m[i] - before[i].max(0.0)).abs() <= APPROACH_TOLERANCE * lanes.free_m[i].abs()
            };
            if (0..CONTACTS).all(still) {
                break;
            }
        }
        unit.force_n.copy_from_slice(&lanes.force_n[..CONTACTS]);
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
            let state = stepper.at_rest(&height[..unit.wheels()]);
            let wheels = unit.wheels();
            units.push(Running { stepper, state, first_wheel, wheels, force_n, phase: Phase::Before });
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
    traces: (&'a mut [ContactTrace], [f64; 2]),
}

impl pulp::WithSimd for AllContacts<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for unit in self.units.iter_mut().filter(|u| u.phase == Phase::On) {
            let traces = (&mut *self.traces.0, self.traces.1);
            self.passage.unit_step(simd, self.track, unit, self.travelled_m, traces);
        }
    }
}

impl UnitStepper {
    fn offset_m(&self, contact: usize) -> f64 {
        self.unit().contact_offset_m(contact)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Profile, Support, SupportLaw, TimeStep, TrackModel, VehicleUnit};
    use super::*;
    use crate::track::{Kelvin, Mesh, Side, Track};

    /// Static wheel force of the benchmark: half of 15 500 kg.
    const Q: f64 = 76_027.5;
    /// Pads of the benchmark: name, N/m, Ns/m.
    const PADS: [(&str, f64, f64); 3] = [("soft", 60e6, 6e3), ("mid", 200e6, 28e3), ("stiff", 1200e6, 25e3)];
    const LINEAR: ContactLaw = ContactLaw::Linear(1.2e9);

    fn t1(pad: (f64, f64), rail_step_m: f64, step: TimeStep, support: Support) -> Stepper {
        let mesh = Mesh { rail_step_m, sleeper_step_m: 0.25 };
        let track = Track::benchmark_t1(Kelvin { stiffness: pad.0, damping: pad.1 }, mesh);
        Stepper::new(TrackModel::new(&track, vec![support; 101], 2).unwrap(), step).unwrap()
    }

    fn bed() -> Support {
        Support::linear(30e6, 125e3)
    }

    /// One wheel of 670 kg on each of the two rails, which do not feel each other.
    fn wheelset() -> Train {
        let unit = VehicleUnit::wheelset(1340.0, 1340.0 * 0.75 * 0.75, 0.75, 0.0).unwrap();
        Train { units: vec![unit], wheels: vec![Wheel::nominal(Q); 2], wheel_radius_m: 0.46 }
    }

    fn both_rails(profile: &Profile) -> RunningSurface {
        RunningSurface {
            paths: vec![profile.clone()],
            crossing_roughness: Profile::level(),
            stock: profile.clone(),
        }
    }

    fn cosine_dip(depth_m: f64, length_m: f64) -> RunningSurface {
        both_rails(
            &Profile::of([29.0, 31.0], 0.0025, |x| {
                let s = ((x - 30.0) / length_m).clamp(-0.5, 0.5);
                0.5 * depth_m * (1.0 + (std::f64::consts::TAU * s).cos())
            })
            .unwrap(),
        )
    }

    fn journey(speed_m_s: f64, duration_s: f64) -> Journey {
        Journey {
            direction: 1.0,
            speed_m_s,
            acceleration_m_s2: 0.0,
            first_m: 15.0,
            duration_s,
            start: Start::Static,
        }
    }

    fn largest(values: &[f64]) -> f64 {
        values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
    }

    fn smallest(values: &[f64]) -> f64 {
        values.iter().copied().fold(f64::INFINITY, f64::min)
    }

    fn reference(case: &str) -> Vec<Vec<f64>> {
        let dir = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/reference");
        let text = std::fs::read_to_string(dir.join(format!("T1_{case}.csv"))).unwrap();
        let rows = text.lines().filter(|l| !l.starts_with('#'));
        rows.map(|l| l.split(',').map(|v| v.parse().unwrap()).collect()).collect()
    }

    fn column(rows: &[Vec<f64>], i: usize) -> Vec<f64> {
        rows.iter().map(|r| r[i]).collect()
    }

    #[test]
    fn reference_wheel_over_a_dip_within_3_percent() {
        for (name, k, c) in PADS {
            let stepper = t1((k, c), 0.3, TimeStep::default(), bed());
            let record = run(
                &stepper,
                &wheelset(),
                (&cosine_dip(1e-3, 0.6), LINEAR),
                &journey(50.0, 0.4),
                [0.0, 60.0],
            )
            .unwrap();
            let expected = reference(&format!("dip_fe_{name}"));
            let (force, sleeper) = (&record.contacts[0].force_n, &record.sensor_m);
            let ratio = largest(force) / largest(&column(&expected, 1));
            assert!((ratio - 1.0).abs() < 0.03, "{name}: largest force {ratio}");
            let ratio = largest(sleeper) / largest(&column(&expected, 2));
            assert!((ratio - 1.0).abs() < 0.003, "{name}: sleeper {ratio}");
            // The smallest force is a small difference: 3 % of the static force.
            let difference = smallest(force) - smallest(&column(&expected, 1));
            assert!(difference.abs() < 0.03 * Q, "{name}: smallest force {difference}");
        }
    }

    #[test]
    fn reference_moving_force_within_half_a_percent() {
        for (name, k, c) in PADS {
            let stepper = t1((k, c), 0.3, TimeStep::default(), bed());
            let mut state = stepper.at_rest();
            let read = stepper.model.point(Side::Crossing, 30.0).unwrap();
            let (mut sleeper, mut rail) = (0.0_f64, 0.0_f64);
            for step in 0..9000 {
                let time = (f64::from(step) + 0.5) * 1e-4;
                stepper.begin(&mut state);
                let point = stepper.model.point(Side::Crossing, 7.5 + 50.0 * time).unwrap();
                stepper.load(&mut state, &point, Q * (time / 0.05).min(1.0));
                stepper.finish(&mut state);
                sleeper = sleeper.max(stepper.sensor_m(&state));
                rail = rail.max(stepper.rail_m(&state, &read));
            }
            let expected = reference(&format!("moving_fe_full_{name}"));
            for (what, found, i) in [("sleeper", sleeper, 1), ("rail", rail, 2)] {
                let ratio = found / largest(&column(&expected, i));
                assert!((ratio - 1.0).abs() < 0.005, "{name}: {what} {ratio}");
            }
        }
    }

    #[test]
    fn property_error_falls_with_the_square_of_the_step_and_mesh_hardly_matters() {
        let (surface, train) = (cosine_dip(1e-3, 0.6), wheelset());
        let peak = |rail_step_m, dt_s| {
            let stepper = t1((1200e6, 25e3), rail_step_m, TimeStep { dt_s, theta: 0.5 }, bed());
            let record = run(&stepper, &train, (&surface, LINEAR), &journey(50.0, 0.4), [0.0, 60.0]).unwrap();
            largest(&record.sensor_m)
        };
        let (coarse, middle, fine) = (peak(0.3, 2e-4), peak(0.3, 1e-4), peak(0.3, 5e-5));
        assert!((coarse - middle).abs() > 2.5 * (middle - fine).abs(), "{coarse} {middle} {fine}");
        assert!((peak(0.15, 1e-4) / middle - 1.0).abs() < 5e-4);
    }

    #[test]
    fn property_static_start_is_an_equilibrium() {
        let stepper = t1((200e6, 28e3), 0.3, TimeStep::default(), bed());
        let slow = Journey { speed_m_s: 1.0, ..journey(1.0, 0.05) };
        let record =
            run(&stepper, &wheelset(), (&RunningSurface::level(), LINEAR), &slow, [0.0, 60.0]).unwrap();
        let force = &record.contacts[0].force_n;
        assert!((force[0] / Q - 1.0).abs() < 1e-3, "{}", force[0]);
        assert!(force.iter().all(|f| (f / Q - 1.0).abs() < 0.01));
    }

    #[test]
    fn property_quiet_start_carries_the_static_load_and_leaves_a_quiet_track() {
        let stepper = t1((200e6, 28e3), 0.3, TimeStep::default(), bed());
        let trip = Journey { first_m: -5.0, start: Start::Quiet, ..journey(50.0, 1.8) };
        let record =
            run(&stepper, &wheelset(), (&RunningSurface::level(), LINEAR), &trip, [10.0, 50.0]).unwrap();
        let force = &record.contacts[0].force_n;
        assert!((crate::signal::mean(force) / Q - 1.0).abs() < 1e-3, "{}", crate::signal::mean(force));
        assert_eq!(record.sensor_m[0], 0.0);
        assert!(record.sensor_m.last().unwrap().abs() < 1e-9);
    }

    #[test]
    fn property_wheel_that_leaves_the_rail_feels_no_force_and_comes_back() {
        let stepper = t1((1200e6, 25e3), 0.3, TimeStep::default(), bed());
        let surface = cosine_dip(3e-3, 0.5);
        for law in [LINEAR, ContactLaw::Hertz(9.3e10)] {
            let record =
                run(&stepper, &wheelset(), (&surface, law), &journey(70.0, 0.28), [0.0, 60.0]).unwrap();
            let force = &record.contacts[0].force_n;
            assert!(force.iter().all(|f| *f >= 0.0));
            let airborne = force.iter().filter(|f| **f == 0.0).count();
            assert!(airborne > 10, "{airborne} steps without contact");
            assert!(largest(force) > 3.0 * Q);
            assert!((force[force.len() - 1] / Q - 1.0).abs() < 0.3, "{}", force[force.len() - 1]);
        }
    }

    #[test]
    fn property_both_directions_mirror_each_other() {
        let stepper = t1((200e6, 28e3), 0.3, TimeStep::default(), bed());
        let surface = cosine_dip(1e-3, 0.6);
        let go = |direction: f64, first_m| {
            let trip = Journey { direction, first_m, ..journey(50.0, 0.4) };
            run(&stepper, &wheelset(), (&surface, LINEAR), &trip, [0.0, 60.0]).unwrap().sensor_m
        };
        let (there, back) = (go(1.0, 15.0), go(-1.0, -45.0));
        assert!(there.iter().zip(&back).all(|(a, b)| (a - b).abs() < 1e-12));
    }

    #[test]
    fn paper_p2_force_is_below_jenkins() {
        // Jenkins et al. 1974: P2 = P0 + 2αv √(Mu/(Mu+Mt)) [1 − πCt/(4 √(Kt(Mu+Mt)))] √(Kt Mu); track constants of a beam
        // on continuous support: Kt = 2k/β, Mt = 3m/2β, Ct = 3c/2β, β = (k/4EI)^¼. Light ballast damping, because the formula
        // holds for little damping only.
        let (k_pad, k_bed, c_bed) = (200e6, 37.5e6, 20e3);
        let support = Support::linear(k_bed / 1.25, c_bed / 1.25);
        let stepper = t1((k_pad, 28e3), 0.3, TimeStep::default(), support);
        let (alpha, v, mu) = (0.005, 40.0, 670.0);
        let joint = both_rails(
            &Profile::of([28.5, 31.5], 0.0025, |x| alpha * (1.0 - (x - 30.0f64).abs()).max(0.0)).unwrap(),
        );
        let record =
            run(&stepper, &wheelset(), (&joint, ContactLaw::Hertz(9.3e10)), &journey(v, 0.5), [0.0, 60.0])
                .unwrap();
        let excess: Vec<f64> = record.contacts[0].force_n.iter().map(|f| f - Q).collect();
        // P2 is below 100 Hz; above it is P1.
        let low = crate::signal::brick_band(&excess, 1e4, 0.0, 150.0);
        let after = record.contacts[0].position_m.iter().position(|x| *x > 30.02).unwrap();
        let p2 = largest(&low[after..after + 600]);
        let k = k_bed * k_pad / (k_bed + k_pad) / 0.6;
        let beta = (k / (4.0 * 210e9 * 3.037e-5f64)).powf(0.25);
        let (kt, mt, ct) = (2.0 * k / beta, 1.5 * (60.2 + 150.0 / 0.6) / beta, 1.5 * c_bed / 0.6 / beta);
        let damping = 1.0 - std::f64::consts::PI * ct / (4.0 * (kt * (mu + mt)).sqrt());
        let jenkins = 2.0 * alpha * v * (mu / (mu + mt)).sqrt() * damping * (kt * mu).sqrt();
        assert!(p2 < jenkins && p2 > 0.5 * jenkins, "simulated {p2}, Jenkins {jenkins}");
    }

    #[test]
    fn property_void_softens_and_contact_law_without_gap_is_linear() {
        let with = |law, dt_s| {
            let support = Support { law, ..bed() };
            let mesh = Mesh { rail_step_m: 0.3, sleeper_step_m: 0.25 };
            let track = Track::benchmark_t1(Kelvin { stiffness: 200e6, damping: 28e3 }, mesh);
            let mut supports = vec![bed(); 101];
            supports[50] = support;
            let model = TrackModel::new(&track, supports, 2).unwrap();
            let stepper = Stepper::new(model, TimeStep { dt_s, theta: 0.5 }).unwrap();
            let trip = Journey { first_m: 18.0, start: Start::Quiet, ..journey(50.0, 0.4) };
            largest(
                &run(&stepper, &wheelset(), (&RunningSurface::level(), LINEAR), &trip, [0.0, 60.0])
                    .unwrap()
                    .sensor_m,
            )
        };
        let linear = with(SupportLaw::Linear, 1e-4);
        // A preload beyond every uplift: never apart, only integrated explicitly.
        let touching = with(SupportLaw::Unilateral { gap_m: 0.0, preload_n_m: 1e6 }, 1e-4);
        assert!((touching / linear - 1.0).abs() < 1e-3, "{touching} {linear}");
        let gap = |gap_m, dt_s| with(SupportLaw::Unilateral { gap_m, preload_n_m: 0.0 }, dt_s);
        let (small, large) = (gap(0.3e-3, 1e-4), gap(5e-3, 1e-4));
        assert!(linear < small && small < linear + 0.3e-3, "{linear} {small}");
        assert!(small < large && large < 2e-3, "rails carry a sleeper that hangs freely: {large}");
        let fine = gap(0.3e-3, 2.5e-5);
        assert!((small / fine - 1.0).abs() < 2e-3, "explicit ballast converges: {small} {fine}");
        let stiffer = with(SupportLaw::Quadratic { doubling_m: 1e-3 }, 1e-4);
        let bilinear = with(SupportLaw::Bilinear { from_m: 0.3e-3, factor: 3.0 }, 1e-4);
        assert!(stiffer < linear && bilinear < linear);
    }

    #[test]
    fn property_impossible_input_is_refused_with_the_value() {
        let refused = |dt_s, theta| TimeStep { dt_s, theta }.check().unwrap_err();
        assert_eq!(refused(1e-4, 0.49), SimulationError::Theta { theta: 0.49 });
        assert!(matches!(refused(1e-4, f64::NAN), SimulationError::Theta { theta } if theta.is_nan()));
        assert!(matches!(refused(1e-3, 0.5), SimulationError::TimeStep { dt_s, .. } if dt_s == 1e-3));
        assert!(matches!(refused(f64::NAN, 0.5), SimulationError::TimeStep { .. }));
        let stepper = t1((200e6, 28e3), 0.6, TimeStep::default(), bed());
        let level = RunningSurface::level();
        let go = |train: &Train, law, trip: &Journey| run(&stepper, train, (&level, law), trip, [0.0, 1.0]);
        let mut headless = wheelset();
        headless.wheels.pop();
        assert_eq!(
            go(&headless, LINEAR, &journey(50.0, 0.1)).unwrap_err(),
            SimulationError::Wheels { axles: 1, wheels: 1 }
        );
        let mut lost = wheelset();
        lost.wheels[0].path = 3;
        assert_eq!(
            go(&lost, LINEAR, &journey(50.0, 0.1)).unwrap_err(),
            SimulationError::Path { path: 3, wheel: 0, paths: 1 }
        );
        let negative = go(&wheelset(), ContactLaw::Linear(-1.0), &journey(50.0, 0.1)).unwrap_err();
        assert!(negative.to_string().contains("-1"), "{negative}");
        let standing = go(&wheelset(), LINEAR, &journey(0.0, 0.1)).unwrap_err();
        assert!(matches!(standing, SimulationError::OutOfRange { what: "speed", value: 0.0, .. }));
        let mut gaping = bed();
        gaping.law = SupportLaw::Unilateral { gap_m: 1e-3, preload_n_m: 0.0 };
        let voided = t1((200e6, 28e3), 0.6, TimeStep::default(), gaping);
        let start = run(&voided, &wheelset(), (&level, LINEAR), &journey(50.0, 0.1), [0.0, 1.0]).unwrap_err();
        assert_eq!(start, SimulationError::StaticStart { sleeper: 0 });
    }
}
