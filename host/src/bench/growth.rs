//! How CPU time grows: passages of a site, sleepers of a track, speeds of a crossing, each doubled in turn.

use std::path::Path;

use rustix::time::{ClockId, clock_gettime};
use serde_json::{Value, json};

use super::job::JobError;
use crate::greens::moving::{WheelPath, kernel};
use crate::greens::{Chain, GreensFunctions, GreensSampling, Quantity};
use crate::pipeline::{AnalyseOptions, analyse};
use crate::progress::{Progress, Silent};
use crate::recording::read_site;
use crate::track::{Mesh, Side};
use crate::verification::reference::{STIFF, ballast, panel_of_length};

/// A measured curve.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// For file names.
    pub name: &'static str,
    /// What was done.
    pub what: &'static str,
    /// What was doubled.
    pub of: &'static str,
    /// Number of them and CPU time, s.
    pub points: Vec<(f64, f64)>,
}

impl Curve {
    /// Exponent of the growth between the first and the last point: 1 is proportional.
    pub fn exponent(&self) -> f64 {
        match (self.points.first(), self.points.last()) {
            (Some(first), Some(last)) => (last.1 / first.1).ln() / (last.0 / first.0).ln(),
            _ => f64::NAN,
        }
    }

    /// For `--json`.
    pub fn json(&self) -> Value {
        json!({ "name": self.name, "what": self.what, "of": self.of, "points": self.points, "exponent": self.exponent() })
    }
}

/// Runs per point; the shortest counts, other load only adds.
const RUNS: usize = 3;

/// CPU time of all threads of this process, s.
fn cpu_s() -> f64 {
    let now = clock_gettime(ClockId::ProcessCPUTime);
    now.tv_sec as f64 + 1e-9 * now.tv_nsec as f64
}

fn shortest(runs: usize, mut work: impl FnMut() -> Result<(), JobError>) -> Result<f64, JobError> {
    let mut least = f64::INFINITY;
    for _ in 0..runs {
        let begin = cpu_s();
        work()?;
        least = least.min(cpu_s() - begin);
    }
    Ok(least)
}

/// All curves.
pub fn measure(site: &Path, progress: &dyn Progress) -> Result<Vec<Curve>, JobError> {
    progress.begin("curves", 4);
    let mut curves = Vec::new();
    for curve in [passages(site)?, sleepers()?, simulation()?, speeds()?] {
        curves.push(curve);
        progress.step();
    }
    Ok(curves)
}

/// The whole analysis of a site.
fn passages(path: &Path) -> Result<Curve, JobError> {
    let site = read_site(path)?;
    let mut points = Vec::new();
    for count in [3, 6, 12, 24] {
        let mut part = site.clone();
        part.passages.truncate(count);
        let time = shortest(1, || {
            analyse(&part, &AnalyseOptions::default(), &Silent)?;
            Ok(())
        })?;
        points.push((part.passages.len() as f64, time));
    }
    Ok(Curve { name: "passages", what: "analysis of a site", of: "passages", points })
}

/// Sampling of the identification.
const SAMPLING: GreensSampling = GreensSampling { rate_hz: 1000.0, len: 512, band_hz: [260.0, 330.0] };

/// Receptances between sensor and all rail nodes at the frequencies of the identification.
fn sleepers() -> Result<Curve, JobError> {
    let frequencies = SAMPLING.frequencies_hz();
    let mut points = Vec::new();
    for count in [15, 31, 61, 121, 241] {
        let track = panel_of_length(STIFF, Mesh::default(), count);
        let bed = ballast(&track);
        let time = shortest(RUNS, || {
            std::hint::black_box(track.sensor_receptance(&frequencies, &bed));
            Ok(())
        })?;
        points.push((count as f64, time));
    }
    Ok(Curve { name: "sleepers", what: "receptances at 169 frequencies", of: "sleepers", points })
}

/// Time steps of the passage simulation without a train.
fn simulation() -> Result<Curve, JobError> {
    use crate::passage::{SLEEPER_MODES, Stepper, Support, TimeStep, TrackModel};
    let mut points = Vec::new();
    for count in [15, 31, 61, 121, 241] {
        let track = panel_of_length(STIFF, Mesh::default(), count);
        let model = TrackModel::new(&track, vec![Support::linear(30e6, 125e3); count], SLEEPER_MODES)?;
        let stepper = Stepper::new(model, TimeStep::default())?;
        let mut state = stepper.at_rest();
        let time = shortest(RUNS, || {
            for _ in 0..10_000 {
                stepper.begin(&mut state);
                stepper.finish(&mut state);
            }
            Ok(())
        })?;
        points.push((count as f64, time));
    }
    Ok(Curve { name: "simulation", what: "10 000 time steps of the track", of: "sleepers", points })
}

/// Kernels of one wheel for more and more speeds from the same Green's functions.
fn speeds() -> Result<Curve, JobError> {
    let track = panel_of_length(STIFF, Mesh::default(), 61);
    let greens = GreensFunctions::try_new(
        &track,
        &ballast(&track),
        SAMPLING,
        Quantity::Acceleration,
        &Chain::Corrected,
    )?;
    let mut points = Vec::new();
    for count in [8, 16, 32, 64, 128] {
        let time = shortest(RUNS, || {
            for k in 0..count {
                let speed_m_s = 30.0 + 20.0 * f64::from(k) / f64::from(count);
                let path = WheelPath { direction: 1.0, speed_m_s, time_at_origin_s: 0.25 };
                std::hint::black_box(kernel(&greens, Side::Crossing, &path, 4.0, 512));
            }
            Ok(())
        })?;
        points.push((f64::from(count), time));
    }
    Ok(Curve { name: "speeds", what: "kernels of one wheel", of: "speeds", points })
}

/// The curves as a Markdown table.
pub fn markdown(curves: &[Curve]) -> String {
    let row = |curve: &Curve| {
        let points: Vec<String> = curve.points.iter().map(|(n, t)| format!("{n:.0}: {t:.4}")).collect();
        vec![curve.what.into(), curve.of.into(), points.join(", "), format!("{:.2}", curve.exponent())]
    };
    let rows: Vec<Vec<String>> = curves.iter().map(row).collect();
    crate::report::markdown::rows(&["work", "doubled", "CPU s at each", "exponent"], &rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_exponent_of_a_square() {
        let points = vec![(2.0, 0.4), (4.0, 1.6), (8.0, 6.4)];
        let curve = Curve { name: "n", what: "w", of: "o", points };
        assert!((curve.exponent() - 2.0).abs() < 1e-12);
        assert!(markdown(&[curve]).contains("2: 0.4000, 4: 1.6000"));
    }
}
