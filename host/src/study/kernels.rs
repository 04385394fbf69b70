//! Green's functions of the six panels (paper, section 4.1, fig. 11 and 12).

use super::panels::{self, Panel};
use crate::greens::{Chain, GreensFunctions, GreensSampling, Quantity};
use crate::track::{Mesh, Side, Track};
use crate::verification::Table;

/// Sampling of the paper; band-limited so high that a figure does not show it.
const SAMPLING: GreensSampling = GreensSampling { rate_hz: 5000.0, len: 4096, band_hz: [1200.0, 1500.0] };
/// Distances of the force from the sensor in the figure of a panel, metres: sleepers and the middle of bays.
pub const OFFSETS_M: [f64; 7] = [0.0, 0.3, 0.6, 0.9, 1.2, 1.5, 1.8];
/// Samples kept: 0.1 s.
const KEPT: usize = 500;

/// Green's functions of one panel.
pub struct PanelGreens {
    /// Which.
    pub panel: Panel,
    /// Time, seconds.
    pub time_s: Vec<f64>,
    /// Per rail node of the crossing side: distance from the sensor, metres, and response, m/(N s).
    pub nodes: Vec<(f64, Vec<f64>)>,
    /// The same between nodes, at [`OFFSETS_M`] behind the sensor.
    pub interpolated: Vec<(f64, Vec<f64>)>,
}

fn largest(values: &[f64]) -> f64 {
    values.iter().copied().fold(0.0, f64::max)
}

impl PanelGreens {
    fn new(panel: &Panel) -> Self {
        let track = Track::of_crossing(&panel.crossing(37), Mesh::default());
        let ballast = panel.ballast.bed(&track);
        let greens =
            GreensFunctions::new(&track, &ballast, SAMPLING, Quantity::Displacement, &Chain::Corrected);
        let sensor = track.sleeper_x_m[track.sensor_sleeper];
        let at = |x: f64| {
            let mut response = vec![0.0; SAMPLING.len];
            greens.at(Side::Crossing, x, &mut response);
            response.truncate(KEPT);
            (x - sensor, response)
        };
        Self {
            time_s: (0..KEPT).map(|k| k as f64 / SAMPLING.rate_hz).collect(),
            nodes: track.node_x_m.iter().map(|x| at(*x)).collect(),
            interpolated: OFFSETS_M.iter().map(|o| at(sensor + o)).collect(),
            panel: panel.clone(),
        }
    }

    /// Largest response to an impulse over the sensor, m/(N s).
    pub fn over_sensor(&self) -> f64 {
        self.nodes.iter().map(|n| largest(&n.1)).fold(0.0, f64::max)
    }

    /// Largest response to an impulse so many bays away, as a part of [`Self::over_sensor`]; mean of both directions.
    pub fn at_bays(&self, bays: f64) -> f64 {
        let near = |d: &f64| (d.abs() - 0.6 * bays).abs() < 1e-6;
        let found: Vec<f64> = self.nodes.iter().filter(|n| near(&n.0)).map(|n| largest(&n.1)).collect();
        found.iter().sum::<f64>() / found.len().max(1) as f64 / self.over_sensor()
    }
}

/// All six panels.
pub fn run() -> Vec<PanelGreens> {
    panels::all().iter().map(PanelGreens::new).collect()
}

/// How near-sighted the sensor is.
pub fn table(panels: &[PanelGreens]) -> Table {
    let mut table = Table::new(
        "Green's functions (section 4.1, fig. 11\u{2013}12)",
        "Largest response of the sensor to an impulse on the rail over it, and that to impulses 1 to 3 sleeper bays away as a part of it. \
         The paper: about 20 % at three bays; smallest at Ho 21B, largest at Vad 131.",
        &["panel", "over the sensor, nm/(N s)", "1 bay", "2 bays", "3 bays", "rail nodes"],
    );
    for p in panels {
        let share = |bays: f64| format!("{:.0} %", 100.0 * p.at_bays(bays));
        table.row(&[
            p.panel.name.into(),
            format!("{:.0}", 1e9 * p.over_sensor()),
            share(1.0),
            share(2.0),
            share(3.0),
            p.nodes.len().to_string(),
        ]);
    }
    table
}
