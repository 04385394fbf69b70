//! Force and irregularity of one bogie from its own simulated displacement (paper, section 6.1, fig. 15–17): no noise, no
//! reconstruction, ballast known, so that what is left is the error of the inverse.

use faer::Mat;
use rayon::prelude::*;

use super::StudyError;
use super::bogie::{BogieRun, BogieTrack};
use super::panels::{self, Panel};
use crate::forces::{LOW_PASS_HZ, WheelForce};
use crate::greens::moving::{WheelPath, constant_force_response, kernel};
use crate::greens::moving_response::RailGreens;
use crate::greens::{Chain, GreensFunctions, GreensSampling, Quantity};
use crate::inverse::displacement::{DisplacementModel, Rule, RuleSolver, fit_by_evidence};
use crate::irregularity::{LONGEST_WAVELENGTH_M, irregularity, on_grid};
use crate::passage::{ContactTrace, Profile};
use crate::progress::Progress;
use crate::recording::Crossing;
use crate::scenario::crossing_path;
use crate::signal::{CubicSpline, brick_band, rms};
use crate::track::{Mesh, Side, Track};
use crate::vehicle::static_wheel_force_n;
use crate::verification::Table;

/// Sampling of the paper, Hz; raised or lowered by so little that the axle spacing is a whole number of samples (eq. 11).
const RATE_HZ: f64 = 5000.0;
/// Green's functions: 0.8 s; practically no band limit, as in the paper.
const GREENS_LEN: usize = 4096;
/// The record reaches from here before the nose to as far behind it, metres.
const REACH_M: f64 = 10.5;
/// Deviations of the evidence estimate lie within this distance of the nose, metres.
const WIDE_M: f64 = 2.0;
/// … and are seen until the rear wheels are this far behind it, metres.
const SEEN_M: f64 = 4.3;
/// Rate and band of the moving response (GKFM-MR), Hz.
const RAIL: GreensSampling = GreensSampling { rate_hz: 1000.0, len: 256, band_hz: [260.0, 330.0] };
/// Irregularities are found from forces within this distance, metres.
const RAIL_HALF_M: f64 = 4.0;
/// Grid of the results, metres.
const GRID_M: f64 = 0.01;

/// Transition region, metres (2.4 m as in the paper): from 0.9 m before the nose tip to 1.5 m behind, mirrored in trailing
/// direction.
pub fn region_m(direction: f64) -> [f64; 2] {
    if direction > 0.0 { [-0.9, 1.5] } else { [-1.5, 0.9] }
}

/// Curves of one panel on a grid over the transition region.
pub struct PanelCurves {
    /// Which.
    pub panel: Panel,
    /// x, metres.
    pub position_m: Vec<f64>,
    /// Front wheel, low-passed at 250 Hz, newtons: simulated, by the paper's rule, by evidence.
    pub force_n: [Vec<f64>; 3],
    /// Band-passed irregularity, metres: of the path itself, from the simulated force, by the paper's rule, by evidence.
    pub irregularity_m: [Vec<f64>; 4],
    /// Front wheels behind the nose, metres.
    pub travelled_m: Vec<f64>,
    /// Displacement, metres: simulated, by Green's functions from the simulated forces, and from the forces of the
    /// paper's rule.
    pub displacement_m: [Vec<f64>; 3],
    /// Static wheel force, newtons.
    pub static_n: f64,
}

/// One bogie on the time axis of its kernels.
struct Inverse {
    crossing: Crossing,
    greens: GreensFunctions,
    rail: RailGreens,
    direction: f64,
    speed_m_s: f64,
    rate_hz: f64,
    samples: usize,
    /// Sample at which the front wheels are at x = 0.
    origin: usize,
    /// Samples between the wheelsets.
    spacing: usize,
    static_n: f64,
}

impl Inverse {
    fn new(panel: &Panel) -> Self {
        let crossing = panel.crossing(37);
        let track = Track::of_crossing(&crossing, Mesh::default());
        let ballast = panel.ballast.bed(&track);
        let (speed_m_s, v) = (panel.speed_m_s(), &crossing.vehicle);
        let spacing = (v.axle_spacing_m / speed_m_s * RATE_HZ).round();
        let rate_hz = spacing * speed_m_s / v.axle_spacing_m;
        let sampling = GreensSampling { rate_hz, len: GREENS_LEN, band_hz: [0.48 * rate_hz, 0.5 * rate_hz] };
        let origin = (REACH_M / speed_m_s * rate_hz).ceil() as usize;
        let direction = crossing.traffic_direction.sign();
        let static_n = static_wheel_force_n(v.axle_load_kg, v.gravity_m_s2);
        Self {
            greens: GreensFunctions::new(
                &track,
                &ballast,
                sampling,
                Quantity::Displacement,
                &Chain::Corrected,
            ),
            rail: RailGreens::of_crossing_rail(&track, &ballast, RAIL_HALF_M, RAIL),
            crossing,
            direction,
            speed_m_s,
            rate_hz,
            samples: 2 * origin + spacing as usize,
            origin,
            spacing: spacing as usize,
            static_n,
        }
    }

    /// Motion of front (0) and rear (1) wheels.
    fn path(&self, axle: usize) -> WheelPath {
        WheelPath {
            direction: self.direction,
            speed_m_s: self.speed_m_s,
            time_at_origin_s: (self.origin + axle * self.spacing) as f64 / self.rate_hz,
        }
    }

    /// Position of the front wheels at a sample, metres.
    fn x_m(&self, sample: usize) -> f64 {
        self.path(0).x_m(sample as f64 / self.rate_hz)
    }

    /// Samples during which the front wheels are between two positions.
    fn samples_in(&self, [low, high]: [f64; 2]) -> std::ops::Range<usize> {
        let inside: Vec<usize> = (0..self.samples).filter(|k| (low..=high).contains(&self.x_m(*k))).collect();
        let first = inside.first().copied().unwrap_or(0);
        first..inside.last().map_or(first, |l| l + 1)
    }

    /// Simulated displacement on the time axis, metres; rest before the simulation begins.
    fn displacement_m(&self, run: &BogieRun) -> Option<Vec<f64>> {
        let d = &run.record.sensor_m;
        let times: Vec<f64> = (0..d.len()).map(|k| k as f64 * run.record.dt_s).collect();
        let spline = CubicSpline::new(&times, d)?;
        let begin = run.front_at_origin_s - self.origin as f64 / self.rate_hz;
        let at = |k: usize| begin + k as f64 / self.rate_hz;
        Some((0..self.samples).map(|k| if at(k) < 0.0 { 0.0 } else { spline.at(at(k)) }).collect())
    }

    /// Displacement under forces that are static but for deviations on the crossing side, given per wheelset as
    /// functions of position.
    fn predicted_m(&self, deviation_n: [&dyn Fn(f64) -> f64; 2]) -> Vec<f64> {
        let mut sum = self.static_m();
        for (axle, deviation) in deviation_n.into_iter().enumerate() {
            let path = self.path(axle);
            let matrix = kernel(&self.greens, Side::Crossing, &path, REACH_M, self.samples);
            let first = *path.samples_within(REACH_M, self.rate_hz).start();
            for j in 0..matrix.ncols() {
                let force = deviation(path.x_m((first + j as i64) as f64 / self.rate_hz));
                sum.iter_mut().zip(matrix.col(j).iter()).for_each(|(s, g)| *s += force * g);
            }
        }
        sum
    }

    /// Displacement under the static forces of all four wheels.
    fn static_m(&self) -> Vec<f64> {
        let mut sum = vec![0.0; self.samples];
        for axle in [0, 1] {
            for side in [Side::Crossing, Side::Stock] {
                let response = constant_force_response(&self.greens, side, &self.path(axle), self.samples);
                sum.iter_mut().zip(response).for_each(|(s, r)| *s += self.static_n * r);
            }
        }
        sum
    }

    /// Eq. 12: rows × force of the front wheel in a stretch, the rear wheel's being the same.
    fn model(&self, rows: &std::ops::Range<usize>, columns: &std::ops::Range<usize>) -> DisplacementModel {
        let matrices = [0, 1].map(|axle| {
            let path = self.path(axle);
            let first = *path.samples_within(REACH_M, self.rate_hz).start();
            let shift = columns.start as i64 + (axle * self.spacing) as i64 - first;
            (kernel(&self.greens, Side::Crossing, &path, REACH_M, self.samples), shift)
        });
        let entry = |i: usize, j: usize| -> f64 {
            matrices
                .iter()
                .map(|(m, shift)| {
                    let column = usize::try_from(j as i64 + shift).ok().filter(|c| *c < m.ncols());
                    column.map_or(0.0, |c| m[(i, c)])
                })
                .sum()
        };
        DisplacementModel {
            kernel: Mat::from_fn(rows.len(), columns.len(), |i, j| entry(rows.start + i, j)),
            rate_hz: self.rate_hz,
            static_force_n: self.static_n,
            surround: [columns.start, self.samples - columns.end],
            low_pass_hz: LOW_PASS_HZ,
        }
    }

    /// Rows of the displacement without the responses to known forces.
    fn window(&self, model: &DisplacementModel, rows: &std::ops::Range<usize>, d: &[f64]) -> Vec<f64> {
        let known = self.static_m();
        let own = |i: usize| (0..model.kernel.ncols()).map(|j| model.kernel[(i, j)]).sum::<f64>();
        rows.clone().enumerate().map(|(i, k)| d[k] - known[k] + self.static_n * own(i)).collect()
    }

    /// Force by the paper's rule, with its positions in the order of passing.
    fn by_paper(&self, d: &[f64]) -> Result<Vec<f64>, StudyError> {
        let region = self.samples_in(region_m(self.direction));
        let model = self.model(&region, &region);
        Ok(RuleSolver::new(&model)?.solve(Rule::Pinv, &self.window(&model, &region, d))?.force_n)
    }

    /// Force by evidence in the transition region.
    fn by_evidence(&self, d: &[f64]) -> Result<Vec<f64>, StudyError> {
        let region = self.samples_in(region_m(self.direction));
        let centre = self.crossing.track.crossing_sleeper_x_m;
        let columns = self.samples_in([centre - WIDE_M, centre + WIDE_M]);
        let after =
            ((SEEN_M + self.crossing.vehicle.axle_spacing_m) / self.speed_m_s * self.rate_hz) as usize;
        let rows = columns.start..(self.origin + after).min(self.samples);
        let model = self.model(&rows, &columns);
        let position: Vec<f64> = columns.clone().map(|k| self.x_m(k)).collect();
        let report = region.start - columns.start..region.end - columns.start;
        let window = self.window(&model, &rows, d);
        let fit = fit_by_evidence(&model, &position, centre, &[window], report)?;
        Ok(fit.forces.into_iter().next().map_or_else(Vec::new, |f| f.force_n))
    }

    /// Irregularity (eq. 13–16) from a force as a function of position.
    fn irregularity_m(&self, force_n: &dyn Fn(f64) -> f64, grid: &[f64]) -> Vec<f64> {
        let step = self.speed_m_s / RAIL.rate_hz;
        let reach = (RAIL_HALF_M / step).floor() as i64;
        let position_m: Vec<f64> = (-reach..=reach).map(|k| self.direction * k as f64 * step).collect();
        let force_n = position_m.iter().map(|x| force_n(*x)).collect();
        let force = WheelForce::given(0, position_m, force_n);
        irregularity(&force, self.speed_m_s, self.static_n, &self.rail, &self.crossing.vehicle, grid)
    }
}

/// A curve over positions as a function: `outside` where it is not known.
fn function(position_m: &[f64], values: &[f64], outside: f64) -> impl Fn(f64) -> f64 {
    let (mut x, mut y) = (position_m.to_vec(), values.to_vec());
    if x.first() > x.last() {
        x.reverse();
        y.reverse();
    }
    let ends = (x.first().copied().unwrap_or(0.0), x.last().copied().unwrap_or(-1.0));
    let spline = CubicSpline::new(&x, &y);
    move |p: f64| match &spline {
        Some(s) if p >= ends.0 && p <= ends.1 => s.at(p),
        _ => outside,
    }
}

/// Simulated force of a wheel, low-passed on its own time axis, with its positions.
fn low_passed(trace: &ContactTrace, rate_hz: f64, static_n: f64) -> Vec<f64> {
    let n = trace.force_n.len();
    let mut deviation: Vec<f64> = trace.force_n.iter().map(|f| f - static_n).collect();
    deviation.resize((2 * n).next_power_of_two(), 0.0);
    let mut low = brick_band(&deviation, rate_hz, 0.0, LOW_PASS_HZ);
    low.truncate(n);
    low.iter().map(|d| d + static_n).collect()
}

/// The path in the band of the irregularities, at `grid`, metres.
fn banded_path(path: &Profile, speed_m_s: f64, grid: &[f64]) -> Vec<f64> {
    let n = 2048;
    let x: Vec<f64> = (0..n).map(|i| (i as f64 - 1024.0) * GRID_M).collect();
    let z: Vec<f64> = x.iter().map(|p| path.at(*p)).collect();
    let banded = brick_band(&z, 1.0 / GRID_M, 1.0 / LONGEST_WAVELENGTH_M, LOW_PASS_HZ / speed_m_s);
    on_grid(&x, &banded, grid)
}

fn panel_curves(panel: &Panel) -> Result<PanelCurves, StudyError> {
    let path = crossing_path(&panel.geometry, None)?;
    let run = BogieTrack::new(&panel.crossing(37), &panel.ballast)?.run(&path, panel.speed_m_s())?;
    let inverse = Inverse::new(panel);
    let empty = StudyError::Empty("simulated displacement");
    let d = inverse.displacement_m(&run).ok_or(empty)?;
    let region = inverse.samples_in(region_m(inverse.direction));
    let at: Vec<f64> = region.clone().map(|k| inverse.x_m(k)).collect();
    let (static_n, dt) = (inverse.static_n, run.record.dt_s);
    let (front, rear) = (&run.record.contacts[0], &run.record.contacts[2]);
    let low = low_passed(front, 1.0 / dt, static_n);
    let [paper, ours] = [inverse.by_paper(&d)?, inverse.by_evidence(&d)?];
    let grid = grid(region_m(inverse.direction));
    let known = function(&front.position_m, &low, static_n);
    let by_paper = function(&at, &paper, static_n);
    let by_ours = function(&at, &ours, static_n);
    let raw = [front, rear].map(|t| function(&t.position_m, &t.force_n, static_n));
    let deviation = |f: &dyn Fn(f64) -> f64, x: f64| f(x) - static_n;
    let from_true = inverse.predicted_m([&|x| deviation(&raw[0], x), &|x| deviation(&raw[1], x)]);
    let from_paper = inverse.predicted_m([&|x| deviation(&by_paper, x), &|x| deviation(&by_paper, x)]);
    let force = |f: &dyn Fn(f64) -> f64| grid.iter().map(|x| f(*x)).collect::<Vec<f64>>();
    Ok(PanelCurves {
        force_n: [force(&known), force(&by_paper), force(&by_ours)],
        irregularity_m: [
            banded_path(&path, inverse.speed_m_s, &grid),
            inverse.irregularity_m(&known, &grid),
            inverse.irregularity_m(&by_paper, &grid),
            inverse.irregularity_m(&by_ours, &grid),
        ],
        travelled_m: (0..inverse.samples).map(|k| inverse.direction * inverse.x_m(k)).collect(),
        displacement_m: [d, from_true, from_paper],
        position_m: grid,
        static_n,
        panel: panel.clone(),
    })
}

/// True and identified forces of one bogie at the samples of its front wheel in the transition region.
pub(super) struct Known {
    /// Front and rear wheel, low-passed, newtons.
    pub true_n: [Vec<f64>; 2],
    /// By the paper's rule, by evidence: one for both wheels, newtons.
    pub found_n: [Vec<f64>; 2],
}

impl Known {
    /// Identifies the forces of a simulated bogie with the panel's own ballast and load.
    pub(super) fn new(panel: &Panel, run: &BogieRun) -> Result<Self, StudyError> {
        let inverse = Inverse::new(panel);
        let d = inverse.displacement_m(run).ok_or(StudyError::Empty("simulated displacement"))?;
        let region = inverse.samples_in(region_m(inverse.direction));
        let at: Vec<f64> = region.map(|k| inverse.x_m(k)).collect();
        let (static_n, rate) = (inverse.static_n, 1.0 / run.record.dt_s);
        let true_n = [0, 2].map(|wheel: usize| {
            let trace = &run.record.contacts[wheel];
            let low_n = low_passed(trace, rate, static_n);
            let low = function(&trace.position_m, &low_n, static_n);
            at.iter().map(|x| low(*x)).collect()
        });
        Ok(Self { true_n, found_n: [inverse.by_paper(&d)?, inverse.by_evidence(&d)?] })
    }
}

/// 10 mm grid over a stretch.
pub fn grid([low, high]: [f64; 2]) -> Vec<f64> {
    let count = ((high - low) / GRID_M).round() as usize + 1;
    (0..count).map(|i| low + i as f64 * GRID_M).collect()
}

/// All six panels.
pub fn run(progress: &dyn Progress) -> Result<Vec<PanelCurves>, StudyError> {
    progress.begin("bogies on six panels", 6);
    panels::all()
        .par_iter()
        .map(|panel| {
            let curves = panel_curves(panel);
            progress.step();
            curves
        })
        .collect()
}

fn largest(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
}

/// RMS difference over the peak to peak of the first.
pub fn nrmse(known: &[f64], found: &[f64]) -> f64 {
    let difference: Vec<f64> = known.iter().zip(found).map(|(a, b)| a - b).collect();
    let low = known.iter().copied().fold(f64::INFINITY, f64::min);
    rms(&difference) / (largest(known) - low)
}

impl PanelCurves {
    /// Error of the largest force: paper's rule, evidence.
    pub fn peak_error(&self) -> [f64; 2] {
        [1, 2].map(|k: usize| largest(&self.force_n[k]) / largest(&self.force_n[0]) - 1.0)
    }

    /// RMS error of the force over its peak to peak: paper's rule, evidence.
    pub fn force_nrmse(&self) -> [f64; 2] {
        [1, 2].map(|k: usize| nrmse(&self.force_n[0], &self.force_n[k]))
    }
}

/// Figures 15–17 as numbers.
pub fn table(panels: &[PanelCurves]) -> Table {
    let mut table = Table::new(
        "One bogie per panel, without noise, ballast known (section 6.1, fig. 15\u{2013}17)",
        "Force below 250 Hz of the front wheel in the transition region: error of the peak, and RMS error over peak to peak; \
         displacement from the simulated forces by Green's functions, and irregularity (1 m \u{2026} 250 Hz) against the path \
         itself: RMS over peak to peak. The paper shows these without numbers: \"good agreement\", \"slightly lower magnitudes\", \
         displacement \"more or less exactly the same\".",
        &[
            "panel",
            "peak, kN",
            "paper's rule: peak",
            "waveform",
            "irregularity",
            "evidence: peak",
            "waveform",
            "irregularity",
            "irregularity from the true force",
            "displacement from the true forces",
        ],
    );
    for p in panels {
        let percent = |v: f64| format!("{:.2} %", 100.0 * v);
        let signed = |v: f64| format!("{:+.2} %", 100.0 * v).replace('-', "\u{2212}");
        let z = &p.irregularity_m;
        let (peak, wave) = (p.peak_error(), p.force_nrmse());
        table.row(&[
            p.panel.name.into(),
            format!("{:.0}", 1e-3 * largest(&p.force_n[0])),
            signed(peak[0]),
            percent(wave[0]),
            percent(nrmse(&z[0], &z[2])),
            signed(peak[1]),
            percent(wave[1]),
            percent(nrmse(&z[0], &z[3])),
            percent(nrmse(&z[0], &z[1])),
            percent(nrmse(&p.displacement_m[0], &p.displacement_m[1])),
        ]);
    }
    table
}
