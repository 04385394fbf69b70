//! From FIFO visits to passages: the sampling side of the node, without the waiting.

use heapless::Vec;

use crate::adxl357::Batch;
use crate::detect::Detector;
use crate::message::{Activity, Live};
use crate::passage::Buffer;
use crate::sample::{M_S2_PER_CODE, RAW_RATE_HZ, SensorCode};
use crate::sampler::{Event, Sampler};

/// What one visit to the FIFO can complete: one passage ended by lost samples, one by the samples after them.
pub type Events = Vec<Event, 2>;

/// Feeds the sampler and keeps account of what the field tool may ask.
pub struct Acquisition {
    sampler: Sampler,
    level: Level,
    live: Live,
}

impl Acquisition {
    /// The next passage gets the number `sequence`.
    pub fn new(sequence: u32) -> Self {
        Acquisition {
            sampler: Sampler::new(Detector::default(), sequence),
            level: Level::default(),
            live: Live::default(),
        }
    }

    /// Takes what a visit to the FIFO gave. `free` is the recording buffer, while no evaluation has it.
    pub fn take(&mut self, batch: &Batch, mut free: Option<&mut Buffer>) -> Events {
        let mut events = Events::new();
        if batch.lost > 0 {
            self.live.counters.lost_samples =
                self.live.counters.lost_samples.saturating_add(u64::from(batch.lost));
            self.note(&mut events, |sampler| sampler.lost(batch.lost, free.as_deref_mut()));
        }
        self.live.counters.fifo_deepest = self.live.counters.fifo_deepest.max(batch.codes.len() as u16);
        for &code in &batch.codes {
            if let Some(level) = self.level.add(code) {
                (self.live.mean_m_s2, self.live.rms_m_s2, self.live.peak_m_s2) = level;
            }
        }
        self.note(&mut events, |sampler| sampler.push_burst(&batch.codes, free));
        events
    }

    /// Ends a passage that is going on, because no more samples will come.
    pub fn stop(&mut self, free: Option<&mut Buffer>) -> Events {
        let mut events = Events::new();
        self.note(&mut events, |sampler| sampler.stop(free));
        self.live.activity = Activity::Ended;
        events
    }

    /// Counts a failure of the sensor's bus.
    pub fn sensor_failed(&mut self) {
        self.live.counters.sensor_errors = self.live.counters.sensor_errors.saturating_add(1);
    }

    /// What the field tool may see; `lost_passages`, `storage_errors` and `link_errors` are for others to fill in.
    pub fn live(&self) -> Live {
        self.live
    }

    fn note(&mut self, events: &mut Events, work: impl FnOnce(&mut Sampler) -> Option<Event>) {
        if let Some(event) = work(&mut self.sampler) {
            self.live.counters.passages = self.live.counters.passages.saturating_add(1);
            let _ = events.push(event); // room for one per call
        }
        self.live.sample = self.sampler.raw_count();
        self.live.counters.samples = self.live.sample;
        self.live.activity = if self.sampler.in_passage() { Activity::Passage } else { Activity::Quiet };
    }
}

/// Mean, RMS about it and largest deviation from it, over whole seconds of raw samples.
#[derive(Default)]
struct Level {
    count: u32,
    sum: i64,
    squares: i64,
    low: SensorCode,
    high: SensorCode,
}

impl Level {
    fn add(&mut self, code: SensorCode) -> Option<(f32, f32, f32)> {
        if self.count == 0 {
            *self = Level { low: code, high: code, ..Level::default() };
        }
        let wide = i64::from(code.get());
        self.count += 1;
        self.sum += wide;
        self.squares += wide * wide;
        self.low = self.low.min(code);
        self.high = self.high.max(code);
        (self.count == RAW_RATE_HZ).then(|| {
            let level = self.total();
            self.count = 0;
            level
        })
    }

    fn total(&self) -> (f32, f32, f32) {
        let count = i64::from(self.count.max(1));
        let mean = self.sum as f32 / count as f32;
        // In whole numbers, where nothing cancels: 2³⁸ · 4000² stays below 2⁶³.
        let variance = (self.squares * count - self.sum * self.sum) as f32 / (count * count) as f32;
        let peak = (self.high.get() as f32 - mean).max(mean - self.low.get() as f32);
        (mean * M_S2_PER_CODE, libm::sqrtf(variance.max(0.0)) * M_S2_PER_CODE, peak * M_S2_PER_CODE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::boxed::Box;

    #[test]
    fn analytic_level_of_a_square_wave_on_gravity() {
        let mut level = Level::default();
        let codes =
            (0..RAW_RATE_HZ).map(|k| SensorCode::from_m_s2(9.8 + if k % 2 == 0 { 0.3 } else { -0.3 }));
        let (mean, rms, peak) = codes.filter_map(|code| level.add(code)).next().unwrap();
        assert!((mean - 9.8).abs() < 1e-3 && (rms - 0.3).abs() < 1e-3 && (peak - 0.3).abs() < 1e-3);
        let extremes = (0..RAW_RATE_HZ).map(|k| if k % 2 == 0 { SensorCode::MAX } else { SensorCode::MIN });
        let (_, rms, _) = extremes.filter_map(|code| level.add(code)).next().unwrap();
        assert!((rms - 524_287.5 * M_S2_PER_CODE).abs() < 0.01);
    }

    #[test]
    fn property_lost_samples_advance_the_count() {
        let mut acquisition = Acquisition::new(0);
        let mut buffer = Box::new(Buffer::new());
        let mut batch = Batch { lost: 7, codes: Vec::new() };
        batch.codes.extend([SensorCode::new(1); 20]);
        assert!(acquisition.take(&batch, Some(&mut buffer)).is_empty());
        let live = acquisition.live();
        assert_eq!((live.sample, live.counters.lost_samples, live.activity), (27, 7, Activity::Quiet));
    }
}
