//! Contact force of every wheelset of a passage, with intervals.

use rayon::prelude::*;

use crate::identify::IdentifiedSite;
use crate::inverse::hierarchy::{SitePassage, kinds};
use crate::inverse::{Estimator, Excitation, GroupGeometry, InverseError, Running, TrackModel};

/// Forces are low-passed here, Hz (paper, section 4.2): the displacement holds hardly any energy above.
pub const LOW_PASS_HZ: f64 = 250.0;

/// Crossing-side force of one wheelset along the track.
#[derive(Clone, Debug)]
pub struct WheelForce {
    /// Index of the axle in the train.
    pub wheelset: usize,
    /// x, metres, in the order of passing, equidistant in time.
    pub position_m: Vec<f64>,
    /// Low-passed at [`LOW_PASS_HZ`], newtons.
    pub force_n: Vec<f64>,
    /// Standard deviation, newtons.
    pub sd_n: Vec<f64>,
}

/// Forces of the wheelsets of passage `index`, over the whole stretch in which they are estimated, at the sampling rate
/// of the Green's functions.
pub fn wheel_forces(site: &IdentifiedSite, index: usize) -> Result<Vec<WheelForce>, InverseError> {
    let passage = SitePassage {
        recording: &site.recordings[index],
        timing: site.timings[index],
        static_force_n: site.static_force_n[index],
    };
    let speed = passage.timing.speed_m_s;
    let rate = site.greens.sampling.rate_hz;
    let reach = (site.prior.half_m / speed * rate).floor() as i64;
    let position_m: Vec<f64> = (-reach..=reach).map(|j| site.direction * speed * j as f64 / rate).collect();
    let mut forces = Vec::new();
    for kind in kinds(&site.pattern) {
        let geometry = GroupGeometry {
            running: Running {
                direction: site.direction,
                speed_m_s: speed,
                static_force_n: passage.static_force_n,
            },
            axle_offset_m: &kind.offsets.own,
            train_offset_m: &kind.offsets.train,
        };
        let model = TrackModel { greens: &site.greens, excitation: Excitation::Force };
        let estimator = Estimator::new(&model, &geometry, &site.prior, &site.profile)?;
        let gains = estimator.gains(&position_m, LOW_PASS_HZ, &site.profile);
        for group in &kind.groups {
            let start =
                passage.timing.axle_s(site.pattern.offset_m[group.first]) - estimator.before as f64 / rate;
            let window = passage.recording.window(start, rate, estimator.len(), site.greens.sampling.band_hz);
            let residual: Vec<f64> =
                window.iter().zip(&estimator.expected_m_s2).map(|(a, b)| a - b).collect();
            for (axle, gain) in gains.iter().enumerate() {
                forces.push(WheelForce {
                    wheelset: group.first + axle,
                    position_m: position_m.clone(),
                    force_n: gain.apply(&residual),
                    sd_n: gain.sd_n.clone(),
                });
            }
        }
    }
    forces.sort_by_key(|f| f.wheelset);
    Ok(forces)
}

/// [`wheel_forces`] of all passages, in order, on all cores.
pub fn all_wheel_forces(
    site: &IdentifiedSite,
    done: &(dyn Fn() + Sync),
) -> Result<Vec<Vec<WheelForce>>, InverseError> {
    (0..site.recordings.len())
        .into_par_iter()
        .map(|i| {
            let forces = wheel_forces(site, i);
            done();
            forces
        })
        .collect()
}
