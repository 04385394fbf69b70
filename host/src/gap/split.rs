//! Which passages are learnt from, and which are kept for nothing but the final numbers.

use crate::recording::Site;

/// Indices among the site's passages.
#[derive(Clone, Debug, PartialEq)]
pub struct Split {
    /// Fit and selection.
    pub train: Vec<usize>,
    /// Held out.
    pub test: Vec<usize>,
}

/// Every third passage in the order of speed is held out, so that both parts cover all speeds. With fewer than three there is
/// nothing to hold out: the passages are used twice, which the verdict says.
///
/// Order and choice depend on the recordings only, not on names or places in the file.
pub fn split(site: &Site) -> Split {
    let mut order: Vec<usize> = (0..site.passages.len()).collect();
    let key = |i: &usize| {
        let p = &site.passages[*i];
        (p.speed_m_s.unwrap_or(0.0), p.acceleration_m_s2.len(), p.passage_id)
    };
    order.sort_by(|a, b| {
        let (a, b) = (key(a), key(b));
        a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)).then(a.2.cmp(&b.2))
    });
    if order.len() < 3 {
        return Split { train: order.clone(), test: order };
    }
    let pick = |keep: bool| {
        order.iter().enumerate().filter(|(k, _)| (k % 3 == 1) == keep).map(|(_, i)| *i).collect()
    };
    Split { train: pick(false), test: pick(true) }
}
