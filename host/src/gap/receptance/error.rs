//! Why there is no receptance, with what to do about it.

use super::{LEAST_COHERENCE, MOST_SPACING_HZ};
use crate::recording::RecordingError;

/// Why hits give no receptance.
#[derive(Debug, thiserror::Error)]
pub enum ReceptanceError {
    /// No file.
    #[error(transparent)]
    File(#[from] RecordingError),
    /// Not the expected table.
    #[error("{file}, line {line}: expected {header}")]
    Format {
        /// Which file.
        file: String,
        /// Line, from 1.
        line: usize,
        /// Columns of the table.
        header: &'static str,
    },
    /// Not a universal file that can be used.
    #[error("{file}, line {line}: {what}")]
    Universal {
        /// Which file.
        file: String,
        /// Line, from 1.
        line: usize,
        /// What is wrong.
        what: &'static str,
    },
    /// Coherence that is none.
    #[error("{file}, line {line}: a coherence of {coherence} is outside 0 … 1; is it in percent?")]
    Coherence {
        /// Which file.
        file: String,
        /// Line, from 1.
        line: usize,
        /// As it stands there.
        coherence: f64,
    },
    /// Which of them is meant is not said.
    #[error(
        "{file}: {functions} {what}; export one file with that between the hammer and the site's sensor, which is one"
    )]
    Several {
        /// Which file.
        file: String,
        /// What there are several of.
        what: &'static str,
        /// How many.
        functions: usize,
    },
    /// Hits of which a series is missing.
    #[error(
        "{file}: {forces} series of force and {responses} of acceleration; every hit needs one of each: export all of them again"
    )]
    Unpaired {
        /// Which file.
        file: String,
        /// Series of force.
        forces: usize,
        /// Series of acceleration.
        responses: usize,
    },
    /// Samples are missing or doubled.
    #[error(
        "{file}: sample {sample} comes {step_s:.2e} s after the one before, the others every {mean_s:.2e} s; export the hit as recorded"
    )]
    Uneven {
        /// Which file.
        file: String,
        /// Sample, from 1.
        sample: usize,
        /// Time since the one before, s.
        step_s: f64,
        /// Mean of all, s.
        mean_s: f64,
    },
    /// No files, or several of which one is an estimate already.
    #[error("{files} files; give all hits, one file each, or one file with the estimated receptance")]
    Files {
        /// Number of files.
        files: usize,
    },
    /// Too few hits.
    #[error("{hits} hit; coherence needs at least 2, better 5: it is 1 for one hit whatever was measured")]
    Hits {
        /// Number of hits.
        hits: usize,
    },
    /// Hits that differ in rate.
    #[error("hits at {first_hz} and {other_hz} Hz; all must have the same rate")]
    Rates {
        /// Rate of the first, Hz.
        first_hz: f64,
        /// Rate that differs, Hz.
        other_hz: f64,
    },
    /// The hammer has no energy there.
    #[error(
        "the hammer excites {low_hz} … {high_hz} Hz too little: down to {decibel:.0} dB of its strongest; use a softer or heavier tip"
    )]
    NotExcited {
        /// Asked band, Hz.
        low_hz: f64,
        /// Asked band, Hz.
        high_hz: f64,
        /// Weakest line over the strongest, dB.
        decibel: f64,
    },
    /// The band was not measured.
    #[error(
        "none of the {lines} lines lies between {low_hz} and {high_hz} Hz: they go from {first_hz} to {last_hz} Hz; is the frequency in kHz?"
    )]
    Outside {
        /// Asked band, Hz.
        low_hz: f64,
        /// Asked band, Hz.
        high_hz: f64,
        /// Number of lines.
        lines: usize,
        /// Lowest of them, Hz; 0 without lines.
        first_hz: f64,
        /// Highest of them, Hz; 0 without lines.
        last_hz: f64,
    },
    /// The band was measured in part.
    #[error(
        "no line between {from_hz} and {to_hz} Hz, and {low_hz} … {high_hz} Hz need one every {MOST_SPACING_HZ} Hz; record longer, or \
         export the whole band"
    )]
    Sparse {
        /// Asked band, Hz.
        low_hz: f64,
        /// Asked band, Hz.
        high_hz: f64,
        /// Where the gap begins, Hz.
        from_hz: f64,
        /// Where it ends, Hz.
        to_hz: f64,
    },
    /// Nothing was measured there.
    #[error(
        "the receptance is zero or no number on {share:.0} % of {low_hz} … {high_hz} Hz: look at the exported file, force in N and \
         acceleration in m/s²"
    )]
    Dead {
        /// Asked band, Hz.
        low_hz: f64,
        /// Asked band, Hz.
        high_hz: f64,
        /// Part of the lines, %.
        share: f64,
    },
    /// The hits do not agree.
    #[error(
        "coherence is below {LEAST_COHERENCE} on {share:.0} % of {low_hz} … {high_hz} Hz (lowest {lowest:.2}); hit again, at one point, without double hits"
    )]
    Incoherent {
        /// Asked band, Hz.
        low_hz: f64,
        /// Asked band, Hz.
        high_hz: f64,
        /// Part of the lines, %.
        share: f64,
        /// Lowest coherence.
        lowest: f64,
    },
}
