//! Which passages a site is identified from: one with a spike, a gap or half a train in it spoils ballast and forces of all others.

use super::IdentifyError;
use super::known::{Found, Known, Start};
use crate::progress::Progress;
use crate::signal::quantile;

/// Misfit above which the model does not explain a passage. Sound passages of eleven recorded sites and 20 simulated ones are between
/// 0.1 and 1.6, most of those with clipping, spikes, gaps, drift or half a train in them between 3 and 10 000.
pub const UNLIKE: f64 = 3.0;
/// A passage is left out of the identification where its misfit is this many times the median of the site's: of sound sites, the
/// largest is 2.4 times. The absolute value says little before: priors widen until they hold what spoils the site.
const ODD: f64 = 4.0;
/// Medians below this are taken as this: prior and noise are wide by then.
const LEAST_MEDIAN: f64 = 0.25;
/// Identifications at most.
const ROUNDS: usize = 4;
/// Passages that must stay.
pub(super) const LEAST_PASSAGES: usize = 3;

impl Known<'_> {
    /// Identifies the site from some passages with their quasi-static fit, again without those that stand out, until none does; one
    /// that stood out because of another comes back. Where fewer than half would be left, none is left out any more: nobody can tell
    /// then which ones are right.
    pub(super) fn of_sound_passages(
        &self,
        some: &[usize],
        start: Start,
        progress: &dyn Progress,
    ) -> Result<(Vec<usize>, Found), IdentifyError> {
        let mut used = some.to_vec();
        let mut found = self.find(&used, start, progress)?;
        for _ in 1..ROUNDS {
            found = self.with_the_others(&used, found)?;
            let mut stay = staying(&used, &found.misfit);
            stay.retain(|i| some.contains(i));
            if stay == used || stay.len() < LEAST_PASSAGES || 2 * stay.len() < some.len() {
                return Ok((used, found));
            }
            found = self.find(&stay, self.start(&stay, progress), progress)?;
            used = stay;
        }
        let found = self.with_the_others(&used, found)?;
        Ok((used, found))
    }
}

/// Passages that do not stand out from those used, by their place in the site.
fn staying(used: &[usize], misfit: &[f64]) -> Vec<usize> {
    let of_used: Vec<f64> = used.iter().map(|i| misfit[*i]).collect();
    let limit = ODD * quantile(&of_used, 0.5).max(LEAST_MEDIAN);
    (0..misfit.len()).filter(|i| misfit[*i] <= limit).collect()
}

/// Which passages the model explains. None where it explains less than half of those that it should, or no more than half of those that it
/// was made from: what little it has left of the others is then no proof of it.
pub(super) fn explained(used: &[usize], should: &[usize], misfit: &[f64]) -> Vec<bool> {
    let mut explained = vec![false; misfit.len()];
    used.iter().for_each(|i| explained[*i] = misfit[*i] <= UNLIKE);
    let count = explained.iter().filter(|e| **e).count();
    let proven = 2 * count >= should.len() && 2 * count > used.len();
    if proven { explained } else { vec![false; misfit.len()] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn property_less_than_half_is_nothing() {
        let all = [0, 1, 2, 3];
        assert_eq!(explained(&[0, 1, 3], &all, &[0.5, 3.5, 0.4, 2.0]), [true, false, false, true]);
        assert_eq!(explained(&[0, 1, 3], &all, &[0.5, 3.5, 0.4, 9.0]), [false; 4]);
        // Half of a site may be spoilt, but not half of what the model was made from.
        assert_eq!(explained(&[0, 3], &all, &[0.5, 3.5, 9.0, 2.0]), [true, false, false, true]);
        assert_eq!(explained(&all, &all, &[0.5, 3.5, 9.0, 2.0]), [false; 4]);
        assert_eq!(explained(&all, &all, &[0.5, 3.5, 0.4, 2.0]), [true, false, true, true]);
        assert!(explained(&[], &[], &[]).is_empty());
    }

    #[test]
    fn property_what_stands_out_goes() {
        let all = [0, 1, 2, 3, 4];
        assert_eq!(staying(&all, &[0.5, 0.4, 1.2, 0.6, 0.5]), all);
        assert_eq!(staying(&all, &[0.5, 0.4, 36.0, 0.6, f64::NAN]), [0, 1, 3]);
        // A wide prior makes all of them small.
        assert_eq!(staying(&all, &[0.01, 0.04, 3.7, 0.02, 0.06]), [0, 1, 3, 4]);
        assert_eq!(staying(&all, &[0.01, 0.04, 0.6, 0.02, 0.06]), all);
        // Where nothing fits, what is least wrong is no yardstick.
        assert_eq!(staying(&all, &[20.0, 70.0, 30.0, 50.0, 10.0]), all);
        // One that was left out is judged by the others, and comes back.
        assert_eq!(staying(&[0, 1, 3], &[0.5, 0.6, 0.7, 0.4, 36.0]), [0, 1, 2, 3]);
    }
}
