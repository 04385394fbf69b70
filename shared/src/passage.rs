//! The recording of one passage: a fixed buffer with pre-trigger.

use crate::decimate::DECIMATION;

/// Decimated samples a recording can hold: 12 s at 1 kHz, 48 kB.
pub const CAPACITY: usize = 12_000;
/// Decimated samples kept from before the moment of detection. Detection takes up to 0.13 s, and 0.4 s before the
/// first wheel are wanted, at low speed too, where its effect begins earlier.
pub const PRE_TRIGGER: usize = 800;

/// What is known of a recording besides its samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Passage {
    /// Advances by one for every passage detected, recorded or not.
    pub sequence: u32,
    /// Number of the raw sample, counted from start-up, at whose time the first decimated sample stands.
    pub first_sample: u64,
    /// Raw samples from there to the end of the passage, also when the buffer could not hold them.
    pub samples: u32,
    /// Largest |acceleration| of the raw samples, m/s², from the quiet level (gravity is taken off).
    pub max_acceleration_m_s2: f32,
    /// The flags of [`crate::record::flag`] that are known from sampling.
    pub flags: u16,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// The first [`PRE_TRIGGER`] samples are a ring; the number is where the next one goes.
    Waiting(usize),
    Recording,
    Complete,
}

/// Samples of one passage, at [`crate::decimate::RATE_HZ`].
///
/// It waits with the latest [`PRE_TRIGGER`] samples, records from [`begin`](Self::begin) on, and after
/// [`finish`](Self::finish) keeps what it has until [`clear`](Self::clear).
#[derive(Debug)]
pub struct Buffer {
    samples: [f32; CAPACITY],
    len: usize,
    state: State,
    /// Raw number of the first sample; valid once recording.
    first_sample: u64,
    truncated: bool,
}

impl Default for Buffer {
    fn default() -> Self {
        Self::new()
    }
}

impl Buffer {
    /// An empty buffer that waits.
    pub const fn new() -> Self {
        Self { samples: [0.0; CAPACITY], len: 0, state: State::Waiting(0), first_sample: 0, truncated: false }
    }

    /// Forgets everything and waits for the next passage.
    pub fn clear(&mut self) {
        self.len = 0;
        self.state = State::Waiting(0);
        self.truncated = false;
    }

    /// The recording so far, oldest first; empty while waiting.
    pub fn samples(&self) -> &[f32] {
        match self.state {
            State::Waiting(_) => &[],
            State::Recording | State::Complete => self.samples.get(..self.len).unwrap_or(&[]),
        }
    }

    /// Whether a passage has been recorded and not been cleared yet.
    pub fn is_complete(&self) -> bool {
        self.state == State::Complete
    }

    /// Whether a passage is being recorded.
    pub fn is_recording(&self) -> bool {
        self.state == State::Recording
    }

    /// Whether the passage went on after the buffer was full.
    pub fn is_truncated(&self) -> bool {
        self.truncated
    }

    /// Number of the raw sample at the time of the first one recorded.
    pub fn first_sample(&self) -> u64 {
        self.first_sample
    }

    /// Takes the next sample, m/s².
    pub fn push(&mut self, x: f32) {
        match self.state {
            State::Waiting(next) => {
                if let Some(slot) = self.samples.get_mut(next) {
                    *slot = x;
                }
                self.len = (self.len + 1).min(PRE_TRIGGER);
                self.state = State::Waiting((next + 1) % PRE_TRIGGER);
            }
            State::Recording => match self.samples.get_mut(self.len) {
                Some(slot) => {
                    *slot = x;
                    self.len += 1;
                }
                None => self.truncated = true,
            },
            State::Complete => {}
        }
    }

    /// Turns the waiting samples into the beginning of a recording; `newest_raw` is the raw number of the latest.
    pub fn begin(&mut self, newest_raw: u64) {
        let State::Waiting(next) = self.state else { return };
        if let (true, Some(ring)) = (self.len == PRE_TRIGGER, self.samples.get_mut(..PRE_TRIGGER)) {
            ring.rotate_left(next.min(PRE_TRIGGER));
        }
        let older = self.len.saturating_sub(1) * DECIMATION;
        self.first_sample = newest_raw.saturating_sub(older as u64);
        self.state = State::Recording;
    }

    /// Ends the recording.
    pub fn finish(&mut self) {
        if self.state == State::Recording {
            self.state = State::Complete;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_pre_trigger_is_in_order() {
        for before in [10, PRE_TRIGGER, PRE_TRIGGER + 1, 3 * PRE_TRIGGER + 17] {
            let mut buffer = Buffer::new();
            (0..before).for_each(|k| buffer.push(k as f32));
            assert!(buffer.samples().is_empty());
            buffer.begin(4 * (before as u64 - 1) + 3);
            (before..before + 100).for_each(|k| buffer.push(k as f32));
            let first = before.saturating_sub(PRE_TRIGGER);
            assert!(buffer.samples().iter().zip(first..).all(|(&x, k)| x == k as f32), "{before}");
            assert_eq!(buffer.samples().len(), before - first + 100);
            assert_eq!(buffer.first_sample(), 4 * first as u64 + 3);
        }
    }

    #[test]
    fn property_overflow_is_flagged_and_keeps_the_beginning() {
        let mut buffer = Buffer::new();
        buffer.begin(0);
        (0..CAPACITY).for_each(|k| buffer.push(k as f32));
        assert!(!buffer.is_truncated());
        buffer.push(-1.0);
        assert!(buffer.is_truncated());
        buffer.finish();
        assert_eq!(buffer.samples().len(), CAPACITY);
        assert_eq!(buffer.samples().last(), Some(&((CAPACITY - 1) as f32)));
        buffer.push(5.0);
        assert!(buffer.is_complete());
        buffer.clear();
        assert!(buffer.samples().is_empty() && !buffer.is_truncated());
    }
}
