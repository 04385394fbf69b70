//! An [`Analysis`] made from the truth of a reference site, for tests of what comes after the physics.
//!
//! Nothing here is a result: forces are the true ones smoothed, the intervals are invented.

use std::path::{Path, PathBuf};

use cpcm::analysis::{
    Analysis, BallastEstimate, Condition, DampingEstimate, Indicators, Interval, PassageResult, Spread,
    WheelsetResult,
};
use cpcm::recording::truth::{Side, Truth, WheelTruth, read_truth};
use cpcm::recording::{Passage, Scan, Site, read_site};
use cpcm::signal::{mean, quantile, rms};

/// Field recordings without an effect, whose truth is known, speeds included.
pub const REFERENCE_SITES: [&str; 3] = ["reference-1", "reference-2", "reference-3"];

/// Field recordings whose effect is known; speeds are the operator's.
pub const KNOWN_SITES: [&str; 7] = [
    "known-clock-error",
    "known-gain-temperature",
    "known-load-transfer",
    "known-pad-stiffness",
    "known-saturation",
    "known-voided-sleepers",
    "known-wheel-out-of-roundness",
];

/// Directory of a field recording.
pub fn field(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data/field").join(name)
}

/// Made from `reference-1`.
pub fn sample_analysis() -> Analysis {
    let dir = field("reference-1");
    let (site, truth) = (read_site(&dir).unwrap(), read_truth(&dir).unwrap());
    let scan = site.scan.clone().unwrap();
    let passages: Vec<PassageResult> =
        site.passages.iter().map(|p| passage(p, &site, &truth, &scan)).collect();
    let indicators = indicators(&passages);
    let z = band_pass(&scan.irregularity_m);
    let scan = Some(Scan { position_m: scan.position_m, irregularity_m: z });
    Analysis {
        crossing: site.crossing,
        scan,
        ballast: ballast(&truth),
        passages,
        indicators,
        misdescription: None,
        budget: None,
        effects_included: Vec::new(),
        skipped: site.skipped,
    }
}

fn around(value: f64, fraction: f64) -> Interval {
    Interval { value, lower: value * (1.0 - fraction), upper: value * (1.0 + fraction) }
}

fn ballast(truth: &Truth) -> BallastEstimate {
    let b = &truth.site.ballast;
    let [p1, p2, p3] = b.p1_p2_p3.unwrap();
    BallastEstimate {
        p1_n_m2: around(p1, 0.02),
        p2_n_m2: around(p2, 0.05),
        p3: around(p3, 0.5),
        damping: DampingEstimate {
            described_ns_m2: 125e3,
            recorded_ns_m2: around(125e3, 0.1),
            used_ns_m2: 125e3,
        },
        stiffness_n_m2: b
            .stiffness_n_m2
            .iter()
            .map(|&k| around(k, if k < p1 { 0.08 } else { 0.02 }))
            .collect(),
        misfit: 0.021,
    }
}

fn passage(p: &Passage, site: &Site, truth: &Truth, scan: &Scan) -> PassageResult {
    let wheels: Vec<&WheelTruth> =
        truth.wheels.iter().filter(|w| w.passage_id == p.passage_id && w.side == Side::Crossing).collect();
    let displacement = wheels[0].sleeper_displacement_m.clone().unwrap();
    let speed_m_s = wheels[0].true_speed_m_s;
    let acceleration: Vec<f64> = p.acceleration_m_s2.iter().map(|&a| f64::from(a)).collect();
    let every = |v: Vec<f64>| -> Vec<f64> { v.into_iter().step_by(4).collect() };
    let v = &site.crossing.vehicle;
    let deepest = displacement.iter().copied().fold(0.0, f64::max);
    let first = displacement.iter().position(|&d| d > 0.5 * deepest).unwrap() as f64 / p.sample_rate_hz;
    let axle_times_s = (0..4 * v.cars)
        .map(|k| {
            let within = [0.0, v.axle_spacing_m, v.bogie_centres_m, v.bogie_centres_m + v.axle_spacing_m];
            first + 0.01 + ((k / 4) as f64 * v.car_length_m + within[k % 4]) / speed_m_s
        })
        .collect();
    PassageResult {
        passage_id: p.passage_id,
        speed_m_s,
        temperature_c: p.temperature_c,
        axle_times_s,
        trace_rate_hz: p.sample_rate_hz / 4.0,
        acceleration_m_s2: every(smooth(&acceleration, 5)),
        model_displacement_m: every(smooth(&displacement, 25)),
        displacement_m: every(displacement),
        wheelsets: wheels.iter().map(|w| wheelset(w, scan)).collect(),
    }
}

fn wheelset(w: &WheelTruth, scan: &Scan) -> WheelsetResult {
    let range = w.position_m.iter().position(|&x| x > -0.905).unwrap();
    let range = range..range + 241;
    let force = smooth(&w.contact_force_n, 3)[range.clone()].to_vec();
    let position_m: Vec<f64> = (0..241).map(|i| -0.9 + 0.01 * f64::from(i)).collect();
    let (top, peak) =
        force.iter().copied().enumerate().fold((0, 0.0), |m, (i, f)| if f > m.1 { (i, f) } else { m });
    let scale = 0.8 + peak / 700e3;
    let z = |x: &f64| {
        let k = scan.position_m.partition_point(|s| s < x).min(scan.position_m.len() - 1);
        scale * scan.irregularity_m[k]
    };
    let irregularity_m = band_pass(&position_m.iter().map(z).collect::<Vec<_>>());
    WheelsetResult {
        wheelset: w.wheelset,
        lower_n: force.iter().map(|f| f - 3e3).collect(),
        upper_n: force.iter().map(|f| f + 3e3).collect(),
        peak_force_n: around(peak, 0.03),
        peak_position_m: position_m[top],
        irregularity_rms_m: rms(&irregularity_m),
        contact_force_n: force,
        irregularity_m,
        position_m,
        flags: if w.wheelset == 3 { vec!["example-flag".into()] } else { vec![] },
    }
}

fn indicators(passages: &[PassageResult]) -> Indicators {
    let all: Vec<&WheelsetResult> = passages.iter().flat_map(|p| &p.wheelsets).collect();
    let spread = |values: Vec<f64>, threshold| Spread {
        mean: mean(&values),
        mean90: [0.98, 1.02].map(|part| part * mean(&values)),
        p10: quantile(&values, 0.1),
        p90: quantile(&values, 0.9),
        threshold,
    };
    let average = |value: fn(&WheelsetResult) -> &[f64]| -> Vec<f64> {
        (0..241).map(|i| mean(&all.iter().map(|w| 0.98 * value(w)[i]).collect::<Vec<_>>())).collect()
    };
    Indicators {
        peak_force_n: spread(all.iter().map(|w| w.peak_force_n.value).collect(), 175e3),
        irregularity_rms_m: spread(all.iter().map(|w| w.irregularity_rms_m).collect(), 270e-6),
        force_mode_n: average(|w| &w.contact_force_n),
        irregularity_mode_m: average(|w| &w.irregularity_m),
        mean_irregularity_m: average(|w| &w.irregularity_m)
            .into_iter()
            .map(|value| Interval { value, lower: value - 20e-6, upper: value + 20e-6 })
            .collect(),
        position_m: all[0].position_m.clone(),
        condition: Condition::Watch,
        urgency: "within three months".into(),
        recommended_action: "tamp the crossing sleeper and inspect the nose; grind when the nose shows a dip"
            .into(),
    }
}

/// Moving average over ±`half` samples.
fn smooth(values: &[f64], half: usize) -> Vec<f64> {
    (0..values.len())
        .map(|i| mean(&values[i.saturating_sub(half)..(i + half + 1).min(values.len())]))
        .collect()
}

/// What is left above 1 m on a 10 mm grid, roughly.
fn band_pass(values: &[f64]) -> Vec<f64> {
    smooth(values, 50).iter().zip(values).map(|(slow, z)| z - slow).collect()
}

/// Adds a step of `size_m_s2` at a time, which decays.
pub fn add_step(passage: &mut Passage, at_s: f64, size_m_s2: f64, decay_s: f64) {
    let rate_hz = passage.sample_rate_hz;
    for (k, a) in passage.acceleration_m_s2.iter_mut().enumerate() {
        let since_s = k as f64 / rate_hz - at_s;
        if since_s >= 0.0 {
            *a += (size_m_s2 * (-since_s / decay_s).exp()) as f32;
        }
    }
}
