//! One bogie over a panel, without noise: what the simulation studies of the paper are made of (sections 3.1 and 6.1).

use super::StudyError;
use crate::ballast::BallastParameters;
use crate::passage::contact::ContactLaw;
use crate::passage::{
    Journey, PassageRecord, Profile, RunningSurface, SLEEPER_MODES, Start, Stepper, Support, SupportLaw,
    TimeStep, TrackModel, Train, VehicleUnit, Wheel, run,
};
use crate::recording::Crossing;
use crate::track::{Mesh, Track};
use crate::vehicle::static_wheel_force_n;

/// After the last wheel has left the track the sleeper comes to rest, seconds.
const DECAY_S: f64 = 0.1;
/// Elements of half the length of the paper's, so that a study does not test a mesh against itself.
const MESH: Mesh = Mesh { rail_step_m: 0.15, sleeper_step_m: 0.125 };
/// The bogie stands this far before the track when a simulation begins, metres.
const BEFORE_M: f64 = 0.05;

/// A track on which bogies can run.
pub struct BogieTrack {
    crossing: Crossing,
    stepper: Stepper,
}

/// A simulated bogie.
pub struct BogieRun {
    /// Displacement of the sensor and forces of the four wheels: front right, front left, rear right, rear left.
    pub record: PassageRecord,
    /// Time at which the front wheels are at x = 0, seconds.
    pub front_at_origin_s: f64,
}

impl BogieTrack {
    /// Track of a panel on linear ballast.
    pub fn new(crossing: &Crossing, ballast: &BallastParameters) -> Result<Self, StudyError> {
        Self::with_voids(crossing, ballast, &[])
    }

    /// The same with gaps under sleepers: (sleeper counted from the crossing sleeper, metres).
    pub fn with_voids(
        crossing: &Crossing,
        ballast: &BallastParameters,
        voids: &[(i64, f64)],
    ) -> Result<Self, StudyError> {
        let track = Track::of_crossing(crossing, MESH);
        let damping = crossing.ballast.damping_ns_m2;
        let mut supports: Vec<Support> =
            ballast.bed(&track).into_iter().map(|k| Support::linear(k, damping)).collect();
        for (offset, gap_m) in voids {
            let sleeper = usize::try_from(track.sensor_sleeper as i64 + offset).ok();
            if let Some(support) = sleeper.and_then(|k| supports.get_mut(k)) {
                support.law = SupportLaw::Unilateral { gap_m: *gap_m, preload_n_m: 0.0 };
            }
        }
        let model = TrackModel::new(&track, supports, SLEEPER_MODES)?;
        Ok(Self { crossing: crossing.clone(), stepper: Stepper::new(model, TimeStep::default())? })
    }

    /// A bogie in the direction of traffic; `path` is what its wheels meet on the crossing side. Contact forces are kept
    /// everywhere on the track.
    pub fn run(&self, path: &Profile, speed_m_s: f64) -> Result<BogieRun, StudyError> {
        let v = &self.crossing.vehicle;
        let wheel = Wheel::nominal(static_wheel_force_n(v.axle_load_kg, v.gravity_m_s2));
        let surface = RunningSurface { paths: vec![path.clone()], ..RunningSurface::level() };
        self.run_wheels(&surface, std::array::from_fn(|_| wheel.clone()), speed_m_s)
    }

    /// A bogie with wheels of its own on given rails: front right, front left, rear right, rear left.
    pub fn run_wheels(
        &self,
        surface: &RunningSurface,
        wheels: [Wheel; 4],
        speed_m_s: f64,
    ) -> Result<BogieRun, StudyError> {
        let v = &self.crossing.vehicle;
        let [first, last] = self.stepper.model.extent_m();
        let direction = self.crossing.traffic_direction.sign();
        let entry = if direction > 0.0 { first } else { -last };
        let journey = Journey {
            direction,
            speed_m_s,
            acceleration_m_s2: 0.0,
            first_m: entry - BEFORE_M,
            duration_s: (last - first + v.axle_spacing_m + BEFORE_M) / speed_m_s + DECAY_S,
            start: Start::Quiet,
        };
        let bogie = crate::passage::Bogie::of_vehicle(v);
        let train = Train {
            units: vec![VehicleUnit::bogie(&bogie, 0.0)?],
            wheels: wheels.to_vec(),
            wheel_radius_m: v.wheel_radius_m,
        };
        let law = ContactLaw::Hertz(v.hertz_constant_n_m15);
        let record = run(&self.stepper, &train, (surface, law), &journey, [first, last])?;
        Ok(BogieRun { record, front_at_origin_s: -journey.first_m / speed_m_s })
    }
}
