//! What wheels that are otherwise add to the window of a bogie.
//!
//! Until the first of them meets what is otherwise, all their passages are one, and what comes far behind the window does not show in it:
//! so they go on from where that one was halted, and end early.

use super::data::{Observed, RATE_HZ};
use super::forward::{Detail, Response, Simulator};
use super::world::World;
use crate::passage::{SimulationError, Underway};

/// A simulation ends this far behind the window, metres of travel: what its end makes of the band of the comparison reaches 20 ms.
const BEHIND_M: f64 = 1.0;

/// Passage of a bogie whose wheels are all as the world has them.
pub struct Plain<'a> {
    observed: &'a Observed,
    simulator: Simulator,
    response: Response,
    /// Travel of the front axle at which it was halted, ascending, metres.
    halts_m: Vec<f64>,
    halted: Vec<Underway>,
}

impl<'a> Plain<'a> {
    /// Simulates it; `halts_m`: travel of the front axle at which others will depart from it, metres.
    pub fn of(
        observed: &'a Observed,
        world: &World,
        detail: Detail,
        mut halts_m: Vec<f64>,
    ) -> Result<Self, SimulationError> {
        let window_s = observed.first_s + observed.mean.len() as f64 / RATE_HZ;
        let until_m = window_s * observed.speed_m_s + BEHIND_M;
        let simulator = Simulator::in_detail(world, observed.axle_load_kg, detail)?.until(until_m);
        halts_m.sort_by(f64::total_cmp);
        let halted = simulator.halted(observed.speed_m_s, &halts_m)?;
        let response = match halted.last() {
            Some(last) => simulator.response_after(last.clone(), observed.speed_m_s)?,
            None => simulator.response(observed.speed_m_s)?,
        };
        Ok(Self { observed, simulator, response, halts_m, halted })
    }

    /// The bogie on its track, to be given other wheels.
    pub fn simulator(&self) -> &Simulator {
        &self.simulator
    }

    /// What the recording of another bogie has beyond this one's, m/s² over recorder time; nothing is otherwise before its front axle has
    /// travelled to `from_m`.
    pub fn departure(&self, other: &Simulator, from_m: f64) -> Result<Response, SimulationError> {
        let speed_m_s = self.observed.speed_m_s;
        let response = match self.halts_m.partition_point(|h| *h <= from_m) {
            0 => other.response(speed_m_s)?,
            halts => other.response_after(self.halted[halts - 1].clone(), speed_m_s)?,
        };
        Ok(response.less(&self.response, 1.0))
    }

    /// The same in the window, m/s²; `late_s` later.
    pub fn in_window(&self, departure: &Response, late_s: f64) -> Vec<f64> {
        let o = self.observed;
        (0..o.mean.len()).map(|k| departure.at(o.first_s - late_s + k as f64 / RATE_HZ)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::base::tests::of_reference;
    use super::*;
    use crate::passage::WheelFlat;
    use crate::signal::dot;

    /// What a departure may lose, part of it, RMS in the window: ending early loses 4e-9 of hollow wheels, the contact that is left out 1.3e-3
    /// of the flat.
    const LOST: f64 = 5e-3;

    /// Hollow wheels and flats on either wheelset, against whole passages. The flat has met the rail before, 5.1 m from the crossing,
    /// which is left out.
    #[test]
    fn property_departures_are_those_of_whole_passages() {
        let base = of_reference(1);
        let (world, o) = (&base.frame.base, &base.frame.observed[0]);
        let half_m = world.path.half_m;
        for axle in [0, 1] {
            let behind_m = axle as f64 * world.crossing.vehicle.axle_spacing_m;
            let (path_m, flat_m) = (behind_m - half_m - 0.1, behind_m - 2.26);
            let plain = Plain::of(o, world, Detail::Full, vec![path_m, flat_m]).unwrap();
            let whole = Simulator::new(world, o.axle_load_kg).unwrap();
            let flat = WheelFlat::fresh(0.05, -2.2, world.crossing.vehicle.wheel_radius_m);
            let both = |of: &dyn Fn(&Simulator) -> Simulator, from_m: f64| {
                let ended = plain.departure(&of(plain.simulator()), from_m).unwrap();
                let here = whole.response(o.speed_m_s).unwrap();
                let there = of(&whole).response(o.speed_m_s).unwrap().less(&here, 1.0);
                (plain.in_window(&ended, 0.0), plain.in_window(&there, 0.0))
            };
            let hollow = both(&|s| s.with_own_path(axle, 2.2, 0.04), path_m);
            let flat = both(&|s| s.with_flat(axle, flat), flat_m);
            for (what, (ended, there)) in [("hollow", hollow), ("flat", flat)] {
                let off: Vec<f64> = ended.iter().zip(&there).map(|(e, t)| e - t).collect();
                let lost = (dot(&off, &off) / dot(&there, &there)).sqrt();
                println!("{what}, axle {axle}: {lost:.1e} is lost");
                assert!(lost < LOST, "{what}, axle {axle}: {lost:e}");
            }
        }
    }
}
