//! From sensor codes to recorded passages: decimate, detect, record, and count what is lost.

use crate::decimate::{DECIMATION, DELAY_SAMPLES, Decimator};
use crate::detect::{Change, Detection, Detector};
use crate::passage::{Buffer, PRE_TRIGGER, Passage};
use crate::record::flag;
use crate::sample::SensorCode;

/// Raw samples of a gap that are filled with the last value to keep the time base. A longer gap ends a passage.
pub const FILLED_GAP: u32 = 400;

/// What the sampler reports.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// A passage is complete in the buffer; it stays there until the buffer is cleared.
    Recorded(Passage),
    /// A passage went by while no buffer was free; only these numbers are left of it.
    Missed(Passage),
}

impl Event {
    /// Gives the passage up, because nobody will evaluate it: a recording makes room for the next train.
    pub fn give_up(&self, buffer: Option<&mut Buffer>) {
        if let (Event::Recorded(_), Some(buffer)) = (self, buffer) {
            buffer.clear();
        }
    }

    /// Whether the passage counts as lost, when its record is `stored` or not.
    pub const fn is_lost(&self, stored: bool) -> bool {
        !stored || matches!(self, Event::Missed(_))
    }
}

/// Takes the samples in, without ever waiting for anything.
#[derive(Debug)]
pub struct Sampler {
    detector: Detector,
    detection: Detection,
    decimator: Decimator,
    recent: Recent,
    last: SensorCode,
    raw_count: u64,
    sequence: u32,
    open: Option<Open>,
}

/// A passage that is going on.
#[derive(Clone, Copy, Debug)]
struct Open {
    recorded: bool,
    first_sample: u64,
    flags: u16,
    peak: Peak,
    /// Quiet level before the passage, m/s²: at its end the detector may have learnt another one.
    baseline_m_s2: f32,
}

/// Smallest and largest code and what went wrong.
#[derive(Clone, Copy, Debug)]
struct Peak {
    low: SensorCode,
    high: SensorCode,
    flags: u16,
}

impl Peak {
    /// Of no samples.
    const NONE: Self = Self { low: SensorCode::MAX, high: SensorCode::MIN, flags: 0 };

    fn add(&mut self, other: Peak) {
        self.low = self.low.min(other.low);
        self.high = self.high.max(other.high);
        self.flags |= other.flags;
    }

    /// Largest distance from an offset, m/s²; 0 of no samples.
    fn distance_m_s2(&self, offset_m_s2: f32) -> f32 {
        (self.high.to_m_s2() - offset_m_s2).max(offset_m_s2 - self.low.to_m_s2()).max(0.0)
    }
}

/// The same over the time before a trigger: two halves that take turns, so it looks back 0.4 to 0.8 s.
#[derive(Clone, Copy, Debug)]
struct Recent {
    older: Peak,
    newer: Peak,
    count: usize,
}

impl Recent {
    const HALF: usize = PRE_TRIGGER * DECIMATION / 2;

    fn add(&mut self, peak: Peak) {
        self.newer.add(peak);
        self.count += 1;
        if self.count >= Self::HALF {
            *self = Self { older: self.newer, newer: Peak::NONE, count: 0 };
        }
    }

    fn total(&self) -> Peak {
        let mut sum = self.older;
        sum.add(self.newer);
        sum
    }
}

impl Sampler {
    /// A sampler whose next passage gets the number `sequence`.
    pub const fn new(detector: Detector, sequence: u32) -> Self {
        Self {
            detector,
            detection: Detection::new(),
            decimator: Decimator::new(),
            recent: Recent { older: Peak::NONE, newer: Peak::NONE, count: 0 },
            last: SensorCode::new(0),
            raw_count: 0,
            sequence,
            open: None,
        }
    }

    /// Raw samples since start-up, the lost ones included.
    pub const fn raw_count(&self) -> u64 {
        self.raw_count
    }

    /// Number that the next passage will get.
    pub const fn next_sequence(&self) -> u32 {
        self.sequence
    }

    /// Whether a passage is going on.
    pub const fn in_passage(&self) -> bool {
        self.detection.in_passage()
    }

    /// Takes a burst of samples, as the FIFO holds them. `free` is the buffer, while no evaluation has it.
    ///
    /// A burst shorter than the hold time completes at most one passage.
    pub fn push_burst(&mut self, codes: &[SensorCode], mut free: Option<&mut Buffer>) -> Option<Event> {
        let mut event = None;
        for &code in codes {
            event = self.push(code, free.as_deref_mut()).or(event);
        }
        event
    }

    /// Takes one sample.
    pub fn push(&mut self, code: SensorCode, free: Option<&mut Buffer>) -> Option<Event> {
        self.last = code;
        let flags = if code.is_clipped() { flag::CLIPPED } else { 0 };
        self.watch(Peak { low: code, high: code, flags });
        self.advance(code, free)
    }

    /// Accounts for `n` samples that the sensor took and nobody read.
    pub fn lost(&mut self, n: u32, mut free: Option<&mut Buffer>) -> Option<Event> {
        self.watch(Peak { flags: flag::SAMPLES_LOST, ..Peak::NONE });
        let mut event = None;
        if n <= FILLED_GAP {
            for _ in 0..n {
                event = self.advance(self.last, free.as_deref_mut()).or(event);
            }
            return event;
        }
        event = self.stop(free.as_deref_mut());
        self.raw_count = self.raw_count.saturating_add(u64::from(n));
        // What was before the gap has no place in a uniform time base any more.
        self.decimator = Decimator::new();
        if let Some(buffer) = free.filter(|buffer| !buffer.is_complete()) {
            buffer.clear();
        }
        event
    }

    /// Ends a passage that is going on, as at the end of a recording.
    pub fn stop(&mut self, free: Option<&mut Buffer>) -> Option<Event> {
        let change = self.detector.stop(&mut self.detection);
        self.apply(change, free)
    }

    fn watch(&mut self, peak: Peak) {
        self.recent.add(peak);
        if let Some(open) = &mut self.open {
            open.peak.add(peak);
        }
    }

    fn advance(&mut self, code: SensorCode, mut free: Option<&mut Buffer>) -> Option<Event> {
        self.raw_count = self.raw_count.saturating_add(1);
        let x = self.decimator.push(code)?;
        if let Some(buffer) = free.as_deref_mut() {
            buffer.push(x);
        }
        let change = self.detector.process(&mut self.detection, x);
        self.apply(change, free)
    }

    fn apply(&mut self, change: Change, free: Option<&mut Buffer>) -> Option<Event> {
        match change {
            Change::None => None,
            Change::Began => {
                self.begin(free);
                None
            }
            Change::Ended => self.end(free),
            Change::Dismissed => {
                if let (Some(true), Some(buffer)) = (self.open.take().map(|open| open.recorded), free) {
                    buffer.clear();
                }
                None
            }
        }
    }

    /// Number of the raw sample at whose time the newest decimated sample stands.
    fn newest_raw(&self) -> u64 {
        self.raw_count.saturating_sub(1 + u64::from(DELAY_SAMPLES))
    }

    fn begin(&mut self, free: Option<&mut Buffer>) {
        let mut open = Open {
            recorded: false,
            first_sample: self.newest_raw(),
            flags: 0,
            peak: self.recent.total(),
            baseline_m_s2: self.detection.baseline_m_s2(),
        };
        match free {
            Some(buffer) if !buffer.is_complete() => {
                buffer.begin(self.newest_raw());
                open.first_sample = buffer.first_sample();
                open.recorded = true;
            }
            _ => open.flags |= flag::NOT_RECORDED,
        }
        self.open = Some(open);
    }

    fn end(&mut self, free: Option<&mut Buffer>) -> Option<Event> {
        let open = self.open.take()?;
        let mut passage = Passage {
            sequence: self.sequence,
            first_sample: open.first_sample,
            samples: u32::try_from(self.newest_raw().saturating_sub(open.first_sample)).unwrap_or(u32::MAX),
            max_acceleration_m_s2: open.peak.distance_m_s2(open.baseline_m_s2),
            flags: open.flags | open.peak.flags,
        };
        self.sequence = self.sequence.wrapping_add(1);
        match free {
            Some(buffer) if open.recorded && buffer.is_recording() => {
                buffer.finish();
                passage.flags |= if buffer.is_truncated() { flag::TRUNCATED } else { 0 };
                Some(Event::Recorded(passage))
            }
            _ => {
                passage.flags |= flag::NOT_RECORDED;
                Some(Event::Missed(passage))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    extern crate std;
    use std::boxed::Box;
    use std::vec::Vec;

    const QUIET: usize = 12_000;

    /// Quiet, 0.5 s of 50 Hz with 20 m/s², quiet.
    fn train() -> impl Iterator<Item = SensorCode> {
        (0..QUIET + 2000 + QUIET).map(|k| {
            let on = (QUIET..QUIET + 2000).contains(&k);
            SensorCode::from_m_s2(if on { 20.0 * (k as f64 * 0.0785).sin() } else { 0.0 })
        })
    }

    fn sampler() -> Sampler {
        Sampler::new(Detector::default(), 7)
    }

    fn recorded(event: Option<Event>) -> Passage {
        match event {
            Some(Event::Recorded(passage)) => passage,
            other => panic!("expected a recording, got {other:?}"),
        }
    }

    #[test]
    fn analytic_time_of_a_recording() {
        let (mut sampler, mut buffer) = (sampler(), Box::new(Buffer::new()));
        let codes: Vec<_> = train().collect();
        let events: Vec<_> =
            codes.chunks(32).filter_map(|burst| sampler.push_burst(burst, Some(&mut buffer))).collect();
        assert_eq!(events.len(), 1);
        let passage = recorded(events.first().copied());
        assert_eq!((passage.sequence, passage.flags), (7, 0));
        assert!((passage.max_acceleration_m_s2 - 20.0).abs() < 0.1);
        // First decimated sample away from zero stands within the filter's reach of the first raw one.
        let onset = buffer.samples().iter().position(|x| x.abs() > 1.0).unwrap() as u64;
        let raw = passage.first_sample + 4 * onset;
        assert!(raw.abs_diff(QUIET as u64) < 12, "{raw}");
        // A quarter of the way in, the tone has the phase it had at the sensor.
        let k = (QUIET as u64 + 1000 - passage.first_sample) / 4;
        let raw = passage.first_sample + 4 * k;
        let expected = 20.0 * (raw as f64 * 0.0785).sin() as f32;
        assert!((buffer.samples()[k as usize] - expected).abs() < 0.1);
        assert!(onset > 400, "0.4 s before the train");
    }

    #[test]
    fn property_a_passage_without_buffer_is_counted() {
        let (mut sampler, mut buffer) = (sampler(), Box::new(Buffer::new()));
        let missed: Vec<_> = train().filter_map(|code| sampler.push(code, None)).collect();
        let [Event::Missed(passage)] = missed[..] else { panic!("{missed:?}") };
        assert_eq!((passage.sequence, passage.flags), (7, flag::NOT_RECORDED));
        let mut event = None;
        train().for_each(|code| event = event.or(sampler.push(code, Some(&mut buffer))));
        assert_eq!(recorded(event).sequence, 8);
        // A complete buffer that nobody cleared counts as none.
        event = None;
        train().for_each(|code| event = event.or(sampler.push(code, Some(&mut buffer))));
        assert!(matches!(event, Some(Event::Missed(Passage { sequence: 9, .. }))));
    }

    /// A recording whose event found no place in the queue stayed complete for ever, and all later trains were missed.
    #[test]
    fn regress_a_recording_that_nobody_takes_makes_room() {
        let (mut sampler, mut buffer) = (sampler(), Box::new(Buffer::new()));
        for sequence in 7..10 {
            let mut event = None;
            train().for_each(|code| event = event.or(sampler.push(code, Some(&mut buffer))));
            assert_eq!(recorded(event).sequence, sequence);
            event.unwrap().give_up(Some(&mut buffer));
        }
        // A missed one has nothing in the buffer: what is there is another's.
        buffer.begin(0);
        buffer.finish();
        Event::Missed(Passage::default()).give_up(Some(&mut buffer));
        assert!(buffer.is_complete());
    }

    /// A missed passage whose record was not stored either counted twice.
    #[test]
    fn regress_a_passage_is_lost_once() {
        let (recorded, missed) = (Event::Recorded(Passage::default()), Event::Missed(Passage::default()));
        assert!(!recorded.is_lost(true) && recorded.is_lost(false));
        assert!(missed.is_lost(true) && missed.is_lost(false));
    }

    /// The quiet level was forgotten before the peak was taken from it, so gravity was in the peak; and the new level was
    /// one sample from the middle of the vibration, so the quiet track afterwards passed for a train.
    #[test]
    fn regress_a_train_longer_than_the_longest_is_without_gravity() {
        const TRAIN: core::ops::Range<usize> = QUIET..QUIET + 30 * 4000;
        let (mut sampler, mut buffer) = (sampler(), Box::new(Buffer::new()));
        let mut passages = Vec::new();
        for k in 0..TRAIN.end + 10 * 4000 {
            // A burst of 50 Hz every 0.25 s.
            let (t, burst) = (k as f64 / 4000.0, (k % 1000) as f64 / 500.0 - 1.0);
            let on = if TRAIN.contains(&k) { 20.0 * (-6.0 * burst * burst).exp() } else { 0.0 };
            let code = SensorCode::from_m_s2(-9.8 + on * (314.0 * t).sin());
            if let Some(event) = sampler.push(code, Some(&mut buffer)) {
                passages.push((k, recorded(Some(event))));
                buffer.clear();
            }
        }
        let [(_, long), (end, rest)] = passages[..] else { panic!("{passages:?}") };
        for peak in [long.max_acceleration_m_s2, rest.max_acceleration_m_s2] {
            assert!((peak - 20.0).abs() < 0.5, "{peak} m/s²");
        }
        let hold = 4 * Detector::default().hold as usize;
        assert!(
            end < TRAIN.end + hold + 400,
            "quiet {} s after the train",
            (end - TRAIN.end) as f64 / 4000.0
        );
        assert!(!sampler.in_passage());
    }

    #[test]
    fn property_small_gaps_keep_the_time() {
        let (mut sampler, mut buffer) = (sampler(), Box::new(Buffer::new()));
        let mut event = None;
        for (k, code) in train().enumerate() {
            // 100 samples are lost in the middle of the train.
            match k {
                13_000 => event = event.or(sampler.lost(100, Some(&mut buffer))),
                13_001..13_100 => {}
                _ => event = event.or(sampler.push(code, Some(&mut buffer))),
            }
        }
        let passage = recorded(event);
        assert_eq!(passage.flags, flag::SAMPLES_LOST);
        assert_eq!(sampler.raw_count(), train().count() as u64);
        let k = (QUIET as u64 + 1900 - passage.first_sample) / 4;
        let raw = passage.first_sample + 4 * k;
        let expected = 20.0 * (raw as f64 * 0.0785).sin() as f32;
        assert!((buffer.samples()[k as usize] - expected).abs() < 0.1);
    }

    #[test]
    fn property_a_long_gap_ends_the_passage() {
        let (mut sampler, mut buffer) = (sampler(), Box::new(Buffer::new()));
        train().take(QUIET + 1500).for_each(|code| assert_eq!(sampler.push(code, Some(&mut buffer)), None));
        let passage = recorded(sampler.lost(50_000, Some(&mut buffer)));
        assert_eq!(passage.flags, flag::SAMPLES_LOST);
        assert_eq!(sampler.raw_count(), QUIET as u64 + 1500 + 50_000);
    }

    #[test]
    fn property_clipping_is_flagged() {
        let (mut sampler, mut buffer) = (sampler(), Box::new(Buffer::new()));
        let mut event = None;
        for (k, code) in train().enumerate() {
            let code = if k == QUIET + 500 { SensorCode::from_m_s2(500.0) } else { code };
            event = event.or(sampler.push(code, Some(&mut buffer)));
        }
        assert_eq!(recorded(event).flags, flag::CLIPPED);
    }
}
