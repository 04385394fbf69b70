//! Results against known truth: for verification, tests and the demo only. Nothing in the analysis calls this.

use cpcm_shared::record::Record;

use crate::analysis::{Analysis, Interval};
use crate::forces::{LOW_PASS_HZ, slope_per_m};
use crate::recording::Crossing;
use crate::recording::truth::{Side, Truth, WheelTruth};
use crate::signal::{CubicSpline, brick_band, mean, mean_of, quantile};
use crate::vehicle::static_wheel_force_n;

/// Time axis on which a true force is low-passed: rate (Hz) and length.
const FINE_RATE_HZ: f64 = 8000.0;
const FINE_LEN: usize = 4096;
/// The true force is known within ±4 m and fades to the static force over the last of it, metres.
const KNOWN_M: f64 = 4.0;
const FADE_M: f64 = 0.3;

/// True force of a wheel at `grid_m`, low-passed at 250 Hz like the identified one, newtons.
pub fn true_force_n(
    wheel: &WheelTruth,
    crossing: &Crossing,
    static_force_n: f64,
    grid_m: &[f64],
) -> Vec<f64> {
    let sign = crossing.traffic_direction.sign();
    let Some(spline) = CubicSpline::new(&wheel.position_m, &wheel.contact_force_n) else {
        return vec![f64::NAN; grid_m.len()];
    };
    let time = |i: usize| (i as f64 - FINE_LEN as f64 / 2.0) / FINE_RATE_HZ;
    let deviation: Vec<f64> = (0..FINE_LEN)
        .map(|i| {
            let x = sign * wheel.true_speed_m_s * time(i);
            let fade = ((KNOWN_M - x.abs()) / FADE_M).clamp(0.0, 1.0);
            if fade > 0.0 { (spline.at(x) - static_force_n) * fade } else { 0.0 }
        })
        .collect();
    let low = brick_band(&deviation, FINE_RATE_HZ, 0.0, LOW_PASS_HZ);
    let times: Vec<f64> = (0..FINE_LEN).map(time).collect();
    let Some(smooth) = CubicSpline::new(&times, &low) else { return vec![f64::NAN; grid_m.len()] };
    grid_m.iter().map(|x| static_force_n + smooth.at(sign * x / wheel.true_speed_m_s)).collect()
}

/// Errors of an analysis against the truth.
#[derive(Clone, Debug, Default)]
pub struct Score {
    /// |peak error| relative to the true peak, one per wheelset.
    pub peak: Vec<f64>,
    /// Signed peak error, relative.
    pub peak_signed: Vec<f64>,
    /// RMS force error over the region relative to the true peak to peak.
    pub waveform: Vec<f64>,
    /// |position error| of the peak, metres.
    pub peak_position_m: Vec<f64>,
    /// Time by which the forces of all wheels come too late together, s.
    pub late_s: f64,
    /// |speed error|, relative, one per passage.
    pub speed: Vec<f64>,
    /// RMS displacement error while the train passes, relative to the true peak to peak, one per passage.
    pub displacement: Vec<f64>,
    /// Mean irregularity of all wheelsets against the laser scan, RMS over peak to peak; NaN without a scan.
    pub irregularity: f64,
    /// Share of the scan that lies inside the interval of the mean irregularity; NaN without either.
    pub irregularity_coverage: f64,
    /// Error of the mean force peak, and half of its 90 % interval, relative to the true mean.
    pub mean_peak: [f64; 2],
    /// Share of wheelsets whose true peak lies inside the interval.
    pub peak_coverage: f64,
    /// Share of grid points whose true force lies inside the interval.
    pub waveform_coverage: f64,
    /// True p1, p2 (N/m²), p3, where they exist.
    pub ballast_truth: Option<[f64; 3]>,
}

impl Score {
    /// Median of one of the error lists.
    pub fn median(values: &[f64]) -> f64 {
        quantile(values, 0.5)
    }

    /// 90th percentile.
    pub fn p90(values: &[f64]) -> f64 {
        quantile(values, 0.9)
    }
}

/// What a node reports, against the truth and against the host.
#[derive(Clone, Debug, Default)]
pub struct NodeScore {
    /// |peak error| relative to the true peak, one per wheelset with forces.
    pub peak: Vec<f64>,
    /// Peak over the host's, less one; in the same order.
    pub against_host: Vec<f64>,
    /// Width of the peak's interval over that of the host's, in the same order.
    pub width: Vec<f64>,
    /// Share of the true peaks inside the node's 90 % intervals.
    pub coverage: f64,
    /// Wheelsets of which the node gives no forces.
    pub missing: usize,
}

/// Compares the records of a node, one per passage of the analysis and in its order, with the truth of the site.
pub fn score_node(records: &[Record], analysis: &Analysis, truth: &Truth) -> NodeScore {
    let mut score = NodeScore::default();
    let mut inside = 0usize;
    for (i, passage) in analysis.passages.iter().enumerate() {
        for host in &passage.wheelsets {
            let Some(known) = truth_of(truth, passage.passage_id, host.wheelset, Side::Crossing) else {
                continue;
            };
            let Some(node) = records.get(i).and_then(|r| r.wheelsets.get(host.wheelset)) else {
                score.missing += 1;
                continue;
            };
            let (peak_n, half_n) = (f64::from(node.peak_force_n), f64::from(node.peak_half_width_n));
            let true_n = true_peak_n(known, analysis);
            let Interval { value, lower, upper } = host.peak_force_n;
            score.peak.push((peak_n / true_n - 1.0).abs());
            score.against_host.push(peak_n / value - 1.0);
            score.width.push(2.0 * half_n / (upper - lower));
            inside += usize::from((peak_n - true_n).abs() <= half_n);
        }
    }
    score.coverage = inside as f64 / score.peak.len().max(1) as f64;
    score
}

/// Largest true force of a wheel on the result grid, low-passed like the identified one, newtons.
pub fn true_peak_n(wheel: &WheelTruth, analysis: &Analysis) -> f64 {
    let static_force_n = stated_static_force_n(&analysis.crossing);
    let true_n = true_force_n(wheel, &analysis.crossing, static_force_n, &analysis.indicators.position_m);
    true_n.into_iter().fold(f64::NEG_INFINITY, f64::max)
}

/// Compares an analysis with the truth of its site.
pub fn score(analysis: &Analysis, truth: &Truth) -> Score {
    let [irregularity, irregularity_coverage] = irregularity_error(analysis);
    let mut score = Score {
        ballast_truth: truth.site.ballast.p1_p2_p3,
        irregularity,
        irregularity_coverage,
        ..Score::default()
    };
    let (mut peaks_inside, mut points_inside, mut points) = (0usize, 0usize, 0usize);
    let mut peaks_n = Vec::new();
    let mut late = (0.0, 0.0);
    let static_force_n = stated_static_force_n(&analysis.crossing);
    for passage in &analysis.passages {
        for wheel in &passage.wheelsets {
            let Some(known) = truth_of(truth, passage.passage_id, wheel.wheelset, Side::Crossing) else {
                continue;
            };
            let true_n = true_force_n(known, &analysis.crossing, static_force_n, &wheel.position_m);
            let at = (0..true_n.len()).max_by(|a, b| true_n[*a].total_cmp(&true_n[*b])).unwrap_or(0);
            let (peak, range) =
                (true_n[at], true_n[at] - true_n.iter().copied().fold(f64::INFINITY, f64::min));
            peaks_n.push(peak);
            let error = (wheel.peak_force_n.value - peak) / peak;
            score.peak.push(error.abs());
            score.peak_signed.push(error);
            let square = mean(
                &true_n.iter().zip(&wheel.contact_force_n).map(|(a, b)| (a - b).powi(2)).collect::<Vec<_>>(),
            );
            score.waveform.push(square.sqrt() / range);
            score.peak_position_m.push((wheel.peak_position_m - wheel.position_m[at]).abs());
            let velocity_m_s = analysis.crossing.traffic_direction.sign() * passage.speed_m_s;
            let part = lateness(&wheel.position_m, [&wheel.contact_force_n, &true_n], velocity_m_s);
            late = (late.0 + part.0, late.1 + part.1);
            peaks_inside +=
                usize::from((wheel.peak_force_n.lower..=wheel.peak_force_n.upper).contains(&peak));
            points += true_n.len();
            points_inside += (0..true_n.len())
                .filter(|i| (wheel.lower_n[*i]..=wheel.upper_n[*i]).contains(&true_n[*i]))
                .count();
            if wheel.wheelset == 0 {
                score.speed.push((passage.speed_m_s / known.true_speed_m_s - 1.0).abs());
                if let Some(d) = &known.sleeper_displacement_m {
                    score.displacement.push(displacement_error(passage, d));
                }
            }
        }
    }
    score.peak_coverage = peaks_inside as f64 / score.peak.len().max(1) as f64;
    score.waveform_coverage = points_inside as f64 / points.max(1) as f64;
    score.late_s = late.0 / late.1;
    let (found, true_n) = (&analysis.indicators.peak_force_n, mean(&peaks_n));
    let half_n = 0.5 * (found.mean90[1] - found.mean90[0]);
    score.mean_peak = [found.mean / true_n - 1.0, half_n / true_n];
    score
}

/// What a force on the stock rail that all wheels of a site share does to the forces found on the crossing rail: one sensor takes a part
/// of the one for the other.
#[derive(Clone, Copy, Debug)]
pub struct StockInfluence {
    /// True mean deviation of the stock rail's force from the static one where the mean force on the crossing rail peaks, N.
    pub at_peak_n: f64,
    /// Change of the mean error on the crossing rail per newton of it, least squares along the track.
    pub error_per_newton: f64,
}

/// Compares the mean error of all wheels with the true mean force on the stock rail; `None` without truth of both rails.
pub fn stock_influence(analysis: &Analysis, truth: &Truth) -> Option<StockInfluence> {
    let static_force_n = stated_static_force_n(&analysis.crossing);
    let wheels = || analysis.passages.iter().flat_map(|p| p.wheelsets.iter().map(move |w| (p.passage_id, w)));
    let mean_true_n = |side: Side| {
        let all = wheels().filter_map(|(passage, w)| {
            let known = truth_of(truth, passage, w.wheelset, side)?;
            Some(true_force_n(known, &analysis.crossing, static_force_n, &w.position_m))
        });
        mean_of(&all.collect::<Vec<_>>())
    };
    let (crossing_n, stock_n) = (mean_true_n(Side::Crossing), mean_true_n(Side::Stock));
    let found_n = mean_of(&wheels().map(|(_, w)| w.contact_force_n.clone()).collect::<Vec<_>>());
    if stock_n.len() != found_n.len() || crossing_n.len() != found_n.len() {
        return None;
    }
    let error_n: Vec<f64> = found_n.iter().zip(&crossing_n).map(|(f, t)| f - t).collect();
    let (middle_n, off_n) = (mean(&stock_n), mean(&error_n));
    let product: f64 = error_n.iter().zip(&stock_n).map(|(e, s)| (e - off_n) * (s - middle_n)).sum();
    let square: f64 = stock_n.iter().map(|s| (s - middle_n).powi(2)).sum();
    let at = (0..crossing_n.len()).max_by(|a, b| crossing_n[*a].total_cmp(&crossing_n[*b]))?;
    Some(StockInfluence { at_peak_n: stock_n[at] - static_force_n, error_per_newton: product / square })
}

/// Truth of one wheel.
fn truth_of(truth: &Truth, passage_id: i32, wheelset: usize, side: Side) -> Option<&WheelTruth> {
    truth.wheels.iter().find(|t| t.passage_id == passage_id && t.wheelset == wheelset && t.side == side)
}

/// Static force of a wheel with the axle load of the description, N.
fn stated_static_force_n(crossing: &Crossing) -> f64 {
    static_wheel_force_n(crossing.vehicle.axle_load_kg, crossing.vehicle.gravity_m_s2)
}

/// Sums of which the ratio is the time by which the force `found` comes later than the one `known` under a wheel that moves at
/// `velocity_m_s` along x, s; least squares.
fn lateness(position_m: &[f64], [found_n, known_n]: [&[f64]; 2], velocity_m_s: f64) -> (f64, f64) {
    let slopes = slope_per_m(position_m, known_n);
    let points = slopes.iter().zip(known_n.iter().zip(found_n));
    points.fold((0.0, 0.0), |(early, squares), (slope_per_m, (known, found))| {
        let per_second = slope_per_m * velocity_m_s;
        (early + (known - found) * per_second, squares + per_second * per_second)
    })
}

/// RMS error over the time from the first axle 8 m before to the last 8 m behind the crossing, over peak to peak.
fn displacement_error(passage: &crate::analysis::PassageResult, true_m: &[f64]) -> f64 {
    let found = &passage.displacement_m;
    let truth = crate::signal::resample(true_m, found.len());
    let reach_s = 8.0 / passage.speed_m_s;
    let first = passage.axle_times_s.first().map_or(0.0, |t| t - reach_s);
    let last = passage.axle_times_s.last().map_or(0.0, |t| t + reach_s);
    let inside: Vec<usize> = (0..found.len().min(truth.len()))
        .filter(|i| (first..=last).contains(&(*i as f64 / passage.trace_rate_hz)))
        .collect();
    let square = mean(&inside.iter().map(|i| (found[*i] - truth[*i]).powi(2)).collect::<Vec<_>>());
    let high = truth.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let low = truth.iter().copied().fold(f64::INFINITY, f64::min);
    square.sqrt() / (high - low)
}

/// Mean irregularity of all wheelsets against the scan in the same band, where both are known: RMS over peak to peak, and the share of
/// the scan that lies inside the interval of the mean.
fn irregularity_error(analysis: &Analysis) -> [f64; 2] {
    let Some(scan) = &analysis.scan else { return [f64::NAN; 2] };
    let i = &analysis.indicators;
    let Some(spline) = CubicSpline::new(&scan.position_m, &scan.irregularity_m) else {
        return [f64::NAN; 2];
    };
    let ends = scan.position_m[0]..=scan.position_m[scan.position_m.len() - 1];
    let both: Vec<(f64, &Interval)> = (i.position_m.iter().zip(&i.mean_irregularity_m))
        .filter(|(x, _)| ends.contains(x))
        .map(|(x, found)| (spline.at(*x), found))
        .collect();
    let high = both.iter().map(|b| b.0).fold(f64::NEG_INFINITY, f64::max);
    let low = both.iter().map(|b| b.0).fold(f64::INFINITY, f64::min);
    let squares: Vec<f64> = both.iter().map(|(z, found)| (found.value - z).powi(2)).collect();
    let stated = both.iter().all(|(_, found)| found.lower.is_finite());
    let inside = both.iter().filter(|(z, found)| (found.lower..=found.upper).contains(z)).count();
    let share = if stated { inside as f64 / both.len() as f64 } else { f64::NAN };
    [mean(&squares).sqrt() / (high - low), share]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_a_shifted_wave_is_as_late_as_it_was_shifted() {
        let wave =
            |late: f64| -> Vec<f64> { (0..400).map(|i| (0.05 * (f64::from(i) - late)).sin()).collect() };
        let metres: Vec<f64> = (0..400).map(f64::from).collect();
        let (early, squares) = lateness(&metres, [&wave(0.3), &wave(0.0)], 1.0);
        // Central differences of a wave of 126 samples are 0.04 % off.
        assert!((early / squares - 0.3).abs() < 1e-3, "{}", early / squares);
    }
}
