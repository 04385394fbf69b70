//! What including the effects of a diagnosis changes in the results that matter: force peaks, irregularity, ballast.

use super::corrected::{CorrectionError, Purpose, corrected};
use super::diagnosis::Diagnosis;
use super::included::Included;
use crate::analysis::Analysis;
use crate::pipeline::{AnalyseOptions, PipelineError, analyse};
use crate::progress::Progress;
use crate::recording::Site;

/// A result without and with the effects.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Change {
    /// As `analyse` finds it.
    pub without: f64,
    /// As `analyse --with-effects` finds it.
    pub with: f64,
}

/// Changes of the results of a site.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Consequences {
    /// Mean force peak over all wheelsets, newtons.
    pub peak_force_n: Change,
    /// Mean RMS of the irregularity, metres.
    pub irregularity_rms_m: Change,
    /// Outer ballast stiffness, N/m².
    pub ballast_p1_n_m2: Change,
    /// Ballast stiffness under the crossing, N/m².
    pub ballast_p2_n_m2: Change,
}

impl Consequences {
    /// Captions with units, and values in those units.
    pub fn rows(&self) -> [(&'static str, Change); 4] {
        let scaled = |c: Change, by: f64| Change { without: by * c.without, with: by * c.with };
        [
            ("force peak, kN", scaled(self.peak_force_n, 1e-3)),
            ("irregularity, \u{b5}m RMS", scaled(self.irregularity_rms_m, 1e6)),
            ("ballast outside, MN/m\u{b2}", scaled(self.ballast_p1_n_m2, 1e-6)),
            ("ballast under the crossing, MN/m\u{b2}", scaled(self.ballast_p2_n_m2, 1e-6)),
        ]
    }
}

/// Why the consequences of a diagnosis cannot be told.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum ConsequenceError {
    #[error(transparent)]
    Correction(#[from] CorrectionError),
    #[error(transparent)]
    Analysis(#[from] PipelineError),
}

/// Analyses the site without and with the effects that `found` names.
pub fn consequences(
    site: &Site,
    found: &Diagnosis,
    progress: &dyn Progress,
) -> Result<Consequences, ConsequenceError> {
    let effects: Vec<Included> = found
        .effects
        .iter()
        .map(|e| Included {
            name: e.name.into(),
            parameters: e.parameters.iter().map(|(n, v, ..)| ((*n).to_string(), *v)).collect(),
        })
        .collect();
    let other = corrected(site, &effects, Purpose::Analysis, progress)?;
    let without = analyse(site, &AnalyseOptions::default(), progress)?;
    let with = analyse(&other, &AnalyseOptions::default(), progress)?;
    let change = |f: &dyn Fn(&Analysis) -> f64| Change { without: f(&without), with: f(&with) };
    Ok(Consequences {
        peak_force_n: change(&|a| a.indicators.peak_force_n.mean),
        irregularity_rms_m: change(&|a| a.indicators.irregularity_rms_m.mean),
        ballast_p1_n_m2: change(&|a| a.ballast.p1_n_m2.value),
        ballast_p2_n_m2: change(&|a| a.ballast.p2_n_m2.value),
    })
}
