//! Paths through a crossing and roughness of rails.

use faer::c64;

use super::file::{Geometry, Roughness};
use crate::passage::random::Random;
use crate::passage::surface::GRID_M;
use crate::passage::{Profile, SimulationError};
use crate::signal::irfft;

/// Continuation of a scan beyond its ends, m: nothing is known there.
const FADE_M: f64 = 0.3;

/// Path of a nominal wheel. With a scan it is the scan, faded out at both ends.
pub fn crossing_path(
    geometry: &Geometry,
    scan: Option<&crate::recording::Scan>,
) -> Result<Profile, SimulationError> {
    if let Some(scan) = scan {
        return Profile::of_scan(&scan.position_m, &scan.irregularity_m, FADE_M);
    }
    for (what, value, range) in [
        ("wing_length_m", geometry.wing_length_m, [0.05, 5.0]),
        ("nose_length_m", geometry.nose_length_m, [0.05, 5.0]),
        ("wear_length_m", geometry.wear_length_m, [0.05, 5.0]),
        ("exponent", geometry.exponent, [1.0, 6.0]),
        ("dip_m", geometry.dip_m, [0.0, 0.02]),
        ("wear_m", geometry.wear_m, [0.0, 0.02]),
        ("transition_x_m", geometry.transition_x_m, [-3.0, 3.0]),
    ] {
        crate::passage::in_range(what, value, range, "")?;
    }
    let x0 = geometry.transition_x_m;
    Profile::of(
        [x0 - geometry.wing_length_m, x0 + geometry.nose_length_m.max(geometry.wear_length_m)],
        GRID_M,
        |x| depth_m(geometry, x),
    )
}

/// Depth by the formula, m.
fn depth_m(g: &Geometry, x_m: f64) -> f64 {
    let from = x_m - g.transition_x_m;
    let length = if from < 0.0 { g.wing_length_m } else { g.nose_length_m };
    let dip = g.dip_m * (1.0 - from.abs() / length).max(0.0).powf(g.exponent);
    let wear = if from > 0.0 && from < g.wear_length_m {
        0.5 * g.wear_m * (1.0 - (std::f64::consts::TAU * from / g.wear_length_m).cos())
    } else {
        0.0
    };
    dip + wear
}

/// Random roughness between two positions.
pub fn roughness(
    spectrum: &Roughness,
    [first_m, last_m]: [f64; 2],
    random: &mut Random,
) -> Result<Profile, SimulationError> {
    crate::passage::in_range("roughness rms_m", spectrum.rms_m, [0.0, 1e-3], "m")?;
    crate::passage::in_range("roughness shortest_m", spectrum.shortest_m, [4.0 * GRID_M, 10.0], "m")?;
    crate::passage::in_range("roughness longest_m", spectrum.longest_m, [spectrum.shortest_m, 50.0], "m")?;
    crate::passage::in_range("roughness exponent", spectrum.exponent, [0.0, 6.0], "")?;
    let n = ((last_m - first_m) / GRID_M).ceil() as usize + 1;
    let length_m = n as f64 * GRID_M;
    let mut values = vec![c64::new(0.0, 0.0); n / 2 + 1];
    for (k, value) in values.iter_mut().enumerate().skip(1) {
        // Drawn for every wavenumber, so that another band leaves the common part unchanged.
        let (re, im) = (random.normal(), random.normal());
        let wavelength_m = length_m / k as f64;
        if (spectrum.shortest_m..=spectrum.longest_m).contains(&wavelength_m) {
            let amplitude = (k as f64).powf(-0.5 * spectrum.exponent);
            *value = c64::new(amplitude * re, amplitude * im);
        }
    }
    let depth = irfft(&values, n);
    let rms = crate::signal::rms(&depth);
    let scale = if rms > 0.0 { spectrum.rms_m / rms } else { 0.0 };
    Profile::new(first_m, GRID_M, depth.into_iter().map(|d| scale * d).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_path_is_deepest_at_the_transition() {
        let g = Geometry { wear_m: 0.0, ..Geometry::default() };
        let path = crossing_path(&g, None).unwrap();
        assert!((path.at(0.3) - 1.2e-3).abs() < 1e-9);
        assert!((path.at(0.7) - 0.3e-3).abs() < 1e-6, "half way up, (1/2)² is left");
        assert_eq!(path.at(2.0), 0.0);
        let bad = Geometry { exponent: f64::NAN, ..g };
        assert!(matches!(
            crossing_path(&bad, None),
            Err(SimulationError::OutOfRange { what: "exponent", .. })
        ));
    }

    #[test]
    fn analytic_roughness_has_the_asked_rms() {
        let spectrum = Roughness { rms_m: 20e-6, ..Roughness::default() };
        let profile = roughness(&spectrum, [-18.0, 18.0], &mut Random::new(5, 0)).unwrap();
        let values: Vec<f64> = (0..7000).map(|i| profile.at(-17.5 + 0.005 * f64::from(i))).collect();
        assert!((crate::signal::rms(&values) / 20e-6 - 1.0).abs() < 0.05);
    }
}
