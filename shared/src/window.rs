//! The window of an axle group, as it would be at the speed that an operator was computed for.

use crate::decimate::RATE_HZ;
use crate::pace::Pace;
use crate::resample::{Position, WORK, at};
use crate::timing::axles::Signal;

/// Where a window lies and how it is scaled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cut {
    /// Moment when the first axle of the group is at x = 0, s after the first sample of the recording.
    pub group_time_s: f32,
    /// Speed of the train, m/s.
    pub speed_m_s: f32,
    /// Speed of the operator, m/s.
    pub bin_speed_m_s: f32,
    /// Window samples before that moment.
    pub before: u16,
}

impl Cut {
    /// Real time per time in the window.
    fn ratio(&self) -> f32 {
        self.bin_speed_m_s / self.speed_m_s
    }

    /// Fills `window`, sample k with `a(group_time + (k − before) / rate · r) · r²`, where `r = v_bin / v` and a is
    /// the signal without its bias.
    ///
    /// Scaling the time puts the wheels where they would be at the bin's speed. Displacements that follow the
    /// wheels quasi-statically keep their size, so their acceleration changes with the square of the speed.
    ///
    /// Returns whether the whole window is within the recording; what is outside is taken as quiet.
    pub async fn fill(&self, signal: Signal<'_>, window: &mut [f32], pace: &mut Pace) -> bool {
        let ratio = self.ratio();
        let scale = ratio * ratio;
        let origin = Position::new(self.group_time_s * RATE_HZ);
        let first = origin.after(-f32::from(self.before) * ratio);
        let last = origin.after((window.len() as f32 - 1.0 - f32::from(self.before)) * ratio);
        for (k, y) in window.iter_mut().enumerate() {
            let position = origin.after((k as f32 - f32::from(self.before)) * ratio);
            *y = (at(signal.samples, position, signal.mean) - signal.mean) * scale;
            pace.spend(WORK).await;
        }
        first.whole >= 0 && usize::try_from(last.whole).is_ok_and(|last| last < signal.samples.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use embassy_futures::block_on;

    /// Interpolation below 1e-3 (see resample) and rounding.
    const RELATIVE: f32 = 1.5e-3;

    /// Quasi-static acceleration of a wheel: second time derivative of a bell that moves with the train.
    fn quasi_static(v: f32, t: f32) -> f32 {
        let u = v * t / 1.2;
        v * v * (4.0 * u * u - 2.0) * libm::expf(-u * u)
    }

    #[test]
    fn analytic_quasi_static_response_scales_exactly() {
        let (v, bin) = (31.7, 30.0);
        let samples: [f32; 1000] =
            core::array::from_fn(|k| 0.05 + quasi_static(v, k as f32 / RATE_HZ - 0.4003));
        let cut = Cut { group_time_s: 0.4003, speed_m_s: v, bin_speed_m_s: bin, before: 150 };
        let mut window = [0.0; 301];
        let signal = Signal { samples: &samples, mean: 0.05 };
        assert!(block_on(cut.fill(signal, &mut window, &mut Pace::default())));
        for (k, y) in window.iter().enumerate() {
            let expected = quasi_static(bin, (k as f32 - 150.0) / RATE_HZ);
            assert!((y - expected).abs() < RELATIVE * 2.0 * bin * bin, "{k}: {y} {expected}");
        }
    }

    #[test]
    fn property_a_window_beyond_the_recording_is_reported() {
        let samples = [1.0; 400];
        let signal = Signal { samples: &samples, mean: 1.0 };
        let at_time = |group_time_s| {
            let cut = Cut { group_time_s, speed_m_s: 30.0, bin_speed_m_s: 30.0, before: 100 };
            block_on(cut.fill(signal, &mut [0.0; 200], &mut Pace::default()))
        };
        assert!(at_time(0.2));
        assert!(!at_time(0.05));
        assert!(!at_time(0.35));
        assert!(!at_time(f32::NAN));
    }
}
