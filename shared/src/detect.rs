//! Notices that a train passes.
//!
//! A decimated sample is *active* when it is far from the baseline compared with the noise. A passage *begins*
//! when enough of the latest samples are active, *lasts* while activity goes on with gaps shorter than the hold
//! time, and counts as a passage when it was long enough. One electrical spike makes about 16 active samples (the
//! length of the low-pass), a train makes hundreds; that difference is what the counting uses.

/// Number of latest samples that are looked at to decide on a beginning.
pub const HISTORY: u32 = u128::BITS;

/// Configuration. All times are in decimated samples, that is milliseconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detector {
    /// A sample is active beyond this distance from the baseline, m/s², when the noise is small.
    pub on_level_m_s2: f32,
    /// ... and beyond this many times the noise (mean absolute value) when that is larger.
    pub noise_factor: f32,
    /// The threshold never rises above this, m/s²: noise must not deafen the node.
    pub max_level_m_s2: f32,
    /// During a passage the threshold is this fraction of what it was (hysteresis).
    pub off_fraction: f32,
    /// Active samples among the latest [`HISTORY`] that begin a passage.
    pub min_active: u32,
    /// A passage ends after this long without activity. The longest gap between bogies, some 15 m, must pass in
    /// less at the lowest speed: 1.5 s is 15 m at 10 m/s.
    pub hold: u32,
    /// Shortest time between first and last activity of a passage: a single bogie at 75 m/s takes 0.1 s.
    pub min_duration: u32,
    /// A passage that lasts longer than this is ended, and the baseline learnt anew.
    pub max_duration: u32,
}

impl Default for Detector {
    fn default() -> Self {
        Self {
            // 20 times the noise of the sensor in 250 Hz; a train at 15 m/s reaches more than 10 m/s².
            on_level_m_s2: 1.0,
            noise_factor: 10.0,
            max_level_m_s2: 5.0,
            off_fraction: 0.7,
            // More than two spikes within the history can make.
            min_active: 36,
            hold: 1500,
            min_duration: 80,
            max_duration: 20_000,
        }
    }
}

/// What a sample changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// Nothing.
    None,
    /// A train has come.
    Began,
    /// The train is gone.
    Ended,
    /// What began was too short for a train.
    Dismissed,
}

/// State of the detector.
#[derive(Clone, Debug)]
pub struct Detection {
    /// Offset of the quiet signal, m/s²: bias, and gravity where the sensor contains it. Taken from the first
    /// sample, then tracked while quiet.
    baseline: Option<f32>,
    /// Mean absolute deviation from it while quiet, m/s².
    noise: f32,
    /// Running mean of a passage, m/s²: a vibration is about the quiet level, so this is the next baseline when it
    /// does not end.
    mean: f32,
    /// Latest samples, newest in bit 0: active or not.
    history: u128,
    /// Since the latest passage began and since its latest activity, in samples; `None` between passages.
    passage: Option<Span>,
}

#[derive(Clone, Copy, Debug)]
struct Span {
    duration: u32,
    idle: u32,
}

impl Default for Detection {
    fn default() -> Self {
        Self::new()
    }
}

impl Detection {
    /// Nothing heard yet. The noise starts at the level that gives the lowest threshold.
    pub const fn new() -> Self {
        Self { baseline: None, noise: 0.05, mean: 0.0, history: 0, passage: None }
    }

    /// Whether a passage is going on.
    pub const fn in_passage(&self) -> bool {
        self.passage.is_some()
    }

    /// Offset of the quiet signal, m/s².
    pub fn baseline_m_s2(&self) -> f32 {
        self.baseline.unwrap_or(0.0)
    }

    /// Noise while quiet, as mean absolute value, m/s².
    pub const fn noise_m_s2(&self) -> f32 {
        self.noise
    }
}

/// Slowness of baseline, noise and mean, samples: a drift of 0.15 m/s² in 10 s lags by 0.03 m/s².
const TRACKING: f32 = 2048.0;
/// One sample moves the trackers by no more than this many times the noise, so a spike hardly does.
const CLIP: f32 = 4.0;
/// Least noise, m/s²: a dead-quiet sensor must still let the trackers move.
const LEAST_NOISE_M_S2: f32 = 1e-3;

impl Detector {
    /// Takes one decimated sample, m/s².
    pub fn process(&self, state: &mut Detection, x: f32) -> Change {
        let deviation = x - *state.baseline.get_or_insert(x);
        let active = deviation.abs() > self.threshold(state);
        state.history = (state.history << 1) | u128::from(active);
        match state.passage {
            None => self.wait(state, deviation),
            Some(span) => {
                state.mean += (x - state.mean) / TRACKING;
                self.follow(state, span, active)
            }
        }
    }

    /// Ends a passage at once, as when the samples stop.
    pub fn stop(&self, state: &mut Detection) -> Change {
        match state.passage {
            None => Change::None,
            Some(span) => self.end(state, span),
        }
    }

    fn threshold(&self, state: &Detection) -> f32 {
        let level = (self.noise_factor * state.noise).max(self.on_level_m_s2).min(self.max_level_m_s2);
        if state.in_passage() { level * self.off_fraction } else { level }
    }

    fn wait(&self, state: &mut Detection, deviation: f32) -> Change {
        let limit = CLIP * state.noise;
        state.baseline = state.baseline.map(|offset| offset + deviation.clamp(-limit, limit) / TRACKING);
        state.noise =
            (state.noise + (deviation.abs().min(limit) - state.noise) / TRACKING).max(LEAST_NOISE_M_S2);
        if state.history.count_ones() < self.min_active {
            return Change::None;
        }
        state.mean = state.baseline_m_s2();
        state.passage = Some(Span { duration: HISTORY, idle: 0 });
        Change::Began
    }

    fn follow(&self, state: &mut Detection, span: Span, active: bool) -> Change {
        let idle = if active { 0 } else { span.idle.saturating_add(1) };
        let span = Span { duration: span.duration.saturating_add(1), idle };
        state.passage = Some(span);
        if span.duration >= self.max_duration {
            // Rather the quiet level has moved than that this is a train: learn it anew.
            *state = Detection { baseline: Some(state.mean), ..Detection::new() };
            return self.end(state, span);
        }
        if idle >= self.hold { self.end(state, span) } else { Change::None }
    }

    fn end(&self, state: &mut Detection, span: Span) -> Change {
        state.passage = None;
        state.history = 0;
        let active_for = span.duration.saturating_sub(span.idle).saturating_sub(HISTORY - self.min_active);
        if active_for >= self.min_duration { Change::Ended } else { Change::Dismissed }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::decimate::Decimator;
    use crate::sample::SensorCode;
    extern crate std;
    use std::vec::Vec;

    /// Uniform white noise of the given rms from a fixed linear congruential generator.
    struct Noise(u32);
    impl Noise {
        fn next(&mut self, rms: f64) -> f64 {
            self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (f64::from(self.0 >> 8) / f64::from(1 << 23) - 1.0) * rms * 3f64.sqrt()
        }
    }

    /// Changes that a raw signal causes, with the raw sample at which they came.
    fn run(raw: impl Iterator<Item = f64>) -> Vec<(usize, Change)> {
        let (config, mut state, mut filter) = (Detector::default(), Detection::new(), Decimator::new());
        let mut changes = Vec::new();
        for (k, x) in raw.enumerate() {
            let Some(y) = filter.push(SensorCode::from_m_s2(x)) else { continue };
            match config.process(&mut state, y) {
                Change::None => {}
                change => changes.push((k, change)),
            }
        }
        changes
    }

    #[test]
    fn property_bias_drift_and_noise_are_quiet() {
        let mut noise = Noise(1);
        let raw = (0..240_000).map(|k| 0.15 * (f64::from(k) / 20_000.0).sin() + noise.next(0.1));
        assert_eq!(run(raw), []);
        let mut noise = Noise(2);
        assert_eq!(run((0..240_000).map(|_| -0.15 + noise.next(0.1))), []);
    }

    #[test]
    fn property_a_spike_is_quiet() {
        for height in [400.0, -400.0, 100.0, 5.0] {
            let mut noise = Noise(3);
            let raw = (0..40_000).map(|k| noise.next(0.1) + if k % 4001 == 2000 { height } else { 0.0 });
            assert_eq!(run(raw), [], "{height}");
        }
    }

    #[test]
    fn property_a_shock_is_no_train() {
        // A hammer blow on the sleeper: 60 Hz, decaying in 15 ms.
        let mut noise = Noise(4);
        let raw = (0..40_000).map(|k| {
            let t = (f64::from(k) - 8000.0) / 4000.0;
            noise.next(0.1) + if t > 0.0 { 80.0 * (-t / 0.015).exp() * (377.0 * t).sin() } else { 0.0 }
        });
        assert!(run(raw).iter().all(|(_, change)| *change != Change::Ended));
    }

    #[test]
    fn property_gaps_between_bogies_do_not_split() {
        // Bogies of 2 wheels at 0, 17.7, 24.95 and 42.65 m; a decaying 70 Hz burst per wheel.
        let wheels = [0.0, 2.9, 17.7, 20.6, 24.95, 27.85, 42.65, 45.55];
        for v in [15.0, 25.0, 75.0] {
            let mut noise = Noise(5);
            let raw = (0..60_000).map(|k| {
                let t = f64::from(k) / 4000.0 - 2.0;
                let burst = |x: f64| {
                    let u = (t - x / v) * v / 0.8;
                    v * (-u * u).exp() * (440.0 * (t - x / v)).cos()
                };
                noise.next(0.1) + wheels.iter().map(|&x| burst(x)).sum::<f64>()
            });
            let changes: Vec<_> = run(raw).into_iter().map(|(_, change)| change).collect();
            assert_eq!(changes, [Change::Began, Change::Ended], "{v} m/s");
        }
    }

    #[test]
    fn property_gravity_is_no_train_and_a_step_is_learnt() {
        let mut noise = Noise(7);
        assert_eq!(run((0..100_000).map(|_| -9.8 + noise.next(0.1))), []);
        let step = |k: u32| if k < 20_000 { 0.0 } else { 2.0 };
        let changes = run((0..400_000).map(|k| step(k) + noise.next(0.1)));
        assert!(matches!(changes[..], [(_, Change::Began), (_, Change::Ended)]), "{changes:?}");
    }

    #[test]
    fn property_endless_vibration_ends() {
        let mut noise = Noise(6);
        let changes = run((0..300_000).map(|_| noise.next(60.0)));
        assert!(changes.iter().any(|(_, change)| *change == Change::Ended));
    }
}
