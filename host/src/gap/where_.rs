//! Where the gap is: along the track, and against what varies between passages.

use super::data::RATE_HZ;
use super::diagnosis::{Named, Residual};
use super::fit::Frame;
use super::measure::Prediction;
use crate::signal::CubicSpline;

/// Mean residual windows of all passages.
pub fn residuals(predictions: &[Prediction], frame: &Frame, held_out: &[usize]) -> Vec<Residual> {
    let direction = frame.base.crossing.traffic_direction.sign();
    predictions
        .iter()
        .enumerate()
        .map(|(i, p)| {
            let (starts, len) = &p.windows;
            let mean = |values: &dyn Fn(usize) -> f64| -> Vec<f64> {
                let inside = starts.iter().filter(|s| **s + len <= p.acceleration[0].len());
                let count = inside.clone().count().max(1) as f64;
                (0..*len).map(|k| inside.clone().map(|s| values(s + k)).sum::<f64>() / count).collect()
            };
            let [measured, before, after] = &p.acceleration;
            let model = mean(&|k| before[k]);
            let residual = mean(&|k| measured[k] - before[k]);
            let bogie = |from: usize, model: &[f64]| {
                let end = (from + len).min(measured.len());
                let left: Vec<f64> = (from.min(end)..end).map(|k| measured[k] - model[k]).collect();
                crate::signal::rms(&left)
            };
            let power: f64 = model.iter().map(|m| m * m).sum();
            let product: f64 = model.iter().zip(&residual).map(|(m, r)| m * r).sum();
            Residual {
                passage_id: p.passage_id,
                speed_m_s: p.speed_m_s,
                temperature_c: frame.observed[i].temperature_c,
                axle_load_kg: frame.observed[i].axle_load_kg,
                deflection_m: p.displacement[2].iter().fold(0.0, |m: f64, d| m.max(d.abs())),
                bogies_m_s2: starts.iter().map(|s| [bogie(*s, before), bogie(*s, after)]).collect(),
                position_m: (0..*len)
                    .map(|k| direction * (p.first_m + k as f64 / RATE_HZ * p.speed_m_s))
                    .collect(),
                before: residual,
                after: mean(&|k| measured[k] - after[k]),
                scale_error: product / power.max(f64::MIN_POSITIVE),
                held_out: held_out.contains(&i),
            }
        })
        .collect()
}

/// Correlation from which a dependence is named: at 24 passages chance reaches it once in two hundred sites.
const CORRELATION: f64 = 0.56;

/// What the base model's residual varies with.
pub fn depends_on(residuals: &[Residual], effects: &[Named]) -> Vec<&'static str> {
    let scale: Vec<f64> = residuals.iter().map(|r| r.scale_error).collect();
    let size: Vec<f64> = residuals.iter().map(|r| crate::signal::rms(&r.before)).collect();
    let speed: Vec<f64> = residuals.iter().map(|r| r.speed_m_s).collect();
    let temperature: Vec<f64> = residuals.iter().map(|r| r.temperature_c).collect();
    let mut out = Vec::new();
    if residuals.len() >= 8 {
        if correlation(&scale, &temperature).abs() > CORRELATION {
            out.push("temperature");
        }
        if correlation(&scale, &speed).abs().max(correlation(&size, &speed).abs()) > CORRELATION {
            out.push("speed");
        }
    }
    for effect in effects {
        let covariate = match effect.name {
            "voided-sleepers" | "ballast-stiffening" => "deflection",
            "wheel-out-of-roundness" => "order",
            "wheel-flat" | "hollow-wheels" | "front-rear" => "wheelset",
            "axle-load" | "load-transfer" => "axle-load",
            "gain-temperature" => "temperature",
            _ => continue,
        };
        if !out.contains(&covariate) {
            out.push(covariate);
        }
    }
    out
}

/// Speeds that differ by less cannot tell position from time.
const LEAST_SPREAD: f64 = 0.05;
/// Spacing of the common grid of positions, metres; that of times follows from the mean speed.
const GRID_M: f64 = 0.05;

/// Part of the energy of the base model's residuals that is common to all passages, without the bias of their number, when
/// they are laid over one another along the track and in time. What is fixed to the track collapses in position, what the
/// recorder makes in time.
pub fn collapse(residuals: &[Residual]) -> Option<[f64; 2]> {
    let speeds: Vec<f64> = residuals.iter().map(|r| r.speed_m_s).collect();
    let mean = crate::signal::mean(&speeds);
    let spread = speeds.iter().map(|v| (v / mean - 1.0).abs()).fold(0.0, f64::max);
    if residuals.len() < 3 || spread < LEAST_SPREAD {
        return None;
    }
    let in_time = |r: &Residual| 1.0 / r.speed_m_s;
    Some([common(residuals, &|_| 1.0, GRID_M), common(residuals, &in_time, GRID_M / mean)])
}

/// Common part over an axis which is `scale` times the position.
fn common(residuals: &[Residual], scale: &dyn Fn(&Residual) -> f64, step: f64) -> f64 {
    let splines: Vec<Option<(CubicSpline, [f64; 2])>> = residuals
        .iter()
        .map(|r| {
            let mut points: Vec<(f64, f64)> =
                r.position_m.iter().map(|x| x * scale(r)).zip(r.before.iter().copied()).collect();
            points.sort_by(|a, b| a.0.total_cmp(&b.0));
            let (x, y): (Vec<f64>, Vec<f64>) = points.into_iter().unzip();
            CubicSpline::new(&x, &y).map(|s| (s, [x[0], x[x.len() - 1]]))
        })
        .collect();
    let Some(splines) = splines.into_iter().collect::<Option<Vec<_>>>() else { return 0.0 };
    let low = splines.iter().map(|s| s.1[0]).fold(f64::NEG_INFINITY, f64::max);
    let high = splines.iter().map(|s| s.1[1]).fold(f64::INFINITY, f64::min);
    let count = ((high - low) / step).max(0.0) as usize;
    let n = splines.len() as f64;
    let (mut all, mut mean) = (0.0, 0.0);
    for k in 0..=count {
        let values: Vec<f64> = splines.iter().map(|s| s.0.at(low + k as f64 * step)).collect();
        all += values.iter().map(|v| v * v).sum::<f64>();
        mean += n * crate::signal::mean(&values).powi(2);
    }
    // Chance alone leaves 1/n of the energy in the mean.
    ((mean / all.max(f64::MIN_POSITIVE) * n - 1.0) / (n - 1.0)).clamp(0.0, 1.0)
}

/// Pearson's correlation; 0 where one of the two does not vary.
pub fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let (ma, mb) = (crate::signal::mean(a), crate::signal::mean(b));
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (x, y) in a.iter().zip(b) {
        (ab, aa, bb) = (ab + (x - ma) * (y - mb), aa + (x - ma).powi(2), bb + (y - mb).powi(2));
    }
    if aa > 0.0 && bb > 0.0 { ab / (aa * bb).sqrt() } else { 0.0 }
}

/// Bins along the track, metres.
const BIN_M: f64 = 0.15;
/// The base model is off where its mean residual exceeds this many times its standard error (in squares).
const OFF: f64 = 2.0;

/// Positions x of a bogie's front axle at which the residual that all bogies share stands out of their scatter; `direction`: sign of
/// their travel along x.
pub fn positions(predictions: &[Prediction], direction: f64) -> Vec<[f64; 2]> {
    let mut bins: std::collections::BTreeMap<i64, (f64, f64)> = std::collections::BTreeMap::new();
    for p in predictions {
        let (starts, len) = &p.windows;
        let n = starts.len() as f64;
        for k in 0..*len {
            let values: Vec<f64> = starts
                .iter()
                .filter_map(|s| Some(p.acceleration[0].get(s + k)? - p.acceleration[1].get(s + k)?))
                .collect();
            let mean = crate::signal::mean(&values);
            let scatter: f64 = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
            let x = direction * (p.first_m + k as f64 / RATE_HZ * p.speed_m_s);
            let bin = (x / BIN_M).floor() as i64;
            let entry = bins.entry(bin).or_default();
            *entry = (entry.0 + mean * mean, entry.1 + scatter / n);
        }
    }
    let mut out: Vec<[f64; 2]> = Vec::new();
    for (bin, (mean, scatter)) in bins {
        let x = bin as f64 * BIN_M;
        if mean > (1.0 + OFF) * scatter {
            match out.last_mut() {
                Some(last) if (last[1] - x).abs() < 1e-9 => last[1] = x + BIN_M,
                _ => out.push([x, x + BIN_M]),
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::trains::Deeper;

    /// Wavelets fixed to the track, and such that are fixed in time, at several speeds.
    #[test]
    fn analytic_what_is_fixed_to_the_track_collapses_there() {
        let passage = |id: i32, of: &dyn Fn(f64, f64) -> f64| {
            let speed = 30.0 + f64::from(id);
            let position_m: Vec<f64> = (-150..=150).map(|k| f64::from(k) / RATE_HZ * speed).collect();
            Residual {
                passage_id: id,
                speed_m_s: speed,
                temperature_c: 20.0,
                axle_load_kg: 15e3,
                deflection_m: 1e-3,
                bogies_m_s2: Vec::new(),
                before: position_m.iter().map(|x| of(*x, x / speed)).collect(),
                after: vec![0.0; position_m.len()],
                position_m,
                scale_error: 0.0,
                held_out: false,
            }
        };
        let wave = |u: f64| (-u * u).exp() * (20.0 * u).cos();
        let track: Vec<Residual> = (0..8).map(|i| passage(i, &|x, _| wave(x - 2.0))).collect();
        let time: Vec<Residual> = (0..8).map(|i| passage(i, &|_, t| wave(30.0 * t - 2.0))).collect();
        let [position, in_time] = collapse(&track).unwrap();
        assert!(position > 0.95 && in_time < 0.6, "{position} {in_time}");
        let [position, in_time] = collapse(&time).unwrap();
        assert!(in_time > 0.95 && position < 0.6, "{position} {in_time}");
        assert_eq!(collapse(&track[..1]), None);
    }

    /// Where traffic is trailing, trains travel against x: positions were those of facing traffic.
    #[test]
    fn regress_positions_are_those_of_the_track_in_both_directions() {
        let (first_m, speed_m_s, len) = (-2.0, 40.0, 120);
        let starts: Vec<usize> = (0..4).map(|b| b * len).collect();
        let travel_m = |k: usize| first_m + (k % len) as f64 / RATE_HZ * speed_m_s;
        let off = |k: usize| if (1.2..1.5).contains(&travel_m(k)) { 10.0 } else { 0.0 };
        let noise = |k: usize| if (k / len).is_multiple_of(2) { 1.0 } else { -1.0 };
        let count = starts.len() * len;
        let nothing = vec![0.0; count];
        let passage = Prediction {
            passage_id: 0,
            speed_m_s,
            acceleration: [(0..count).map(|k| off(k) + noise(k)).collect(), nothing.clone(), nothing.clone()],
            displacement: [nothing.clone(), nothing.clone(), nothing],
            windows: (starts, len),
            first_m,
            deeper: Deeper::default(),
        };
        let near = |found: Vec<[f64; 2]>, expected: [f64; 2]| {
            let [one] = found.as_slice() else { panic!("{found:?}") };
            assert!(one.iter().zip(expected).all(|(a, b)| (a - b).abs() <= BIN_M + 1e-9), "{one:?}");
        };
        near(positions(std::slice::from_ref(&passage), 1.0), [1.2, 1.5]);
        near(positions(&[passage], -1.0), [-1.5, -1.2]);
    }

    #[test]
    fn analytic_correlation_of_lines() {
        let a = [1.0, 2.0, 3.0];
        assert!((correlation(&a, &[2.0, 4.0, 6.0]) - 1.0).abs() < 1e-12);
        assert!((correlation(&a, &[3.0, 2.0, 1.0]) + 1.0).abs() < 1e-12);
        assert_eq!(correlation(&a, &[1.0, 1.0, 1.0]), 0.0);
    }
}
