//! Where the gap is: along the track, and against what varies between passages.

use super::data::RATE_HZ;
use super::diagnosis::{Named, Residual};
use super::fit::Frame;
use super::measure::Prediction;

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
            let power: f64 = model.iter().map(|m| m * m).sum();
            let product: f64 = model.iter().zip(&residual).map(|(m, r)| m * r).sum();
            Residual {
                passage_id: p.passage_id,
                speed_m_s: p.speed_m_s,
                temperature_c: frame.observed[i].temperature_c,
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

/// Positions x of a bogie's front axle at which the residual that all bogies share stands out of their scatter.
pub fn positions(predictions: &[Prediction]) -> Vec<[f64; 2]> {
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
            let bin = ((p.first_m + k as f64 / RATE_HZ * p.speed_m_s) / BIN_M).floor() as i64;
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

    #[test]
    fn analytic_correlation_of_lines() {
        let a = [1.0, 2.0, 3.0];
        assert!((correlation(&a, &[2.0, 4.0, 6.0]) - 1.0).abs() < 1e-12);
        assert!((correlation(&a, &[3.0, 2.0, 1.0]) + 1.0).abs() < 1e-12);
        assert_eq!(correlation(&a, &[1.0, 1.0, 1.0]), 0.0);
    }
}
