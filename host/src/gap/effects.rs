//! The catalogue: one file per effect, registered here.

mod around_wheels;
mod axle_load;
pub(super) mod bias_step;
mod ballast_mass;
mod ballast_stiffening;
mod clock_error;
mod crossing_rail;
mod front_rear;
mod gain_temperature;
mod hollow_wheels;
mod load_transfer;
mod mount_resonance;
mod pad_stiffness;
pub mod saturation;
mod stock_irregularity;
mod support_loss;
mod tonal;
mod unsprung_mass;
mod voided_sleepers;
mod wheel_flat;
mod wheel_out_of_roundness;

use super::effect::{Advice, Effect, Stage};
use super::included::Inclusion;
use super::latent::Latent;

/// Effects that all wheels and passages share.
pub static COMMON: [&dyn Effect; 15] = [
    &voided_sleepers::VoidedSleepers,
    &ballast_stiffening::BallastStiffening,
    &ballast_mass::BallastMass,
    &support_loss::SupportLoss,
    &pad_stiffness::PadStiffness,
    &crossing_rail::CrossingRail,
    &axle_load::AxleLoad,
    &unsprung_mass::UnsprungMass,
    &load_transfer::LoadTransfer,
    &front_rear::FrontRear,
    &stock_irregularity::StockIrregularity,
    &gain_temperature::GainTemperature,
    &saturation::Saturation,
    &clock_error::ClockError,
    &mount_resonance::MountResonance,
];

/// Effects that differ from wheel to wheel or from passage to passage.
pub static LATENT: [&dyn Latent; 5] = [
    &wheel_out_of_roundness::WheelOutOfRoundness,
    &wheel_flat::WheelFlat,
    &hollow_wheels::HollowWheels,
    &tonal::Tonal,
    &bias_step::BiasStep,
];

/// Names of all effects of the catalogue, as in the contract.
pub fn names() -> impl Iterator<Item = &'static str> {
    COMMON.into_iter().map(|e| e.name()).chain(LATENT.into_iter().map(|e| e.name()))
}

/// What an effect of the catalogue means, and what to do about it.
pub fn advice(name: &str) -> Option<Advice> {
    of_either(name, |e| e.advice(), |e| e.advice())
}

/// What `--with-effects` does with an effect of the catalogue.
pub fn inclusion(name: &str) -> Option<Inclusion> {
    of_either(name, |e| e.inclusion(), |e| e.inclusion())
}

/// Place in the chain of an effect of the catalogue.
pub fn stage_of(name: &str) -> Option<Stage> {
    of_either(name, |e| e.stage(), |e| e.stage())
}

fn of_either<T>(name: &str, of_latent: fn(&dyn Latent) -> T, of_common: fn(&dyn Effect) -> T) -> Option<T> {
    let latent = LATENT.into_iter().find(|e| e.name() == name).map(of_latent);
    latent.or_else(|| common(name).map(of_common))
}

/// An effect that all wheels and passages share, by its name in the contract.
pub fn common(name: &str) -> Option<&'static dyn Effect> {
    COMMON.into_iter().find(|e| e.name() == name)
}

/// The forms that an effect of the panel may have, that of the catalogue first; none if it is not in there.
pub fn forms(name: &str) -> Vec<&'static dyn Effect> {
    let more: Option<&'static dyn Effect> =
        (name == voided_sleepers::VoidedSleepers.name()).then_some(&voided_sleepers::VoidOverFive);
    common(name).into_iter().flat_map(|first| std::iter::once(first).chain(more)).collect()
}

/// Coordinates of a form whose sizes, which come first in all forms of an effect, are at `sizes`; what else it has is of no interest by
/// itself, and where most of that form have it.
pub fn in_form(form: &dyn Effect, sizes: &[f64]) -> Vec<f64> {
    let rest = form.parameters().iter().skip(form.sizes()).map(|p| p.prior.0);
    sizes.iter().take(form.sizes()).copied().chain(rest).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::effect::Hints;

    #[test]
    fn property_every_effect_says_what_it_means_and_what_to_do() {
        for name in names() {
            let Advice { what, action } = advice(name).unwrap();
            assert!(!what.is_empty() && !what.ends_with('.'), "{name}");
            assert!(action.ends_with('.') && action.chars().all(|c| c != '\n'), "{name}");
        }
        assert_eq!(advice("gremlins"), None);
    }

    #[test]
    fn property_starts_lie_inside_the_ranges_and_far_ones_on_both_sides_of_nought() {
        let hints = Hints { largest_m_s2: 100.0, on_top_m_s2: 0.0 };
        for effect in COMMON {
            let far = effect.far_starts(&hints);
            assert!(!effect.starts(&hints).is_empty(), "{}", effect.name());
            for start in effect.starts(&hints).iter().chain(&far) {
                let inside =
                    start.iter().zip(effect.parameters()).all(|(c, p)| (p.range[0]..=p.range[1]).contains(c));
                assert!(inside && start.len() == effect.parameters().len(), "{} {start:?}", effect.name());
            }
            let Some(nought) = effect.nought() else { continue };
            let p = effect.parameters()[0];
            let above = far.iter().any(|s| s[0] > nought[0]);
            let below = far.iter().any(|s| s[0] < nought[0]);
            // Where nought is an end of the range, there is one side only.
            assert!(above || nought[0] >= p.range[1], "{}", effect.name());
            assert!(below || nought[0] <= p.range[0], "{}", effect.name());
        }
    }
}
