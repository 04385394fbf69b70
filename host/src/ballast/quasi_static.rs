//! Calibration on the quasi-static part of the displacement (paper, eq. 2): below the frequency v/2.3 m the
//! sleeper follows a constant moving load, so no crossing geometry is needed.
//!
//! The comparison is made in the frequency domain, where the brick-wall low-pass of eq. 2 is a choice of lines and
//! the alignment of model and measurement a phase.

mod times;

pub use times::Sinking;

use faer::c64;
use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::{DMatrix, DVector, Dyn, Owned, Vector3};
use rayon::prelude::*;

use super::BallastParameters;
use crate::reconstruct::{ABOUT, Recording, comb};
use crate::track::{RailGrid, SensorReceptance, Track};
use crate::vehicle::AxlePattern;

/// Deformation wavelength that separates quasi-static from dynamic response, metres (paper, section 3.1).
pub const SEPARATION_WAVELENGTH_M: f64 = 2.3;
/// Spacing of the compared lines, Hz.
const LINE_HZ: f64 = 0.5;
/// Lowest compared line, Hz: double integration leaves nothing but noise below.
const LOWEST_HZ: f64 = 2.0;
/// A recording begins when the first axle is at least this far away and ends when the last one is, metres.
const APPROACH_M: f64 = 6.0;
/// Positions x at which the moving load is sampled, metres.
const STEP_M: f64 = 0.1;
/// Where the load begins to fade and where it is gone, metres from the origin: no step at the rail ends.
const FADE_M: [f64; 2] = [13.0, 17.0];
/// A misfit from which on the fit may have ended where no ballast is: over 10 and 5 MN/m² it went from nominal ballast to 485 MN/m², and left
/// 0.36. Right ones leave 0.02 to 0.28; an end that is right is kept.
const POOR: f64 = 0.2;
/// Ballast to begin with then, times the start.
const OTHER_STARTS: [f64; 2] = [0.3, 3.0];
/// What another start leaves at most of the misfit, if its end is preferred.
const MUCH_BETTER: f64 = 0.7;
/// One passage prepared for the comparison.
#[derive(Clone, Debug)]
pub struct QuasiStaticPassage {
    speed_m_s: f64,
    static_force_n: f64,
    /// Where the first axle is looked for, s: from, to.
    search_s: [f64; 2],
    /// Displacement spectrum on the lines, m s.
    measured: Vec<c64>,
    /// Sum of the axles' phases on the lines.
    pattern: Vec<c64>,
    /// Squared magnitude of a line of the acceleration where the track is quiet, (m/s)².
    quiet_m2_s2: f64,
}

/// Lines at which model and measurement are compared, and the model to evaluate there.
pub struct QuasiStatic<'a> {
    track: &'a Track,
    direction: f64,
    frequency_hz: Vec<f64>,
    /// Where the moving load is sampled.
    grid: RailGrid,
    passages: Vec<QuasiStaticPassage>,
}

/// Result of the calibration.
#[derive(Clone, Debug)]
pub struct QuasiStaticFit {
    /// Best parameters.
    pub parameters: BallastParameters,
    /// Time of the first axle at x = 0 per passage, seconds.
    pub first_axle_s: Vec<f64>,
    /// Remaining misfit, RMS ratio to the measured displacement in the band.
    pub misfit: f64,
    /// Model evaluations used.
    pub evaluations: usize,
}

impl QuasiStaticFit {
    /// Where a fit of the whole acceleration starts: this one errs towards a soft centre, because the dynamic force leaks
    /// into its band, and hardly sees the shape.
    pub fn start_of_evidence(&self) -> BallastParameters {
        let found = self.parameters;
        BallastParameters {
            p2_n_m2: (1.5 * found.p2_n_m2).max(0.3 * found.p1_n_m2),
            p3: BallastParameters::NOMINAL.p3,
            ..found
        }
    }
}

impl<'a> QuasiStatic<'a> {
    /// Prepares recordings with known speeds.
    pub fn new(
        track: &'a Track,
        direction: f64,
        pattern: &AxlePattern,
        recordings: &[(&Recording, f64, f64)],
    ) -> Self {
        let fastest = recordings.iter().map(|(_, v, _)| *v).fold(0.0, f64::max);
        let lines = (fastest / SEPARATION_WAVELENGTH_M / LINE_HZ).floor() as usize;
        let frequency_hz: Vec<f64> =
            (1..=lines).map(|k| k as f64 * LINE_HZ).filter(|f| *f >= LOWEST_HZ).collect();
        let passages = recordings
            .par_iter()
            .map(|(recording, speed, force)| prepare(recording, *speed, *force, pattern, &frequency_hz))
            .collect();
        Self { track, direction, frequency_hz, grid: track.rail_grid(STEP_M), passages }
    }

    /// Fits the three parameters, times of the axles included: from `start`, and where that leaves much from softer and stiffer ballast.
    pub fn fit(&self, start: BallastParameters) -> QuasiStaticFit {
        let first = self.fit_from(start);
        if first.misfit < POOR {
            return first;
        }
        let from = |factor: &f64| {
            let (p1_n_m2, p2_n_m2) = (factor * start.p1_n_m2, factor * start.p2_n_m2);
            self.fit_from(BallastParameters { p1_n_m2, p2_n_m2, ..start })
        };
        let better = |best: QuasiStaticFit, other: QuasiStaticFit| {
            if other.misfit < MUCH_BETTER * best.misfit { other } else { best }
        };
        OTHER_STARTS.iter().map(from).fold(first, better)
    }

    fn fit_from(&self, start: BallastParameters) -> QuasiStaticFit {
        let first_axle_s = self.align(&start);
        let problem = Problem { model: self, times: first_axle_s, scaled: to_scaled(&start), evaluations: 0 };
        let (problem, report) = LevenbergMarquardt::new().with_ftol(1e-8).with_xtol(1e-6).minimize(problem);
        let parameters = from_scaled(&problem.scaled);
        let models = self.models(&parameters);
        let first_axle_s = (0..self.passages.len())
            .map(|i| self.refine_time(&self.passages[i], &models[i], problem.times[i]))
            .collect();
        QuasiStaticFit {
            parameters,
            first_axle_s,
            misfit: (2.0 * report.objective_function.max(0.0)).sqrt(),
            evaluations: report.number_of_evaluations,
        }
    }

    /// Displacement spectrum of the whole train under constant wheel forces, first axle at time 0, per passage.
    fn models(&self, ballast: &BallastParameters) -> Vec<Vec<c64>> {
        let distribution = ballast.bed(self.track);
        let receptance = self.track.sensor_receptance(&self.frequency_hz, &distribution);
        self.models_of(&receptance)
    }

    /// Models of all passages on a track of given receptance, or their derivatives for one of its derivatives.
    fn models_of(&self, receptance: &SensorReceptance) -> Vec<Vec<c64>> {
        let lines: Vec<Line> = receptance
            .crossing
            .par_iter()
            .zip(&receptance.stock)
            .map(|(crossing, stock)| self.line(&self.grid.both_rails(crossing, stock)))
            .collect();
        let arch = pulp::Arch::new();
        let of = |passage| arch.dispatch(|| self.model_of(passage, &lines));
        self.passages.par_iter().map(of).collect()
    }

    /// Models as [`Self::models`] gives them, and their derivatives by (ln p1, ln p2, p3).
    fn models_and_slopes(&self, ballast: &BallastParameters) -> [Vec<Vec<c64>>; 4] {
        let track = self.track;
        let (value, slopes) = track.sensor_receptance_and_slopes(
            &self.frequency_hz,
            &ballast.bed(track),
            &ballast.bed_slopes(track),
        );
        [&value, &slopes[0], &slopes[1], &slopes[2]].map(|r| self.models_of(r))
    }

    /// Derivatives of [`Self::residuals`] by (ln p1, ln p2, p3), each with its number. The axle times follow the
    /// parameters: they keep the slope of the correlation at zero.
    fn slopes(&self, ballast: &BallastParameters, times: &[f64]) -> [(Vec<f64>, usize); 3] {
        let [models, moved @ ..] = self.models_and_slopes(ballast);
        let mut columns = [0, 1, 2].map(|k| (Vec::new(), k));
        let mut power = 0.0;
        for (i, passage) in self.passages.iter().enumerate() {
            let time = self.refine_time(passage, &models[i], times[i]);
            let lines = self.in_band(passage);
            let turn = |k: usize| std::f64::consts::TAU * self.frequency_hz[k];
            // Σ ω^n m conj(v) e^{iωt}: derivatives of the correlation with v in the place of the model.
            let moment = |v: &[c64], order: i32| {
                (0..lines).fold(c64::new(0.0, 0.0), |sum, k| {
                    sum + passage.measured[k] * v[k].conj() * unit(turn(k) * time) * turn(k).powi(order)
                })
            };
            let curvature = -moment(&models[i], 2).re;
            for ((column, _), slope) in columns.iter_mut().zip(&moved) {
                let later = if curvature < 0.0 { moment(&slope[i], 1).im / curvature } else { 0.0 };
                for k in 0..lines {
                    let phase = unit(-turn(k) * time);
                    let e = models[i][k] * phase * c64::new(0.0, turn(k) * later) - slope[i][k] * phase;
                    column.extend([e.re, e.im]);
                }
            }
            power += passage.measured.iter().take(lines).map(|v| v.norm_sqr()).sum::<f64>();
        }
        let scale = 1.0 / power.sqrt().max(f64::MIN_POSITIVE);
        for (column, _) in &mut columns {
            column.iter_mut().for_each(|v| *v *= scale);
        }
        columns
    }

    /// What acts on the sensor along the track at one frequency, the fading load included.
    fn line(&self, profile: &[c64]) -> Line {
        let first = self.track.node_x_m[0];
        let fading = profile.iter().enumerate().map(|(i, h)| {
            let x = first + i as f64 * STEP_M;
            h * ((FADE_M[1] - x.abs()) / (FADE_M[1] - FADE_M[0])).clamp(0.0, 1.0)
        });
        Line::new(fading)
    }

    #[inline(always)]
    fn model_of(&self, passage: &QuasiStaticPassage, lines: &[Line]) -> Vec<c64> {
        let first = self.track.node_x_m[0];
        let scale = passage.static_force_n / passage.speed_m_s * STEP_M;
        self.frequency_hz
            .iter()
            .zip(lines)
            .zip(&passage.pattern)
            .map(|((f, line), pattern)| {
                let turn = -std::f64::consts::TAU * f * self.direction / passage.speed_m_s;
                line.turned(turn * STEP_M) * unit(turn * first) * pattern * scale
            })
            .collect()
    }

    fn in_band(&self, passage: &QuasiStaticPassage) -> usize {
        self.frequency_hz.partition_point(|f| *f <= passage.speed_m_s / SEPARATION_WAVELENGTH_M)
    }

    /// Stacked real and imaginary residuals over all passages, scaled so that their square sum is the misfit ratio squared.
    fn residuals(&self, ballast: &BallastParameters, times: &mut [f64]) -> Vec<f64> {
        let models = self.models(ballast);
        let mut out = Vec::new();
        let mut power = 0.0;
        for ((passage, model), time) in self.passages.iter().zip(&models).zip(times.iter_mut()) {
            *time = self.refine_time(passage, model, *time);
            let lines = self.frequency_hz.iter().zip(&passage.measured).zip(model);
            for ((hz, measured), modelled) in lines.take(self.in_band(passage)) {
                let e = measured - modelled * unit(-std::f64::consts::TAU * hz * *time);
                out.extend([e.re, e.im]);
                power += measured.norm_sqr();
            }
        }
        let scale = 1.0 / power.sqrt().max(f64::MIN_POSITIVE);
        out.iter().map(|v| v * scale).collect()
    }
}

/// Neighbouring points that are summed side by side.
const LANES: usize = 8;

/// Values along the grid at one frequency, real and imaginary parts, [`LANES`] at a time; the last ones are filled up with zeros.
struct Line(Vec<[[f64; LANES]; 2]>);

impl Line {
    fn new(values: impl Iterator<Item = c64>) -> Self {
        let mut chunks: Vec<[[f64; LANES]; 2]> = Vec::new();
        for (i, value) in values.enumerate() {
            if i % LANES == 0 {
                chunks.push([[0.0; LANES]; 2]);
            }
            if let Some([re, im]) = chunks.last_mut() {
                (re[i % LANES], im[i % LANES]) = (value.re, value.im);
            }
        }
        Self(chunks)
    }

    /// Σ value of point i · e^{i·phase·i}: the phasor advances by a constant factor from chunk to chunk.
    #[inline(always)]
    fn turned(&self, phase: f64) -> c64 {
        let (mut phasor, advance) = (c64::new(1.0, 0.0), unit(phase * LANES as f64));
        let [mut sum_re, mut sum_im] = [[0.0; LANES]; 2];
        for [re, im] in &self.0 {
            for lane in 0..LANES {
                sum_re[lane] += re[lane] * phasor.re - im[lane] * phasor.im;
                sum_im[lane] += re[lane] * phasor.im + im[lane] * phasor.re;
            }
            phasor *= advance;
        }
        (0..LANES).map(|lane| c64::new(sum_re[lane], sum_im[lane]) * unit(phase * lane as f64)).sum()
    }
}

fn unit(phase: f64) -> c64 {
    c64::new(phase.cos(), phase.sin())
}

/// Rate of the slow copy of the recording, Hz, and its band.
const SLOW_RATE_HZ: f64 = 200.0;
const SLOW_BAND_HZ: [f64; 2] = [60.0, 90.0];

fn prepare(
    recording: &Recording,
    speed: f64,
    force: f64,
    pattern: &AxlePattern,
    lines: &[f64],
) -> QuasiStaticPassage {
    let duration_s = recording.duration_s();
    let slow = recording.window(0.0, SLOW_RATE_HZ, (duration_s * SLOW_RATE_HZ) as usize, SLOW_BAND_HZ);
    let measured = lines
        .iter()
        .map(|f| {
            let w = std::f64::consts::TAU * f;
            let (mut phasor, advance) = (c64::new(1.0, 0.0), unit(-w / SLOW_RATE_HZ));
            let mut sum = c64::new(0.0, 0.0);
            for a in &slow {
                sum += phasor * *a;
                phasor *= advance;
            }
            sum * (-1.0 / (w * w) / SLOW_RATE_HZ)
        })
        .collect();
    let axles = lines
        .iter()
        .map(|f| {
            pattern
                .offset_m
                .iter()
                .fold(c64::new(0.0, 0.0), |acc, o| acc + unit(-std::f64::consts::TAU * f * o / speed))
        })
        .collect();
    QuasiStaticPassage {
        speed_m_s: speed,
        static_force_n: force,
        search_s: search_s(recording, speed, pattern),
        quiet_m2_s2: 0.5 * recording.quiet_density_m2_s3() * recording.duration_s(),
        measured,
        pattern: axles,
    }
}

/// Where the first axle is looked for: the whole train with its approach lies inside the recording. The spacing of the lines repeats
/// the train every two seconds; where the recording is longer than that, the impacts on the crossing say which one it is.
fn search_s(recording: &Recording, speed_m_s: f64, pattern: &AxlePattern) -> [f64; 2] {
    let approach_s = APPROACH_M / speed_m_s;
    let inside = [approach_s, recording.duration_s() - pattern.length_m() / speed_m_s - approach_s];
    let repeats_s = 1.0 / LINE_HZ;
    if inside[1] - inside[0] < repeats_s {
        return inside;
    }
    let about = [(1.0 - ABOUT) * speed_m_s, (1.0 + ABOUT) * speed_m_s];
    match comb(recording, pattern, about) {
        Some((_, hit_s)) => {
            [(hit_s - 0.5 * repeats_s).max(inside[0]), (hit_s + 0.5 * repeats_s).min(inside[1])]
        }
        None => inside,
    }
}

/// The optimiser works on (ln p1, ln p2, p3), which keeps the stiffnesses positive.
fn to_scaled(p: &BallastParameters) -> Vector3<f64> {
    Vector3::from(p.stiffness_vector())
}

fn from_scaled(z: &Vector3<f64>) -> BallastParameters {
    BallastParameters::from_stiffness_vector([z[0], z[1], z[2]])
}

struct Problem<'p, 'a> {
    model: &'p QuasiStatic<'a>,
    times: Vec<f64>,
    scaled: Vector3<f64>,
    evaluations: usize,
}

impl LeastSquaresProblem<f64, Dyn, nalgebra::U3> for Problem<'_, '_> {
    type ParameterStorage = Owned<f64, nalgebra::U3>;
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, nalgebra::U3>;

    fn set_params(&mut self, x: &Vector3<f64>) {
        self.scaled = *x;
        self.evaluations += 1;
    }

    fn params(&self) -> Vector3<f64> {
        self.scaled
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        let mut times = self.times.clone();
        Some(DVector::from_vec(self.model.residuals(&from_scaled(&self.scaled), &mut times)))
    }

    fn jacobian(&self) -> Option<nalgebra::OMatrix<f64, Dyn, nalgebra::U3>> {
        let columns = self.model.slopes(&from_scaled(&self.scaled), &self.times).map(|(column, k)| {
            let inside = from_scaled(&self.scaled).to_vector()[k] == self.scaled[k];
            // Beyond its bound a parameter does nothing.
            DVector::from_vec(column) * if inside { 1.0 } else { 0.0 }
        });
        let matrix = DMatrix::from_columns(&columns);
        Some(matrix.fixed_columns::<3>(0).into_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::track::Mesh;
    use crate::verification::reference::{STIFF, panel};

    /// A passage measured on another ballast, with something that the model does not know.
    fn passage(model: &QuasiStatic, speed_m_s: f64, time_s: f64) -> QuasiStaticPassage {
        let offsets = [0.0, 2.9];
        let axles = |f: f64| {
            offsets
                .iter()
                .fold(c64::new(0.0, 0.0), |sum, o| sum + unit(-std::f64::consts::TAU * f * o / speed_m_s))
        };
        let mut out = QuasiStaticPassage {
            speed_m_s,
            static_force_n: 76e3,
            search_s: [APPROACH_M / speed_m_s, 1.5 - (2.9 + APPROACH_M) / speed_m_s],
            measured: vec![c64::new(0.0, 0.0); model.frequency_hz.len()],
            quiet_m2_s2: 0.0,
            pattern: model.frequency_hz.iter().map(|f| axles(*f)).collect(),
        };
        let truth = BallastParameters::stiffness([34e6, 15e6, 0.45]);
        let alone = QuasiStatic {
            passages: vec![out.clone()],
            frequency_hz: model.frequency_hz.clone(),
            grid: model.grid.clone(),
            ..*model
        };
        let spectra = alone.models(&truth);
        let place = |f: f64| unit(-std::f64::consts::TAU * f * time_s);
        out.measured = model
            .frequency_hz
            .iter()
            .zip(&spectra[0])
            .map(|(f, v)| v * place(*f) * (1.0 + 0.05 * (0.7 * f).sin()))
            .collect();
        out
    }

    /// Gradient of eq. 2 with the axle times free, against central differences.
    #[test]
    fn property_gradient_of_the_quasi_static_misfit() {
        let track = panel(STIFF, Mesh::default());
        let frequency_hz: Vec<f64> = (4..=38).map(|k| 0.5 * f64::from(k)).collect();
        let grid = track.rail_grid(STEP_M);
        let mut model =
            QuasiStatic { track: &track, direction: 1.0, frequency_hz, grid, passages: Vec::new() };
        model.passages = vec![passage(&model, 44.0, 0.6), passage(&model, 38.0, 0.7)];
        let at = BallastParameters::stiffness([28e6, 20e6, 0.4]);
        let times = model.align(&at);
        let columns = model.slopes(&at, &times);
        for (k, (column, parameter)) in columns.iter().enumerate() {
            assert_eq!(k, *parameter);
            let step = 1e-3;
            let moved = |sign: f64| model.residuals(&at.moved(k, sign * step), &mut times.clone());
            let (above, below) = (moved(1.0), moved(-1.0));
            let largest = column.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
            for ((a, b), found) in above.iter().zip(&below).zip(column) {
                let difference = (a - b) / (2.0 * step);
                assert!((difference - found).abs() < 1e-4 * largest, "parameter {k}: {difference} {found}");
            }
        }
    }
}
