//! The assumptions of the paper's inverse (section 4.2, I–III; section 6.3), each broken on purpose: what that does to the
//! force.
//!
//! Once with one bogie whose displacement and ballast are known exactly, so that only the assumption counts; once with
//! recordings through the whole chain, the paper's and this program's.

use std::io::Write as _;

use super::StudyError;
use super::bogie::BogieTrack;
use super::panels::{self, Panel};
use super::simulation::{Known, nrmse};
use crate::passage::{Profile, RunningSurface, Wheel};
use crate::progress::Progress;
use crate::recording::Scan;
use crate::scenario::effects::{Factor, FrontRear, LoadTransfer, StockIrregularity, VoidedSleepers};
use crate::scenario::{Scenario, crossing_path, simulate};
use crate::scoring::{Score, score};
use crate::vehicle::static_wheel_force_n;
use crate::verification::{Table, site_analyses};

/// The panel: stiff pads, facing, healthy.
const PANEL: &str = "Sg 21A";
/// Passes of a site.
const PASSES: usize = 6;
/// Where the second defect lies: outside the transition region, in which forces are identified, metres.
const OUTSIDE_X_M: f64 = 2.2;
/// Length of the defects on the stock rail and outside, metres.
const DEFECT_M: f64 = 0.6;
/// The scan that carries the path and the second defect, metres.
const SCAN_M: [f64; 2] = [-1.2, 3.2];

/// One way to break an assumption.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Break {
    /// For the table.
    name: &'static str,
    /// I: front path this part deeper than the rear's.
    front_rear: f64,
    /// II: depth of a dip in the stock rail beside the nose, metres.
    stock_m: f64,
    /// III: depth of a dip outside the transition region, metres.
    outside_m: f64,
    /// Known load: true over assumed, minus 1.
    load: f64,
    /// Equal left and right: the crossing wheel carries this part more, the other as much less.
    side: f64,
    /// Linear track: gap under the crossing sleeper, half of it under its neighbours, metres.
    gap_m: f64,
}

fn breaks() -> [Break; 11] {
    let none = Break { name: "none broken", ..Break::default() };
    [
        none,
        Break { name: "I: front 20 % deeper than rear", front_rear: 0.2, ..none },
        Break { name: "I: front 50 % deeper than rear", front_rear: 0.5, ..none },
        Break { name: "II: dip of 0.3 mm in the stock rail", stock_m: 0.3e-3, ..none },
        Break { name: "II: dip of 1 mm in the stock rail", stock_m: 1e-3, ..none },
        Break { name: "III: dip of 0.3 mm at x = 2.2 m", outside_m: 0.3e-3, ..none },
        Break { name: "III: dip of 1 mm at x = 2.2 m", outside_m: 1e-3, ..none },
        Break { name: "known load: 5 % more", load: 0.05, ..none },
        Break { name: "left = right: 10 % to the crossing side", side: 0.1, ..none },
        Break { name: "linear track: gap of 0.2 mm", gap_m: 0.2e-3, ..none },
        Break { name: "linear track: gap of 0.5 mm", gap_m: 0.5e-3, ..none },
    ]
}

impl Break {
    fn voids(&self) -> Vec<(i64, f64)> {
        [(-1, 0.5), (0, 1.0), (1, 0.5)].map(|(o, share)| (o, share * self.gap_m)).to_vec()
    }

    /// Dip (1 − cos)/2 around a place.
    fn dip(depth_m: f64, at_m: f64) -> Result<Profile, StudyError> {
        let range = [at_m - 0.5 * DEFECT_M, at_m + 0.5 * DEFECT_M];
        let cosine = |x: f64| (std::f64::consts::TAU * (x - at_m) / DEFECT_M).cos();
        Ok(Profile::of(range, 0.005, |x| 0.5 * depth_m * (1.0 + cosine(x)))?)
    }

    fn path(&self, panel: &Panel) -> Result<Profile, StudyError> {
        let path = crossing_path(&panel.geometry, None)?;
        Ok(path.plus(&Self::dip(self.outside_m, OUTSIDE_X_M)?))
    }

    fn scenario(&self, panel: &Panel, scan: &std::path::Path) -> Scenario {
        let mut scenario = super::samples::scenario(panel, 7);
        let s = &mut scenario.simulation;
        s.passages = PASSES;
        s.effects.hollow_wheels = None;
        // The path of the unbroken cases is a scan too, so that nothing else changes.
        s.geometry.scan = Some(scan.to_owned());
        let x = scenario.crossing.track.crossing_sleeper_x_m;
        let e = &mut s.effects;
        e.front_rear = (self.front_rear != 0.0).then_some(FrontRear { depth_difference: self.front_rear });
        e.stock_irregularity = (self.stock_m != 0.0).then_some(StockIrregularity {
            depth_m: self.stock_m,
            at_x_m: x,
            length_m: DEFECT_M,
        });
        e.axle_load = (self.load != 0.0).then_some(Factor { factor: 1.0 + self.load });
        e.load_transfer =
            (self.side != 0.0).then_some(LoadTransfer { to_crossing_side: self.side, to_front: 0.0 });
        e.voided_sleepers = (self.gap_m != 0.0).then(|| VoidedSleepers::in_the_middle(self.gap_m));
        scenario
    }
}

/// Errors of one method with one bogie: front and rear wheel.
#[derive(Clone, Copy, Debug)]
struct BogieErrors {
    peak: [f64; 2],
    waveform: [f64; 2],
}

/// What one break does.
pub struct Broken {
    name: &'static str,
    /// Paper's rule and evidence on the exact displacement.
    bogie: [BogieErrors; 2],
    /// This program, the paper's chain, the chain in between, on recordings.
    scores: Vec<Score>,
}

fn bogie(panel: &Panel, broken: &Break) -> Result<[BogieErrors; 2], StudyError> {
    let crossing = panel.crossing(37);
    let v = &crossing.vehicle;
    let assumed_n = static_wheel_force_n(v.axle_load_kg, v.gravity_m_s2);
    let wheels: [Wheel; 4] = std::array::from_fn(|i| {
        let (front, right) = (if i < 2 { 0.5 } else { -0.5 }, if i % 2 == 0 { 1.0 } else { -1.0 });
        let mut wheel = Wheel::nominal(assumed_n * (1.0 + broken.load) * (1.0 + right * broken.side));
        wheel.depth_factor = 1.0 + front * broken.front_rear;
        wheel
    });
    let surface = RunningSurface {
        paths: vec![broken.path(panel)?],
        crossing_roughness: Profile::level(),
        stock: Break::dip(broken.stock_m, crossing.track.crossing_sleeper_x_m)?,
    };
    let voids = if broken.gap_m > 0.0 { broken.voids() } else { Vec::new() };
    let track = BogieTrack::with_voids(&crossing, &panel.ballast, &voids)?;
    let run = track.run_wheels(&surface, wheels, panel.speed_m_s())?;
    let known = Known::new(panel, &run)?;
    Ok(known.found_n.each_ref().map(|found| {
        let peak = |f: &[f64]| f.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        BogieErrors {
            peak: [0, 1].map(|w: usize| peak(found) / peak(&known.true_n[w]) - 1.0),
            waveform: [0, 1].map(|w: usize| nrmse(&known.true_n[w], found)),
        }
    }))
}

/// The path with the second defect as a scan file.
fn scan_file(panel: &Panel, broken: &Break) -> Result<tempfile::NamedTempFile, StudyError> {
    let path = broken.path(panel)?;
    let count = ((SCAN_M[1] - SCAN_M[0]) / 0.01).round() as usize + 1;
    let position_m: Vec<f64> = (0..count).map(|i| SCAN_M[0] + 0.01 * i as f64).collect();
    let scan = Scan { irregularity_m: position_m.iter().map(|x| path.at(*x)).collect(), position_m };
    let mut file = tempfile::Builder::new().suffix(".csv").tempfile()?;
    writeln!(file, "position_m,irregularity_m")?;
    for (x, z) in scan.position_m.iter().zip(&scan.irregularity_m) {
        writeln!(file, "{x:.4},{z}")?;
    }
    Ok(file)
}

fn recordings(panel: &Panel, broken: &Break, progress: &dyn Progress) -> Result<Vec<Score>, StudyError> {
    let scan = scan_file(panel, broken)?;
    let simulated = simulate(&broken.scenario(panel, scan.path()), progress)?;
    let found = site_analyses(&simulated.site, progress)?;
    Ok(found.methods.iter().map(|(_, a)| score(a, &simulated.truth)).collect())
}

/// All breaks.
pub fn run(progress: &dyn Progress) -> Result<Vec<Broken>, StudyError> {
    let panels = panels::all();
    let panel = panels.iter().find(|p| p.name == PANEL).ok_or(StudyError::Empty("list of panels"))?;
    breaks()
        .iter()
        .map(|b| {
            let scores = recordings(panel, b, progress)?;
            Ok(Broken { name: b.name, bogie: bogie(panel, b)?, scores })
        })
        .collect()
}

fn percent(v: f64) -> String {
    format!("{:.1} %", 100.0 * v)
}

fn signed(v: f64) -> String {
    format!("{:+.1} %", 100.0 * v).replace('-', "\u{2212}")
}

/// One bogie, displacement and ballast known.
pub fn bogie_table(all: &[Broken]) -> Table {
    let mut table = Table::new(
        "Assumptions of the inverse broken: one bogie, displacement and ballast known",
        "Panel Sg 21A. Eq. 12 by the paper's pseudo-inverse, and by evidence from both wheels' windows; both take one force for front \
         and rear wheel and a static one on the stock rail. Error of the peak of front and rear wheel, and waveform (RMS over peak to \
         peak) of the front wheel.",
        &[
            "broken",
            "paper's rule: front peak",
            "rear peak",
            "waveform",
            "evidence: front peak",
            "rear peak",
            "waveform",
        ],
    );
    for b in all {
        let mut row = vec![b.name.to_string()];
        for e in &b.bogie {
            row.extend([signed(e.peak[0]), signed(e.peak[1]), percent(e.waveform[0])]);
        }
        table.row(&row);
    }
    table
}

/// Recordings through the whole chain.
pub fn site_table(all: &[Broken]) -> Table {
    let mut table = Table::new(
        "Assumptions broken: recordings through the whole chain",
        "Six passes of three cars over Sg 21A, nothing known but recording and drawing. |peak| median and 90th percentile, waveform \
         median, over all wheels, each against its own true force. cpcm gives every wheel a force of its own, but expects a smooth stock rail, the stated load and linear ballast.",
        &[
            "broken",
            "paper's chain: peak",
            "p90",
            "waveform",
            "per wheelset, model below 3 Hz: peak",
            "p90",
            "waveform",
            "cpcm: peak",
            "p90",
            "waveform",
            "peaks inside 90 %",
        ],
    );
    for b in all {
        let mut row = vec![b.name.to_string()];
        for method in [1, 2, 0] {
            let Some(s) = b.scores.get(method) else { continue };
            row.extend(
                [Score::median(&s.peak), Score::p90(&s.peak), Score::median(&s.waveform)].map(percent),
            );
        }
        row.push(b.scores.first().map_or("-".into(), |s| format!("{:.0} %", 100.0 * s.peak_coverage)));
        table.row(&row);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn property_every_assumption_is_broken_alone() {
        let all = breaks();
        let sound = all[0];
        for b in &all[1..] {
            let broken = [b.front_rear, b.stock_m, b.outside_m, b.load, b.side, b.gap_m];
            assert_eq!(broken.iter().filter(|v| **v != 0.0).count(), 1, "{}", b.name);
            assert_ne!(*b, sound);
        }
        let dip = Break::dip(1e-3, OUTSIDE_X_M).unwrap();
        assert!((dip.at(OUTSIDE_X_M) - 1e-3).abs() < 1e-9 && dip.at(1.5) == 0.0, "outside the region only");
    }
}
