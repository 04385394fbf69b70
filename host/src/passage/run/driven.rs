//! A track under wheel forces that are given, as those of a passage over another track.

use super::{ContactTrace, Journey, share};
use crate::passage::error::{SimulationError, in_range};
use crate::passage::stepper::Stepper;
use crate::passage::unit::Train;

/// How far a force may be from the place where its wheel is, m: another step or another journey is farther off.
const SAME_PLACE_M: f64 = 1e-6;

/// Displacement of the sleeper at the sensor at t = 0, dt, …, m, under the wheel forces of a record. It must have been kept over the
/// whole track, from a journey that begins before the track does, with a track as long and a step as this one's; a force from
/// elsewhere is refused.
pub fn driven(
    stepper: &Stepper,
    train: &Train,
    journey: &Journey,
    contacts: &[ContactTrace],
) -> Result<Vec<f64>, SimulationError> {
    let (dt, theta) = (stepper.step.dt_s, stepper.step.theta);
    let extent_m = stepper.model.extent_m();
    let offsets_m: Vec<f64> =
        train.units.iter().flat_map(|unit| (0..unit.wheels()).map(|i| unit.contact_offset_m(i))).collect();
    let mut next = vec![0; offsets_m.len()];
    let mut track = stepper.at_rest();
    let mut sensor_m = vec![stepper.sensor_m(&track)];
    for step in 0..journey.steps(dt) {
        let travelled_m = journey.travelled_m((step as f64 + theta) * dt);
        stepper.begin(&mut track);
        for (wheel, ((offset_m, trace), next)) in offsets_m.iter().zip(contacts).zip(&mut next).enumerate() {
            let x_m = journey.direction * (travelled_m - offset_m);
            if x_m < extent_m[0] || x_m > extent_m[1] {
                continue;
            }
            let at_m = trace.position_m.get(*next).copied().unwrap_or(f64::NAN);
            in_range("place of a given wheel force", at_m, [x_m - SAME_PLACE_M, x_m + SAME_PLACE_M], "m")?;
            if let Some(point) = stepper.model.point_on(wheel % 2, x_m) {
                stepper.load(&mut track, &point, share(extent_m, x_m) * trace.force_n[*next]);
            }
            *next += 1;
        }
        stepper.finish(&mut track);
        sensor_m.push(stepper.sensor_m(&track));
    }
    Ok(sensor_m)
}
