//! From a scenario to a site with truth.

use rayon::prelude::*;

use super::effects::Effects;
use super::file::{Scenario, ScenarioError};
use super::geometry::{crossing_path, roughness};
use super::limits::check;
use crate::ballast::BallastParameters;
use crate::passage::contact::ContactLaw;
use crate::passage::random::Random;
use crate::passage::sensor::{BiasStep, MountResonance, SensorChain, Tone, ideal_displacement};
use crate::passage::surface::GRID_M;
use crate::passage::{
    Bogie, Journey, OutOfRoundness, PassageRecord, Profile, RunningSurface, SimulationError, Start, Stepper,
    Support, SupportLaw, TimeStep, TrackModel, Train, VehicleUnit, WheelFlat, run,
};
use crate::progress::Progress;
use crate::recording::truth::{BallastTruth, Side, SiteTruth, Truth, WheelTruth};
use crate::recording::{Crossing, Passage, Scan, Site, read_scan_file};
use crate::signal::CubicSpline;
use crate::track::{Mesh, Track};
use crate::vehicle::{AxlePattern, static_wheel_force_n};

/// A simulated site.
#[derive(Clone, Debug)]
pub struct SimulatedSite {
    /// What the operator would have.
    pub site: Site,
    /// What really happened.
    pub truth: Truth,
}

/// Independent random streams of a seed; passages follow from [`PASSAGES`] on.
const ROUGHNESS: u64 = 0;
const SCAN: u64 = 1;
const PASSAGES: u64 = 16;

/// Range of the contact forces in the truth, m.
const TRUTH_M: f64 = 4.0;
/// Grid of the truth, m.
pub(super) const TRUTH_STEP_M: f64 = 0.01;
/// The recording begins and ends when the train is this far from the crossing sleeper …
const CLEAR_M: f64 = 8.0;
/// … plus a time between these, s.
const QUIET_S: [f64; 2] = [0.3, 0.5];

/// Simulates all passages.
pub fn simulate(scenario: &Scenario, progress: &dyn Progress) -> Result<SimulatedSite, ScenarioError> {
    check(scenario)?;
    let world = World::new(scenario)?;
    progress.begin("passages", scenario.simulation.passages as u64);
    let results: Vec<(Passage, Vec<WheelTruth>)> = (0..scenario.simulation.passages)
        .into_par_iter()
        .map(|index| {
            let result = world.passage(index);
            progress.step();
            result
        })
        .collect::<Result<_, _>>()?;
    let (passages, wheels): (Vec<Passage>, Vec<Vec<WheelTruth>>) = results.into_iter().unzip();
    let site =
        Site { crossing: scenario.crossing.clone(), passages, scan: Some(world.scan()), skipped: Vec::new() };
    let truth = Truth { wheels: wheels.into_iter().flatten().collect(), site: world.site_truth() };
    Ok(SimulatedSite { site, truth })
}

/// Everything the passages share.
struct World<'a> {
    scenario: &'a Scenario,
    /// Description with the effects on track and vehicle in it.
    real: Crossing,
    stepper: Stepper,
    surface: RunningSurface,
    ballast_n_m2: Vec<f64>,
}

impl<'a> World<'a> {
    fn new(scenario: &'a Scenario) -> Result<Self, ScenarioError> {
        let s = &scenario.simulation;
        let real = real_crossing(&scenario.crossing, &s.effects);
        let real = match s.solver.sleepers_each_side {
            Some(each_side) => real.shortened(each_side),
            None => real,
        };
        let mesh = Mesh { rail_step_m: s.solver.rail_step_m, sleeper_step_m: s.solver.sleeper_step_m };
        let track = Track::of_crossing(&real, mesh);
        let ballast = BallastParameters::stiffness([s.ballast.p1_n_m2, s.ballast.p2_n_m2, s.ballast.p3]);
        let mut ballast_n_m2 = ballast.bed(&track);
        let supports =
            supports(&mut ballast_n_m2, real.ballast.damping_ns_m2, &s.effects, track.sensor_sleeper);
        let model = TrackModel::new(&track, supports, s.solver.sleeper_modes)?;
        let extent = model.extent_m();
        let stepper = Stepper::new(model, TimeStep { dt_s: s.solver.dt_s, theta: s.solver.theta })?;
        let surface = surface(scenario, extent)?;
        Ok(Self { scenario, real, stepper, surface, ballast_n_m2 })
    }

    fn passage(&self, index: usize) -> Result<(Passage, Vec<WheelTruth>), SimulationError> {
        let s = &self.scenario.simulation;
        let mut random = Random::new(s.seed, PASSAGES + index as u64);
        let speed = s.speed_m_s * (1.0 + random.between(-s.speed_spread, s.speed_spread));
        let temperature_c = s.temperature_c[0] + s.temperature_c[1] * random.between(-1.0, 1.0);
        let operator =
            s.operator_speed_error.map(|e| speed * (1.0 + (e * random.normal()).clamp(-0.01, 0.01)));
        let journey = self.journey(speed, &mut random);
        let train = self.train(&mut random)?;
        let law = ContactLaw::Hertz(self.real.vehicle.hertz_constant_n_m15);
        let range = [-TRUTH_M - 0.5, TRUTH_M + 0.5];
        let record = run(&self.stepper, &train, (&self.surface, law), &journey, range)?;
        let chain = self.chain(temperature_c, &journey, &mut random);
        let passage = Passage {
            passage_id: index as i32,
            train_type: self.scenario.crossing.vehicle.kind.clone(),
            axle_load_kg: self.scenario.crossing.vehicle.axle_load_kg,
            speed_m_s: operator,
            temperature_c,
            sample_rate_hz: chain.sample_rate_hz,
            acceleration_m_s2: chain.record(&record, &mut random),
        };
        Ok((passage, self.wheel_truth(index as i32, speed, &record)))
    }

    /// From 0.3–0.5 s before the first axle is near to 0.3–0.5 s after the last one was.
    fn journey(&self, speed_m_s: f64, random: &mut Random) -> Journey {
        let direction = self.real.traffic_direction.sign();
        let (before, after) =
            (random.between(QUIET_S[0], QUIET_S[1]), random.between(QUIET_S[0], QUIET_S[1]));
        let length = AxlePattern::of_vehicle(&self.real.vehicle).length_m();
        Journey {
            direction,
            speed_m_s,
            acceleration_m_s2: 0.0,
            first_m: direction * self.real.track.crossing_sleeper_x_m - CLEAR_M - speed_m_s * before,
            duration_s: before + (2.0 * CLEAR_M + length) / speed_m_s + after,
            start: Start::Quiet,
        }
    }

    fn train(&self, random: &mut Random) -> Result<Train, SimulationError> {
        let (v, variation) = (&self.real.vehicle, &self.scenario.simulation.wheels);
        let effects = &self.scenario.simulation.effects;
        let mut train = Train::of_vehicle(v, static_wheel_force_n(v.axle_load_kg, v.gravity_m_s2))?;
        let mut bogie = Bogie::of_vehicle(v);
        if let Some(f) = effects.unsprung_mass {
            bogie.wheelset_mass_kg = bogie.wheelset_mass_kg.map(|m| m * f.factor);
            bogie.wheelset_roll_inertia_kg_m2 = bogie.wheelset_roll_inertia_kg_m2.map(|m| m * f.factor);
        }
        let offsets = AxlePattern::of_vehicle(v).offset_m;
        train.units =
            offsets.iter().step_by(2).map(|o| VehicleUnit::bogie(&bogie, *o)).collect::<Result<_, _>>()?;
        let transfer = effects.load_transfer.unwrap_or_default();
        for (axle, pair) in train.wheels.chunks_exact_mut(2).enumerate() {
            let front = if axle % 2 == 0 { 1.0 } else { -1.0 };
            let load = (1.0 + variation.load * random.normal()) * (1.0 + front * transfer.to_front);
            let side = variation.side_load * random.normal() + transfer.to_crossing_side;
            pair[0].static_force_n *= load * (1.0 + side);
            pair[1].static_force_n *= load * (1.0 - side);
            pair[0].depth_factor = 1.0 + variation.depth * random.normal();
            pair[0].shift_m = variation.shift_m * random.normal();
            if let Some(f) = effects.front_rear {
                pair[0].depth_factor *= 1.0 + 0.5 * front * f.depth_difference;
            }
            wheel_defects(effects, pair, v.wheel_radius_m, random);
        }
        Ok(train)
    }

    fn chain(&self, temperature_c: f64, journey: &Journey, random: &mut Random) -> SensorChain {
        let (sensor, effects) = (&self.scenario.crossing.sensor, &self.scenario.simulation.effects);
        let mut chain = SensorChain::of_sensor(sensor);
        chain.bias_m_s2 = random.between(-sensor.bias_max_m_s2, sensor.bias_max_m_s2);
        if let Some(g) = effects.gain_temperature {
            chain.gain = 1.0 + g.per_kelvin * (temperature_c - g.reference_c);
        }
        if let Some(s) = effects.saturation {
            chain.range_m_s2 = s.range_m_s2;
        }
        chain.clock_error = effects.clock_error.map_or(0.0, |c| c.relative);
        chain.mount = effects
            .mount_resonance
            .map(|m| MountResonance { frequency_hz: m.frequency_hz, damping_ratio: m.damping_ratio });
        if let Some(t) = effects.tonal {
            let phase_rad = random.between(0.0, std::f64::consts::TAU);
            chain.tones.push(Tone {
                frequency_hz: t.frequency_hz,
                amplitude_m_s2: t.amplitude_m_s2,
                phase_rad,
            });
        }
        if let Some(b) = effects.bias_step {
            for offset in AxlePattern::of_vehicle(&self.real.vehicle).offset_m.iter().step_by(2) {
                let sign = if random.unit() < 0.5 { -1.0 } else { 1.0 };
                chain.bias_steps.push(BiasStep {
                    time_s: (offset - journey.first_m) / journey.speed_m_s,
                    step_m_s2: sign * b.step_m_s2,
                    decay_s: b.decay_s,
                });
            }
        }
        chain
    }

    fn wheel_truth(&self, passage_id: i32, true_speed_m_s: f64, record: &PassageRecord) -> Vec<WheelTruth> {
        let rate = self.scenario.crossing.sensor.sample_rate_hz;
        let count = (2.0 * TRUTH_M / TRUTH_STEP_M).round() as usize + 1;
        let grid: Vec<f64> = (0..count).map(|i| -TRUTH_M + i as f64 * TRUTH_STEP_M).collect();
        let wheel = |(i, trace): (usize, &crate::passage::ContactTrace)| {
            let (mut x, mut f) = (trace.position_m.clone(), trace.force_n.clone());
            if x.first() > x.last() {
                x.reverse();
                f.reverse();
            }
            let spline = CubicSpline::new(&x, &f);
            WheelTruth {
                passage_id,
                wheelset: i / 2,
                side: if i % 2 == 0 { Side::Crossing } else { Side::Stock },
                contact_force_n: grid
                    .iter()
                    .map(|x| spline.as_ref().map_or(0.0, |s| s.at(*x).max(0.0)))
                    .collect(),
                position_m: grid.clone(),
                true_speed_m_s,
                sleeper_displacement_m: (i == 0).then(|| ideal_displacement(record, rate)),
            }
        };
        record.contacts.iter().enumerate().map(wheel).collect()
    }

    /// Laser scan of the true path, with its noise.
    fn scan(&self) -> Scan {
        let g = &self.scenario.simulation.geometry;
        let mut random = Random::new(self.scenario.simulation.seed, SCAN);
        let [first, last] = g.scan_m;
        let count = ((last - first) / TRUTH_STEP_M).round().max(1.0) as usize + 1;
        let position_m: Vec<f64> = (0..count).map(|i| first + i as f64 * TRUTH_STEP_M).collect();
        let depth = |x: &f64| {
            self.surface.paths[0].at(*x)
                + self.surface.crossing_roughness.at(*x)
                + g.scan_noise_m * random.normal()
        };
        Scan { irregularity_m: position_m.iter().map(depth).collect(), position_m }
    }

    fn site_truth(&self) -> SiteTruth {
        let s = &self.scenario.simulation;
        let names = s.effects.names().into_iter().map(toml::Value::String).collect();
        let shaped = s.effects.support_loss.is_none();
        SiteTruth {
            effects: toml::Value::Array(names),
            ballast: BallastTruth {
                first_sleeper_offset: -(self.real.track.crossing_sleeper_index as i64),
                stiffness_n_m2: self.ballast_n_m2.clone(),
                p1_p2_p3: shaped.then_some([s.ballast.p1_n_m2, s.ballast.p2_n_m2, s.ballast.p3]),
            },
            // The table has no value that TOML cannot hold.
            geometry: toml::Value::try_from(&s.geometry)
                .unwrap_or_else(|_| toml::Value::Table(toml::Table::new())),
        }
    }
}

/// Track and vehicle as they really are.
fn real_crossing(nominal: &Crossing, effects: &Effects) -> Crossing {
    let mut real = nominal.clone();
    if let Some(p) = effects.pad_stiffness {
        real.pad.stiffness_n_m *= p.factor;
        real.pad.damping_ns_m *= p.damping_factor;
    }
    if let Some(c) = effects.crossing_rail {
        real.rail.crossing_part_stiffness_factor *= c.stiffness_factor;
        real.rail.crossing_part_mass_factor *= c.mass_factor;
    }
    if let Some(a) = effects.axle_load {
        real.vehicle.axle_load_kg *= a.factor;
    }
    real
}

/// Ballast under every sleeper; `ballast_n_m2` becomes the true stiffness.
fn supports(
    ballast_n_m2: &mut [f64],
    damping_ns_m2: f64,
    effects: &Effects,
    crossing_sleeper: usize,
) -> Vec<Support> {
    let at = |offset: i64| usize::try_from(crossing_sleeper as i64 + offset).ok();
    if let Some(loss) = &effects.support_loss {
        for k in loss.sleepers.iter().filter_map(|o| at(*o)) {
            if let Some(stiffness) = ballast_n_m2.get_mut(k) {
                *stiffness *= loss.factor;
            }
        }
    }
    let mut supports: Vec<Support> =
        ballast_n_m2.iter().map(|k| Support::linear(*k, damping_ns_m2)).collect();
    for support in &mut supports {
        support.mass_kg_m = effects.ballast_mass.map_or(0.0, |m| m.mass_kg_m);
        if let Some(s) = effects.ballast_stiffening {
            support.law = match s.bilinear_factor {
                None => SupportLaw::Quadratic { doubling_m: s.doubling_m },
                Some(factor) => SupportLaw::Bilinear { from_m: s.doubling_m, factor },
            };
        }
    }
    if let Some(voided) = &effects.voided_sleepers {
        for (offset, share) in &voided.sleepers {
            if let Some(support) = at(*offset).and_then(|k| supports.get_mut(k)) {
                support.law = SupportLaw::Unilateral { gap_m: share * voided.gap_m, preload_n_m: 0.0 };
                support.open_damping_ns_m2 = voided.crib_damping * damping_ns_m2;
            }
        }
    }
    supports
}

fn surface(scenario: &Scenario, extent_m: [f64; 2]) -> Result<RunningSurface, ScenarioError> {
    let s = &scenario.simulation;
    let scan = s.geometry.scan.as_deref().map(read_scan_file).transpose()?;
    let mut random = Random::new(s.seed, ROUGHNESS);
    let crossing_roughness = roughness(&s.roughness, extent_m, &mut random)?;
    let mut stock = roughness(&s.roughness, extent_m, &mut random)?;
    if let Some(d) = s.effects.stock_irregularity {
        let dip = Profile::of([d.at_x_m - 0.5 * d.length_m, d.at_x_m + 0.5 * d.length_m], GRID_M, |x| {
            0.5 * d.depth_m * (1.0 + (std::f64::consts::TAU * (x - d.at_x_m) / d.length_m).cos())
        })?;
        stock = stock.plus(&dip);
    }
    Ok(RunningSurface { paths: vec![crossing_path(&s.geometry, scan.as_ref())?], crossing_roughness, stock })
}

/// Defects of the two wheels of a wheelset; numbers are drawn whether the effect acts or not, so that everything else stays
/// the same when it is switched on.
fn wheel_defects(effects: &Effects, pair: &mut [crate::passage::Wheel], radius_m: f64, random: &mut Random) {
    let [round, flat, hollow] = [random.unit(), random.unit(), random.unit()];
    let (phase_rad, at_m) =
        (random.between(0.0, std::f64::consts::TAU), random.between(0.0, std::f64::consts::TAU * radius_m));
    if let Some(o) = effects.wheel_out_of_roundness.filter(|o| round < o.share) {
        for wheel in pair.iter_mut() {
            wheel.out_of_roundness.push(OutOfRoundness {
                order: o.order,
                amplitude_m: o.amplitude_m,
                phase_rad,
            });
        }
    }
    if let Some(f) = effects.wheel_flat.filter(|f| flat < f.share) {
        for wheel in pair.iter_mut() {
            wheel.flat = Some(WheelFlat::fresh(f.length_m, at_m, radius_m));
        }
    }
    if let Some(h) = effects.hollow_wheels.filter(|h| hollow < h.share) {
        pair[0].depth_factor *= h.depth_factor;
        pair[0].shift_m += h.shift_m;
    }
}
