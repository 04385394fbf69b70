//! Where wheels hit the crossing, for trains that were found beside it.
//!
//! Trains are found by the deflection under them. What drifts as slowly, steps of the sensor's baseline or clipping, looks deeper, and puts
//! some of them metres from where they are. The envelope of the recording knows no drift, and is right within some 0.1 m.

use super::Recording;
use crate::ballast::quasi_static::Sinking;
use crate::reconstruct::{FARTHEST_HIT_M, comb};
use crate::signal::{mean, quantile};
use crate::vehicle::AxlePattern;

/// Trains this far from where the others are, metres, relative to their hits, were not found: of 18 recorded sites, 17 have none beyond 0.4 m,
/// and one that clips nine between 2.4 and 18 m.
const ASTRAY_M: f64 = 1.0;
/// Trains this near to where the others are, metres, are where they are thought to be.
const TOGETHER_M: f64 = 0.5;
/// Where wheels hit crossings, from x = 0 towards the nose, and how much that differs, metres.
const USUAL_HIT_M: (f64, f64) = (0.3, 0.4);
/// Scatter of the hits of one crossing, metres: 0.02 to 0.06 on recorded and simulated sites, more where envelopes are flat.
const SCATTER_M: f64 = 0.1;
/// Share of hits that are those of another axle, or of something else.
const STRAY: f64 = 0.1;
/// Between places that are looked at, metres.
const STEP_M: f64 = 0.02;
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

    /// When the first axle is at x = 0 if that is so far behind the hit, s.
    pub fn first_axle_s(&self, behind_m: f64) -> Option<f64> {
        Some(self.time_s? + behind_m / self.speed_m_s)
    }

    /// Log-likelihood of a deflection where the train is so far behind its hit, relative to that of one that may be anywhere.
    fn log_evidence(&self, sinking: &Sinking, behind_m: f64) -> f64 {
        let (mut near, mut weights) = (0.0, 0.0);
        for k in -10..=10 {
            let off = 0.3 * f64::from(k);
            let weight = (-0.5 * off * off).exp();
            let there = self.first_axle_s(behind_m + off * SCATTER_M).and_then(|time_s| sinking.at(time_s));
            near += weight * there.unwrap_or(0.0);
            weights += weight;
        }
        ((1.0 - STRAY) * near / weights + STRAY).ln()
    }

    /// Way from the hit to where the first axle is taken to be at x = 0, metres.
    fn behind_m(&self, first_axle_s: f64) -> Option<f64> {
        Some((first_axle_s - self.time_s?) * self.speed_m_s)
    }
}

/// How far behind their hits trains are at x = 0, metres, by what the deflections under all of them say together.
///
/// Each by itself is where its deflection is most like the model's, which noise, drift and the crossing's own dynamics make the wrong place
/// where they are stronger than it. Relative to their hits trains of a site are all at the same place. What the model lacks is the same in
/// all of them, so that they count as one look.
pub fn together_m(hits: &[Hit], sinking: &[Sinking], direction: f64) -> f64 {
    let count = (2.0 * FARTHEST_HIT_M / STEP_M) as usize;
    let log_posterior = |behind_m: f64| {
        let off = (behind_m + direction * USUAL_HIT_M.0) / USUAL_HIT_M.1;
        let looks = hits.iter().zip(sinking).map(|(hit, sinking)| hit.log_evidence(sinking, behind_m));
        mean(&looks.collect::<Vec<_>>()) - 0.5 * off * off
    };
    let places = (0..=count).map(|k| k as f64 * STEP_M - FARTHEST_HIT_M);
    let rated = places.map(|behind_m| (behind_m, log_posterior(behind_m)));
    rated.max_by(|(_, a), (_, b)| a.total_cmp(b)).map_or(0.0, |(behind_m, _)| behind_m)
}

/// How far behind their hits most trains are, metres, those aside that were not found.
pub fn usual_m(hits: &[Hit], first_axle_s: &[f64]) -> Option<f64> {
    let possible: Vec<f64> =
        behind_m(hits, first_axle_s).into_iter().filter(|b| b.abs() <= FARTHEST_HIT_M).collect();
    (!possible.is_empty()).then(|| quantile(&possible, 0.5))
}

/// Of every train with a hit.
fn behind_m(hits: &[Hit], first_axle_s: &[f64]) -> Vec<f64> {
    hits.iter().zip(first_axle_s).filter_map(|(hit, time_s)| hit.behind_m(*time_s)).collect()
}

/// Puts trains that lie far from where most are, relative to their hits, to where those are. Where most are not together nothing is moved:
/// then it is the deflection that is wrong, that of a sensor upside down for instance, or the hits, and nobody can tell which.
pub fn back_to_hits(hits: &[Hit], first_axle_s: &mut [f64]) {
    let Some(usual_m) = usual_m(hits, first_axle_s) else { return };
    let near = |b: &&f64| (**b - usual_m).abs() <= TOGETHER_M;
    let together = behind_m(hits, first_axle_s).iter().filter(near).count();
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

    /// Deflections that say little each, one of them of a train whose hit is that of its second axle.
    #[test]
    fn property_trains_are_where_all_deflections_are_best_together() {
        let (speed_m_s, behind_m) = (40.0, -0.42);
        let noisy = |train: usize| {
            let hit_s = 1.0 + 0.1 * train as f64;
            let true_s = hit_s + behind_m / speed_m_s;
            let bump = |at_s: f64, t: f64, m: f64| (-0.5 * ((t - at_s) * speed_m_s / m).powi(2)).exp();
            let log_likelihood = (0..2000).map(|k| {
                let t = 0.5 + 1e-3 * f64::from(k);
                // As high a maximum somewhere else, and not at the same place behind the hit.
                let elsewhere_s = true_s + (1.5 + 0.7 * train as f64) / speed_m_s;
                4.0 * bump(true_s, t, 0.4) + 4.5 * bump(elsewhere_s, t, 0.4)
            });
            let heard_s = if train == 2 { hit_s + 2.6 / speed_m_s } else { hit_s };
            let sinking = Sinking::of(0.5, &log_likelihood.collect::<Vec<_>>());
            (Hit { time_s: Some(heard_s), speed_m_s }, sinking)
        };
        let (hits, sinking): (Vec<Hit>, Vec<Sinking>) = (0..6).map(noisy).unzip();
        let found_m = together_m(&hits, &sinking, 1.0);
        // The deflections are some 0.4 m wide, and the usual place of hits draws a little.
        assert!((found_m - behind_m).abs() < 0.1, "{found_m}");
        let at_s: Vec<f64> = hits.iter().filter_map(|h| h.first_axle_s(found_m)).collect();
        assert!((usual_m(&hits, &at_s).unwrap() - found_m).abs() < 1e-9);
        assert!(together_m(&[Hit { time_s: None, speed_m_s }], &sinking[..1], 1.0).is_finite());
    }

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
