//! Where a transducer clips, by its recordings alone: values pile up at its range.

use crate::recording::{Passage, Site};

/// Flat tops are looked for from here to a little above the largest value, in these steps, relative to it: a recorder's low-pass
/// overshoots, and interference after the transducer spreads the tops.
const SOUGHT: (f64, f64, f64) = (0.8, 1.006, 0.001);
/// Samples this near to a value are counted as at it, relative to the largest.
const WITHIN: f64 = 0.005;
/// Where the values lie that tell how many would be there without clipping, below it, relative to the largest.
const BELOW: (f64, f64) = (0.08, 0.03);
/// Standard deviations by which the count must exceed that. Of 509 simulated sites, those that clip have 17 and more (but one, on
/// which a quarter of the recordings do), all others up to 4.4.
const PILED: f64 = 10.0;
/// Samples at the top in a recording that clips.
const LEAST_SAMPLES: usize = 4;

/// Range of a transducer that clips, and how far it may be off, m/s²: values pile up there in most recordings. Needs no model.
pub fn flat_top_m_s2(site: &Site) -> Option<(f64, f64)> {
    let top = site.passages.iter().flat_map(magnitudes).fold(0.0, f64::max);
    let least = (SOUGHT.0 - BELOW.0) * top;
    let high = |p: &Passage| Sorted::of(magnitudes(p).filter(|a| *a >= least).collect());
    let passages: Vec<Sorted> = site.passages.iter().map(high).collect();
    let all = |from: f64, to: f64| -> f64 {
        passages.iter().map(|p| p.between(from * top, to * top)).sum::<usize>() as f64
    };
    let at = |x: f64| all(x - WITHIN, x + WITHIN);
    let expected = |x: f64| all(x - BELOW.0, x - BELOW.1) * 2.0 * WITHIN / (BELOW.0 - BELOW.1);
    let steps = ((SOUGHT.1 - SOUGHT.0) / SOUGHT.2).round() as usize;
    let grid: Vec<f64> = (0..=steps).map(|k| SOUGHT.0 + k as f64 * SOUGHT.2).collect();
    let excess = |x: &f64| (at(*x) - expected(*x)) / (expected(*x) + 1.0).sqrt();
    let pile = grid.iter().copied().max_by(|a, b| excess(a).total_cmp(&excess(b)))?;
    let clips = |p: &&Sorted| p.between((pile - WITHIN) * top, (pile + WITHIN) * top) >= LEAST_SAMPLES;
    if excess(&pile) < PILED || 2 * passages.iter().filter(clips).count() <= passages.len() {
        return None;
    }
    // Interference on top of the flat tops makes two piles, at its crests and troughs: the range is half way.
    let least = 0.5 * (at(pile) + expected(pile));
    let mut high = grid.iter().filter(|x| at(**x) > least);
    let first = *high.next()?;
    let last = *high.next_back().unwrap_or(&first);
    Some((0.5 * (first + last) * top, (0.5 * (last - first)).max(WITHIN) * top))
}

fn magnitudes(passage: &Passage) -> impl Iterator<Item = f64> + '_ {
    passage.acceleration_m_s2.iter().map(|a| f64::from(a.abs()))
}

/// Values in ascending order.
struct Sorted(Vec<f64>);

impl Sorted {
    fn of(mut values: Vec<f64>) -> Self {
        values.sort_unstable_by(f64::total_cmp);
        Self(values)
    }

    /// Values in an interval.
    fn between(&self, from: f64, to: f64) -> usize {
        self.0.partition_point(|a| *a <= to) - self.0.partition_point(|a| *a < from)
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::recording::read_site;

    fn site(name: &str) -> Site {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field");
        read_site(&root.join(name)).unwrap()
    }

    #[test]
    fn reference_range_of_the_known_site_that_clips() {
        // truth.toml: 9 g.
        let (range, within) = flat_top_m_s2(&site("known-saturation")).unwrap();
        assert!((range - 88.29).abs() < within && within < 0.01 * range, "{range} +- {within}");
    }

    #[test]
    fn reference_recordings_that_do_not_clip_have_no_flat_tops() {
        for name in ["reference-1", "reference-2", "reference-3", "known-pad-stiffness"] {
            assert_eq!(flat_top_m_s2(&site(name)), None, "{name}");
        }
    }

    #[test]
    fn property_interference_after_clipping_does_not_shift_the_range() {
        let mut site = site("known-saturation");
        for p in &mut site.passages {
            let rate = p.sample_rate_hz;
            for (k, a) in p.acceleration_m_s2.iter_mut().enumerate() {
                *a += (3.5 * (std::f64::consts::TAU * 50.0 * k as f64 / rate).sin()) as f32;
            }
        }
        let (range, within) = flat_top_m_s2(&site).unwrap();
        assert!((range - 88.29).abs() < 0.01 * range && within > 0.02 * range, "{range} +- {within}");
    }
}
