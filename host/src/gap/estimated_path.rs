//! The path over a crossing that nobody has scanned: what `analyse` makes of the passages that are learnt from.

use std::borrow::Cow;

use super::base::PathPrior;
use super::diagnosis::PATH_PRIOR;
use crate::pipeline::{AnalyseOptions, analyse};
use crate::progress::Progress;
use crate::recording::{Scan, Site};

/// Standard deviation of the path around an estimated one, metres. With that of a scan, 10 µm, ballast takes over what is wrong with it
/// (shape p3 of 1.0 on reference-1 and -2 without their scans); with 120 µm both have the gap and the ballast that they have with them.
pub const ESTIMATED_PATH_PRIOR: PathPrior = PathPrior { inside_m: 120e-6, ..PATH_PRIOR };

/// The site with a path, and how far the true one may be from it: its scan or, without one, what some of its passages say, where they can
/// be identified. Owned where it is estimated.
pub fn with_path<'s>(
    site: &'s Site,
    passages: &[usize],
    progress: &dyn Progress,
) -> (Cow<'s, Site>, PathPrior) {
    let estimated = match site.scan {
        Some(_) => None,
        None => with_estimated_path(site, passages, progress),
    };
    match estimated {
        Some(estimated) => (Cow::Owned(estimated), ESTIMATED_PATH_PRIOR),
        None => (Cow::Borrowed(site), PATH_PRIOR),
    }
}

/// The site with the irregularity that all wheels of some of its passages share as its scan; nothing where they cannot be identified.
fn with_estimated_path(site: &Site, passages: &[usize], progress: &dyn Progress) -> Option<Site> {
    let learnt_from = site.with_passages(passages.iter().map(|i| site.passages[*i].clone()).collect());
    let found = analyse(&learnt_from, &AnalyseOptions::default(), progress).ok()?.indicators;
    let scan = Scan { position_m: found.position_m, irregularity_m: found.irregularity_mode_m };
    let usable = scan.position_m.len() > 1 && scan.irregularity_m.iter().all(|depth_m| depth_m.is_finite());
    usable.then(|| Site { scan: Some(scan), ..site.clone() })
}
