//! Placeholder so that the command line compiles until the pipeline is merged: every call fails.

use cpcm_shared::record::Record;

use crate::analysis::Analysis;
use crate::progress::Progress;
use crate::recording::truth::WheelTruth;
use crate::recording::{Crossing, Site};
use crate::verification::Verification;

/// Choices in the analysis.
#[derive(Clone, Debug, Default)]
pub struct AnalyseOptions {}

/// Why an analysis fails.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// No pipeline yet.
    #[error("the analysis is not part of this build")]
    Missing,
}

/// The whole method on one site.
pub fn analyse(
    _site: &Site,
    _options: &AnalyseOptions,
    _progress: &dyn Progress,
) -> Result<Analysis, PipelineError> {
    Err(PipelineError::Missing)
}

/// The kernel package for the node, encoded.
pub fn kernel(
    _site: &Site,
    _options: &AnalyseOptions,
    _progress: &dyn Progress,
) -> Result<Vec<u8>, PipelineError> {
    Err(PipelineError::Missing)
}

/// What a node with this package records of the passages of the site, one record per passage in site order.
pub fn simulate_node(
    _site: &Site,
    _package: &[u8],
    _progress: &dyn Progress,
) -> Result<Vec<Record>, PipelineError> {
    Err(PipelineError::Missing)
}

/// Largest true force of a wheel in the transition region, low-passed at 250 Hz as the identified one, newtons.
pub fn true_peak_n(_wheel: &WheelTruth, _crossing: &Crossing) -> f64 {
    f64::NAN
}

/// All checks of the model.
pub fn verify(_progress: &dyn Progress) -> Result<Verification, PipelineError> {
    Err(PipelineError::Missing)
}
