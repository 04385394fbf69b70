//! The node as a stage of its own in the substitution ladder: sensor codes, f32 arithmetic and decimation against the same
//! recording in f64 with an ideal low-pass.
//!
//! What this leaves is in every result of the node and in none of the host, whatever the model. Measured on reference-1:
//! 1.4 % of the signal. The ripple of the decimation filter explains 0.5 % of it; the rest, probably its transition next to
//! 250 Hz, has not been taken apart.

use cpcm_shared::decimate::{DECIMATION, DELAY_SAMPLES, Decimator, PASS_HZ, TAPS_LEN};
use cpcm_shared::sample::{RAW_RATE_HZ, SensorCode};

use crate::recording::{Passage, Site};
use crate::signal::{brick_band, quantile};

/// From here on the node's own arithmetic is worth a remark: as much as the floor of the best field recordings leaves room
/// for.
pub const NOTABLE: f64 = 0.02;

/// RMS of (node − host) over RMS of host below 250 Hz, median over the passages; `None` where the node could not sample so.
pub fn node_gap(site: &Site) -> Option<f64> {
    let gaps: Vec<f64> = site.passages.iter().filter_map(of_passage).collect();
    (!gaps.is_empty()).then(|| quantile(&gaps, 0.5))
}

fn of_passage(passage: &Passage) -> Option<f64> {
    let rate = f64::from(RAW_RATE_HZ);
    if passage.sample_rate_hz != rate || passage.acceleration_m_s2.len() < 4 * TAPS_LEN {
        return None;
    }
    let raw: Vec<f64> = passage.acceleration_m_s2.iter().map(|a| f64::from(*a)).collect();
    let mut decimator = Decimator::new();
    let node: Vec<(usize, f64)> = raw
        .iter()
        .enumerate()
        .filter_map(|(i, a)| Some((i, f64::from(decimator.push(SensorCode::from_m_s2(*a))?))))
        .collect();
    // The ends of the filters are no part of the comparison.
    let edge = TAPS_LEN;
    let node_rate = rate / DECIMATION as f64;
    let values: Vec<f64> = node.iter().map(|n| n.1).collect();
    let banded = brick_band(&values, node_rate, 1.0, PASS_HZ);
    let ideal = brick_band(&raw, rate, 1.0, PASS_HZ);
    let (mut off, mut all) = (0.0, 0.0);
    for ((newest, _), y) in node.iter().zip(&banded).skip(edge).take(node.len().saturating_sub(2 * edge)) {
        let host = ideal[newest - DELAY_SAMPLES as usize];
        off += (y - host).powi(2);
        all += host * host;
    }
    (all > 0.0).then(|| (off / all).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn property_node_stage_is_small_within_its_range_and_shows_clipping() {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field/reference-1");
        let mut site = crate::recording::read_site(&dir).unwrap();
        site.passages.truncate(3);
        let gap = node_gap(&site).unwrap();
        assert!(gap > 1e-5 && gap < NOTABLE, "{gap}");
        // A recording beyond the node's range of 40 g: its clipping shows here.
        for a in site.passages.iter_mut().flat_map(|p| &mut p.acceleration_m_s2) {
            *a *= 20.0;
        }
        assert!(node_gap(&site).unwrap() > NOTABLE);
        site.passages.iter_mut().for_each(|p| p.sample_rate_hz = 3200.0);
        assert_eq!(node_gap(&site), None);
    }
}
