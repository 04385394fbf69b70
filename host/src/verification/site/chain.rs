//! Force from displacement on recordings: the paper's chain, and one in between it and the analysis.

use faer::Mat;
use rayon::prelude::*;

use super::super::VerifyError;
use crate::analysis::{Analysis, Interval, PassageResult};
use crate::forces::{LOW_PASS_HZ, WheelForce};
use crate::greens::moving::{WheelPath, constant_force_response, kernel, own_positions};
use crate::greens::moving_response::RailGreens;
use crate::greens::{Chain, GreensFunctions, GreensSampling, Quantity};
use crate::identify::IdentifiedSite;
use crate::indicator::indicators;
use crate::inverse::displacement::{DisplacementModel, Rule, RuleForce, RuleSolver};
use crate::irregularity::irregularity;
use crate::progress::Progress;
use crate::reconstruct::{HighPassSearch, Timing, complementary_displacement, high_pass_displacement};
use crate::signal::{CubicSpline, resample, rms};
use crate::track::Side;

/// Sampling of the displacement methods, as in the published script of the field chains.
const SAMPLING: GreensSampling = GreensSampling { rate_hz: 2000.0, len: 1024, band_hz: [900.0, 1000.0] };
/// Below this the model supplies the displacement of the chain in between, Hz.
const COMPLEMENT_HZ: f64 = 3.0;
/// Wheels further away than this do not move the sensor, metres: the constant force fades out there.
const NEIGHBOUR_M: f64 = 17.0;
/// Corners of the paper's chain. Below, drift over the length of a train enlarges the very range that the objective is
/// relative to: one passage in six then gets a corner of 0.3 Hz and forces of several times the true ones.
const HIGH_PASS: HighPassSearch =
    HighPassSearch { corner_hz: [0.8, 6.0], steps: 24, clear_m: 6.0, physical_uplift: 0.1 };
/// Rate and band of the moving response (eq. 13), and the stretch in which a force counts for it, metres.
const RAIL: GreensSampling = GreensSampling { rate_hz: 800.0, len: 512, band_hz: [260.0, 330.0] };
const RAIL_HALF_M: f64 = 4.0;
/// Samples of static force assumed around the region where a force is low-passed.
const SURROUND: usize = 512;

/// Positions, metres, ascending, and the force there, newtons.
type Profile = (Vec<f64>, Vec<f64>);

/// How a chain gets from acceleration to force.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Chains {
    /// High-pass by the quiet ends, pseudo-inverse, one force per bogie.
    Paper,
    /// Model below 3 Hz, truncated singular values of f − Q, one force per wheelset.
    Between,
}

/// What both displacement chains share: the track with the quasi-static ballast.
pub(super) struct DisplacementChain<'a> {
    identified: &'a IdentifiedSite<'a>,
    greens: GreensFunctions,
    rail: RailGreens,
    region_m: [f64; 2],
}

impl<'a> DisplacementChain<'a> {
    pub(super) fn new(identified: &'a IdentifiedSite<'a>) -> Result<Self, VerifyError> {
        let track = &identified.track;
        let ballast = identified.quasi_static.parameters;
        let distribution = ballast.bed(track);
        let greens = GreensFunctions::try_new(
            track,
            &distribution,
            SAMPLING,
            Quantity::Displacement,
            &Chain::Corrected,
        )?;
        let rail = RailGreens::of_crossing_rail(track, &distribution, RAIL_HALF_M, RAIL);
        Ok(Self { identified, greens, rail, region_m: identified.region_m() })
    }

    /// The analysis with forces and displacement replaced by those of a chain.
    pub(super) fn analysis(
        &self,
        analysis: &Analysis,
        kind: Chains,
        progress: &dyn Progress,
    ) -> Result<Analysis, VerifyError> {
        let passages = (0..analysis.passages.len())
            .into_par_iter()
            .map(|i| {
                let out = self.passage(&analysis.passages[i], i, kind);
                progress.step();
                out
            })
            .collect::<Result<Vec<_>, _>>()?;
        let grid_m = &analysis.indicators.position_m;
        let indicators = indicators(&passages, grid_m, self.identified.usual_force_n());
        Ok(Analysis { passages, indicators, ..analysis.clone() })
    }

    fn timing(&self, index: usize) -> Timing {
        Timing {
            speed_m_s: self.identified.timings[index].speed_m_s,
            first_axle_s: self.identified.quasi_static.first_axle_s[index],
        }
    }

    fn passage(
        &self,
        result: &PassageResult,
        index: usize,
        kind: Chains,
    ) -> Result<PassageResult, VerifyError> {
        let displacement = self.displacement(index, kind);
        let forces = self.forces(index, kind, &displacement)?;
        let mut out = result.clone();
        for (wheel, (position, force)) in out.wheelsets.iter_mut().zip(&forces) {
            let spline = CubicSpline::new(position, force).ok_or(VerifyError::Empty("transition region"))?;
            wheel.contact_force_n = wheel.position_m.iter().map(|x| spline.at(*x)).collect();
            let at = (0..wheel.contact_force_n.len())
                .max_by(|a, b| wheel.contact_force_n[*a].total_cmp(&wheel.contact_force_n[*b]))
                .unwrap_or(0);
            let peak = wheel.contact_force_n[at];
            wheel.peak_position_m = wheel.position_m[at];
            // These chains give no interval.
            wheel.peak_force_n = Interval { value: peak, lower: f64::NAN, upper: f64::NAN };
            wheel.lower_n.fill(f64::NAN);
            wheel.upper_n.fill(f64::NAN);
            wheel.irregularity_m = self.irregularity_m(index, &spline, &wheel.position_m);
            wheel.irregularity_rms_m = rms(&wheel.irregularity_m);
        }
        out.displacement_m = resample(&displacement, out.displacement_m.len());
        Ok(out)
    }

    /// Irregularity (eq. 13–16) from a force that is static outside the region.
    fn irregularity_m(&self, index: usize, force_n: &CubicSpline, grid_m: &[f64]) -> Vec<f64> {
        let (speed, static_n) =
            (self.identified.timings[index].speed_m_s, self.identified.static_force_n[index]);
        let (_, position_m) = own_positions(self.identified.direction, speed, RAIL_HALF_M, RAIL.rate_hz);
        let within = |x: &f64| if self.inside(*x) { force_n.at(*x) } else { static_n };
        let force_n = position_m.iter().map(within).collect();
        let force = WheelForce::given(0, position_m, force_n);
        irregularity(&force, speed, static_n, &self.rail, &self.identified.site.crossing.vehicle, grid_m)
    }

    /// Displacement at the rate of the recording, metres.
    fn displacement(&self, index: usize, kind: Chains) -> Vec<f64> {
        let recording = &self.identified.recordings[index];
        let (timing, pattern) = (self.timing(index), &self.identified.pattern);
        match kind {
            Chains::Paper => high_pass_displacement(recording, timing, pattern, HIGH_PASS).displacement_m,
            Chains::Between => {
                let model = resample(&self.static_train(index), recording.len);
                complementary_displacement(recording, timing, pattern, &model, COMPLEMENT_HZ)
            }
        }
    }

    fn path(&self, index: usize, time_at_origin_s: f64) -> WheelPath {
        WheelPath {
            direction: self.identified.direction,
            speed_m_s: self.identified.timings[index].speed_m_s,
            time_at_origin_s,
        }
    }

    /// Displacement of the model under the static forces of the whole train, over the recording.
    fn static_train(&self, index: usize) -> Vec<f64> {
        let timing = self.timing(index);
        let samples = (self.identified.recordings[index].duration_s() * SAMPLING.rate_hz).round() as usize;
        let mut sum = vec![0.0; samples];
        for offset in &self.identified.pattern.offset_m {
            let path = self.path(index, timing.axle_s(*offset));
            self.add_static(&mut sum, &path, self.identified.static_force_n[index]);
        }
        sum
    }

    fn add_static(&self, sum: &mut [f64], path: &WheelPath, force_n: f64) {
        for side in [Side::Crossing, Side::Stock] {
            let response = constant_force_response(&self.greens, side, path, sum.len());
            sum.iter_mut().zip(response).for_each(|(s, r)| *s += force_n * r);
        }
    }

    /// Force of every axle at the positions of its samples, ascending.
    fn forces(&self, index: usize, kind: Chains, displacement: &[f64]) -> Result<Vec<Profile>, VerifyError> {
        let offsets = &self.identified.pattern.offset_m;
        let wheel = RegionWheel::new(self, index);
        let solver = RuleSolver::new(&wheel.model)?;
        let rate = self.identified.recordings[index].rate_hz;
        let times: Vec<f64> = (0..displacement.len()).map(|i| i as f64 / rate).collect();
        let measured = CubicSpline::new(&times, displacement).ok_or(VerifyError::Empty("recording"))?;
        let static_n = self.identified.static_force_n[index];
        let mut deviations: Vec<Vec<f64>> = Vec::new();
        for (axle, offset) in offsets.iter().enumerate() {
            let rear_of_bogie = axle % 2 == 1;
            if kind == Chains::Paper && rear_of_bogie {
                deviations.push(deviations[axle - 1].clone());
                continue;
            }
            let mut window = wheel.window(&measured, self.timing(index).axle_s(*offset));
            self.subtract_known(&mut window, &wheel, index, axle, &deviations);
            let rule = if kind == Chains::Paper { Rule::Pinv } else { Rule::TruncatedGcv };
            let RuleForce { force_n, .. } = solver.solve(rule, &window)?;
            deviations.push(force_n.iter().map(|f| f - static_n).collect());
        }
        Ok(deviations
            .into_iter()
            .map(|d| wheel.ascending(&d.iter().map(|v| v + static_n).collect::<Vec<_>>()))
            .collect())
    }

    /// Takes the responses to all other forces out of a window: static forces of the neighbours and of the wheel itself
    /// outside the region, deviations of the wheels in front.
    fn subtract_known(
        &self,
        window: &mut [f64],
        wheel: &RegionWheel,
        index: usize,
        axle: usize,
        deviations: &[Vec<f64>],
    ) {
        let (offsets, speed) = (&self.identified.pattern.offset_m, wheel.path.speed_m_s);
        let static_n = self.identified.static_force_n[index];
        let mut known = vec![0.0; wheel.samples];
        for (other, offset) in offsets.iter().enumerate() {
            let behind_m = offset - offsets[axle];
            if behind_m.abs() > NEIGHBOUR_M {
                continue;
            }
            let path = self.path(index, wheel.path.time_at_origin_s + behind_m / speed);
            self.add_static(&mut known, &path, static_n);
            if let Some(deviation) = deviations.get(other) {
                let (matrix, first) = self.region_kernel(&path, wheel.samples);
                for (j, d) in deviation.iter().enumerate().take(matrix.ncols().saturating_sub(first)) {
                    let column = matrix.col(first + j);
                    known.iter_mut().zip(column.iter()).for_each(|(k, g)| *k += d * g);
                }
            }
        }
        for (k, w) in window.iter_mut().enumerate() {
            let own: f64 = (0..wheel.model.kernel.ncols()).map(|j| wheel.model.kernel[(k, j)]).sum();
            *w -= known[wheel.rows.start + k] - static_n * own;
        }
    }

    /// Kernel of the crossing side around the region, and the first of its columns inside the region.
    fn region_kernel(&self, path: &WheelPath, samples: usize) -> (Mat<f64>, usize) {
        let half_m = self.half_m();
        let matrix = kernel(&self.greens, Side::Crossing, path, half_m, samples);
        let range = path.samples_within(half_m, SAMPLING.rate_hz);
        let first = range.clone().position(|j| self.inside(path.x_m(j as f64 / SAMPLING.rate_hz)));
        (matrix, first.unwrap_or(0))
    }

    fn half_m(&self) -> f64 {
        self.region_m[0].abs().max(self.region_m[1].abs())
    }

    fn inside(&self, x_m: f64) -> bool {
        (self.region_m[0]..=self.region_m[1]).contains(&x_m)
    }
}

/// One wheel in the transition region: the same for all wheels of a passage on their own time axes.
struct RegionWheel {
    path: WheelPath,
    /// Length of the time axis.
    samples: usize,
    /// Samples during which the wheel is in the region.
    rows: std::ops::Range<usize>,
    model: DisplacementModel,
}

impl RegionWheel {
    fn new(chain: &DisplacementChain, index: usize) -> Self {
        let rate = SAMPLING.rate_hz;
        let speed = chain.identified.timings[index].speed_m_s;
        // The origin falls on a sample, and everything that the constant force does is on the axis.
        let origin = ((chain.half_m() + 0.5) / speed * rate).ceil();
        let path = chain.path(index, origin / rate);
        let samples = 2 * origin as usize + 1;
        let inside: Vec<usize> = (0..samples).filter(|k| chain.inside(path.x_m(*k as f64 / rate))).collect();
        let start = inside.first().copied().unwrap_or(0);
        let rows = start..inside.last().map_or(start, |last| last + 1);
        let (matrix, first) = chain.region_kernel(&path, samples);
        let kernel = Mat::from_fn(rows.len(), rows.len(), |i, j| matrix[(rows.start + i, first + j)]);
        let model = DisplacementModel {
            kernel,
            rate_hz: rate,
            static_force_n: chain.identified.static_force_n[index],
            surround: [SURROUND; 2],
            low_pass_hz: LOW_PASS_HZ,
        };
        Self { path, samples, rows, model }
    }

    /// Measured displacement while the wheel that is at x = 0 at `time_s` is in the region.
    fn window(&self, measured: &CubicSpline, time_s: f64) -> Vec<f64> {
        let start = time_s - self.path.time_at_origin_s;
        self.rows.clone().map(|k| measured.at(start + k as f64 / SAMPLING.rate_hz)).collect()
    }

    /// Positions of the samples and the values there, in ascending order of position.
    fn ascending(&self, values: &[f64]) -> Profile {
        let mut pairs: Vec<(f64, f64)> = self
            .rows
            .clone()
            .map(|k| self.path.x_m(k as f64 / SAMPLING.rate_hz))
            .zip(values.iter().copied())
            .collect();
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        pairs.into_iter().unzip()
    }
}
