//! Trains that lie a wave beside one another: told by the envelopes of the recordings, which know no waves.
//!
//! Where wheels have waves, or steps of the baseline are left, a train can lock onto a neighbouring wave of the model, half a metre beside
//! its place and more, from where no fit leads back.

use super::data::Observed;
use crate::reconstruct::envelope;
use crate::signal::{between, dot, mean, quantile};

/// Travel of the front axle in which envelopes are compared, metres: first, and behind the shortest train; step.
const TRAVEL_M: (f64, f64, f64) = (-8.0, 8.0, 0.05);
/// How far beside its place a train is looked for, metres.
const REACH_M: f64 = 1.2;
/// A train lies ahead by more than this, metres, and only where its envelope then resembles that of the others by so much more: five of 16
/// trains of a site with steps of the baseline and waves lay 0.6 to 0.8 m beside the others, and rose from 0.72 … 0.76 to 0.90 … 0.92.
const LEAST_M: f64 = 0.3;
const LEAST_GAIN: f64 = 0.08;

/// How far every train lies ahead of the others, metres, within 0.15 m; none where all lie where most do.
pub fn ahead_m(observed: &[Observed]) -> Option<Vec<f64>> {
    let length_m = observed.iter().filter_map(|o| o.bogie_m.last().copied()).fold(f64::INFINITY, f64::min);
    if observed.len() < 3 || !length_m.is_finite() {
        return None;
    }
    let places = ((length_m + TRAVEL_M.1 - TRAVEL_M.0) / TRAVEL_M.2) as usize;
    let curves: Vec<Vec<f64>> = observed.iter().map(|o| along(o, places)).collect();
    let middle: Vec<f64> =
        (0..places).map(|k| quantile(&curves.iter().map(|c| c[k]).collect::<Vec<_>>(), 0.5)).collect();
    let ahead: Vec<f64> = curves.iter().map(|curve| ahead_of(curve, &middle)).collect();
    ahead.iter().any(|a| *a != 0.0).then_some(ahead)
}

/// The same of one curve; nought where it is not plain.
fn ahead_of(curve: &[f64], middle: &[f64]) -> f64 {
    let reach = (REACH_M / TRAVEL_M.2) as i64;
    let at = |shift: i64| correlation(curve, middle, shift);
    let best = (-reach..=reach).max_by(|a, b| at(*a).total_cmp(&at(*b))).unwrap_or(0);
    let ahead_m = best as f64 * TRAVEL_M.2;
    if ahead_m.abs() > LEAST_M && at(best) - at(0) > LEAST_GAIN { ahead_m } else { 0.0 }
}

/// Envelope at places of the front axle, relative to its mean.
fn along(o: &Observed, places: usize) -> Vec<f64> {
    let (values, rate_hz) = envelope(&o.recording);
    let at = |k: usize| {
        let travel_m = TRAVEL_M.0 + k as f64 * TRAVEL_M.2;
        between(&values, (o.first_axle_s + travel_m / o.speed_m_s) * rate_hz).unwrap_or(0.0)
    };
    let curve: Vec<f64> = (0..places).map(at).collect();
    let whole = mean(&curve).max(f64::MIN_POSITIVE);
    curve.iter().map(|v| v / whole).collect()
}

/// Correlation of a curve `shift` steps later with another one, about their means.
fn correlation(curve: &[f64], other: &[f64], shift: i64) -> f64 {
    let (from, until) = (shift.max(0) as usize, (-shift).max(0) as usize);
    let (a, b) = (&curve[from..curve.len() - until], &other[until..other.len() - from]);
    let about = |v: &[f64]| -> Vec<f64> {
        let middle = mean(v);
        v.iter().map(|x| x - middle).collect()
    };
    let (a, b) = (about(a), about(b));
    dot(&a, &b) / (dot(&a, &a) * dot(&b, &b)).sqrt().max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::base::observe;
    use super::*;
    use crate::recording::read_site;

    /// Field recordings, of which three trains are moved.
    #[test]
    fn property_trains_that_are_moved_lie_ahead_of_the_others() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field/reference-1");
        let site = read_site(&root).unwrap();
        let mut observed = observe(&site).unwrap();
        assert_eq!(ahead_m(&observed), None);
        let mut moved = vec![0.0; observed.len()];
        for (i, by_m) in [(1, 0.7), (4, -0.6), (9, 0.8)] {
            moved[i] = by_m;
            observed[i].first_axle_s += by_m / observed[i].speed_m_s;
        }
        let ahead = ahead_m(&observed).unwrap();
        for (ahead, moved) in ahead.iter().zip(&moved) {
            assert!((ahead + moved).abs() < 0.16, "{ahead} {moved}");
        }
    }
}
