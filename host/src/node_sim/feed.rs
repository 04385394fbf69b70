//! The recordings of a site as the sensor would have sampled them, one after another.

use cpcm_shared::sample::{RAW_RATE_HZ, SensorCode};

use crate::recording::{Passage, Site};

/// Quiet time before and after each train, seconds. A passage ends 1.5 s after the last vibration, and 0.8 s of quiet
/// are kept from before the first.
pub const QUIET_S: f64 = 2.5;
/// The beginning of a recording that is surely before the train, seconds.
const HEAD_S: f64 = 0.25;

/// A site that cannot be fed to a node.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum FeedError {
    /// The recording has another rate than the node's sensor.
    #[error("passage {passage_id} is sampled at {rate_hz} Hz; the node's sensor takes {RAW_RATE_HZ} Hz")]
    SampleRate {
        /// Which passage.
        passage_id: i32,
        /// Its rate, Hz.
        rate_hz: f64,
    },
    /// The recording is too short.
    #[error("passage {passage_id} has {samples} samples; at least {least} are needed")]
    TooShort {
        /// Which passage.
        passage_id: i32,
        /// Its length.
        samples: usize,
        /// Shortest length.
        least: usize,
    },
    /// The site has no usable passage.
    #[error("the site has no usable passage")]
    Empty,
    /// Nothing went wrong with one passage, but all together are too long for the simulated board.
    #[error("{samples} samples do not fit in the simulated board, which takes {max}")]
    TooLong {
        /// In all.
        samples: usize,
        /// Most.
        max: usize,
    },
}

/// All passages in site order. Before and after each train its own quiet beginning is repeated, forwards and backwards in
/// turn so that it has no steps.
pub fn codes_of_site(site: &Site) -> Result<Vec<SensorCode>, FeedError> {
    if site.passages.is_empty() {
        return Err(FeedError::Empty);
    }
    let mut codes = Vec::new();
    for passage in &site.passages {
        check(passage)?;
        let head = &passage.acceleration_m_s2[..samples(HEAD_S)];
        let quiet = head.iter().chain(head.iter().rev()).cycle().take(samples(QUIET_S));
        let whole = quiet.clone().chain(&passage.acceleration_m_s2).chain(quiet);
        codes.extend(whole.map(|&a| SensorCode::from_m_s2(f64::from(a))));
    }
    Ok(codes)
}

fn samples(seconds: f64) -> usize {
    (seconds * f64::from(RAW_RATE_HZ)) as usize
}

fn check(passage: &Passage) -> Result<(), FeedError> {
    let (passage_id, rate_hz) = (passage.passage_id, passage.sample_rate_hz);
    // A clock that is off by less than this is an effect to be found, not a wrong file.
    if (rate_hz / f64::from(RAW_RATE_HZ) - 1.0).abs() > 1e-3 {
        return Err(FeedError::SampleRate { passage_id, rate_hz });
    }
    let (samples, least) = (passage.acceleration_m_s2.len(), samples(HEAD_S));
    if samples < least { Err(FeedError::TooShort { passage_id, samples, least }) } else { Ok(()) }
}
