//! Wall time of samples.
//!
//! The node counts samples since start-up and nothing else. When the field tool sets the clock, host time and sample
//! count are bound together; the first and the latest binding since start-up give the drift of the sensor's clock
//! against the host's. The drift is kept in flash, with the number of start-ups and the time of the last setting,
//! so that it is known after a restart; times are not, because nothing tells how long the node was off.
//! Records carry sample counts only: the host turns them into times with the bindings it has seen.

use core::ops::Range;

use embedded_storage_async::nor_flash::NorFlash;
use serde::{Deserialize, Serialize};

use crate::sample::RAW_RATE_HZ;
use crate::slots::{Slots, VALUE};

const SAMPLE_PERIOD_US: i128 = 1_000_000 / RAW_RATE_HZ as i128;

/// Shortest span between two bindings that gives a drift, µs: an error of 10 ms in host time is then 17 ppm.
pub const SHORTEST_SPAN_US: u64 = 600_000_000;

/// Largest drift that is believed, parts per 10⁹ (1000 ppm): the clocks of sensor and host are far better, so beyond it
/// the host's was put right between two settings, as of a laptop that began in 1970.
const LARGEST_DRIFT_PPB: u32 = 1_000_000;

/// Host time and sample count at one moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Binding {
    /// Raw samples since start-up.
    pub sample: u64,
    /// Host time, µs since 1970-01-01 UTC.
    pub unix_us: u64,
}

/// What the node knows of time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct State {
    /// How often the node has started, this time included.
    pub boots: u32,
    /// Latest binding since start-up.
    pub binding: Option<Binding>,
    /// How much the sensor's clock is fast against the host's, parts per 10⁹; from this start-up or an earlier one.
    pub drift_ppb: Option<i32>,
    /// Host time of the last setting before this start-up, µs since 1970-01-01 UTC.
    pub set_before_us: Option<u64>,
}

/// What setting the clock has shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Set {
    /// The new binding.
    pub binding: Binding,
    /// How far the node's time was ahead of the host's, µs; `None` when it had none since start-up.
    pub ahead_us: Option<i64>,
    /// Time since the first binding after start-up, µs.
    pub span_us: u64,
    /// See [`State::drift_ppb`].
    pub drift_ppb: Option<i32>,
    /// Whether the drift is stored.
    pub stored: bool,
}

/// The clock and its place in flash.
#[derive(Clone, Debug)]
pub struct Clock {
    slots: Slots,
    first: Option<Binding>,
    state: State,
}

/// What is kept in flash.
#[derive(Default, Serialize, Deserialize)]
struct Kept {
    boots: u32,
    drift_ppb: Option<i32>,
    set_us: Option<u64>,
}

impl Clock {
    /// Knows nothing of the flash yet.
    pub const fn new(region: Range<u32>) -> Self {
        let state = State { boots: 0, binding: None, drift_ppb: None, set_before_us: None };
        Clock { slots: Slots::new(region), first: None, state }
    }

    /// Reads what was kept and counts this start-up. A flash that cannot be written costs the count, not the clock.
    pub async fn mount<F: NorFlash>(&mut self, flash: &mut F) -> Result<(), F::Error> {
        self.slots.mount(flash).await?;
        let kept =
            self.slots.value().and_then(|value| postcard::from_bytes::<Kept>(value).ok()).unwrap_or_default();
        self.state.boots = kept.boots.saturating_add(1);
        self.state.drift_ppb = kept.drift_ppb.filter(|drift| drift.unsigned_abs() <= LARGEST_DRIFT_PPB);
        self.state.set_before_us = kept.set_us;
        self.keep(flash).await;
        Ok(())
    }

    /// What is known.
    pub fn state(&self) -> State {
        self.state
    }

    /// Host time of a raw sample, µs since 1970-01-01 UTC, by the latest binding; `None` before one.
    pub fn unix_us(&self, sample: u64) -> Option<u64> {
        let binding = self.state.binding?;
        let elapsed = i128::from(sample) - i128::from(binding.sample);
        u64::try_from(i128::from(binding.unix_us) + elapsed * SAMPLE_PERIOD_US).ok()
    }

    /// Binds host time `unix_us` to raw sample `sample`.
    pub async fn set<F: NorFlash>(&mut self, flash: &mut F, sample: u64, unix_us: u64) -> Set {
        let binding = Binding { sample, unix_us };
        let before = self.unix_us(sample);
        // After a jump of the host's clock, what was bound before says nothing of the drift.
        let first = *self.first.filter(|first| !jumped(*first, binding)).get_or_insert(binding);
        self.first = Some(first);
        let span_us = unix_us.saturating_sub(first.unix_us);
        let drift = drift(first, binding);
        self.state.binding = Some(binding);
        self.state.drift_ppb = drift.or(self.state.drift_ppb);
        let stored = self.keep(flash).await;
        let ahead_us = before.map(|before| before.wrapping_sub(unix_us) as i64);
        Set { binding, ahead_us, span_us, drift_ppb: self.state.drift_ppb, stored }
    }

    async fn keep<F: NorFlash>(&mut self, flash: &mut F) -> bool {
        let set_us = self.state.binding.map(|binding| binding.unix_us).or(self.state.set_before_us);
        let kept = Kept { boots: self.state.boots, drift_ppb: self.state.drift_ppb, set_us };
        let mut value = [0xFF; VALUE];
        postcard::to_slice(&kept, &mut value).is_ok() && self.slots.store(flash, value).await.is_ok()
    }
}

/// Whether the host's clock was put right by more than the sensor's can drift and the host can be late, one second.
fn jumped(first: Binding, now: Binding) -> bool {
    let host = i128::from(now.unix_us) - i128::from(first.unix_us);
    let node = (i128::from(now.sample) - i128::from(first.sample)) * SAMPLE_PERIOD_US;
    (node - host).abs() > 1_000_000 + node.abs() / 1000
}

fn drift(first: Binding, now: Binding) -> Option<i32> {
    let host = i128::from(now.unix_us) - i128::from(first.unix_us);
    if host < i128::from(SHORTEST_SPAN_US) {
        return None;
    }
    let node = (i128::from(now.sample) - i128::from(first.sample)) * SAMPLE_PERIOD_US;
    let drift = i32::try_from((node - host) * 1_000_000_000 / host).ok()?;
    (drift.unsigned_abs() <= LARGEST_DRIFT_PPB).then_some(drift)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nor_mock::Nor;
    use embassy_futures::block_on;

    const START_US: u64 = 1_760_000_000_000_000;

    fn mounted(nor: &mut Nor) -> Clock {
        let mut clock = Clock::new(nor.whole());
        block_on(clock.mount(nor)).unwrap();
        clock
    }

    /// Worked by hand from postcard's rules.
    #[test]
    fn reference_bytes_of_what_is_kept() {
        let kept = Kept { boots: 300, drift_ppb: Some(-3), set_us: Some(128) };
        let expected: [u8; 7] = [0xAC, 2, 1, 5, 1, 0x80, 1];
        let mut bytes = [0; VALUE];
        assert_eq!(postcard::to_slice(&kept, &mut bytes).unwrap(), &expected);
    }

    #[test]
    fn analytic_drift_of_a_fast_sensor() {
        let mut nor = Nor::new(2);
        let mut clock = mounted(&mut nor);
        assert_eq!(clock.unix_us(5), None);
        let first = block_on(clock.set(&mut nor, 4000, START_US));
        assert_eq!((first.ahead_us, first.drift_ppb, first.span_us), (None, None, 0));
        assert_eq!(clock.unix_us(4000 + 8), Some(START_US + 2000));
        assert_eq!(clock.unix_us(0), Some(START_US - 1_000_000));
        // One hour later the node has taken 100 ppm more samples than an hour has: 0.36 s.
        let sample = 4000 + 3600 * 4000 + 1440;
        let second = block_on(clock.set(&mut nor, sample, START_US + 3_600_000_000));
        assert_eq!((second.ahead_us, second.drift_ppb), (Some(360_000), Some(100_000)));
        assert!(second.stored);
        assert_eq!(clock.unix_us(sample), Some(START_US + 3_600_000_000));
    }

    /// The clock of a laptop that began in 1970 and was put right gave a drift of −999 999 000 ppb, kept in flash.
    #[test]
    fn regress_a_host_clock_that_jumps_gives_no_drift() {
        let mut nor = Nor::new(2);
        let mut clock = mounted(&mut nor);
        block_on(clock.set(&mut nor, 0, 60_000_000));
        let jumped = block_on(clock.set(&mut nor, 240_000, START_US));
        assert_eq!((jumped.drift_ppb, mounted(&mut nor).state().drift_ppb), (None, None));
        // From the jump on it is learnt: 10 ppm in an hour.
        let later = block_on(clock.set(&mut nor, 240_000 + 14_400_144, START_US + 3_600_000_000));
        assert_eq!((later.drift_ppb, later.span_us), (Some(10_000), 3_600_000_000));
        // Least and most that is believed, over 1000 s.
        for (samples, drift_ppb) in [
            (4_004_000, Some(1_000_000)),
            (3_996_000, Some(-1_000_000)),
            (4_004_001, None),
            (3_995_999, None),
        ] {
            let mut nor = Nor::new(2);
            let mut clock = mounted(&mut nor);
            block_on(clock.set(&mut nor, 0, START_US));
            let set = block_on(clock.set(&mut nor, samples, START_US + 1_000_000_000));
            assert_eq!(set.drift_ppb, drift_ppb, "{samples}");
        }
    }

    #[test]
    fn property_drift_and_start_ups_survive_a_restart() {
        let mut nor = Nor::new(2);
        let mut clock = mounted(&mut nor);
        block_on(clock.set(&mut nor, 0, START_US));
        block_on(clock.set(&mut nor, 4_000_000, START_US + 1_000_010_000));
        let state = mounted(&mut nor).state();
        let set_before_us = Some(START_US + 1_000_010_000);
        assert_eq!(state, State { boots: 2, binding: None, drift_ppb: Some(-9_999), set_before_us });
    }

    #[test]
    fn property_wild_times_do_not_panic() {
        let mut nor = Nor::new(2);
        let mut clock = mounted(&mut nor);
        for (sample, unix_us) in [(u64::MAX, 0), (0, u64::MAX), (7, 7), (u64::MAX, u64::MAX), (0, 1)] {
            block_on(clock.set(&mut nor, sample, unix_us));
            clock.unix_us(0);
            clock.unix_us(u64::MAX);
        }
    }
}
