//! Classes of speed: over a crossing the force of a train at 15 m/s is another than that of one at 45 m/s, by more than in proportion to
//! the speed. Trains of one class share their force; ballast is that of all.

use faer::MatRef;

use super::common_force;
use crate::greens::GreensFunctions;
use crate::inverse::hierarchy::{SitePassage, SitePosterior};
use crate::inverse::{CommonProfile, InverseError, Prior};
use crate::progress::Progress;
use crate::vehicle::AxlePattern;

/// Fastest over slowest train of a class. A force in proportion to the speed holds for trains that differ by a half: simulated trains of
/// 31 to 60 m/s in one class have peaks 0.64 % wrong in the median, of 42 to 49 m/s 0.34 %; of 15 and 45 m/s 6.5 %.
const WIDEST: f64 = 1.5;

/// What trains of about the same speed share.
pub struct ForceClass {
    /// Slowest and fastest of them, m/s.
    pub speeds_m_s: [f64; 2],
    /// Prior of the forces at the full band.
    pub prior: Prior,
    /// Posterior at the full band.
    pub posterior: SitePosterior,
}

impl ForceClass {
    /// Force deviation that all wheels share.
    pub fn profile(&self) -> &CommonProfile {
        &self.posterior.profile
    }

    /// Posterior covariance of that profile's entries.
    pub fn profile_covariance(&self) -> MatRef<'_, f64> {
        let p = self.profile().value.len();
        self.posterior.covariance.submatrix(0, 0, p, p)
    }

    /// How far a speed is from those of the class, as a ratio's logarithm.
    fn distance(&self, speed_m_s: f64) -> f64 {
        let [slow, fast] = self.speeds_m_s;
        (slow / speed_m_s).ln().max((speed_m_s / fast).ln()).max(0.0)
    }
}

/// The class of a speed, or the next one.
pub(super) fn class_of(classes: &[ForceClass], speed_m_s: f64) -> usize {
    let nearest =
        |a: &usize, b: &usize| classes[*a].distance(speed_m_s).total_cmp(&classes[*b].distance(speed_m_s));
    (0..classes.len()).min_by(nearest).unwrap_or(0)
}

/// Force that the wheels of every class share, with the axle times; and the misfit of every passage.
pub(super) fn forces_of_classes(
    greens: &GreensFunctions,
    direction: f64,
    pattern: &AxlePattern,
    passages: &mut [SitePassage],
    progress: &dyn Progress,
) -> Result<(Vec<ForceClass>, Vec<f64>), InverseError> {
    let speeds: Vec<f64> = passages.iter().map(|p| p.timing.speed_m_s).collect();
    let mut misfit = vec![0.0; passages.len()];
    let mut classes = Vec::new();
    for members in members(&speeds) {
        let mut own: Vec<SitePassage> = members.iter().map(|i| passages[*i]).collect();
        let (prior, posterior) = common_force(greens, direction, pattern, &mut own, progress)?;
        for ((i, passage), m) in members.iter().zip(own).zip(&posterior.misfit) {
            passages[*i] = passage;
            misfit[*i] = *m;
        }
        let ends = |f: fn(f64, f64) -> f64, start: f64| members.iter().map(|i| speeds[*i]).fold(start, f);
        let speeds_m_s = [ends(f64::min, f64::INFINITY), ends(f64::max, 0.0)];
        classes.push(ForceClass { speeds_m_s, prior, posterior });
    }
    Ok((classes, misfit))
}

/// Passages of every class, slowest class first, each in the order of the passages.
fn members(speed_m_s: &[f64]) -> Vec<Vec<usize>> {
    let mut order: Vec<usize> = (0..speed_m_s.len()).collect();
    order.sort_by(|a, b| speed_m_s[*a].total_cmp(&speed_m_s[*b]));
    let ascending: Vec<f64> = order.iter().map(|i| speed_m_s[*i]).collect();
    let mut first = 0;
    split(&ascending)
        .into_iter()
        .map(|len| {
            let mut members = order[first..first + len].to_vec();
            first += len;
            members.sort_unstable();
            members
        })
        .collect()
}

/// Sizes of the classes of ascending speeds: halved where the wider half is narrowest, until all are narrow enough.
fn split(ascending: &[f64]) -> Vec<usize> {
    let width = |s: &[f64]| match (s.first(), s.last()) {
        (Some(slow), Some(fast)) => fast / slow,
        _ => 1.0,
    };
    if ascending.len() < 2 || width(ascending) <= WIDEST {
        return vec![ascending.len()];
    }
    let wider = |at: &usize| width(&ascending[..*at]).max(width(&ascending[*at..]));
    let at = (1..ascending.len()).min_by(|a, b| wider(a).total_cmp(&wider(b))).unwrap_or(1);
    [split(&ascending[..at]), split(&ascending[at..])].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn property_speeds_that_differ_little_are_one_class() {
        assert_eq!(members(&[45.0, 41.0, 49.0, 40.0]), [[0, 1, 2, 3]]);
        assert_eq!(members(&[45.0]), [[0]]);
        assert_eq!(members(&[45.0, f64::NAN]).concat().len(), 2);
    }

    #[test]
    fn property_classes_part_at_the_gap_and_keep_the_order() {
        assert_eq!(members(&[45.0, 15.0, 49.0, 16.0, 47.0]), [vec![1, 3], vec![0, 2, 4]]);
        assert_eq!(members(&[10.0, 25.0, 60.0, 11.0]), [vec![0, 3], vec![1], vec![2]]);
        // Without a gap, in the middle.
        assert_eq!(split(&[30.0, 35.0, 40.0, 45.0, 50.0, 55.0]), [3, 3]);
    }
}
