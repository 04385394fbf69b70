//! Speed in the full band: the axles are laid on top of each other, and the speed is where they agree best.

use crate::decimate::RATE_HZ;
use crate::pace::Pace;
use crate::peaks::vertex;
use crate::resample::{Position, WORK, at};
use crate::timing::axles::Signal;

/// Part of the track around the crossing over which the axles are compared, m to either side.
const REACH_M: f32 = 4.0;
/// The coarse speed is searched this far to either side, relative; it is good to 0.2 %.
const SEARCH: f32 = 4e-3;
/// First step: the delay of the last axle moves by this much, s; at 100 Hz a twentieth of a period.
const DELAY_STEP_S: f32 = 0.5e-3;
/// Most steps of the first search to either side.
const MOST_STEPS: f32 = 100.0;
/// Second search: this many times finer.
const FINER: f32 = 4.0;

/// Best speed near `speed_m_s`, m/s.
pub async fn refine(
    signal: Signal<'_>,
    offsets_m: &[f32],
    speed_m_s: f32,
    first_axle_s: f32,
    pace: &mut Pace,
) -> f32 {
    let last = offsets_m.last().copied().unwrap_or(0.0).max(1.0);
    let steps = (SEARCH * last / speed_m_s / DELAY_STEP_S).clamp(2.0, MOST_STEPS);
    let stack = Stack { signal, offsets_m, start: (first_axle_s - REACH_M / speed_m_s) * RATE_HZ, speed_m_s };
    let step = SEARCH / steps;
    let near = stack.search(0.0, step, steps as i32, pace).await;
    let exact = stack.search(near, step / FINER, FINER as i32, pace).await;
    speed_m_s * (1.0 + exact)
}

struct Stack<'a> {
    signal: Signal<'a>,
    offsets_m: &'a [f32],
    start: f32,
    speed_m_s: f32,
}

impl Stack<'_> {
    /// Relative change of speed, `steps` steps to either side of `middle`, that stacks to the most energy.
    async fn search(&self, middle: f32, step: f32, steps: i32, pace: &mut Pace) -> f32 {
        let mut best = (0, -1.0);
        let mut around = (0.0, 0.0);
        let mut previous = 0.0;
        for k in -steps..=steps {
            let energy = self.energy(self.speed_m_s * (1.0 + middle + k as f32 * step), pace).await;
            if k == best.0 + 1 {
                around.1 = energy;
            }
            if energy > best.1 {
                best = (k, energy);
                around = (previous, energy);
            }
            previous = energy;
        }
        let inside = best.0 > -steps && best.0 < steps;
        let shift = if inside { vertex(around.0, best.1, around.1) } else { 0.0 };
        middle + (best.0 as f32 + shift) * step
    }

    /// Σ_t (Σ_w a(t + offset_w / v))² over the part of the track.
    async fn energy(&self, v: f32, pace: &mut Pace) -> f32 {
        let per_metre = RATE_HZ / v;
        let count = (2.0 * REACH_M * RATE_HZ / self.speed_m_s) as u32;
        // Speed changes turn the train about its middle, so that the crossing stays in view of all axles.
        let middle = self.offsets_m.last().copied().unwrap_or(0.0) / 2.0;
        let start = self.start + middle * (RATE_HZ / self.speed_m_s - per_metre);
        let mut energy = 0.0;
        for t in 0..count {
            let mut sum = 0.0;
            for offset in self.offsets_m {
                let position = Position::new(start + t as f32 + offset * per_metre);
                sum += at(self.signal.samples, position, self.signal.mean) - self.signal.mean;
            }
            energy += sum * sum;
            pace.spend(WORK * self.offsets_m.len()).await;
        }
        energy
    }
}
