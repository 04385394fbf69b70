//! Time integration of the track: one-step scheme with the rate taken at t + θ dt. θ = ½ is Newmark's average
//! acceleration (implicit midpoint rule): unconditionally stable, second order, no numerical damping. θ > ½ damps.
//!
//! With v the rate at t + θ dt and A = M/(θ dt) + C + θ dt K, one step solves A v = f + b with b = M v₀/(θ dt) − K u₀.
//! Because M v/(θ dt) = f + b − C v − θ dt K v, neither M nor K is applied to the state: with the elastic force r = K u,
//!   b ← b + (f − r − C v)/θ − 2 dt K v,   r ← r + dt K v,   u ← u + dt v.

use super::chain::Seat;
use super::effective::{Effective, Shares, lanes, lanes_mut};
use super::error::SimulationError;
use super::influence::Influence;
use super::model::{CHUNK, RailPoint, TrackModel};
use super::support::Support;

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
    effective: Effective,
    influence: Influence,
    elements: Elements,
    /// Per sleeper lane: implicit ballast stiffness, damping and 1/(a_m m + c + a_k k).
    bed_stiffness: Vec<f64>,
    bed_damping: Vec<f64>,
    bed_inverse: Vec<f64>,
    nonlinear: Vec<usize>,
    pub(super) arch: pulp::Arch,
}

/// Stiffness of the rail elements in terms of shear and bending deformation, `[element in bay · row + lane]`.
#[derive(Clone, Debug)]
struct Elements {
    shear: Vec<f64>,
    bending: Vec<f64>,
    half_length_m: f64,
}

/// Motion of the track.
#[derive(Clone, Debug)]
pub struct TrackState {
    rail: Motion,
    sleeper: Motion,
    /// Sleeper rates one step earlier.
    earlier: Vec<f64>,
    correction: Vec<f64>,
    load: Vec<f64>,
    work: Vec<f64>,
    seats: Vec<Seat>,
}

/// Displacement u, rate v at t + θ dt, elastic force r and momentum term b of a set of values.
#[derive(Clone, Debug)]
struct Motion {
    u: Vec<f64>,
    v: Vec<f64>,
    r: Vec<f64>,
    b: Vec<f64>,
}

impl Motion {
    fn at_rest(len: usize) -> Self {
        Self { u: vec![0.0; len], v: vec![0.0; len], r: vec![0.0; len], b: vec![0.0; len] }
    }
}

impl Stepper {
    /// Factorises.
    pub fn new(model: TrackModel, step: TimeStep) -> Result<Self, SimulationError> {
        step.check()?;
        let shares = step.shares();
        let effective = Effective::new(&model, shares)?;
        let influence = Influence::new(&model, &effective);
        let stride = model.layout.stride;
        let per_sleeper = |value: &dyn Fn(&Support) -> f64| {
            let mut lanes = vec![0.0; stride];
            for (lane, support) in lanes.iter_mut().zip(&model.supports) {
                *lane = value(support);
            }
            lanes
        };
        let bed = |s: &Support| {
            let (k, c) = s.implicit();
            let sum = shares.mass * s.mass_kg_m + c + shares.stiffness * k;
            // Without a bed its deflection is of no consequence.
            if sum > 0.0 { 1.0 / sum } else { 0.0 }
        };
        Ok(Self {
            bed_stiffness: per_sleeper(&|s| s.implicit().0),
            bed_damping: per_sleeper(&|s| s.implicit().1),
            bed_inverse: per_sleeper(&bed),
            nonlinear: (0..model.supports.len()).filter(|s| !model.supports[*s].is_linear()).collect(),
            elements: Elements::new(&model),
            effective,
            influence,
            step,
            model,
            arch: pulp::Arch::new(),
        })
    }

    /// Largest part of the influence of a load that the contact solution leaves out, relative to the influence at the
    /// load.
    pub fn influence_cut_off(&self) -> f64 {
        self.influence.cut_off
    }

    /// Sleepers whose bed is not linear.
    pub fn nonlinear_sleepers(&self) -> &[usize] {
        &self.nonlinear
    }

    /// Unloaded track at rest.
    pub fn at_rest(&self) -> TrackState {
        let layout = self.model.layout;
        let (rail, sleeper) = (layout.rows() * layout.row, self.model.basis.len() * layout.stride);
        TrackState {
            rail: Motion::at_rest(rail),
            sleeper: Motion::at_rest(sleeper),
            earlier: vec![0.0; sleeper],
            correction: vec![0.0; sleeper],
            load: vec![0.0; sleeper],
            work: vec![0.0; rail],
            seats: vec![[0.0; 4]; layout.sleepers],
        }
    }

    /// Track at rest under constant forces (N) on rail points. The ballast must be linear.
    pub fn static_state(&self, loads: &[(RailPoint, f64)]) -> Result<TrackState, SimulationError> {
        if let Some(&sleeper) = self.nonlinear.first() {
            return Err(SimulationError::StaticStart { sleeper });
        }
        let shares = Shares { mass: 0.0, damping: 0.0, stiffness: 1.0 };
        let elastic = Effective::new(&self.model, shares)?;
        let mut state = self.at_rest();
        for (point, force) in loads {
            self.add_load(&mut state.rail.r, point, *force);
        }
        for (b, r) in state.rail.b.iter_mut().zip(&state.rail.r) {
            *b = -r;
        }
        state.rail.u.copy_from_slice(&state.rail.r);
        elastic.condense(&state.correction, &mut state.sleeper.u, &mut state.rail.u);
        elastic.solve_rails(&mut state.rail.u, &mut state.seats);
        elastic.recover_sleepers(&state.rail.u, &mut state.sleeper.u);
        Ok(state)
    }

    fn add_load(&self, values: &mut [f64], point: &RailPoint, force: f64) {
        for (a, weight) in point.weights.iter().enumerate() {
            values[self.model.layout.dof(point.side, point.bay, point.element, a)] += weight * force;
        }
    }

    /// Begins a step: everything but the loads on the rails.
    pub fn begin(&self, state: &mut TrackState) {
        if !self.nonlinear.is_empty() {
            self.correct_beds(state);
        }
        self.arch.dispatch(Begin(self, state));
    }

    /// Rate of a rail point at t + θ dt under everything but the loads of this step.
    #[inline(always)]
    pub fn free_rate(&self, state: &TrackState, point: &RailPoint) -> f64 {
        self.influence.rate(point, &state.work)
    }

    /// Rate of a rail point per newton on it.
    #[inline(always)]
    pub fn compliance(&self, point: &RailPoint) -> f64 {
        self.influence.compliance(point)
    }

    /// Loads a rail point during this step; between [`Stepper::begin`] and [`Stepper::finish`].
    pub fn load(&self, state: &mut TrackState, point: &RailPoint, force_n: f64) {
        self.add_load(&mut state.work, point, force_n);
        self.add_load(&mut state.rail.b, point, force_n / self.step.theta);
    }

    /// Ends the step.
    pub fn finish(&self, state: &mut TrackState) {
        self.arch.dispatch(Finish(self, state));
    }

    /// Sleepers and pads: new r, b, u of the coordinates; pad forces on the rail seats.
    #[inline(always)]
    fn advance_sleepers(&self, state: &mut TrackState) {
        let (stride, n) = (self.model.layout.stride, self.model.basis.len());
        let basis = &self.model.basis;
        let (dt, per_theta, shares) = (self.step.dt_s, 1.0 / self.step.theta, self.step.shares());
        let (kp, cp, gp) = (self.model.pad.stiffness, self.model.pad.damping, self.effective.pad);
        let TrackState { rail, sleeper, correction, .. } = state;
        for at in (0..stride).step_by(CHUNK) {
            // Rate of pad compression.
            let mut pad = [*lanes(&rail.v, at), *lanes(&rail.v, stride + at)];
            for i in 0..n {
                let v = lanes(&sleeper.v, i * stride + at);
                for (p, shape) in pad.iter_mut().zip(&basis.seat) {
                    for l in 0..CHUNK {
                        p[l] -= shape[i] * v[l];
                    }
                }
            }
            for (side, p) in pad.iter().enumerate() {
                let place = side * stride + at;
                let (mut b, mut r) = (*lanes(&rail.b, place), *lanes(&rail.r, place));
                for l in 0..CHUNK {
                    b[l] -= (r[l] + cp * p[l]) * per_theta + 2.0 * dt * kp * p[l];
                    // The elastic force of the beam itself is added with the elements, after this r was used.
                    r[l] += dt * kp * p[l];
                }
                (*lanes_mut(&mut rail.b, place), *lanes_mut(&mut rail.r, place)) = (b, r);
            }
            let (k, c, bed) = (
                *lanes(&self.bed_stiffness, at),
                *lanes(&self.bed_damping, at),
                *lanes(&self.bed_inverse, at),
            );
            for i in 0..n {
                let elastic = basis.elastic[i];
                let inertia = shares.mass + (basis.damping_s + shares.stiffness) * elastic;
                let place = i * stride + at;
                // Copies, because the compiler cannot know that the lists do not overlap.
                let (v, f) = (*lanes(&sleeper.v, place), *lanes(correction, place));
                let (mut b, mut r) = (*lanes(&sleeper.b, place), *lanes(&sleeper.r, place));
                let mut u = *lanes(&sleeper.u, place);
                for l in 0..CHUNK {
                    let through_pads = basis.seat[0][i] * pad[0][l] + basis.seat[1][i] * pad[1][l];
                    // From the equation itself: what is neither inertia nor elastic is the bed's share.
                    let deflection = (f[l] + b[l] + gp * through_pads - inertia * v[l]) * bed[l];
                    let stiff = elastic * v[l] + k[l] * deflection - kp * through_pads;
                    let damp = basis.damping_s * elastic * v[l] + c[l] * deflection - cp * through_pads;
                    b[l] += (f[l] - r[l] - damp) * per_theta - 2.0 * dt * stiff;
                    r[l] += dt * stiff;
                    u[l] += dt * v[l];
                }
                (*lanes_mut(&mut sleeper.b, place), *lanes_mut(&mut sleeper.r, place)) = (b, r);
                *lanes_mut(&mut sleeper.u, place) = u;
            }
        }
    }

    /// Rails: elastic force of the elements, then r, b, u. Pads have already used up the old r of the seats.
    #[inline(always)]
    fn advance_rails(&self, state: &mut TrackState) {
        let layout = self.model.layout;
        let (dt, theta, row) = (self.step.dt_s, self.step.theta, layout.row);
        let damping = self.model.rail_damping_s;
        let TrackState { rail, work, .. } = state;
        work.fill(0.0);
        self.elements.apply(&rail.v, work, layout.nodes_per_bay, (layout.lanes(), row));
        for index in 0..layout.rows() {
            // Row 0 holds the seats' deflections, whose r went into b with the pads.
            let old = if index == 0 { 0.0 } else { 1.0 / theta };
            for at in (index * row..index * row + layout.lanes()).step_by(CHUNK) {
                let (k, v) = (*lanes(work, at), *lanes(&rail.v, at));
                let (mut b, mut r, mut u) = (*lanes(&rail.b, at), *lanes(&rail.r, at), *lanes(&rail.u, at));
                for l in 0..CHUNK {
                    b[l] -= old * r[l] + (damping / theta + 2.0 * dt) * k[l];
                    r[l] += dt * k[l];
                    u[l] += dt * v[l];
                }
                (*lanes_mut(&mut rail.b, at), *lanes_mut(&mut rail.r, at)) = (b, r);
                *lanes_mut(&mut rail.u, at) = u;
            }
        }
    }

    /// Forces of the nonlinear beds at t + θ dt, with the rate extrapolated from the last two steps.
    fn correct_beds(&self, state: &mut TrackState) {
        let (stride, basis) = (self.model.layout.stride, &self.model.basis);
        let n = basis.len();
        let ahead = self.step.theta * self.step.dt_s;
        let TrackState { sleeper, earlier, correction, .. } = state;
        for &s in &self.nonlinear {
            let support = &self.model.supports[s];
            for i in 0..n {
                correction[i * stride + s] = 0.0;
            }
            for (point, length) in basis.tributary_m.iter().enumerate() {
                let (mut w, mut rate) = (0.0, 0.0);
                for i in 0..n {
                    let shape = basis.points[(point, i)];
                    let at = i * stride + s;
                    rate += shape * (2.0 * sleeper.v[at] - earlier[at]);
                    w += shape * sleeper.u[at];
                }
                let force = length * support.correction(w + ahead * rate, rate);
                for i in 0..n {
                    correction[i * stride + s] += basis.points[(point, i)] * force;
                }
            }
            for i in 0..n {
                earlier[i * stride + s] = sleeper.v[i * stride + s];
            }
        }
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
        let (stride, s) = (self.model.layout.stride, self.model.sensor_sleeper);
        self.model.basis.sensor.iter().enumerate().map(|(i, w)| w * state.sleeper.u[i * stride + s]).sum()
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

/// First half of a step, compiled for the widest vectors of the machine. Only the width differs: no operation is fused
/// or reordered, so that every machine gives the same bits.
struct Begin<'a>(&'a Stepper, &'a mut TrackState);

impl pulp::WithSimd for Begin<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _simd: S) {
        let Self(stepper, TrackState { rail, sleeper, correction, work, load, .. }) = self;
        work.copy_from_slice(&rail.b);
        for ((total, b), c) in load.iter_mut().zip(&sleeper.b).zip(correction.iter()) {
            *total = b + c;
        }
        stepper.effective.condense(load, &mut sleeper.v, work);
    }
}

/// Second half of a step.
struct Finish<'a>(&'a Stepper, &'a mut TrackState);

impl pulp::WithSimd for Finish<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _simd: S) {
        let Self(stepper, state) = self;
        stepper.effective.solve_rails(&mut state.work, &mut state.seats);
        std::mem::swap(&mut state.rail.v, &mut state.work);
        stepper.effective.recover_sleepers(&state.rail.v, &mut state.sleeper.v);
        stepper.advance_sleepers(state);
        stepper.advance_rails(state);
    }
}

impl Elements {
    fn new(model: &TrackModel) -> Self {
        let layout = model.layout;
        let len = layout.nodes_per_bay * layout.row;
        let (mut shear, mut bending) = (vec![0.0; len], vec![0.0; len]);
        for side in 0..2 {
            for bay in 0..layout.sleepers - 1 {
                for e in 0..layout.nodes_per_bay {
                    let Some(section) = model.section(side, bay, e) else { continue };
                    let (at, l) = (e * layout.row + side * layout.stride + bay, model.step_m);
                    let phi = crate::beam::shear_ratio(section, l);
                    shear[at] = 12.0 * section.bending_n_m2 / ((1.0 + phi) * l * l * l);
                    bending[at] = section.bending_n_m2 / l;
                }
            }
        }
        Self { shear, bending, half_length_m: 0.5 * model.step_m }
    }

    /// out += K v: each element's shear force and bending moment from its deformation.
    #[inline(always)]
    fn apply(&self, v: &[f64], out: &mut [f64], nodes: usize, (used, row): (usize, usize)) {
        let h = self.half_length_m;
        for e in 0..nodes {
            // The node behind the last one of a bay is the seat of the next sleeper.
            let (next, shift) = if e + 1 < nodes { (2 * (e + 1), 0) } else { (0, 1) };
            for at in (0..used).step_by(CHUNK) {
                let (w1, t1) = (*lanes(v, 2 * e * row + at), *lanes(v, (2 * e + 1) * row + at));
                let (w2, t2) = (*lanes(v, next * row + at + shift), *lanes(v, (next + 1) * row + at + shift));
                let (ks, kb) = (lanes(&self.shear, e * row + at), lanes(&self.bending, e * row + at));
                let (mut force, mut left, mut right) = ([0.0; CHUNK], [0.0; CHUNK], [0.0; CHUNK]);
                for l in 0..CHUNK {
                    let shear = ks[l] * (w2[l] - w1[l] - h * (t1[l] + t2[l]));
                    let moment = kb[l] * (t2[l] - t1[l]);
                    force[l] = shear;
                    left[l] = -h * shear - moment;
                    right[l] = -h * shear + moment;
                }
                add(lanes_mut(out, 2 * e * row + at), &force, -1.0);
                add(lanes_mut(out, (2 * e + 1) * row + at), &left, 1.0);
                add(lanes_mut(out, next * row + at + shift), &force, 1.0);
                add(lanes_mut(out, (next + 1) * row + at + shift), &right, 1.0);
            }
        }
    }
}

#[inline(always)]
fn add(target: &mut [f64; CHUNK], values: &[f64; CHUNK], sign: f64) {
    for (t, v) in target.iter_mut().zip(values) {
        *t += sign * v;
    }
}

#[cfg(test)]
mod tests {
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
        let momentum = |m: &Motion| m.b.iter().zip(&m.r).map(|(b, r)| (b + r) * ahead).collect::<Vec<f64>>();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        let (mut kinetic, mut work) = (0.0, 0.0);
        for n in 0..2000 {
            let before = [momentum(&state.rail), momentum(&state.sleeper)];
            let at = stepper.rail_m(&state, &point);
            let force = if n < 300 { 1e5 * (f64::from(n) / 50.0).sin() } else { 0.0 };
            stepper.begin(&mut state);
            stepper.load(&mut state, &point, force);
            stepper.finish(&mut state);
            work += force * (stepper.rail_m(&state, &point) - at);
            for (p, m) in before.iter().zip([&state.rail, &state.sleeper]) {
                let change: Vec<f64> = momentum(m).iter().zip(p).map(|(a, b)| a - b).collect();
                kinetic += dot(&change, &m.v);
            }
            let potential =
                0.5 * (dot(&state.rail.u, &state.rail.r) + dot(&state.sleeper.u, &state.sleeper.r));
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
        assert!(stepper.influence_cut_off() < 1e-6, "{}", stepper.influence_cut_off());
        // The rate found before the step is the rate that the step then has.
        let points = [3.31, 30.1, 59.9].map(|x| stepper.model.point(Side::Crossing, x).unwrap());
        let mut state = stepper.at_rest();
        for n in 0..200 {
            stepper.begin(&mut state);
            let force = 1e4 * (1.0 + f64::from(n).sin());
            let expected = points.map(|p| stepper.free_rate(&state, &p) + force * stepper.compliance(&p));
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
