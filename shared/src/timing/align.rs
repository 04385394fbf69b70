//! Alignment of the train and its axle groups with the windows that the package expects.
//!
//! First all groups together are shifted against their templates, which gives the time of the train; then each
//! group for itself a little. The speed is known far better than a single group can be timed, so the group times
//! are put on a straight line along the train, unless they lie so far off it that the train must have braked.

use heapless::Vec;

use crate::decimate::RATE_HZ;
use crate::operator::{BlockError, Blocks, KernelRead};
use crate::pace::Pace;
use crate::package::{Bin, Group, MAX_GROUPS, MAX_WINDOW, Operator, Train};
use crate::peaks::largest;
use crate::timing::axles::Signal;
use crate::window::Cut;

/// The train is searched this far to either side of where the wheels hit hardest, m.
const TRAIN_SEARCH_M: f32 = 1.5;
/// A group is searched this far to either side of where the train says, m.
const GROUP_SEARCH_M: f32 = 0.3;
/// Longest search to either side, samples: [`TRAIN_SEARCH_M`] at 10 m/s.
const MAX_LAG: usize = 150;
/// Group times farther than this from a straight line (rms, m) are left as they are.
const MAX_BEND_M: f32 = 0.05;
/// Scratch space: window with margins, template, correlation and energy per lag.
pub const WORK_LEN: usize = MAX_WINDOW + 2 * MAX_LAG + MAX_WINDOW + 2 * (2 * MAX_LAG + 1);

/// When each group was where, and how well it looked like that.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Alignment {
    /// First axle of each group at x = 0, s after the first sample.
    pub group_time_s: Vec<f32, MAX_GROUPS>,
    /// Normalised correlation of each group's window with its template, 0 … 1.
    pub quality: Vec<f32, MAX_GROUPS>,
}

/// A train at a speed, to be aligned with one bin.
#[derive(Clone, Copy, Debug)]
pub struct Aligner<'a> {
    /// The recording.
    pub signal: Signal<'a>,
    /// Pattern and groups.
    pub train: &'a Train,
    /// The bin nearest in speed.
    pub bin: &'a Bin,
    /// Speed of the train, m/s.
    pub speed_m_s: f32,
}

impl Aligner<'_> {
    /// Finds the group times, given roughly when the first axle was at x = 0. `work` has [`WORK_LEN`].
    pub async fn run<K: KernelRead>(
        &self,
        first_axle_s: f32,
        blocks: &mut Blocks<'_, K>,
        work: &mut [f32],
        pace: &mut Pace,
    ) -> Result<Alignment, BlockError> {
        let mut search = Search::new(self.lags(TRAIN_SEARCH_M), work);
        for group in &self.train.groups {
            self.correlate(group, first_axle_s, &mut search, blocks, pace).await?;
        }
        let first_axle_s = first_axle_s + search.best().0 * self.lag_s();

        let mut alignment = Alignment::default();
        for group in &self.train.groups {
            let mut search = Search::new(self.lags(GROUP_SEARCH_M), work);
            self.correlate(group, first_axle_s, &mut search, blocks, pace).await?;
            let (lag, quality) = search.best();
            let time = first_axle_s + self.offset_m(group) / self.speed_m_s + lag * self.lag_s();
            // There is room: a train has no more groups than the lists.
            let _ = alignment.group_time_s.push(time);
            let _ = alignment.quality.push(quality.clamp(0.0, 1.0));
        }
        self.straighten(&mut alignment);
        Ok(alignment)
    }

    /// Time of one window sample, s: windows are scaled to the bin's speed.
    fn lag_s(&self) -> f32 {
        self.bin.speed_m_s / self.speed_m_s / RATE_HZ
    }

    fn lags(&self, distance_m: f32) -> usize {
        ((distance_m / self.bin.speed_m_s * RATE_HZ) as usize).clamp(3, MAX_LAG)
    }

    fn offset_m(&self, group: &Group) -> f32 {
        self.train.axle_offset_m.get(usize::from(group.first_axle)).copied().unwrap_or(0.0)
    }

    fn operator(&self, group: &Group) -> Option<&Operator> {
        self.bin.operators.get(usize::from(group.operator))
    }

    /// Adds the correlation of one group's window with its template to a search.
    async fn correlate<K: KernelRead>(
        &self,
        group: &Group,
        first_axle_s: f32,
        search: &mut Search<'_>,
        blocks: &mut Blocks<'_, K>,
        pace: &mut Pace,
    ) -> Result<(), BlockError> {
        let Some(operator) = self.operator(group) else { return Ok(()) };
        let before = operator.before.saturating_add(search.lags as u16);
        let Some((window, template)) = search.split(usize::from(operator.template_m_s2.cols)) else {
            return Err(BlockError::Shape { cols: operator.template_m_s2.cols, len: MAX_WINDOW });
        };
        let store = |k: usize, value| template.get_mut(k).into_iter().for_each(|slot| *slot = value);
        blocks.elements(operator.template_m_s2, pace, store).await?;
        let cut = Cut {
            group_time_s: first_axle_s + self.offset_m(group) / self.speed_m_s,
            speed_m_s: self.speed_m_s,
            bin_speed_m_s: self.bin.speed_m_s,
            before,
        };
        cut.fill(self.signal, window, pace).await;
        search.add(usize::from(operator.template_m_s2.cols), pace).await;
        Ok(())
    }

    /// Puts the group times on a straight line along the train, when they are near one.
    fn straighten(&self, alignment: &mut Alignment) {
        let nominal = |group: &Group| self.offset_m(group) / self.speed_m_s;
        let points = || {
            let measured = alignment.group_time_s.iter().zip(&alignment.quality);
            self.train.groups.iter().zip(measured).map(|(g, (t, q))| (nominal(g), t - nominal(g), *q))
        };
        let Some(line) = Line::fit(points()) else { return };
        let squares = points().map(|(x, y, _)| (y - line.at(x)) * (y - line.at(x))).sum::<f32>();
        let bend_m = self.speed_m_s * libm::sqrtf(squares / self.train.groups.len().max(1) as f32);
        if bend_m <= MAX_BEND_M {
            for (time, group) in alignment.group_time_s.iter_mut().zip(&self.train.groups) {
                *time = nominal(group) + line.at(nominal(group));
            }
        }
    }
}

/// Sums over groups of correlation and energy, per lag. The scratch space holds, in this order, the correlation,
/// the energy, the template and the window with margins.
struct Search<'a> {
    /// Largest lag to either side, samples.
    lags: usize,
    template_energy: f32,
    sums: &'a mut [f32],
    rest: &'a mut [f32],
}

impl<'a> Search<'a> {
    fn new(lags: usize, work: &'a mut [f32]) -> Self {
        let count = (2 * (2 * lags + 1)).min(work.len());
        let (sums, rest) = work.split_at_mut(count);
        sums.fill(0.0);
        Self { lags, template_energy: 0.0, sums, rest }
    }

    /// Room for a window with margins and for a template of `len`.
    fn split(&mut self, len: usize) -> Option<(&mut [f32], &mut [f32])> {
        let (template, window) = self.rest.split_at_mut_checked(len)?;
        Some((window.get_mut(..len + 2 * self.lags)?, template))
    }

    async fn add(&mut self, len: usize, pace: &mut Pace) {
        let Some((template, window)) = self.rest.split_at_checked(len) else { return };
        self.template_energy += template.iter().map(|t| t * t).sum::<f32>();
        let (correlation, energy) = self.sums.split_at_mut(self.sums.len() / 2);
        for (lag, (c, e)) in correlation.iter_mut().zip(energy).enumerate() {
            let shifted = window.get(lag..).unwrap_or(&[]);
            *c += template.iter().zip(shifted).map(|(t, y)| t * y).sum::<f32>();
            *e += template.iter().zip(shifted).map(|(_, y)| y * y).sum::<f32>();
            pace.spend(2 * len).await;
        }
    }

    /// Lag of the best match, window samples, and its normalised correlation. (0, 0) when there is nothing.
    fn best(&mut self) -> (f32, f32) {
        let (correlation, energy) = self.sums.split_at_mut(self.sums.len() / 2);
        for (c, e) in correlation.iter_mut().zip(energy) {
            let norm = libm::sqrtf(*e * self.template_energy);
            *c = if norm > 0.0 { *c / norm } else { 0.0 };
        }
        match largest(correlation) {
            Some(peak) if peak.value > 0.0 => (peak.index as f32 + peak.shift - self.lags as f32, peak.value),
            _ => (0.0, 0.0),
        }
    }
}

/// y = y₀ + slope (x − x₀).
struct Line {
    x0: f32,
    y0: f32,
    slope: f32,
}

impl Line {
    /// Weighted least squares through (x, y, weight). `None` without weight.
    fn fit(points: impl Iterator<Item = (f32, f32, f32)> + Clone) -> Option<Self> {
        let weight: f32 = points.clone().map(|(_, _, w)| w).sum();
        if weight <= 0.0 || weight.is_nan() {
            return None;
        }
        let x0 = points.clone().map(|(x, _, w)| w * x).sum::<f32>() / weight;
        let y0 = points.clone().map(|(_, y, w)| w * y).sum::<f32>() / weight;
        let xx: f32 = points.clone().map(|(x, _, w)| w * (x - x0) * (x - x0)).sum();
        let xy: f32 = points.map(|(x, y, w)| w * (x - x0) * (y - y0)).sum();
        Some(Self { x0, y0, slope: if xx > 0.0 { xy / xx } else { 0.0 } })
    }

    fn at(&self, x: f32) -> f32 {
        self.y0 + self.slope * (x - self.x0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_line() {
        let points = [(0.0, 1.0, 1.0), (1.0, 3.0, 0.5), (2.0, 5.0, 2.0)];
        let line = Line::fit(points.into_iter()).unwrap();
        assert!((line.at(4.0) - 9.0).abs() < 1e-5);
        assert!(Line::fit([(0.0, 1.0, 0.0)].into_iter()).is_none());
        assert_eq!(Line::fit([(3.0, 7.0, 1.0)].into_iter()).unwrap().at(100.0), 7.0);
    }

    #[test]
    fn analytic_lag_between_samples() {
        let bell = |t: f32| libm::expf(-t * t / 40.0) * libm::cosf(0.5 * t);
        let mut work = [0.0; WORK_LEN];
        let mut search = Search::new(20, &mut work);
        let (window, template) = search.split(100).unwrap();
        template.iter_mut().enumerate().for_each(|(k, t)| *t = bell(k as f32 - 50.0));
        window.iter_mut().enumerate().for_each(|(k, y)| *y = 3.0 * bell(k as f32 - 20.0 - 57.3));
        embassy_futures::block_on(search.add(100, &mut Pace::default()));
        let (lag, quality) = search.best();
        assert!((lag - 7.3).abs() < 0.02, "{lag}");
        assert!(quality > 0.99);
    }
}
