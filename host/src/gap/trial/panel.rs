//! Panels of trials: the nominal one, or any other of those that are built.

use crate::passage::random::Random;
use crate::scenario::Scenario;

/// Which panels the trials of a run are of.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum, serde::Serialize, serde::Deserialize,
)]
#[serde(rename_all = "kebab-case")]
pub enum Panels {
    /// One panel, that of docs/examples/site.toml, with stiff or soft pads
    #[default]
    Nominal,
    /// A panel for each trial: sleepers, rails, pads, crossing part, transition, sensor and train are drawn too
    Any,
}

/// Rails: second moment of area about the horizontal axis, m⁴, area, m², and mass, kg/m (EN 13674-1: 49E1, 54E1, 60E1).
const RAILS: [(&str, f64, f64, f64); 3] = [
    ("49E1", 18.16e-6, 62.92e-4, 49.39),
    ("54E1", 23.38e-6, 69.77e-4, 54.77),
    ("60E1", 30.38e-6, 76.70e-4, 60.21),
];
/// Materials of sleepers: Young's modulus, Pa, and density, kg/m³, of concrete and of oak.
const SLEEPERS: [(f64, f64); 2] = [(30e9, 2400.0), (13e9, 900.0)];
/// Least distance between the sensor and the end of the sleeper, m.
const SENSOR_TO_END_M: f64 = 0.1;

/// Draws a panel of another build, with its trains. The direction of traffic, the ballast, how deep the transition is and how the sensor
/// samples stay as they are.
pub(super) fn draw(scenario: &mut Scenario, random: &mut Random) {
    let crossing = &mut scenario.crossing;
    let spacing_m = random.between(0.5, 0.75);
    let track = &mut crossing.track;
    track.sleeper_spacing_m = spacing_m;
    track.crossing_sleeper_x_m = random.between(-0.5, 0.5) * spacing_m;

    let rail = &mut crossing.rail;
    let (profile, second_moment_m4, area_m2, mass_per_metre_kg) = RAILS[random.below(RAILS.len())];
    rail.profile = profile.to_string();
    (rail.second_moment_m4, rail.area_m2, rail.mass_per_metre_kg) =
        (second_moment_m4, area_m2, mass_per_metre_kg);
    rail.crossing_part_x0_m = random.between(-3.5, -0.8);
    rail.crossing_part_x1_m = random.between(1.8, 5.0);
    rail.crossing_part_stiffness_factor = random.between(1.0, 4.0);
    rail.crossing_part_mass_factor = random.between(1.0, 3.0);

    // From the soft pads of today to the stiff ones of the last century, evenly in the logarithm.
    crossing.pad.stiffness_n_m = random.between_logarithms(50e6, 1200e6);
    crossing.pad.damping_ns_m = random.between(6e3, 25e3);

    let gauge_m = 2.0 * crossing.vehicle.contact_half_distance_m;
    let sleeper = &mut crossing.sleeper;
    (sleeper.youngs_modulus_pa, sleeper.density_kg_m3) = SLEEPERS[random.below(SLEEPERS.len())];
    sleeper.length_m = random.between(2.6, 4.4);
    sleeper.width_m = random.between(0.24, 0.32);
    sleeper.height_m = random.between(0.16, 0.24);
    sleeper.seat_stock_y_m = random.between(0.4, 0.55);
    sleeper.seat_crossing_y_m = sleeper.seat_stock_y_m + gauge_m;

    let end_m = (sleeper.length_m - SENSOR_TO_END_M).min(sleeper.seat_crossing_y_m + 0.8);
    crossing.sensor.y_m = random.between(sleeper.seat_crossing_y_m, end_m);

    let vehicle = &mut crossing.vehicle;
    vehicle.axle_spacing_m = random.between(2.3, 3.0);
    vehicle.bogie_centres_m = random.between(15.0, 19.0);
    vehicle.car_length_m = vehicle.bogie_centres_m + random.between(6.5, 8.0);
    vehicle.axle_load_kg = random.between(12e3, 20e3);
    vehicle.wheelset_mass_kg = random.between(1100.0, 1700.0);

    let simulation = &mut scenario.simulation;
    simulation.speed_m_s = random.between(28.0, 55.0);
    simulation.geometry.transition_x_m = random.between(0.1, 0.5);
    simulation.geometry.wing_length_m = random.between(0.5, 0.9);
    simulation.geometry.nose_length_m = random.between(0.5, 0.9);
}
