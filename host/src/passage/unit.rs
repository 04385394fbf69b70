//! Vehicles: bogies (two rigid wheelsets with heave and roll, frame with heave, pitch and roll, linear primary suspension)
//! or single wheelsets. The car body is a constant force: what it adds to the wheels is their static force.

use nalgebra::{SMatrix, SVector};
use pulp::Simd;

use super::error::{SimulationError, in_range};
use super::model::{CHUNK, Lanes};
use super::stepper::TimeStep;
use super::surface::{OutOfRoundness, WheelFlat};
use super::vectors::{parts, vectors, vectors_mut};
use crate::recording::Vehicle;
use crate::vehicle::AxlePattern;

/// Degrees of freedom of a unit: z₁, φ₁, z₂, φ₂ of the wheelsets, z, θ, φ of the frame.
const DOF: usize = 7;
/// Wheels of a unit: crossing and stock side of the front, then of the rear wheelset.
pub(super) const CONTACTS: usize = 4;
type Matrix = SMatrix<f64, DOF, DOF>;
type Vector = SVector<f64, DOF>;

/// One wheel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Wheel {
    /// Static force, N.
    pub static_force_n: f64,
    /// Which of the paths through the crossing it takes (crossing side only).
    pub path: usize,
    /// Factor on the depth of the path.
    pub depth_factor: f64,
    /// The wheel meets the path this much later in +x, m.
    pub shift_m: f64,
    /// Waves around the wheel.
    pub out_of_roundness: Vec<OutOfRoundness>,
    /// Flat spot.
    pub flat: Option<WheelFlat>,
}

impl Wheel {
    /// Round nominal wheel.
    pub fn nominal(static_force_n: f64) -> Self {
        Self { static_force_n, depth_factor: 1.0, ..Self::default() }
    }
}

/// Masses and suspension of a bogie.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct Bogie {
    /// Front and rear.
    pub wheelset_mass_kg: [f64; 2],
    pub wheelset_roll_inertia_kg_m2: [f64; 2],
    pub frame_mass_kg: f64,
    pub frame_pitch_inertia_kg_m2: f64,
    pub frame_roll_inertia_kg_m2: f64,
    pub stiffness_per_axle_box_n_m: f64,
    pub damping_per_axle_box_ns_m: f64,
    pub axle_box_half_distance_m: f64,
    pub contact_half_distance_m: f64,
    pub axle_spacing_m: f64,
}

impl Bogie {
    /// As the site description has it.
    pub fn of_vehicle(v: &Vehicle) -> Self {
        Self {
            wheelset_mass_kg: [v.wheelset_mass_kg; 2],
            wheelset_roll_inertia_kg_m2: [v.wheelset_roll_inertia_kg_m2; 2],
            frame_mass_kg: v.bogie_frame_mass_kg,
            frame_pitch_inertia_kg_m2: v.bogie_frame_pitch_inertia_kg_m2,
            frame_roll_inertia_kg_m2: v.bogie_frame_roll_inertia_kg_m2,
            stiffness_per_axle_box_n_m: v.primary_stiffness_per_axle_box_n_m,
            damping_per_axle_box_ns_m: v.primary_damping_per_axle_box_ns_m,
            axle_box_half_distance_m: v.axle_box_half_distance_m,
            contact_half_distance_m: v.contact_half_distance_m,
            axle_spacing_m: v.axle_spacing_m,
        }
    }
}

/// Equations of one bogie or wheelset.
#[derive(Clone, Debug, PartialEq)]
pub struct VehicleUnit {
    mass: Vector,
    stiffness: Matrix,
    damping: Matrix,
    /// Contact displacement per degree of freedom.
    contacts: Vec<Vector>,
    /// Distance of each axle behind the first axle of the train, m.
    axle_offset_m: Vec<f64>,
}

impl VehicleUnit {
    /// A bogie whose front axle is `offset_m` behind the first axle of the train.
    pub fn bogie(b: &Bogie, offset_m: f64) -> Result<Self, SimulationError> {
        let masses = b.wheelset_mass_kg.iter().chain([&b.frame_mass_kg]);
        let inertias = b.wheelset_roll_inertia_kg_m2.iter();
        for value in masses.chain(inertias).chain([&b.frame_pitch_inertia_kg_m2, &b.frame_roll_inertia_kg_m2])
        {
            in_range("mass or inertia of a bogie", *value, [1.0, 1e6], "kg or kg m2")?;
        }
        in_range("primary stiffness", b.stiffness_per_axle_box_n_m, [0.0, 1e9], "N/m")?;
        in_range("primary damping", b.damping_per_axle_box_ns_m, [0.0, 1e7], "Ns/m")?;
        let ([m1, m2], [j1, j2]) = (b.wheelset_mass_kg, b.wheelset_roll_inertia_kg_m2);
        let mass = Vector::from([
            m1,
            j1,
            m2,
            j2,
            b.frame_mass_kg,
            b.frame_pitch_inertia_kg_m2,
            b.frame_roll_inertia_kg_m2,
        ]);
        let mut boxes = Matrix::zeros();
        for (axle, lever) in [0.5, -0.5].into_iter().enumerate() {
            for y in [b.axle_box_half_distance_m, -b.axle_box_half_distance_m] {
                let mut stretch = Vector::zeros();
                (stretch[2 * axle], stretch[2 * axle + 1]) = (-1.0, -y);
                (stretch[4], stretch[5], stretch[6]) = (1.0, lever * b.axle_spacing_m, y);
                boxes += stretch * stretch.transpose();
            }
        }
        Ok(Self {
            mass,
            stiffness: boxes * b.stiffness_per_axle_box_n_m,
            damping: boxes * b.damping_per_axle_box_ns_m,
            contacts: [0, 1].into_iter().flat_map(|axle| contacts(axle, b.contact_half_distance_m)).collect(),
            axle_offset_m: vec![offset_m, offset_m + b.axle_spacing_m],
        })
    }

    /// The same unit with its axles farther behind the first axle of the train, metres.
    pub fn behind(&self, by_m: f64) -> Self {
        let axle_offset_m = self.axle_offset_m.iter().map(|offset_m| offset_m + by_m).collect();
        Self { axle_offset_m, ..self.clone() }
    }

    /// A wheelset under a constant force, without suspension.
    pub fn wheelset(
        mass_kg: f64,
        roll_inertia_kg_m2: f64,
        half_distance_m: f64,
        offset_m: f64,
    ) -> Result<Self, SimulationError> {
        in_range("mass of a wheelset", mass_kg, [1.0, 1e6], "kg")?;
        in_range("roll inertia of a wheelset", roll_inertia_kg_m2, [1.0, 1e6], "kg m2")?;
        let mut mass = Vector::repeat(1.0);
        (mass[0], mass[1]) = (mass_kg, roll_inertia_kg_m2);
        Ok(Self {
            mass,
            stiffness: Matrix::zeros(),
            damping: Matrix::zeros(),
            contacts: contacts(0, half_distance_m).to_vec(),
            axle_offset_m: vec![offset_m],
        })
    }

    /// Distance of the axle of contact `i` behind the first axle of the train, m.
    pub fn contact_offset_m(&self, contact: usize) -> f64 {
        self.axle_offset_m[contact / 2]
    }

    /// Number of wheels.
    pub fn wheels(&self) -> usize {
        self.contacts.len()
    }
}

fn contacts(axle: usize, half_distance_m: f64) -> [Vector; 2] {
    [half_distance_m, -half_distance_m].map(|y| {
        let mut jacobian = Vector::zeros();
        (jacobian[2 * axle], jacobian[2 * axle + 1]) = (1.0, y);
        jacobian
    })
}

/// Train: units front to rear, and their wheels in the order of the units' contacts.
#[derive(Clone, Debug, PartialEq)]
pub struct Train {
    /// Bogies or wheelsets.
    pub units: Vec<VehicleUnit>,
    /// Two per axle: crossing side, stock side.
    pub wheels: Vec<Wheel>,
    /// m.
    pub wheel_radius_m: f64,
}

impl Train {
    /// Nominal train of a site; `static_force_n` on every wheel.
    pub fn of_vehicle(vehicle: &Vehicle, static_force_n: f64) -> Result<Self, SimulationError> {
        let pattern = AxlePattern::of_vehicle(vehicle);
        let bogie = Bogie::of_vehicle(vehicle);
        Ok(Self {
            units: pattern
                .offset_m
                .iter()
                .step_by(2)
                .map(|offset| VehicleUnit::bogie(&bogie, *offset))
                .collect::<Result<_, _>>()?,
            wheels: vec![Wheel::nominal(static_force_n); 2 * pattern.offset_m.len()],
            wheel_radius_m: vehicle.wheel_radius_m,
        })
    }

    /// Refuses trains whose parts do not fit together.
    pub fn check(&self, paths: usize) -> Result<(), SimulationError> {
        let axles = self.units.iter().map(|u| u.axle_offset_m.len()).sum();
        if self.wheels.len() != 2 * axles {
            return Err(SimulationError::Wheels { axles, wheels: self.wheels.len() });
        }
        let offset_m = || self.units.iter().flat_map(|u| &u.axle_offset_m);
        if let Some((before, after)) =
            offset_m().zip(offset_m().skip(1)).find(|(before, after)| before > after)
        {
            return Err(SimulationError::Order { before_m: *before, after_m: *after });
        }
        for (wheel, w) in self.wheels.iter().enumerate() {
            in_range("static wheel force", w.static_force_n, [1.0, 1e6], "N")?;
            if w.path >= paths {
                return Err(SimulationError::Path { path: w.path, wheel, paths });
            }
        }
        in_range("wheel radius", self.wheel_radius_m, [0.1, 2.0], "m")
    }

    /// Distance from the first to the last axle, m.
    pub fn length_m(&self) -> f64 {
        self.units.iter().flat_map(|u| &u.axle_offset_m).fold(0.0, |a, b| a.max(*b))
    }
}

/// A unit factorised for a time step. Degrees of freedom in the lanes of a chunk, of which the last stays empty.
#[derive(Clone)]
pub(super) struct UnitStepper {
    unit: VehicleUnit,
    /// Rates at t + θ dt per rate and per displacement at t, and per contact force, by columns.
    of_rate: [Lanes; DOF],
    of_displacement: [Lanes; DOF],
    of_force: [Lanes; CONTACTS],
    /// Contact displacement rate per contact force, both ways.
    pub compliance: [[f64; CONTACTS]; CONTACTS],
    /// The same without a contact's own.
    pub others: [[f64; CONTACTS]; CONTACTS],
    step: TimeStep,
}

/// Motion of a unit, relative to its static state on level ground.
#[derive(Clone, Debug)]
pub(super) struct UnitState {
    x: Lanes,
    v: Lanes,
    rate: Lanes,
    /// Displacement at t + θ dt without contact forces.
    free: Lanes,
}

impl UnitStepper {
    pub fn new(unit: &VehicleUnit, step: TimeStep) -> Result<Self, SimulationError> {
        let shares = step.shares();
        let effective = Matrix::from_diagonal(&(unit.mass * shares.mass))
            + unit.damping * shares.damping
            + unit.stiffness * shares.stiffness;
        let inverse = effective
            .cholesky()
            .ok_or(SimulationError::Singular { what: "effective", place: "a bogie".into() })?
            .inverse();
        let (mut of_force, mut compliance) = ([[0.0; CHUNK]; CONTACTS], [[0.0; CONTACTS]; CONTACTS]);
        for (j, b) in unit.contacts.iter().enumerate() {
            let moved = inverse * b;
            of_force[j] = lanes(&moved);
            for (i, a) in unit.contacts.iter().enumerate() {
                compliance[i][j] = a.dot(&moved);
            }
        }
        let mut others = compliance;
        (0..CONTACTS).for_each(|i| others[i][i] = 0.0);
        let momentum = inverse * Matrix::from_diagonal(&(unit.mass * shares.mass));
        let elastic = inverse * -unit.stiffness;
        let columns = |m: Matrix| std::array::from_fn(|j| lanes(&m.column(j).into_owned()));
        Ok(Self {
            unit: unit.clone(),
            of_rate: columns(momentum),
            of_displacement: columns(elastic),
            of_force,
            compliance,
            others,
            step,
        })
    }

    /// At rest with the wheelsets at given contact heights (m, positive down) and the frame following them.
    pub fn at_rest(&self, contact_m: &[f64]) -> UnitState {
        let mut x = [0.0; CHUNK];
        let a = self.unit.contacts[0][1];
        for (axle, pair) in contact_m.chunks_exact(2).enumerate() {
            x[2 * axle] = 0.5 * (pair[0] + pair[1]);
            x[2 * axle + 1] = 0.5 * (pair[0] - pair[1]) / a;
        }
        if self.unit.axle_offset_m.len() == 2 {
            let spacing = self.unit.axle_offset_m[1] - self.unit.axle_offset_m[0];
            x[4] = 0.5 * (x[0] + x[2]);
            x[5] = (x[0] - x[2]) / spacing;
            x[6] = 0.5 * (x[1] + x[3]);
        }
        UnitState { x, v: [0.0; CHUNK], rate: [0.0; CHUNK], free: [0.0; CHUNK] }
    }

    /// Rates that forces on the wheels (N, downwards) add to those of a step.
    pub fn rates_of(&self, force_n: &[f64]) -> Lanes {
        std::array::from_fn(|lane| sum_of(pulp::Scalar::new(), lane, &self.of_force, force_n))
    }

    /// Begins a step: rates without contact forces, with those of the static forces of the wheels.
    #[inline(always)]
    pub fn begin<S: Simd>(&self, simd: S, state: &mut UnitState, of_static: &Lanes) {
        let ahead = simd.splat_f64s(self.step.theta * self.step.dt_s);
        let UnitState { x, v, rate, free } = state;
        let (rate, free) = (vectors_mut::<S>(rate), vectors_mut::<S>(free));
        for part in 0..parts::<S>() {
            // Two sums, so that none waits for the other.
            let (of_v, of_x) =
                (sum_of(simd, part, &self.of_rate, v), sum_of(simd, part, &self.of_displacement, x));
            rate[part] = simd.add_f64s(simd.add_f64s(of_v, of_x), vectors::<S>(of_static)[part]);
            free[part] = simd.mul_add_f64s(ahead, rate[part], vectors::<S>(x)[part]);
        }
    }

    /// Height of contact `i` at t + θ dt without contact forces, m.
    #[inline(always)]
    pub fn free_m(&self, state: &UnitState, contact: usize) -> f64 {
        let (jacobian, first) = (&self.unit.contacts[contact], contact / 2 * 2);
        jacobian[first] * state.free[first] + jacobian[first + 1] * state.free[first + 1]
    }

    /// The equations.
    pub fn unit(&self) -> &VehicleUnit {
        &self.unit
    }

    /// Ends the step under the contact forces (N, upwards on the wheels).
    #[inline(always)]
    pub fn finish<S: Simd>(&self, simd: S, state: &mut UnitState, force_n: &[f64]) {
        let (dt, per_theta) = (simd.splat_f64s(self.step.dt_s), simd.splat_f64s(1.0 / self.step.theta));
        let UnitState { x, v, rate, .. } = state;
        let [x, v, rate] = [x, v, rate].map(|row| vectors_mut::<S>(row));
        for part in 0..parts::<S>() {
            rate[part] = simd.sub_f64s(rate[part], sum_of(simd, part, &self.of_force, force_n));
            v[part] = simd.mul_add_f64s(per_theta, simd.sub_f64s(rate[part], v[part]), v[part]);
            x[part] = simd.mul_add_f64s(dt, rate[part], x[part]);
        }
    }
}

/// Degrees of freedom in lanes.
fn lanes(of: &Vector) -> Lanes {
    std::array::from_fn(|i| of.get(i).copied().unwrap_or(0.0))
}

/// Σ column · factor.
#[inline(always)]
fn sum_of<S: Simd>(simd: S, part: usize, columns: &[Lanes], factors: &[f64]) -> S::f64s {
    let mut sum = simd.splat_f64s(0.0);
    for (column, factor) in columns.iter().zip(factors) {
        sum = simd.mul_add_f64s(vectors::<S>(column)[part], simd.splat_f64s(*factor), sum);
    }
    sum
}

#[cfg(test)]
mod tests {
    use pulp::Scalar;

    use super::*;

    /// The scheme's own frequency is known: tan(ω' dt/2) = ω dt/2.
    fn of_scheme(omega: f64, dt_s: f64) -> f64 {
        2.0 / dt_s * (0.5 * omega * dt_s).atan()
    }

    const STEP: TimeStep = TimeStep { dt_s: 1e-3 / 4.0, theta: 0.5 };

    #[test]
    fn analytic_wheelset_bounces_on_its_contact_springs() {
        // 1340 kg on two springs of 1 MN/m, let go 1 mm above equilibrium.
        let (mass, k) = (1340.0, 1e6);
        let unit = VehicleUnit::wheelset(mass, 700.0, 0.75, 0.0).unwrap();
        let stepper = UnitStepper::new(&unit, STEP).unwrap();
        let mut state = stepper.at_rest(&[-1e-3, -1e-3]);
        let discrete = of_scheme((2.0 * k / mass).sqrt(), STEP.dt_s);
        let ahead = 0.5 * STEP.dt_s;
        for n in 1..2000 {
            stepper.begin(Scalar::new(), &mut state, &[0.0; CHUNK]);
            // Force of each spring at the middle of the step: k (free − ahead · (c₀₀ + c₀₁) F).
            let compliance = ahead * (stepper.compliance[0][0] + stepper.compliance[0][1]);
            let force = k * stepper.free_m(&state, 0) / (1.0 + k * compliance);
            stepper.finish(Scalar::new(), &mut state, &[force, force]);
            let expected = -1e-3 * (discrete * f64::from(n) * STEP.dt_s).cos();
            assert!((state.x[0] - expected).abs() < 1e-9, "{n}: {} {expected}", state.x[0]);
        }
    }

    const BOGIE: Bogie = Bogie {
        wheelset_mass_kg: [1340.0; 2],
        wheelset_roll_inertia_kg_m2: [700.0; 2],
        frame_mass_kg: 2800.0,
        frame_pitch_inertia_kg_m2: 2200.0,
        frame_roll_inertia_kg_m2: 1900.0,
        stiffness_per_axle_box_n_m: 1.1e6,
        damping_per_axle_box_ns_m: 12e3,
        axle_box_half_distance_m: 1.0,
        contact_half_distance_m: 0.75,
        axle_spacing_m: 2.9,
    };

    /// Heave, pitch and roll of everything together.
    #[test]
    fn analytic_rigid_motions_of_a_bogie_stretch_no_spring() {
        let unit = VehicleUnit::bogie(&BOGIE, 0.0).unwrap();
        for motion in [
            [1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0],
            [1.45, 0.0, -1.45, 0.0, 0.0, 1.0, 0.0],
            [0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 1.0],
        ] {
            let motion = Vector::from(motion);
            let force = unit.stiffness * motion + unit.damping * motion;
            assert!(force.amax() < 1e-6, "{force}");
        }
    }

    #[test]
    fn analytic_bogie_bounces_on_its_contact_springs_and_its_suspension() {
        // Undamped, with four contact springs of 1 MN/m, let go from the shape of the slower of its two modes of heave. Of λ = ω²:
        // (contact + boxes − λ wheelsets) (boxes − λ frame) = boxes².
        let unit = VehicleUnit::bogie(&Bogie { damping_per_axle_box_ns_m: 0.0, ..BOGIE }, 0.0).unwrap();
        let (k, wheelsets, frame): (f64, f64, f64) = (1e6, 2.0 * 1340.0, 2800.0);
        let (contact, boxes) = (4.0 * k, 4.0 * 1.1e6);
        let half = 0.5 * ((contact + boxes) / wheelsets + boxes / frame);
        let square = half - (half * half - contact * boxes / (wheelsets * frame)).sqrt();
        let stepper = UnitStepper::new(&unit, STEP).unwrap();
        let mut state = stepper.at_rest(&[1e-3; 4]);
        let frame_m = 1e-3 * boxes / (boxes - square * frame);
        state.x[4] = frame_m;
        let discrete = of_scheme(square.sqrt(), STEP.dt_s);
        let compliance = 0.5 * STEP.dt_s * stepper.compliance[0].iter().sum::<f64>();
        for n in 1..2000 {
            stepper.begin(Scalar::new(), &mut state, &[0.0; CHUNK]);
            let force = k * stepper.free_m(&state, 0) / (1.0 + k * compliance);
            stepper.finish(Scalar::new(), &mut state, &[force; 4]);
            let wave = (discrete * f64::from(n) * STEP.dt_s).cos();
            for (i, expected) in [(0, 1e-3 * wave), (2, 1e-3 * wave), (4, frame_m * wave)] {
                assert!((state.x[i] - expected).abs() < 1e-9, "{n}, {i}: {} {expected}", state.x[i]);
            }
        }
    }

    #[test]
    fn property_impossible_masses_are_refused() {
        let refused = VehicleUnit::wheelset(-5.0, 700.0, 0.75, 0.0).unwrap_err();
        assert!(matches!(refused, SimulationError::OutOfRange { value: -5.0, .. }));
    }
}
