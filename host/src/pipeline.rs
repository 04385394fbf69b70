//! The whole chain: site in, analysis or kernel package out.

use std::sync::Arc;

use faer::Mat;
use rayon::prelude::*;

use crate::analysis::{
    Analysis, BallastEstimate, DampingEstimate, Interval, PassageResult, WheelsetResult, explained,
};
use crate::ballast::BallastParameters;
use crate::ballast::evidence::DIFFERENCE;
use crate::forces::{LOW_PASS_HZ, Spread, WheelForce, all_wheel_forces};
use crate::greens::moving::{WheelPath, constant_force_response};
use crate::greens::{Chain, GreensFunctions, GreensSampling, Quantity};
use crate::identify::{IdentifiedSite, IdentifyError, identify};
use crate::indicator::indicators;
use crate::interaction::{BogieResponses, Interaction, Wheelset};
use crate::inverse::InverseError;
use crate::irregularity::{LONGEST_WAVELENGTH_M, irregularity_of_wheelset, on_grid};
use crate::kernel::{KernelError, Package};
use crate::limits::PassageLimits;
use crate::mean_interval::{Tracks, mean_errors};
use crate::passage::Profile;
use crate::progress::Progress;
use crate::reconstruct::complementary_displacement;
use crate::recording::{Scan, Site};
use crate::signal::{HALF_WIDTH_90, brick_band, mean, nearest, resample, rms};
use crate::track::{Side, Track};

/// Choices in the analysis.
#[derive(Clone, Debug, Default)]
pub struct AnalyseOptions {}

/// Why an analysis fails.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// Recordings or calibration.
    #[error(transparent)]
    Identify(#[from] IdentifyError),
    /// Force estimate.
    #[error(transparent)]
    Inverse(#[from] InverseError),
    /// Kernel package.
    #[error(transparent)]
    Kernel(#[from] KernelError),
}

/// The whole method on one site.
pub fn analyse(
    site: &Site,
    _options: &AnalyseOptions,
    progress: &dyn Progress,
) -> Result<Analysis, PipelineError> {
    let identified = identify(site, progress)?;
    evaluate(&identified, progress)
}

/// The kernel package of a site that has been identified.
pub fn package(identified: &IdentifiedSite, progress: &dyn Progress) -> Result<Package, PipelineError> {
    Ok(crate::kernel::package(identified, progress)?)
}

/// Sampling of the model displacement: the static response holds nothing above 60 Hz.
const DISPLACEMENT: GreensSampling = GreensSampling { rate_hz: 400.0, len: 256, band_hz: [110.0, 160.0] };
/// Below this the model supplies the displacement, Hz (measured: `docs/method.md`).
const COMPLEMENT_HZ: f64 = 3.0;
/// Step of the result grid, metres (contract).
const GRID_STEP_M: f64 = 0.01;
/// Recording traces in the results are decimated to this rate, Hz.
const TRACE_RATE_HZ: f64 = 1000.0;

/// Forces, irregularity, displacement and indicators of a site that has been identified.
pub fn evaluate(identified: &IdentifiedSite, progress: &dyn Progress) -> Result<Analysis, PipelineError> {
    let site = identified.site;
    progress.begin("contact forces", site.passages.len() as u64);
    let spreads = Spread::of_classes(identified)?;
    let forces = all_wheel_forces(identified, &spreads, &|| progress.step())?;
    let grid = result_grid(identified);
    let (interaction, moved) = interactions(identified);
    let displacement_greens = displacement_greens(identified);
    progress.begin("irregularity and displacement", site.passages.len() as u64);
    let passages: Vec<PassageResult> = (0..site.passages.len())
        .into_par_iter()
        .map(|i| {
            progress.step();
            passage_result(identified, i, &forces[i], &interaction, &displacement_greens, &grid)
        })
        .collect();
    let tracks = Tracks { calibrated: &interaction, moved: &moved };
    let means = indicators(&passages, &grid, identified.usual_force_n());
    let errors = mean_errors((identified, &spreads), &tracks, &passages, &means);
    let indicators = means.with_errors(&errors);
    let misdescription = identified.misdescription;
    Ok(Analysis {
        crossing: site.crossing.clone(),
        scan: site.scan.as_ref().map(|s| banded_scan(s, identified)),
        ballast: ballast_estimate(identified, &passages),
        passages,
        indicators: match &misdescription {
            Some(m) => indicators.misdescribed(m),
            None => indicators,
        },
        misdescription,
        budget: None,
        effects_included: Vec::new(),
        skipped: site.skipped.clone(),
    })
}

fn result_grid(identified: &IdentifiedSite) -> Vec<f64> {
    let [low, high] = identified.region_m();
    let count = ((high - low) / GRID_STEP_M).round() as usize + 1;
    (0..count).map(|i| low + i as f64 * GRID_STEP_M).collect()
}

/// Wheels on the calibrated track, at the time step of the forces, and on tracks close to it.
pub(crate) fn interactions(identified: &IdentifiedSite) -> (Interaction, Vec<(Interaction, f64)>) {
    let (track, half_m) = (&identified.track, identified.half_m());
    let bogie = BogieResponses::new(&identified.site.crossing.vehicle, identified.greens.sampling);
    let bogie = Arc::new(bogie);
    let on = |p: &BallastParameters| Interaction::new(&p.under(track), &p.bed(track), &bogie, half_m);
    let ballast = &identified.ballast.parameters;
    let moved = |k: usize| (on(&ballast.moved(k, DIFFERENCE[k])), DIFFERENCE[k]);
    rayon::join(
        || on(ballast),
        || (0..identified.calibration.unknown.count()).into_par_iter().map(moved).collect(),
    )
}

fn displacement_greens(identified: &IdentifiedSite) -> GreensFunctions {
    let ballast = &identified.ballast.parameters;
    GreensFunctions::new(
        &ballast.under(&identified.track),
        &ballast.bed(&identified.track),
        DISPLACEMENT,
        Quantity::Displacement,
        &Chain::Corrected,
    )
}

fn passage_result(
    identified: &IdentifiedSite,
    index: usize,
    forces: &[WheelForce],
    interaction: &Interaction,
    displacement_greens: &GreensFunctions,
    grid: &[f64],
) -> PassageResult {
    let (passage, recording) = (&identified.site.passages[index], &identified.recordings[index]);
    let timing = identified.timings[index];
    let samples = (recording.duration_s() * TRACE_RATE_HZ) as usize;
    let model = model_displacement(identified, index, displacement_greens);
    let model_raw = resample(&model, recording.len);
    let displacement =
        complementary_displacement(recording, timing, &identified.pattern, &model_raw, COMPLEMENT_HZ);
    let flags = flags(identified, index, &displacement);
    let position_m = forces.first().map_or(&[][..], |f| &f.position_m);
    let moving = interaction.wheelset(position_m, identified.direction, identified.static_force_n[index]);
    let wheelsets =
        forces.iter().map(|f| wheelset_result(identified, index, f, &moving, grid, flags.clone())).collect();
    PassageResult {
        passage_id: passage.passage_id,
        speed_m_s: timing.speed_m_s,
        temperature_c: passage.temperature_c,
        axle_times_s: identified.pattern.offset_m.iter().map(|o| timing.axle_s(*o)).collect(),
        trace_rate_hz: TRACE_RATE_HZ,
        acceleration_m_s2: recording.window(0.0, TRACE_RATE_HZ, samples, [LOW_PASS_HZ, 1.05 * LOW_PASS_HZ]),
        displacement_m: resample(&displacement, samples),
        model_displacement_m: resample(&model, samples),
        wheelsets,
    }
}

/// Displacement of the calibrated model under constant wheel forces, at the rate of [`DISPLACEMENT`], over the recording.
fn model_displacement(identified: &IdentifiedSite, index: usize, greens: &GreensFunctions) -> Vec<f64> {
    let timing = identified.timings[index];
    let samples = (identified.recordings[index].duration_s() * DISPLACEMENT.rate_hz).round() as usize;
    let mut sum = vec![0.0; samples];
    for offset in &identified.pattern.offset_m {
        let path = WheelPath {
            direction: identified.direction,
            speed_m_s: timing.speed_m_s,
            time_at_origin_s: timing.axle_s(*offset),
        };
        for (side, factor) in [Side::Crossing, Side::Stock].into_iter().zip(identified.track.load_factor) {
            let force_n = factor * identified.static_force_n[index];
            for (s, r) in sum.iter_mut().zip(constant_force_response(greens, side, &path, samples)) {
                *s += force_n * r;
            }
        }
    }
    sum
}

fn flags(identified: &IdentifiedSite, index: usize, displacement_m: &[f64]) -> Vec<String> {
    let (site, passage) = (identified.site, &identified.site.passages[index]);
    PassageLimits {
        speed_m_s: identified.timings[index].speed_m_s,
        stated_m_s: passage.speed_m_s,
        largest_m_s2: identified.recordings[index].max_m_s2,
        range_m_s2: site.crossing.sensor.range_m_s2,
        clips_at_m_s2: identified.clips_at_m_s2,
        train_type: &passage.train_type,
        vehicle_type: &site.crossing.vehicle.kind,
        axle_load_kg: passage.axle_load_kg,
        vehicle_axle_load_kg: site.crossing.vehicle.axle_load_kg,
        excess_noise: identified.excess_noise(index),
        explained: identified.explains(index),
        other_way: identified.other_way.contains(&index),
        described: identified.misdescription.is_none(),
        displacement_m,
    }
    .flags()
}

fn wheelset_result(
    identified: &IdentifiedSite,
    index: usize,
    force: &WheelForce,
    moving: &Wheelset,
    grid: &[f64],
    flags: Vec<String>,
) -> WheelsetResult {
    let on = |values: &[f64]| on_grid(&force.position_m, values, grid);
    let contact_force_n = on(&force.force_n);
    let half: Vec<f64> = on(&force.sd_n).iter().map(|s| HALF_WIDTH_90 * s).collect();
    let (peak, peak_position_m) = peak(grid, &contact_force_n);
    let at_peak = nearest(grid, peak_position_m);
    let at_peak_n = on_grid(&force.position_m, &force.unshifted_sd_n, &grid[at_peak..=at_peak]);
    let peak_half = HALF_WIDTH_90 * at_peak_n.first().copied().unwrap_or(f64::NAN);
    let irregularity_m = irregularity_of_wheelset(
        force,
        identified.timings[index].speed_m_s,
        identified.track.load_factor[0] * identified.static_force_n[index],
        moving,
        &identified.site.crossing.vehicle,
        grid,
    );
    WheelsetResult {
        wheelset: force.wheelset,
        position_m: grid.to_vec(),
        lower_n: contact_force_n.iter().zip(&half).map(|(f, h)| f - h).collect(),
        upper_n: contact_force_n.iter().zip(&half).map(|(f, h)| f + h).collect(),
        contact_force_n,
        peak_force_n: Interval { value: peak, lower: peak - peak_half, upper: peak + peak_half },
        peak_position_m,
        irregularity_rms_m: rms(&irregularity_m),
        irregularity_m,
        flags,
    }
}

/// Largest value and its position, both refined by a parabola through the three largest neighbours.
fn peak(grid: &[f64], force: &[f64]) -> (f64, f64) {
    let i = (0..force.len()).max_by(|a, b| force[*a].total_cmp(&force[*b])).unwrap_or(0);
    if i == 0 || i + 1 >= force.len() {
        return (force[i], grid[i]);
    }
    let (l, m, r) = (force[i - 1], force[i], force[i + 1]);
    let curvature = l - 2.0 * m + r;
    if curvature >= 0.0 {
        return (m, grid[i]);
    }
    let offset = (0.5 * (l - r) / curvature).clamp(-1.0, 1.0);
    (m - 0.25 * (l - r) * offset, grid[i] + offset * (grid[i] - grid[i - 1]))
}

/// Length over which a scan is continued to a level rail beyond its ends, metres, as in simulations: nothing is known there.
const SCAN_FADE_M: f64 = 0.3;

/// The scan in the band of the irregularities, at the mean speed.
fn banded_scan(scan: &Scan, identified: &IdentifiedSite) -> Scan {
    banded(scan, mean(&identified.timings.iter().map(|t| t.speed_m_s).collect::<Vec<_>>()))
}

fn banded(scan: &Scan, speed_m_s: f64) -> Scan {
    let Ok(path) = Profile::of_scan(&scan.position_m, &scan.irregularity_m, SCAN_FADE_M) else {
        return scan.clone();
    };
    let (first, last) = (scan.position_m[0], scan.position_m[scan.position_m.len() - 1]);
    // Far enough that the filter does not see the ends.
    let reach = 4.0 + first.abs().max(last.abs());
    let x: Vec<f64> =
        (0..(2.0 * reach / GRID_STEP_M) as usize).map(|i| -reach + i as f64 * GRID_STEP_M).collect();
    let z: Vec<f64> = x.iter().map(|p| path.at(*p)).collect();
    let banded = brick_band(&z, 1.0 / GRID_STEP_M, 1.0 / LONGEST_WAVELENGTH_M, LOW_PASS_HZ / speed_m_s);
    let inside: Vec<usize> = (0..x.len()).filter(|i| (first..=last).contains(&x[*i])).collect();
    Scan {
        position_m: inside.iter().map(|i| x[*i]).collect(),
        irregularity_m: inside.iter().map(|i| banded[*i]).collect(),
    }
}

/// Parameters with 90 % intervals, and the stiffness of every sleeper with the interval that follows from them.
fn ballast_estimate(identified: &IdentifiedSite, passages: &[PassageResult]) -> BallastEstimate {
    let fit = &identified.ballast;
    let p = fit.parameters;
    let sd = |i: usize| HALF_WIDTH_90 * fit.covariance[(i, i)].sqrt();
    let log = |value: f64, i: usize| around(value, sd(i));
    let stiffness_n_m2 = sleeper_intervals(&p, &fit.covariance, &identified.track);
    let difference: Vec<f64> = explained(passages)
        .into_iter()
        .map(|r| {
            let e: Vec<f64> =
                r.displacement_m.iter().zip(&r.model_displacement_m).map(|(a, b)| a - b).collect();
            rms(&e) / rms(&r.displacement_m).max(f64::MIN_POSITIVE)
        })
        .collect();
    BallastEstimate {
        p1_n_m2: log(p.p1_n_m2, 0),
        p2_n_m2: log(p.p2_n_m2, 1),
        p3: Interval { value: p.p3, lower: (p.p3 - sd(2)).max(0.0), upper: (p.p3 + sd(2)).min(1.0) },
        damping: damping_estimate(identified),
        stiffness_n_m2,
        misfit: mean(&difference),
    }
}

/// Damping of the ballast of a site that has been identified.
pub fn damping_estimate(identified: &IdentifiedSite) -> DampingEstimate {
    let (described_ns_m2, says) = (identified.track.ballast_damping_ns_m2, identified.damping);
    DampingEstimate {
        described_ns_m2,
        recorded_ns_m2: around(described_ns_m2 * says.off.exp(), HALF_WIDTH_90 * says.sd),
        used_ns_m2: described_ns_m2 * identified.ballast.parameters.damping_factor,
    }
}

/// A value that is positive, with an interval of half width `half` in its logarithm.
fn around(value: f64, half: f64) -> Interval {
    Interval { value, lower: value * (-half).exp(), upper: value * half.exp() }
}

/// Stiffness of every sleeper with the interval that follows from the covariance of the ballast's vector, to first order and in the
/// logarithm, as those of p1 and p2 are.
fn sleeper_intervals(p: &BallastParameters, covariance: &Mat<f64>, track: &Track) -> Vec<Interval> {
    let slopes = p.bed_slopes(track);
    let interval = |(s, value): (usize, f64)| {
        let gradient = slopes.each_ref().map(|by| by[s] / value);
        let variance: f64 = (0..3)
            .flat_map(|i| (0..3).map(move |j| (i, j)))
            .map(|(i, j)| gradient[i] * covariance[(i, j)] * gradient[j])
            .sum();
        let half = HALF_WIDTH_90 * variance.max(0.0).sqrt();
        around(value, half)
    };
    p.bed(track).into_iter().enumerate().map(interval).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::read_site;
    use crate::track::Mesh;

    fn reference() -> Site {
        let dir = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field/reference-1");
        read_site(&dir).unwrap()
    }

    /// Sleepers beside a lost support were listed with the stiffness that they had before, and those of p1 and p2 with other intervals
    /// than p1 and p2.
    #[test]
    fn regress_sleepers_have_the_stiffness_and_the_intervals_of_the_model() {
        let mut crossing = reference().crossing;
        crossing.ballast.support_factor = vec![(4, 0.3)];
        let track = Track::of_crossing(&crossing, Mesh::default());
        let p = BallastParameters::stiffness([30e6, 2e6, 0.35]);
        let covariance = faer::mat![[0.01, 0.002, 0.0], [0.002, 0.25, 0.001], [0.0, 0.001, 0.0025]];
        let found = sleeper_intervals(&p, &covariance, &track);
        assert_eq!(found.iter().map(|i| i.value).collect::<Vec<_>>(), p.bed(&track));
        let middle = track.sensor_sleeper;
        for (sleeper, variance, factor) in
            [(middle, 0.25, 1.0), (middle + 3, 0.01, 1.0), (middle + 4, 0.01, 0.3)]
        {
            let value = factor * if sleeper == middle { p.p2_n_m2 } else { p.p1_n_m2 };
            let half = HALF_WIDTH_90 * f64::sqrt(variance);
            let Interval { lower, upper, .. } = found[sleeper];
            assert!((lower / (value * (-half).exp()) - 1.0).abs() < 1e-9, "{sleeper}: {lower}");
            assert!((upper / (value * half.exp()) - 1.0).abs() < 1e-9, "{sleeper}: {upper}");
        }
    }

    /// A scan that ends 1 mm deep was cut off there: the edge put 0.16 mm RMS of what is not there into the band of the irregularities,
    /// next to a threshold of 0.20 mm.
    #[test]
    fn regress_the_ends_of_a_scan_are_no_irregularity() {
        let position_m: Vec<f64> = (0..=210).map(|i| -0.9 + 0.01 * f64::from(i)).collect();
        let level = Scan { irregularity_m: vec![1e-3; position_m.len()], position_m };
        let shown = banded(&level, 45.0);
        assert!(rms(&shown.irregularity_m) < 0.1e-3, "{}", rms(&shown.irregularity_m));
    }
}
