//! Time integration of the track: one-step scheme with the rate taken at t + θ dt. θ = ½ is Newmark's average
//! acceleration (implicit midpoint rule): unconditionally stable, second order, no numerical damping. θ > ½ damps.
//!
//! With v the rate at t + θ dt and A = M/(θ dt) + C + θ dt K, one step solves A v = f + b with b = M v₀/(θ dt) − K u₀.
//! Because M v/(θ dt) = f + b − C v − θ dt K v, the mass is never applied to the state:
//!   b ← b + (f − C v)/θ − K (u/θ + 2 dt v),   u ← u + dt v.

use aligned_vec::avec;

use super::beds::NonlinearBeds;
use super::chain::Seat;
use super::effective::{Effective, Shares};
use super::error::SimulationError;
use super::influence::Influence;
use super::model::{CHUNK, RailPoint, TrackModel};
use super::rails::{RailState, Rails};
use super::sleepers::{SleeperState, Sleepers};
use super::vectors::Aligned;

/// Step and scheme.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeStep {
    /// Step, s.
    pub dt_s: f64,
    /// Place inside the step at which the equations hold, ½ … 1.
    pub theta: f64,
}

impl Default for TimeStep {
    /// 0.1 ms, average acceleration.
    fn default() -> Self {
        Self { dt_s: 1e-4, theta: 0.5 }
    }
}

/// Longest step: beyond it two wheels of a bogie feel each other within a step, which the contact solution leaves out.
const STEP_S: [f64; 2] = [1e-7, 2.5e-4];

impl TimeStep {
    /// Refuses steps and schemes that cannot work.
    pub fn check(&self) -> Result<(), SimulationError> {
        let (dt_s, theta) = (self.dt_s, self.theta);
        if !(STEP_S[0]..=STEP_S[1]).contains(&dt_s) {
            return Err(SimulationError::TimeStep { dt_s, min_s: STEP_S[0], max_s: STEP_S[1] });
        }
        if !(0.5..=1.0).contains(&theta) {
            return Err(SimulationError::Theta { theta });
        }
        Ok(())
    }

    pub(super) fn shares(&self) -> Shares {
        Shares { mass: 1.0 / (self.theta * self.dt_s), damping: 1.0, stiffness: self.theta * self.dt_s }
    }
}

/// Track model factorised for one time step.
#[derive(Clone, Debug)]
pub struct Stepper {
    /// The track.
    pub model: TrackModel,
    /// Step and scheme.
    pub step: TimeStep,
    sleepers: Sleepers,
    beds: NonlinearBeds,
    rails: Rails,
    effective: Effective,
    influence: Influence,
    /// Static deflection of the outer track under each rail per newton on both of them, m/N; none where a bed is not linear.
    pub(super) ground_m_n: [f64; 2],
    pub(super) arch: pulp::Arch,
}

/// Motion of the track.
#[derive(Clone, Debug)]
pub struct TrackState {
    rail: RailState,
    sleeper: SleeperState,
    /// Loads on the rails in the step that has begun, those of the sleepers included.
    work: Aligned<f64>,
    seats: Vec<Seat>,
}

impl Stepper {
    /// Factorises.
    pub fn new(model: TrackModel, step: TimeStep) -> Result<Self, SimulationError> {
        step.check()?;
        let shares = step.shares();
        let sleepers = Sleepers::new(&model, shares)?;
        let effective = Effective::new(&model, &sleepers, shares)?;
        let mut out = Self {
            influence: Influence::new(&model, &effective),
            ground_m_n: [0.0; 2],
            beds: NonlinearBeds::new(&model),
            rails: Rails::new(&model),
            sleepers,
            effective,
            step,
            model,
            arch: pulp::Arch::new(),
        };
        if out.nonlinear_sleepers().is_empty() {
            out.ground_m_n = out.outer_compliance_m_n()?;
        }
        Ok(out)
    }

    fn outer_compliance_m_n(&self) -> Result<[f64; 2], SimulationError> {
        let [first, last] = self.model.extent_m();
        let x_m = first + (last - first) / 6.0;
        let points: Vec<RailPoint> = (0..2).filter_map(|side| self.model.point_on(side, x_m)).collect();
        let loads: Vec<(RailPoint, f64)> = points.iter().map(|p| (*p, 1.0)).collect();
        let state = self.static_state(&loads)?;
        let mut compliance_m_n = [0.0; 2];
        for (c, point) in compliance_m_n.iter_mut().zip(&points) {
            *c = self.rail_m(&state, point);
        }
        Ok(compliance_m_n)
    }

    /// Largest part of the influence of a load that the contact solution leaves out, relative to the influence at the
    /// load.
    pub fn influence_cut_off(&self) -> f64 {
        self.influence.cut_off(&self.effective)
    }

    /// Sleepers whose bed is not linear.
    pub fn nonlinear_sleepers(&self) -> &[usize] {
        &self.beds.sleepers
    }

    /// Unloaded track at rest.
    pub fn at_rest(&self) -> TrackState {
        let layout = self.model.layout;
        TrackState {
            rail: self.rails.at_rest(),
            sleeper: self.sleepers.at_rest(),
            work: avec![0.0; layout.rows() * layout.row],
            seats: vec![[0.0; 4]; layout.sleepers],
        }
    }

    /// Track at rest under constant forces (N) on rail points. The ballast must be linear.
    pub fn static_state(&self, loads: &[(RailPoint, f64)]) -> Result<TrackState, SimulationError> {
        if let Some(&sleeper) = self.beds.sleepers.first() {
            return Err(SimulationError::StaticStart { sleeper });
        }
        let shares = Shares { mass: 0.0, damping: 0.0, stiffness: 1.0 };
        let sleepers = Sleepers::new(&self.model, shares)?;
        let effective = Effective::new(&self.model, &sleepers, shares)?;
        let mut state = self.at_rest();
        let mut still = sleepers.at_rest();
        for (point, force) in loads {
            self.add_load(&mut state, point, [*force, -force]);
        }
        self.arch.dispatch(Settle {
            sleepers: &sleepers,
            effective: &effective,
            state: &mut state,
            still: &mut still,
        });
        state.sleeper.u = sleepers.convert(&still.v, &self.sleepers)?;
        Ok(state)
    }

    /// Begins a step: everything but the loads on the rails.
    pub fn begin(&self, state: &mut TrackState) {
        self.arch.dispatch(Begin(self, state));
    }

    /// Rate of a rail point at t + θ dt under everything but the loads of this step.
    #[inline(always)]
    pub(super) fn free_rate<S: pulp::Simd>(&self, simd: S, state: &TrackState, point: &RailPoint) -> f64 {
        self.influence.rate(simd, point, &state.work)
    }

    /// Rate of a rail point per newton on it.
    #[inline(always)]
    pub fn compliance(&self, point: &RailPoint) -> f64 {
        self.influence.compliance(point)
    }

    /// Loads a rail point during this step; between [`Stepper::begin`] and [`Stepper::finish`].
    #[inline(always)]
    pub fn load(&self, state: &mut TrackState, point: &RailPoint, force_n: f64) {
        self.add_load(state, point, [force_n, force_n / self.step.theta]);
    }

    /// Adds loads to those of the step and to b.
    #[inline(always)]
    fn add_load(
        &self,
        TrackState { rail, work, .. }: &mut TrackState,
        point: &RailPoint,
        [now, later]: [f64; 2],
    ) {
        for (a, weight) in point.weights.iter().enumerate() {
            let dof = self.model.layout.dof(point.side, point.bay, point.element, a);
            work[dof] += weight * now;
            rail.b[dof] += weight * later;
        }
    }

    /// Ends the step.
    pub fn finish(&self, state: &mut TrackState) {
        self.arch.dispatch(Finish(self, state));
    }

    /// Rates of the sleepers; new b and u from all rates.
    #[inline(always)]
    fn advance<S: pulp::Simd>(&self, simd: S, TrackState { rail, sleeper, .. }: &mut TrackState) {
        let (step, stride) = ((self.step.dt_s, self.step.theta), self.model.layout.stride);
        self.sleepers.advance(simd, sleeper, &rail.u, step);
        self.beds.carry(simd, &self.sleepers, sleeper, step.1);
        for side in 0..2 {
            let seats = &mut rail.b[side * stride..(side + 1) * stride];
            self.sleepers.advance_seats(simd, sleeper, (side, seats));
        }
        self.rails.advance(simd, rail, step);
    }

    /// Displacement of a rail point, m.
    #[inline(always)]
    pub fn rail_m(&self, state: &TrackState, point: &RailPoint) -> f64 {
        let layout = self.model.layout;
        (0..4)
            .map(|a| point.weights[a] * state.rail.u[layout.dof(point.side, point.bay, point.element, a)])
            .sum()
    }

    /// Displacement of the sleeper at the sensor, m.
    pub fn sensor_m(&self, state: &TrackState) -> f64 {
        let (sensor, s) = (&self.sleepers.sensor, self.model.sensor_sleeper);
        let of = s / CHUNK * sensor.len()..(s / CHUNK + 1) * sensor.len();
        sensor.iter().zip(&state.sleeper.u[of]).map(|(w, u)| w * u[s % CHUNK]).sum()
    }

    /// Largest deflection of the rail seats, m; NaN when anything is.
    pub fn largest_m(&self, state: &TrackState) -> f64 {
        let lanes = &state.rail.u[..self.model.layout.lanes()];
        if lanes.iter().any(|u| !u.is_finite()) {
            return f64::NAN;
        }
        lanes.iter().fold(0.0, |largest, u| largest.max(u.abs()))
    }
}

/// First half of a step, compiled for the widest vectors of the machine.
struct Begin<'a>(&'a Stepper, &'a mut TrackState);

impl pulp::WithSimd for Begin<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        let Self(stepper, TrackState { rail, sleeper, work, .. }) = self;
        let ahead_s = stepper.step.theta * stepper.step.dt_s;
        stepper.beds.apply(simd, &stepper.sleepers, sleeper, ahead_s);
        work.copy_from_slice(&rail.b);
        stepper.sleepers.condense(simd, sleeper, work);
    }
}

/// Second half of a step.
struct Finish<'a>(&'a Stepper, &'a mut TrackState);

impl pulp::WithSimd for Finish<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        let Self(stepper, state) = self;
        let TrackState { rail, sleeper, work, seats } = &mut *state;
        stepper.effective.solve_rails(simd, work, &mut rail.v, seats);
        stepper.sleepers.compress(simd, sleeper, &rail.v);
        stepper.advance(simd, state);
    }
}

/// Static solution: loads in `work`, rail displacement to u, sleeper displacement to `still.v`.
struct Settle<'a> {
    sleepers: &'a Sleepers,
    effective: &'a Effective,
    state: &'a mut TrackState,
    still: &'a mut SleeperState,
}

impl pulp::WithSimd for Settle<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        let TrackState { rail, work, seats, .. } = self.state;
        self.sleepers.condense(simd, self.still, work);
        self.effective.solve_rails(simd, work, &mut rail.u, seats);
        self.sleepers.compress(simd, self.still, &rail.u);
        self.sleepers.rates(simd, self.still);
    }
}

#[cfg(test)]
mod tests {
    use super::super::Support;
    use super::super::model::Lanes;
    use super::*;
    use crate::recording::read_site;
    use crate::track::{Kelvin, Mesh, Side, Track};

    fn site_track(damped: bool) -> Track {
        let dir = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field/reference-1");
        let mut crossing = read_site(&dir).unwrap().crossing;
        crossing.track.n_sleepers = 25;
        crossing.track.crossing_sleeper_index = 12;
        crossing.sensor.sleeper_index = 12;
        if !damped {
            crossing.rail.damping_stiffness_proportional_s = 0.0;
            crossing.sleeper.damping_stiffness_proportional_s = 0.0;
            crossing.pad.damping_ns_m = 0.0;
        }
        Track::of_crossing(&crossing, Mesh::default())
    }

    fn ballast() -> Vec<f64> {
        (0..25).map(|s| if s == 12 { 18e6 } else { 30e6 }).collect()
    }

    fn stepper(track: &Track, damping: f64, modes: usize, dt_s: f64) -> Stepper {
        let supports = ballast().iter().map(|k| Support::linear(*k, damping)).collect();
        Stepper::new(TrackModel::new(track, supports, modes).unwrap(), TimeStep { dt_s, theta: 0.5 }).unwrap()
    }

    /// Steady response at the sensor and under the load to a harmonic force at a rail node: amplitude by Fourier
    /// coefficients over whole periods after the transient.
    fn harmonic(stepper: &Stepper, node_x_m: f64, frequency_hz: f64) -> [f64; 2] {
        let dt = stepper.step.dt_s;
        let per_period = (1.0 / (frequency_hz * dt)).round() as usize;
        let (skip, count) = (per_period * ((0.6 / dt) as usize / per_period), 20 * per_period);
        let point = stepper.model.point(Side::Crossing, node_x_m).unwrap();
        let mut state = stepper.at_rest();
        let mut sums = [[0.0; 2]; 2];
        for n in 0..skip + count {
            let phase = std::f64::consts::TAU * (n as f64 + 0.5) / per_period as f64;
            stepper.begin(&mut state);
            // The scheme holds at the middle of the step; so does the force.
            stepper.load(&mut state, &point, phase.cos());
            stepper.finish(&mut state);
            if n >= skip {
                let after = std::f64::consts::TAU * (n as f64 + 1.0) / per_period as f64;
                for (sum, value) in
                    sums.iter_mut().zip([stepper.sensor_m(&state), stepper.rail_m(&state, &point)])
                {
                    sum[0] += value * after.cos() * 2.0 / count as f64;
                    sum[1] += value * after.sin() * 2.0 / count as f64;
                }
            }
        }
        // Displacement between the steps is the mean of its ends: amplitude times cos(ω dt/2).
        let mean = (std::f64::consts::PI / per_period as f64).cos();
        sums.map(|s| s[0].hypot(s[1]) * mean)
    }

    #[test]
    fn property_harmonic_response_is_that_of_the_frequency_domain_model() {
        let mut track = site_track(true);
        // The passage simulation uses the elements as they are.
        track.rail_halvings = 0;
        let full = stepper(&track, 125e3, 100, 1e-4);
        let reduced = stepper(&track, 125e3, crate::passage::SLEEPER_MODES, 1e-4);
        let node = track.seat_node(11) + 1;
        for frequency_hz in [20.0, 100.0, 200.0, 400.0] {
            let per_period = (1e4_f64 / frequency_hz).round();
            // The scheme sees the frequency 2/dt tan(ω dt/2).
            let seen = (std::f64::consts::PI / per_period).tan() * 1e4 / std::f64::consts::PI;
            let sensor = track.sensor_receptance(&[seen], &ballast()).crossing[0][node][0].norm();
            let rail =
                track.rail_receptance(&[seen], &ballast(), Side::Crossing, &[node], &[node])[0][0][0].norm();
            for (what, model, tolerance) in [("full", &full, 1e-6), ("reduced", &reduced, 0.01)] {
                let found = harmonic(model, track.node_x_m[node], 1e4 / per_period);
                for (found, expected) in found.iter().zip([sensor, rail]) {
                    let error = found / expected - 1.0;
                    assert!(error.abs() < tolerance, "{what}, {frequency_hz} Hz: {error}");
                }
            }
        }
    }

    #[test]
    fn property_width_of_the_vectors_changes_no_bit() {
        let track = site_track(true);
        let wide = stepper(&track, 125e3, crate::passage::SLEEPER_MODES, 1e-4);
        let narrow = Stepper { arch: pulp::Arch::Scalar, ..wide.clone() };
        let point = wide.model.point(Side::Stock, track.node_x_m[track.seat_node(11)] + 0.17).unwrap();
        let [wide, narrow] = [&wide, &narrow].map(|stepper| {
            let mut state = stepper.at_rest();
            for n in 0..200 {
                stepper.begin(&mut state);
                stepper.load(&mut state, &point, f64::from(n % 7));
                stepper.finish(&mut state);
            }
            (stepper.sensor_m(&state), stepper.rail_m(&state, &point))
        });
        assert_eq!(wide, narrow);
        assert!(wide.0.abs() > 0.0, "the sensor moves");
    }

    #[test]
    fn property_static_state_is_the_limit_of_the_frequency_domain_model() {
        let track = site_track(true);
        let stepper = stepper(&track, 125e3, 3, 1e-4);
        let node = track.seat_node(10);
        let point = stepper.model.point(Side::Crossing, track.node_x_m[node]).unwrap();
        let state = stepper.static_state(&[(point, 1.0)]).unwrap();
        let rail =
            track.rail_receptance(&[1e-4], &ballast(), Side::Crossing, &[node], &[node])[0][0][0].norm();
        assert!((stepper.rail_m(&state, &point) / rail - 1.0).abs() < 1e-6, "seats are statically exact");
        // Nothing moves when the load stays.
        let mut moving = state.clone();
        for _ in 0..50 {
            stepper.begin(&mut moving);
            stepper.load(&mut moving, &point, 1.0);
            stepper.finish(&mut moving);
        }
        assert!((stepper.rail_m(&moving, &point) / rail - 1.0).abs() < 1e-6);
    }

    #[test]
    fn property_energy_of_the_undamped_track_is_the_work_done_on_it() {
        let stepper = stepper(&site_track(false), 0.0, 5, 1e-4);
        let point = stepper.model.point(Side::Stock, 0.47).unwrap();
        let mut state = stepper.at_rest();
        let ahead = stepper.step.theta * stepper.step.dt_s;
        let join = |rail: &[f64], sleeper: &[Lanes]| [rail, sleeper.as_flattened()].concat();
        // Elastic forces: what the momentum term loses without any rate.
        let elastic = |s: &TrackState| {
            let mut still = stepper.at_rest();
            (still.rail.u, still.sleeper.u) = (s.rail.u.clone(), s.sleeper.u.clone());
            stepper.advance(pulp::Scalar::new(), &mut still);
            let lost = join(&still.rail.b, &still.sleeper.b);
            lost.iter().map(|b| -stepper.step.theta * b).collect::<Vec<f64>>()
        };
        let momentum = |s: &TrackState| {
            let b = join(&s.rail.b, &s.sleeper.b);
            b.iter().zip(elastic(s)).map(|(b, r)| (b + r) * ahead).collect::<Vec<f64>>()
        };
        let motion = |s: &TrackState| join(&s.rail.u, &s.sleeper.u);
        let change = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<f64>>();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        let (mut kinetic, mut work) = (0.0, 0.0);
        for n in 0..2000 {
            let before = (momentum(&state), motion(&state));
            let at = stepper.rail_m(&state, &point);
            let force = if n < 300 { 1e5 * (f64::from(n) / 50.0).sin() } else { 0.0 };
            stepper.begin(&mut state);
            stepper.load(&mut state, &point, force);
            stepper.finish(&mut state);
            work += force * (stepper.rail_m(&state, &point) - at);
            let moved = change(&motion(&state), &before.1);
            kinetic += dot(&change(&momentum(&state), &before.0), &moved) / stepper.step.dt_s;
            let potential = 0.5 * dot(&motion(&state), &elastic(&state));
            assert!(
                (kinetic + potential - work).abs() < 1e-7 * work.abs().max(1.0),
                "{n}: {kinetic} {potential} {work}"
            );
        }
        assert!(kinetic > 0.0 && work > 0.0);
    }

    #[test]
    fn property_numerical_damping_takes_energy_out_and_half_does_not() {
        let swing = |theta: f64| {
            let track = site_track(false);
            let supports = ballast().iter().map(|k| Support::linear(*k, 0.0)).collect();
            let model = TrackModel::new(&track, supports, 3).unwrap();
            let stepper = Stepper::new(model, TimeStep { dt_s: 2e-4, theta }).unwrap();
            let point = stepper.model.point(Side::Crossing, 0.3).unwrap();
            let mut state = stepper.at_rest();
            let mut late: f64 = 0.0;
            for n in 0..5000 {
                stepper.begin(&mut state);
                stepper.load(&mut state, &point, if n < 10 { 1e5 } else { 0.0 });
                stepper.finish(&mut state);
                if n > 4000 {
                    late = late.max(stepper.sensor_m(&state).abs());
                }
            }
            late
        };
        let (none, some) = (swing(0.5), swing(0.6));
        assert!(none > 1e-5 && some < 0.5 * none, "{none} {some}");
    }

    #[test]
    fn property_influence_left_out_is_negligible() {
        let track = Track::benchmark_t1(Kelvin { stiffness: 200e6, damping: 28e3 }, Mesh::default());
        let supports = vec![Support::linear(30e6, 125e3); 101];
        let stepper =
            Stepper::new(TrackModel::new(&track, supports, 2).unwrap(), TimeStep::default()).unwrap();
        // The most is at the free ends of the rails.
        assert!(stepper.influence_cut_off() < 3e-5, "{}", stepper.influence_cut_off());
        // The rate found before the step is the rate that the step then has.
        let points = [3.31, 30.1, 59.9].map(|x| stepper.model.point(Side::Crossing, x).unwrap());
        let mut state = stepper.at_rest();
        for n in 0..200 {
            stepper.begin(&mut state);
            let force = 1e4 * (1.0 + f64::from(n).sin());
            let expected = points
                .map(|p| stepper.free_rate(pulp::Scalar::new(), &state, &p) + force * stepper.compliance(&p));
            let before = points.map(|p| stepper.rail_m(&state, &p));
            for point in &points {
                stepper.load(&mut state, point, force);
            }
            stepper.finish(&mut state);
            for ((point, expected), before) in points.iter().zip(expected).zip(before) {
                let rate = (stepper.rail_m(&state, point) - before) / stepper.step.dt_s;
                assert!((rate - expected).abs() < 1e-6 * (1.0 + expected.abs()), "{n}: {rate} {expected}");
            }
        }
    }
}
