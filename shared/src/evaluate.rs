//! From a recorded passage and a kernel package to the record: speed, axle times, force peaks.

use crate::operator::{BlockError, Blocks, CHUNK_LEN, KernelRead};
use crate::pace::Pace;
use crate::package::{Bin, Group, Header, MAX_GRID, MAX_GROUP_AXLES, MAX_RANK, MAX_WINDOW, Operator};
use crate::passage::Passage;
use crate::peaks::{Peak, largest};
use crate::record::{FORMAT, Record, Wheelset, flag};
use crate::sample::RAW_RATE_HZ;
use crate::timing::align::{self, Aligner, Alignment};
use crate::timing::axles::Signal;
use crate::timing::{Quiet, TrainMatch, coarse, find_train};
use crate::window::Cut;

/// Speed below which the method is weak, m/s: 40 km/h (paper, section 6.3).
const LOW_SPEED_M_S: f32 = 40.0 / 3.6;
/// Speeds this far outside the bins are still evaluated with the nearest one, relative. Half a per cent changes a
/// force by a few per mille.
pub const BIN_MARGIN: f32 = 0.005;
/// The track is quiet until the first axle is this near, m.
const QUIET_UNTIL_M: f32 = 9.0;
/// Fewest quiet samples that give a bias.
const LEAST_QUIET: usize = 100;

/// Most force values of a group.
const MAX_FORCES: usize = MAX_GROUP_AXLES * MAX_GRID;
/// Scratch space in numbers: the largest of the three steps that share it.
const WORK_LEN: usize = max(max(coarse::WORK_LEN, align::WORK_LEN), MAX_WINDOW + MAX_RANK + MAX_FORCES);

const fn max(a: usize, b: usize) -> usize {
    if a > b { a } else { b }
}

/// Memory of the evaluation, 16 kB, for a `static`.
#[derive(Debug)]
pub struct Scratch {
    work: [f32; WORK_LEN],
    chunk: [u8; CHUNK_LEN],
}

impl Default for Scratch {
    fn default() -> Self {
        Self::new()
    }
}

impl Scratch {
    /// Empty scratch space.
    pub const fn new() -> Self {
        Self { work: [0.0; WORK_LEN], chunk: [0; CHUNK_LEN] }
    }
}

/// The package in force.
#[derive(Debug)]
pub struct Kernel<'a, K> {
    /// Its header, checked.
    pub header: &'a Header,
    /// The header's CRC.
    pub id: u32,
    /// Access to its payload.
    pub payload: &'a mut K,
}

/// Evaluates a passage. Always gives a record; what could not be done is in its flags.
///
/// It yields to the executor about every millisecond of work.
pub async fn evaluate<K: KernelRead>(
    passage: &Passage,
    samples: &[f32],
    kernel: Option<Kernel<'_, K>>,
    scratch: &mut Scratch,
) -> Record {
    let mut record = blank(passage, samples);
    let Some(kernel) = kernel else {
        record.flags |= flag::NO_KERNEL;
        return record;
    };
    record.kernel_id = kernel.id;
    let mut pace = Pace::default();
    let train = &kernel.header.train;
    let found = find_train(samples, &train.axle_offset_m, &mut scratch.work, &mut pace).await;
    let Some(found) = found.filter(|found| found.is_expected(train.axle_offset_m.len())) else {
        record.flags |= flag::UNKNOWN_TRAIN;
        return record;
    };
    let quiet = note_train(&mut record, passage, samples, &found);
    let Some(bins) = Blend::at(&kernel.header.bins, found.speed_m_s) else {
        record.flags |= flag::SPEED_OUTSIDE;
        return record;
    };
    let mut run = Evaluation {
        header: kernel.header,
        signal: Signal { samples, mean: quiet.mean },
        speed_m_s: found.speed_m_s,
        bins,
        blocks: Blocks { kernel: kernel.payload, chunk: &mut scratch.chunk },
        pace,
    };
    if run.forces(&mut record, passage, &found, &mut scratch.work).await.is_err() {
        record.flags |= flag::KERNEL_READ;
        record.wheelsets.clear();
    }
    record
}

/// The record of a passage of which nothing but the recording is known; also what is left of a missed one.
pub fn blank(passage: &Passage, samples: &[f32]) -> Record {
    Record {
        format: FORMAT,
        sequence: passage.sequence,
        first_axle_sample: passage.first_sample,
        samples: passage.samples,
        kernel_id: 0,
        speed_m_s: 0.0,
        max_acceleration_m_s2: passage.max_acceleration_m_s2,
        quiet_rms_m_s2: Quiet::before_train(samples).rms,
        flags: passage.flags,
        wheelsets: heapless::Vec::new(),
    }
}

/// Puts speed and time into the record; returns bias and noise from all samples before the train.
fn note_train(record: &mut Record, passage: &Passage, samples: &[f32], found: &TrainMatch) -> Quiet {
    record.speed_m_s = found.speed_m_s;
    record.first_axle_sample = raw_sample(passage, found.first_axle_s);
    record.flags |= if found.speed_m_s < LOW_SPEED_M_S { flag::LOW_SPEED } else { 0 };
    let until_s = found.first_axle_s - QUIET_UNTIL_M / found.speed_m_s;
    let count = (until_s * crate::decimate::RATE_HZ) as usize;
    let quiet = match samples.get(..count) {
        Some(before) if count >= LEAST_QUIET => Quiet::of(before),
        _ => Quiet::before_train(samples),
    };
    record.quiet_rms_m_s2 = quiet.rms;
    quiet
}

fn raw_sample(passage: &Passage, time_s: f32) -> u64 {
    passage.first_sample.saturating_add((time_s * RAW_RATE_HZ as f32) as u64)
}

/// The two bins next to a speed and their weights, which sum to 1. Both are the same bin at the ends.
#[derive(Clone, Copy, Debug)]
struct Blend<'a> {
    bins: [&'a Bin; 2],
    weights: [f32; 2],
}

impl<'a> Blend<'a> {
    fn at(bins: &'a [Bin], v: f32) -> Option<Self> {
        let (first, last) = (bins.first()?, bins.last()?);
        if v < first.speed_m_s {
            return (v >= first.speed_m_s * (1.0 - BIN_MARGIN)).then_some(Self::only(first));
        }
        for (slow, fast) in bins.iter().zip(bins.get(1..)?) {
            if v <= fast.speed_m_s {
                let up = (v - slow.speed_m_s) / (fast.speed_m_s - slow.speed_m_s);
                return Some(Self { bins: [slow, fast], weights: [1.0 - up, up] });
            }
        }
        (v <= last.speed_m_s * (1.0 + BIN_MARGIN)).then_some(Self::only(last))
    }

    fn only(bin: &'a Bin) -> Self {
        Self { bins: [bin, bin], weights: [1.0, 0.0] }
    }

    fn nearest(&self) -> &'a Bin {
        let [slow, fast] = self.bins;
        if self.weights[0] >= 0.5 { slow } else { fast }
    }

    /// The operators of a kind, with their speeds and weights; without those of weight 0.
    fn operators(&self, kind: u8) -> impl Iterator<Item = (&'a Operator, f32, f32)> + use<'a> {
        let weighted = self.bins.into_iter().zip(self.weights).filter(|(_, weight)| *weight > 0.0);
        weighted.filter_map(move |(bin, weight)| {
            Some((bin.operators.get(usize::from(kind))?, bin.speed_m_s, weight))
        })
    }
}

struct Evaluation<'a, K> {
    header: &'a Header,
    signal: Signal<'a>,
    speed_m_s: f32,
    bins: Blend<'a>,
    blocks: Blocks<'a, K>,
    pace: Pace,
}

impl<K: KernelRead> Evaluation<'_, K> {
    /// Aligns the groups, then fills in one wheelset after the other.
    async fn forces(
        &mut self,
        record: &mut Record,
        passage: &Passage,
        found: &TrainMatch,
        work: &mut [f32],
    ) -> Result<(), BlockError> {
        let train = &self.header.train;
        let aligner =
            Aligner { signal: self.signal, train, bin: self.bins.nearest(), speed_m_s: self.speed_m_s };
        let alignment = aligner.run(found.first_axle_s, &mut self.blocks, work, &mut self.pace).await?;
        let first_s = alignment.group_time_s.first().copied().unwrap_or(found.first_axle_s);
        record.first_axle_sample = raw_sample(passage, first_s);
        let Alignment { group_time_s, quality } = alignment;
        for ((group, time_s), quality) in train.groups.iter().zip(group_time_s).zip(quality) {
            let whole = self.group_forces(group, time_s, work).await?;
            record.flags |= if whole { 0 } else { flag::WINDOW_CUT };
            let peaks = self.peaks(group, work).await?;
            for (axle, (peak, half_width_n)) in peaks.into_iter().enumerate() {
                let time_s = time_s - first_s + self.behind_s(group, axle);
                // There is room: a train has no more axles than the list.
                let _ = record.wheelsets.push(self.wheelset(peak, half_width_n, time_s, quality));
            }
        }
        Ok(())
    }

    /// How long after the first axle of its group an axle comes, s.
    fn behind_s(&self, group: &Group, axle: usize) -> f32 {
        let offsets = &self.header.train.axle_offset_m;
        let first = usize::from(group.first_axle);
        let offset = |index: usize| offsets.get(index).copied().unwrap_or(0.0);
        (offset(first + axle) - offset(first)) / self.speed_m_s
    }

    fn wheelset(&self, peak: Peak, half_width_n: f32, time_s: f32, match_quality: f32) -> Wheelset {
        let steps = peak.index as f32 + peak.shift;
        Wheelset {
            time_s,
            peak_force_n: peak.value,
            peak_position_m: self.header.grid_first_m + steps * self.header.grid_step_m,
            peak_half_width_n: half_width_n,
            match_quality,
        }
    }

    /// Forces of a group into the first part of `work`: offset + expand · (project · window) of both bins, blended.
    /// Returns whether the windows were within the recording.
    async fn group_forces(
        &mut self,
        group: &Group,
        group_time_s: f32,
        work: &mut [f32],
    ) -> Result<bool, BlockError> {
        let (forces, rest) = work.split_at_mut(MAX_FORCES.min(work.len()));
        let (reduced, window) = rest.split_at_mut(MAX_RANK.min(rest.len()));
        forces.fill(0.0);
        let mut whole = true;
        for (operator, bin_speed_m_s, weight) in self.bins.operators(group.operator) {
            let window = part(window, operator.project.cols)?;
            let reduced = part(reduced, operator.project.rows)?;
            let cut = Cut { group_time_s, speed_m_s: self.speed_m_s, bin_speed_m_s, before: operator.before };
            whole &= cut.fill(self.signal, window, &mut self.pace).await;
            let set = |row: usize, y| reduced.get_mut(row).into_iter().for_each(|slot| *slot = y);
            self.blocks.multiply(operator.project, window, &mut self.pace, set).await?;
            let mut add =
                |row: usize, y| forces.get_mut(row).into_iter().for_each(|slot| *slot += weight * y);
            self.blocks.elements(operator.offset_n, &mut self.pace, &mut add).await?;
            self.blocks.multiply(operator.expand, reduced, &mut self.pace, &mut add).await?;
        }
        Ok(whole)
    }

    /// Largest force of each axle of a group and the half width of its interval.
    async fn peaks(
        &mut self,
        group: &Group,
        forces: &[f32],
    ) -> Result<heapless::Vec<(Peak, f32), MAX_GROUP_AXLES>, BlockError> {
        let grid = usize::from(self.header.grid_len).max(1);
        let mut peaks = heapless::Vec::new();
        for curve in forces.chunks(grid).take(usize::from(group.axles)) {
            // A payload whose numbers are no numbers is as bad as one that cannot be read.
            let peak = largest(curve).ok_or(BlockError::Shape { cols: 1, len: grid })?;
            // There is room: a group has no more axles than the list.
            let _ = peaks.push((peak, 0.0));
        }
        for (operator, _, weight) in self.bins.operators(group.operator) {
            let pick = |row: usize, half_width_n| {
                if let Some((peak, sum)) = peaks.get_mut(row / grid)
                    && peak.index == row % grid
                {
                    *sum += weight * half_width_n;
                }
            };
            self.blocks.elements(operator.half_width_n, &mut self.pace, pick).await?;
        }
        Ok(peaks)
    }
}

/// The first `len` numbers of a part of the scratch space. The header's check makes sure that they fit.
fn part(work: &mut [f32], len: u16) -> Result<&mut [f32], BlockError> {
    let room = work.len();
    work.get_mut(..usize::from(len)).ok_or(BlockError::Shape { cols: len, len: room })
}
