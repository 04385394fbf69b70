//! What a user would write in numpy instead: the script of `bench/peers` on the same site, or its documented figures.

use std::path::Path;

use serde::Deserialize;

use crate::bench::child;
use crate::bench::peers::Peers;

/// Figures of the numpy baseline on one site, as parts of one.
#[derive(Clone, Debug, Deserialize, PartialEq)]
pub struct Baseline {
    /// |peak error|, median.
    pub peak_error: f64,
    /// 90th percentile.
    pub peak_p90: f64,
    /// RMS over peak to peak, median.
    pub waveform: f64,
    /// Mean irregularity against the scan, RMS over peak to peak.
    pub irregularity: f64,
    /// p1, p2 in MN/m², p3.
    pub ballast_mn_m2: [f64; 3],
    /// Run now, or from the table in `bench/peers/README.md`.
    #[serde(skip)]
    pub documented: bool,
}

const SCRIPT: &str = "site_job.py";
const MODULES: [&str; 3] = ["numpy", "scipy", "pyarrow"];

impl Baseline {
    /// Runs the script on a site directory, some 70 s of CPU time; on failure why, and what to install.
    pub fn run(site: &Path, python: &str) -> Result<Self, String> {
        let peers = Peers::unpack(python).map_err(|e| format!("cannot unpack the scripts: {e}"))?;
        if let Some(missing) = peers.missing(&MODULES) {
            return Err(missing);
        }
        let site = site.canonicalize().map_err(|e| format!("{}: {e}", site.display()))?;
        let usage = child::measure(&mut peers.command(SCRIPT, &[&site])).map_err(|e| e.to_string())?;
        serde_json::from_str(&usage.answer).map_err(|e| format!("{SCRIPT} answered {:?}: {e}", usage.answer))
    }

    /// Figures of `bench/peers/README.md` for the directories of `tests/data/field` that it names.
    pub fn documented(site: &str) -> Option<Self> {
        let figures = match site {
            "reference-1" => [0.0061, 0.015, 0.053, 0.071, 27.7, 17.7, 0.5],
            "reference-2" => [0.0067, 0.019, 0.038, f64::NAN, 31.0, 26.3, 0.6],
            "reference-3" => [0.0073, 0.016, 0.105, 0.073, 24.7, 12.4, 0.0],
            _ => return None,
        };
        let [peak_error, peak_p90, waveform, irregularity, ballast_mn_m2 @ ..] = figures;
        Some(Self { peak_error, peak_p90, waveform, irregularity, ballast_mn_m2, documented: true })
    }

    /// Name for the table.
    pub fn name(&self) -> &'static str {
        match self.documented {
            false => "numpy: evidence calibration, joint estimate (bench/peers/field_baseline.py), run now",
            true => "numpy: evidence calibration, joint estimate; not run, figures of bench/peers/README.md",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reference_documented_figures_and_answers_of_the_script() {
        assert_eq!(Baseline::documented("reference-2").map(|b| b.waveform), Some(0.038));
        assert_eq!(Baseline::documented("elsewhere"), None);
        let answer = r#"{"ballast_mn_m2": [27.7, 17.7, 0.5], "peak_error": 0.006, "peak_p90": 0.015,
                         "waveform": 0.02, "irregularity": 0.07}"#;
        let read: Baseline = serde_json::from_str(answer).unwrap();
        assert!(!read.documented && read.ballast_mn_m2[1] == 17.7);
        let absent = Baseline::run(Path::new("."), "no-such-python").unwrap_err();
        assert!(absent.contains("no-such-python"), "{absent}");
    }
}
