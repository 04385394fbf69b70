//! Which train passed, how fast, and when.
//!
//! The speed comes from the whole axle pattern: every axle makes nearly the same signal, so at the right speed the
//! signals seen through the pattern agree. [`coarse`] scans all speeds with the autocorrelation at 125 Hz,
//! [`axles`] finds the axles one by one without knowing the pattern and compares them with it, [`fine`] stacks the
//! axles in the full band and refines the speed. [`align`] then matches the windows that the package expects.

pub mod align;
pub mod axles;
pub mod coarse;
pub mod fine;

use crate::pace::Pace;

/// Slowest train looked for, m/s. (The method itself is weak below 40 km/h and the record says so.)
pub const SLOWEST_M_S: f32 = 10.0;
/// Fastest train looked for, m/s.
pub const FASTEST_M_S: f32 = 75.0;
/// Decimated samples at the start of every recording that are surely before the train: the pre-trigger of 0.8 s,
/// less the time that detection takes and the time the track moves before a wheel arrives.
pub const QUIET_SAMPLES: usize = 300;

/// Largest scatter of the axles around the pattern of the train, m, rms.
/// Real trains of the pattern stay below 0.05, with out-of-round or hollow wheels below 0.12; a bogie centre
/// distance that is 0.5 m different gives 0.22 and more, an axle distance that is 0.3 m different 0.12 to 0.19.
pub const MAX_SCATTER_M: f32 = 0.12;
/// Least agreement of the signal with the pattern (see [`TrainMatch::coherence`]).
/// Real trains of the pattern reach 0.69 and more, most other patterns 0.25 to 0.5; the rest shows in the axles.
pub const MIN_COHERENCE: f32 = 0.6;

/// How a passage compares with an axle pattern.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainMatch {
    /// Speed that fits best, m/s.
    pub speed_m_s: f32,
    /// Time of the first axle after the first sample, s; as good as the largest impact is near x = 0.
    pub first_axle_s: f32,
    /// Energy of the pattern's comb relative to that of identical axles: about 1 when the train has this pattern
    /// and equal wheels.
    pub coherence: f32,
    /// Axles found without use of the pattern.
    pub axles_found: u16,
    /// Axles of the pattern where none was found.
    pub missing: u16,
    /// Axles found where the pattern has none.
    pub extra: u16,
    /// Scatter of the axles found around the pattern, m, rms.
    pub scatter_m: f32,
}

impl TrainMatch {
    /// Whether this is a train of the pattern, which has `axles`.
    ///
    /// One axle in eight may be in doubt (a flat can hit twice); trains differ by a bogie at least.
    pub fn is_expected(&self, axles: usize) -> bool {
        usize::from(self.missing) + usize::from(self.extra) <= axles / 8
            && self.scatter_m <= MAX_SCATTER_M
            && self.coherence >= MIN_COHERENCE
    }
}

/// Mean and rms of the quiet part of a recording, m/s².
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Quiet {
    /// Bias of the sensor.
    pub mean: f32,
    /// Noise around it.
    pub rms: f32,
}

impl Quiet {
    /// From samples without train.
    pub fn of(samples: &[f32]) -> Self {
        if samples.is_empty() {
            return Self::default();
        }
        let n = samples.len() as f32;
        let mean = samples.iter().sum::<f32>() / n;
        let power = samples.iter().map(|x| (x - mean) * (x - mean)).sum::<f32>() / n;
        Self { mean, rms: libm::sqrtf(power) }
    }

    /// From the beginning of a recording.
    pub fn before_train(samples: &[f32]) -> Self {
        Self::of(samples.get(..QUIET_SAMPLES).unwrap_or(samples))
    }
}

/// Finds speed and time of a train with axles at `offsets_m` behind the first.
///
/// `work` is scratch space of at least [`coarse::WORK_LEN`]. `None` when there is nothing to compare: fewer than two
/// axles, or a recording shorter than the train at the fastest speed.
pub async fn find_train(
    samples: &[f32],
    offsets_m: &[f32],
    work: &mut [f32],
    pace: &mut Pace,
) -> Option<TrainMatch> {
    let quiet = Quiet::before_train(samples);
    let comb = coarse::scan(samples, quiet.mean, offsets_m, work, pace).await?;
    let signal = axles::Signal { samples, mean: quiet.mean };
    let first_axle_s = axles::first_axle(signal, offsets_m, comb.speed_m_s, pace).await?;
    let speed_m_s = fine::refine(signal, offsets_m, comb.speed_m_s, first_axle_s, pace).await;
    let found = axles::detect(signal, offsets_m, speed_m_s, first_axle_s, pace).await;
    let fit = axles::compare(&found, offsets_m, speed_m_s, first_axle_s);
    Some(TrainMatch {
        speed_m_s,
        first_axle_s,
        coherence: comb.coherence,
        axles_found: found.len() as u16,
        missing: fit.missing,
        extra: fit.extra,
        scatter_m: fit.scatter_m,
    })
}
