//! Which speeds a package covers when the node cannot hold all that were recorded.

use std::ops::Range;

use cpcm_shared::evaluate::BIN_MARGIN;

/// What a speed bin asks of the node.
#[derive(Clone, Copy, Debug)]
pub(super) struct Demand {
    pub(super) speed_m_s: f64,
    /// Bytes of its operators; `None` where one of them is longer or wider than the node takes.
    pub(super) bytes: Option<usize>,
}

/// What the node has room for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Room {
    pub(super) bins: usize,
    pub(super) bytes: usize,
}

/// Neighbouring bins (ascending speed) within the room that cover most of the recorded speeds; of several, those of the fewest bytes.
pub(super) fn choose(bins: &[Demand], recorded_m_s: &[f64], room: Room) -> Option<Range<usize>> {
    let bytes =
        |range: &Range<usize>| bins.get(range.clone())?.iter().map(|b| b.bytes).sum::<Option<usize>>();
    (0..bins.len())
        .flat_map(|first| (first + 1..=bins.len()).map(move |end| first..end))
        .filter(|range| range.len() <= room.bins)
        .filter_map(|range| bytes(&range).filter(|b| *b <= room.bytes).map(|b| (range, b)))
        .map(|(range, bytes)| (covered(&bins[range.clone()], recorded_m_s), bytes, range))
        .filter(|(count, ..)| *count > 0)
        .max_by(|a, b| a.0.cmp(&b.0).then(b.1.cmp(&a.1)))
        .map(|(.., range)| range)
}

/// Recorded speeds that lie between the bins.
fn covered(bins: &[Demand], recorded_m_s: &[f64]) -> usize {
    recorded_m_s.iter().filter(|v| covers(bins, **v)).count()
}

/// Whether a node with these bins evaluates a train of this speed.
pub(super) fn covers(bins: &[Demand], speed_m_s: f64) -> bool {
    match (bins.first(), bins.last()) {
        (Some(slow), Some(fast)) => {
            let margin = f64::from(BIN_MARGIN);
            ((1.0 - margin) * slow.speed_m_s..=(1.0 + margin) * fast.speed_m_s).contains(&speed_m_s)
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROOM: Room = Room { bins: 4, bytes: 100 };

    fn bins(bytes: &[Option<usize>]) -> Vec<Demand> {
        bytes.iter().zip(1..).map(|(b, v)| Demand { speed_m_s: 10.0 * f64::from(v), bytes: *b }).collect()
    }

    #[test]
    fn property_most_trains_in_the_fewest_bytes() {
        let some = |b: [usize; 6]| bins(&b.map(Some));
        // All fit in number but not in bytes: the trains are fast.
        assert_eq!(choose(&some([60, 50, 40, 30, 20, 10]), &[31.0, 45.0, 59.0], ROOM), Some(2..6));
        // The slow ones need more room each, and there are more of them.
        assert_eq!(choose(&some([60, 40, 40, 30, 20, 10]), &[12.0, 14.0, 55.0], ROOM), Some(0..2));
        // No more than needed.
        assert_eq!(choose(&some([10, 10, 10, 10, 10, 10]), &[25.0], ROOM), Some(1..3));
        // Half a per cent outside, one bin does.
        assert_eq!(choose(&some([10, 10, 10, 10, 10, 10]), &[20.05], ROOM), Some(1..2));
    }

    #[test]
    fn property_what_the_node_cannot_take_is_left_out() {
        let wide = bins(&[None, None, Some(10), Some(10), None, Some(10)]);
        assert_eq!(choose(&wide, &[15.0, 16.0, 35.0, 55.0], ROOM), Some(2..4));
        assert_eq!(choose(&wide, &[15.0, 16.0, 55.0], ROOM), None);
        assert_eq!(choose(&bins(&[Some(101)]), &[10.0], ROOM), None);
        assert_eq!(choose(&[], &[10.0], ROOM), None);
        assert_eq!(choose(&wide, &[f64::NAN], ROOM), None);
    }
}
