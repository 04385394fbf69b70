//! The catalogue: one file per effect, registered here.

mod axle_load;
mod bias_step;
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

use super::effect::Effect;
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
