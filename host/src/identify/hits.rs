//! Where wheels hit the crossing, for trains that were found beside it.
//!
//! Trains are found by the deflection under them. What drifts as slowly, steps of the sensor's baseline or clipping, looks deeper, and puts
//! some of them metres from where they are. The envelope of the recording knows no drift, and is right within some 0.1 m.

use super::Recording;
use crate::reconstruct::{FARTHEST_HIT_M, comb};
use crate::signal::quantile;
use crate::vehicle::AxlePattern;

/// Trains this far from where the others are, metres, relative to their hits, were not found: of 18 recorded sites, 17 have none beyond 0.4 m,
/// and one that clips nine between 2.4 and 18 m.
const ASTRAY_M: f64 = 1.0;
/// Trains this near to where the others are, metres, are where they are thought to be.
const TOGETHER_M: f64 = 0.5;
/// Wide enough for one speed of the comb, relative.
const ONE_SPEED: f64 = 2.1e-3;

/// When the first axle of a train hits the crossing, and its speed.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    /// s; none in a silent recording.
    pub time_s: Option<f64>,
    /// m/s.
    pub speed_m_s: f64,
}

impl Hit {
    /// Of a train of known speed.
    pub fn of(recording: &Recording, pattern: &AxlePattern, speed_m_s: f64) -> Self {
        let hit = comb(recording, pattern, [speed_m_s, (1.0 + ONE_SPEED) * speed_m_s]);
        Self { time_s: hit.map(|(_, time_s)| time_s), speed_m_s }
    }

    /// Way from the hit to where the first axle is taken to be at x = 0, metres.
    fn behind_m(&self, first_axle_s: f64) -> Option<f64> {
        Some((first_axle_s - self.time_s?) * self.speed_m_s)
    }
}

/// Puts trains that lie far from where most are, relative to their hits, to where those are. Where most are not together nothing is moved:
/// then it is the deflection that is wrong, that of a sensor upside down for instance, or the hits, and nobody can tell which.
pub fn back_to_hits(hits: &[Hit], first_axle_s: &mut [f64]) {
    let behind_m: Vec<f64> =
        hits.iter().zip(&*first_axle_s).filter_map(|(hit, time_s)| hit.behind_m(*time_s)).collect();
    let possible: Vec<f64> = behind_m.iter().copied().filter(|b| b.abs() <= FARTHEST_HIT_M).collect();
    if possible.is_empty() {
        return;
    }
    let usual_m = quantile(&possible, 0.5);
    let together = behind_m.iter().filter(|b| (**b - usual_m).abs() <= TOGETHER_M).count();
    if 2 * together <= hits.len() {
        return;
    }
    for (hit, time_s) in hits.iter().zip(first_axle_s) {
        let (Some(hit_s), Some(behind_m)) = (hit.time_s, hit.behind_m(*time_s)) else { continue };
        if (behind_m - usual_m).abs() > ASTRAY_M {
            *time_s = hit_s + usual_m / hit.speed_m_s;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn property_those_astray_go_where_most_are() {
        let hit = |time_s| Hit { time_s, speed_m_s: 40.0 };
        let hits = [hit(Some(1.0)), hit(Some(2.0)), hit(Some(1.5)), hit(None), hit(Some(1.2))];
        let mut first_axle_s = [1.005, 2.006, 1.8, 0.3, 1.203];
        back_to_hits(&hits, &mut first_axle_s);
        assert_eq!(first_axle_s, [1.005, 2.006, 1.505, 0.3, 1.203]);
        // Where half of them are somewhere, and where all are, nothing is known.
        for scattered in [[1.005, 2.4], [1.3, 2.4]] {
            let mut astray = scattered;
            back_to_hits(&hits[..2], &mut astray);
            assert_eq!(astray, scattered);
        }
    }
}
