//! A track at the low sampling of the calibration, on one ballast after the other.

use std::sync::{Arc, Mutex, PoisonError};

use super::BallastParameters;
use crate::greens::{Chain, GreensFunctions, GreensSampling, Quantity};
use crate::interaction::{BogieResponses, Interaction};
use crate::inverse::{Excitation, TrackModel};
use crate::recording::{Crossing, Vehicle};
use crate::track::{Mesh, Track};

/// Models that are kept, those asked for last. Where a search begins, what a glance at the site has asked for is asked for again, and
/// what the hyper-parameters were chosen on.
const KEPT: usize = 6;

/// Track without ballast, and what became of it on the ballasts asked for last. Whichever way trains run, it is the same.
pub struct LowTrack {
    /// Track without ballast.
    pub track: Track,
    bogie: Arc<BogieResponses>,
    /// Last one last.
    latest: Mutex<Vec<Known>>,
}

struct Known {
    ballast: BallastParameters,
    half_m: f64,
    model: Arc<LowModel>,
}

impl LowTrack {
    /// Under a vehicle.
    pub fn new(track: Track, vehicle: &Vehicle) -> Self {
        let bogie = Arc::new(BogieResponses::new(vehicle, GreensSampling::low()));
        Self { track, bogie, latest: Mutex::default() }
    }

    /// As crossing.toml has it.
    pub fn of_crossing(crossing: &Crossing) -> Self {
        Self::new(Track::of_crossing(crossing, Mesh::default()), &crossing.vehicle)
    }

    /// Model on a ballast, for forces within `half_m` of x = 0.
    pub fn model(&self, ballast: &BallastParameters, half_m: f64) -> Arc<LowModel> {
        if let Some(model) = self.kept(ballast, half_m) {
            return model;
        }
        // Not under the lock: others that this thread takes over while it waits for its own work may ask, too.
        let model = Arc::new(self.passing_model(ballast, half_m));
        let mut latest = self.latest.lock().unwrap_or_else(PoisonError::into_inner);
        if latest.len() == KEPT {
            latest.remove(0);
        }
        latest.push(Known { ballast: *ballast, half_m, model: Arc::clone(&model) });
        model
    }

    /// The same where nobody will ask for it again.
    pub fn passing_model(&self, ballast: &BallastParameters, half_m: f64) -> LowModel {
        let sensor = (Quantity::Acceleration, &Chain::Corrected);
        let (track, bed) = (ballast.under(&self.track), ballast.bed(&self.track));
        let (interaction, greens) = Interaction::and_sensor(&track, &bed, &self.bogie, half_m, sensor);
        LowModel { greens, interaction }
    }

    fn kept(&self, ballast: &BallastParameters, half_m: f64) -> Option<Arc<LowModel>> {
        let latest = self.latest.lock().unwrap_or_else(PoisonError::into_inner);
        let known = latest.iter().find(|k| k.ballast == *ballast && k.half_m == half_m)?;
        Some(Arc::clone(&known.model))
    }
}

/// Track of given ballast at the low sampling.
pub struct LowModel {
    greens: GreensFunctions,
    interaction: Interaction,
}

impl LowModel {
    /// As the inverse needs it.
    pub fn track_model(&self) -> TrackModel<'_> {
        TrackModel { greens: &self.greens, excitation: Excitation::Irregularity(&self.interaction) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::verification::reference::{STIFF, panel, vehicle};

    /// What is kept is what was asked for, by ballast and reach, and does not grow.
    #[test]
    fn property_models_are_kept_by_what_they_are_of() {
        let low = LowTrack::new(panel(STIFF, Mesh::default()), &vehicle());
        let ballast = BallastParameters::NOMINAL;
        let first = low.model(&ballast, 1.0);
        assert!(Arc::ptr_eq(&first, &low.model(&ballast, 1.0)));
        assert!(!Arc::ptr_eq(&first, &low.model(&ballast, 1.5)));
        for k in 0..2 * KEPT {
            let other = ballast.moved(0, 0.1 * (k + 1) as f64);
            assert!(!Arc::ptr_eq(&first, &low.model(&other, 1.0)));
        }
        assert_eq!(low.latest.lock().unwrap().len(), KEPT);
        assert!(!Arc::ptr_eq(&first, &low.model(&ballast, 1.0)), "long ago");
    }
}
