//! Forward simulation of one bogie: the acceleration that the sensor shows, for a world and a speed.
//!
//! A train is the sum of its bogies: they are 4 m and more apart, where neither wheel nor sleeper under the next bogie feels them. Over
//! beds that open that is so as long as a bogie is there, but sleepers swing behind it until the next one comes:
//! [`equivalent`](super::equivalent) simulates whole trains.

use std::sync::Arc;

use super::clipping::{Spread, clipped_mean};
use super::world::World;
use crate::ballast::BallastParameters;
use crate::passage::contact::ContactLaw;
use crate::passage::surface::GRID_M;
use crate::passage::{
    Bogie, Journey, LEAD_IN_M, OutOfRoundness, PassageRecord, Profile, RunningSurface, SLEEPER_MODES,
    SimulationError, Start, Stepper, Support, SupportLaw, TimeStep, TrackModel, Train, Underway, VehicleUnit,
    Wheel, WheelFlat, driven, halt, resume, run,
};
use crate::recording::Crossing;
use crate::signal::{AntiAlias, irfft, rfft, rfft_frequencies_hz, taper};
use crate::track::{Mesh, Side, Track};
use crate::vehicle::static_wheel_force_n;

/// Band of the comparison: gain 1 up to the first, 0 from the second frequency, Hz.
pub const BAND_HZ: [f64; 2] = [250.0, 300.0];
/// Step of the simulation, s: the average-acceleration rule is 0.6 % off in frequency at 250 Hz, 0.2 % at 150 Hz. With it and
/// [`REACH_M`] the mean window of wheels that are all alike is missed by 0.31 %, with three quarters of the step by 0.29 %.
const DT_S: f64 = 1.0 / 6000.0;
/// Step where valleys are only looked for, s: 1.3 % off in frequency at 250 Hz, less than what a model lacks there.
const SCOUTING_DT_S: f64 = 1.0 / 4000.0;
/// Both where the transducer clips: that is before the recorder's low-pass, so what lies above the band counts as well.
const CLIPPED_DT_S: f64 = 0.8e-4;
const CLIPPED_SCOUTING_DT_S: f64 = 1.6e-4;
/// Track simulated on either side of the crossing sleeper, metres, at least: 11 sleepers 0.6 m apart. With 13 or 16 the mean window is
/// missed by as much, and 23 sleepers fill the lanes of the simulation.
const REACH_M: f64 = 6.6;
/// Where the track has taken a wheel over, the sensor is at least this many times the length over which the rail spreads a load away, so
/// that it sinks as under a wheel that was on the track all along. With 4.1 times, on 12 MN/m² where 14 were found at first, the sleeper was
/// missed by 2 % of its displacement, with 4.7 times by what differs from bogie to bogie. Voids make 30 MN/m² look like 20, which is 4.4
/// times with 11 sleepers: twelve of them take twice as long there, and nothing is gained.
const SPREADS: f64 = 4.2;
/// Part of a sleeper that is too much to add another, for the last digits of spacings.
const WHOLE: f64 = 1e-6;

/// How closely a simulation is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// As closely as recordings tell.
    Full,
    /// As closely as valleys are told from one another.
    Scouting,
}

/// Simulation of a bogie over a track, ready for any speed.
#[derive(Clone)]
pub struct Simulator {
    stepper: Arc<Stepper>,
    train: Train,
    surface: RunningSurface,
    law: ContactLaw,
    direction: f64,
    sensor: super::world::SensorModel,
    /// Standard deviations of the depth of the wheels' paths (relative) and of where they meet them (metres).
    wheels_differ: [f64; 2],
    antialias: AntiAlias,
    /// Travel of the front axle at which simulations end early, metres from x = 0.
    until_m: f64,
}

impl Simulator {
    /// Builds track and bogie; `axle_load_kg` is the operator's.
    pub fn new(world: &World, axle_load_kg: f64) -> Result<Self, SimulationError> {
        Self::in_detail(world, axle_load_kg, Detail::Full)
    }

    /// The same in a given detail.
    pub fn in_detail(world: &World, axle_load_kg: f64, detail: Detail) -> Result<Self, SimulationError> {
        let crossing = world.crossing.clone().shortened(world.sleepers);
        let track = Track::of_crossing(&crossing, Mesh::default());
        let model = TrackModel::new(&track, supports(world, &track), SLEEPER_MODES)?;
        let dt_s = match (world.sensor.range_m_s2, detail) {
            (Some(_), Detail::Full) => CLIPPED_DT_S,
            (Some(_), Detail::Scouting) => CLIPPED_SCOUTING_DT_S,
            (None, Detail::Full) => DT_S,
            (None, Detail::Scouting) => SCOUTING_DT_S,
        };
        let stepper = Stepper::new(model, TimeStep { dt_s, theta: 0.5 })?;
        let extent = [-world.path.half_m, world.path.half_m];
        let crossing_path = Profile::of(extent, GRID_M, |x| world.path.at(Side::Crossing, x))?;
        let stock = Profile::of(extent, GRID_M, |x| world.path.at(Side::Stock, x))?;
        let sensor = &world.crossing.sensor;
        Ok(Self {
            stepper: Arc::new(stepper),
            train: train(world, axle_load_kg)?,
            surface: RunningSurface {
                paths: vec![crossing_path],
                crossing_roughness: Profile::level(),
                stock,
            },
            law: ContactLaw::Hertz(world.crossing.vehicle.hertz_constant_n_m15),
            direction: world.crossing.traffic_direction.sign(),
            sensor: world.sensor,
            wheels_differ: [world.wheels.depth_sd, world.path.blur_m],
            antialias: AntiAlias::new(sensor.antialias_order, sensor.antialias_hz),
            until_m: f64::INFINITY,
        })
    }

    /// The same with a whole train, whose bogies have their front axles at `bogies_m` behind the first one.
    pub fn with_bogies(&self, bogies_m: &[f64]) -> Self {
        let [first] = self.train.units.as_slice() else { return self.clone() };
        let mut out = self.clone();
        out.train.units = bogies_m.iter().map(|offset_m| first.behind(*offset_m)).collect();
        out.train.wheels = bogies_m.iter().flat_map(|_| self.train.wheels.clone()).collect();
        out
    }

    /// The same with one knot of the path raised: under the front (0) or rear (1) wheel on the crossing side, under both on
    /// the other.
    pub fn with_bump(
        &self,
        world: &World,
        knot: usize,
        axle: usize,
        height_m: f64,
    ) -> Result<Self, SimulationError> {
        let mut moved = world.path.clone();
        moved.deviation.coefficient_m[knot] += height_m;
        let extent = [-world.path.half_m, world.path.half_m];
        let side = world.path.deviation.knots()[knot].0;
        let profile = Profile::of(extent, GRID_M, |x| moved.at(side, x))?;
        let mut out = self.clone();
        match side {
            Side::Crossing => {
                out.surface.paths.push(profile);
                out.train.wheels[2 * axle].path = out.surface.paths.len() - 1;
            }
            Side::Stock => out.surface.stock = profile,
        }
        Ok(out)
    }

    /// The same with the front (0) or rear (1) wheel on the crossing side on a path of another depth, met later in x.
    pub fn with_own_path(&self, axle: usize, depth_factor: f64, shift_m: f64) -> Self {
        let mut out = self.clone();
        let wheel = &mut out.train.wheels[2 * axle];
        wheel.depth_factor *= depth_factor;
        wheel.shift_m += shift_m;
        out
    }

    /// The same with a flat on both wheels of the front (0) or rear (1) wheelset.
    pub fn with_flat(&self, axle: usize, flat: WheelFlat) -> Self {
        let mut out = self.clone();
        for wheel in &mut out.train.wheels[2 * axle..2 * axle + 2] {
            wheel.flat = Some(flat);
        }
        out
    }

    /// The same with waves around both wheels of the front (0) or rear (1) wheelset.
    pub fn with_waves(&self, axle: usize, waves: OutOfRoundness) -> Self {
        let mut out = self.clone();
        for wheel in &mut out.train.wheels[2 * axle..2 * axle + 2] {
            wheel.out_of_roundness.push(waves);
        }
        out
    }

    /// The same, ended where the front axle has travelled to `front_m`, metres from x = 0: what comes then does not matter.
    pub fn until(self, front_m: f64) -> Self {
        Self { until_m: front_m, ..self }
    }

    /// Travel of the front axle from which on a bump ([`with_bump`](Self::with_bump)) is under a wheel, metres.
    pub fn meets_m(&self, world: &World, knot: usize, axle: usize) -> f64 {
        let (side, x_m) = world.path.deviation.knots()[knot];
        let behind_m =
            if side == Side::Crossing { axle as f64 * world.crossing.vehicle.axle_spacing_m } else { 0.0 };
        // A cubic B-spline reaches over two steps, its samples over two of theirs.
        self.direction * x_m - 2.0 * (world.path.deviation.step_m(side) + GRID_M) + behind_m
    }

    /// Acceleration at the sensor while one bogie passes at `speed_m_s` by the recorder's clock.
    pub fn response(&self, speed_m_s: f64) -> Result<Response, SimulationError> {
        let journey = self.journey(speed_m_s);
        let record = run(&self.stepper, &self.train, (&self.surface, self.law), &journey, [0.0, 0.0])?;
        Ok(self.shown(&journey, &record))
    }

    /// What the sensor shows beyond what it would show on the track of `other` under the same wheel forces.
    pub fn beyond(&self, other: &Self, speed_m_s: f64) -> Result<Response, SimulationError> {
        let journey = self.journey(speed_m_s);
        let everywhere_m = self.stepper.model.extent_m();
        let mut record = run(&self.stepper, &self.train, (&self.surface, self.law), &journey, everywhere_m)?;
        let there_m = driven(&other.stepper, &self.train, &journey, &record.contacts)?;
        record.sensor_m.iter_mut().zip(&there_m).for_each(|(here, there)| *here -= there);
        Ok(self.shown(&journey, &record))
    }

    /// The same passage halted before the front axle has travelled to each of `halts_m`, ascending, metres from x = 0.
    pub fn halted(&self, speed_m_s: f64, halts_m: &[f64]) -> Result<Vec<Underway>, SimulationError> {
        halt(&self.stepper, &self.train, (&self.surface, self.law), &self.journey(speed_m_s), halts_m)
    }

    /// The same as [`response`](Self::response) where a halted passage has met nothing yet that is otherwise here.
    pub fn response_after(&self, underway: Underway, speed_m_s: f64) -> Result<Response, SimulationError> {
        let journey = self.journey(speed_m_s);
        let record = resume(&self.stepper, &self.train, (&self.surface, self.law), &journey, underway)?;
        Ok(self.shown(&journey, &record))
    }

    /// From one end of the track to the other at a speed by the recorder's clock.
    fn journey(&self, speed_m_s: f64) -> Journey {
        let speed = speed_m_s * self.stretch();
        let [first, last] = self.stepper.model.extent_m();
        let first_m = if self.direction > 0.0 { first } else { -last };
        let length_m = (last - first + self.train.length_m()).min(self.until_m - first_m);
        Journey {
            direction: self.direction,
            speed_m_s: speed,
            acceleration_m_s2: 0.0,
            first_m,
            duration_s: length_m / speed,
            start: Start::Quiet,
        }
    }

    /// Recorder time per time.
    fn stretch(&self) -> f64 {
        1.0 + self.sensor.clock_error
    }

    fn shown(&self, journey: &Journey, record: &PassageRecord) -> Response {
        let (speed, stretch) = (journey.speed_m_s, self.stretch());
        Response {
            first_s: journey.first_m / speed * stretch,
            step_s: record.dt_s * stretch,
            acceleration_m_s2: self.acceleration(&record.sensor_m, 1.0 / record.dt_s, speed),
        }
    }

    /// What the recorder makes of the motion, in the band of the comparison. The recorder's low-pass is undone in the
    /// recordings, so it matters only together with a range.
    fn acceleration(&self, motion_m: &[f64], rate_hz: f64, speed_m_s: f64) -> Vec<f64> {
        let n = (motion_m.len() + motion_m.len() / 4).next_power_of_two();
        let mut motion = motion_m.to_vec();
        let end = motion.last().copied().unwrap_or(0.0);
        // A slow return to rest instead of a step.
        motion.resize_with(n, || 0.0);
        let (from, count) = (motion_m.len(), n - motion_m.len());
        for (k, value) in motion[from..].iter_mut().enumerate() {
            *value = end * (1.0 - crate::passage::surface::smooth_step(k as f64 / count as f64));
        }
        let mut spectrum = rfft(&motion);
        let frequencies = rfft_frequencies_hz(n, rate_hz);
        for (value, f) in spectrum.iter_mut().zip(&frequencies) {
            let omega = std::f64::consts::TAU * f;
            *value *= self.sensor.mounted(*f) * -(omega * omega);
        }
        if let Some(range) = self.sensor.range_m_s2 {
            let [depth, shift_m] = self.wheels_differ;
            let spread = Spread { depth, time_s: shift_m / speed_m_s };
            spectrum = rfft(&clipped_mean(&irfft(&spectrum, n), rate_hz, range, spread));
        }
        for (value, f) in spectrum.iter_mut().zip(&frequencies) {
            // The comparison's band is in the recorder's hertz.
            *value *= taper(*f / (1.0 + self.sensor.clock_error), BAND_HZ[0], BAND_HZ[1]);
        }
        let mut out = irfft(&spectrum, n);
        out.truncate(motion_m.len());
        out
    }

    /// The recorder's low-pass.
    pub fn antialias(&self) -> &AntiAlias {
        &self.antialias
    }
}

/// Acceleration over recorder time since the front axle was at x = 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Response {
    first_s: f64,
    step_s: f64,
    acceleration_m_s2: Vec<f64>,
}

impl Response {
    /// Given acceleration (m/s²) from a time on, in steps, s.
    #[cfg(test)]
    pub fn of(first_s: f64, step_s: f64, acceleration_m_s2: Vec<f64>) -> Self {
        Self { first_s, step_s, acceleration_m_s2 }
    }

    /// Number of samples.
    pub fn samples(&self) -> usize {
        self.acceleration_m_s2.len()
    }

    /// (this − other) / step, for responses at the same speed.
    pub fn less(&self, other: &Response, step: f64) -> Response {
        let difference = self.acceleration_m_s2.iter().zip(&other.acceleration_m_s2);
        Response { acceleration_m_s2: difference.map(|(a, b)| (a - b) / step).collect(), ..*self }
    }

    /// The same with what `added` is at every time, m/s².
    pub fn with(&self, added: impl Fn(f64) -> f64) -> Response {
        let values = self.acceleration_m_s2.iter().enumerate();
        let sum = values.map(|(k, a)| a + added(self.first_s + k as f64 * self.step_s)).collect();
        Response { acceleration_m_s2: sum, ..*self }
    }

    /// Acceleration at `t_s` by cubic interpolation; zero outside.
    pub fn at(&self, t_s: f64) -> f64 {
        let p = (t_s - self.first_s) / self.step_s;
        let n = self.acceleration_m_s2.len();
        if !(p >= 1.0 && p < n as f64 - 2.0) {
            return 0.0;
        }
        let i = p as usize;
        let t = p - i as f64;
        let y = &self.acceleration_m_s2[i - 1..i + 3];
        let (below, above) = (t + 1.0, t - 1.0);
        y[0] * (-t * above * (t - 2.0) / 6.0)
            + y[1] * (below * above * (t - 2.0) / 2.0)
            + y[2] * (-below * t * (t - 2.0) / 2.0)
            + y[3] * (below * t * above / 6.0)
    }

    /// Sum over bogies whose front axles are at x = 0 at `bogie_s` before the first time of `t_s`.
    pub fn add_train(&self, bogie_s: &[f64], gain: f64, first_s: f64, step_s: f64, out: &mut [f64]) {
        let (from, to) = (self.first_s, self.first_s + self.step_s * self.acceleration_m_s2.len() as f64);
        for start in bogie_s {
            let begin = ((start + from - first_s) / step_s).floor().max(0.0) as usize;
            let end = (((start + to - first_s) / step_s).ceil().max(0.0) as usize).min(out.len());
            for (k, value) in out.iter_mut().enumerate().take(end).skip(begin) {
                *value += gain * self.at(first_s + k as f64 * step_s - start);
            }
        }
    }
}

/// Sleepers to simulate on either side of the sensor's, on about this ballast. The rail spreads a load over (4 E I / k)^¼, with k the
/// stiffness of the ballast under half of every sleeper, per length of rail (Winkler).
pub fn sleepers_on(crossing: &Crossing, ballast: &BallastParameters) -> usize {
    let (rail, spacing_m) = (&crossing.rail, crossing.track.sleeper_spacing_m);
    let support_n_m2 = 0.5 * ballast.p1_n_m2 * crossing.sleeper.length_m / spacing_m;
    let spread_m = (4.0 * rail.youngs_modulus_pa * rail.second_moment_m4 / support_n_m2).powf(0.25);
    let reach_m = (LEAD_IN_M + SPREADS * spread_m).max(REACH_M);
    (reach_m / spacing_m - WHOLE).ceil() as usize
}

/// Beds of the sleepers of a track.
pub(super) fn supports(world: &World, track: &Track) -> Vec<Support> {
    let n = track.sleeper_x_m.len();
    let distribution = world.ballast.bed(track);
    let damping = world.ballast.damping_factor * world.crossing.ballast.damping_ns_m2;
    let mut supports: Vec<Support> = distribution.iter().map(|k| Support::linear(*k, damping)).collect();
    let at = |offset: i64| usize::try_from(track.sensor_sleeper as i64 + offset).ok().filter(|i| *i < n);
    for support in &mut supports {
        support.mass_kg_m = world.bed.mass_kg_m;
        if let Some(doubling_m) = world.bed.doubling_m {
            support.law = SupportLaw::Quadratic { doubling_m };
        }
    }
    for (offset, gap_m) in &world.bed.gap_m {
        if let Some(i) = at(*offset) {
            supports[i].law = SupportLaw::Unilateral { gap_m: *gap_m, preload_n_m: 0.0 };
            supports[i].open_damping_ns_m2 = world.bed.crib_damping * damping;
        }
    }
    supports
}

fn train(world: &World, axle_load_kg: f64) -> Result<Train, SimulationError> {
    let vehicle = &world.crossing.vehicle;
    let force = static_wheel_force_n(axle_load_kg, vehicle.gravity_m_s2);
    let mut bogie = Bogie::of_vehicle(vehicle);
    for mass in bogie.wheelset_mass_kg.iter_mut().chain(&mut bogie.wheelset_roll_inertia_kg_m2) {
        *mass *= world.wheels.unsprung;
    }
    let wheel = |axle: usize, side: usize| Wheel {
        depth_factor: if side == 0 { world.wheels.depth[axle] } else { 1.0 },
        ..Wheel::nominal(force * world.wheels.load[axle][side])
    };
    Ok(Train {
        units: vec![VehicleUnit::bogie(&bogie, 0.0)?],
        wheels: vec![wheel(0, 0), wheel(0, 1), wheel(1, 0), wheel(1, 1)],
        wheel_radius_m: vehicle.wheel_radius_m,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::read_site;

    /// E I = 6.38 MN m²; 12 MN/m² under half of 3.5 m every 0.6 m are 35 MN/m², which spread a load over 0.924 m: 3 m + 4.2 · 0.924 m is
    /// within the twelfth sleeper. On 30 MN/m² 6.6 m are enough, which are eleven.
    #[test]
    fn analytic_soft_ballast_wants_more_sleepers() {
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field/reference-1");
        let crossing = read_site(&root).unwrap().crossing;
        let on = |p1_n_m2: f64| {
            sleepers_on(&crossing, &BallastParameters { p1_n_m2, ..BallastParameters::NOMINAL })
        };
        assert_eq!([12e6, 20e6, 30e6].map(on), [12, 11, 11]);
    }
}
