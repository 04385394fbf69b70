//! What a wheel rolls over, positive downwards: path through the crossing, roughness, and the wheel's own shape.

use super::error::{SimulationError, in_range};
use crate::signal::CubicSpline;

/// Vertical profile along the track on a regular grid, zero outside.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Profile {
    first_x_m: f64,
    step_m: f64,
    depth_m: Vec<f64>,
}

/// Deepest profile accepted, m.
const DEEPEST_M: f64 = 0.05;

impl Profile {
    /// Level surface.
    pub fn level() -> Self {
        Self { first_x_m: 0.0, step_m: 1.0, depth_m: Vec::new() }
    }

    /// Depth (m, positive down) from `first_x_m` in steps of `step_m`.
    pub fn new(first_x_m: f64, step_m: f64, depth_m: Vec<f64>) -> Result<Self, SimulationError> {
        in_range("step of a profile", step_m, [1e-5, 1.0], "m")?;
        in_range("begin of a profile", first_x_m, [-1e4, 1e4], "m")?;
        for depth in &depth_m {
            in_range("depth of a profile", *depth, [-DEEPEST_M, DEEPEST_M], "m")?;
        }
        Ok(Self { first_x_m, step_m, depth_m })
    }

    /// Samples a function from `first_x_m` to `last_x_m`.
    pub fn of(
        [first_x_m, last_x_m]: [f64; 2],
        step_m: f64,
        depth_m: impl Fn(f64) -> f64,
    ) -> Result<Self, SimulationError> {
        in_range("length of a profile", last_x_m - first_x_m, [0.0, 1e4], "m")?;
        in_range("step of a profile", step_m, [1e-5, 1.0], "m")?;
        let count = ((last_x_m - first_x_m) / step_m).round() as usize + 1;
        Self::new(first_x_m, step_m, (0..count).map(|i| depth_m(first_x_m + i as f64 * step_m)).collect())
    }

    /// A measured profile, continued beyond its ends to zero within `fade_m`; nothing is known there.
    pub fn of_scan(position_m: &[f64], depth_m: &[f64], fade_m: f64) -> Result<Self, SimulationError> {
        in_range("fade length of a scan", fade_m, [1e-3, 10.0], "m")?;
        let Some(spline) = CubicSpline::new(position_m, depth_m) else {
            return Err(SimulationError::OutOfRange {
                what: "number of points of a scan with ascending positions",
                value: position_m.len() as f64,
                min: 2.0,
                max: f64::INFINITY,
                unit: "",
            });
        };
        let (first, last) = (position_m[0], position_m[position_m.len() - 1]);
        let (at_first, at_last) = (depth_m[0], depth_m[depth_m.len() - 1]);
        Self::of([first - fade_m, last + fade_m], GRID_M, |x| {
            if x < first {
                at_first * smooth_step(1.0 - (first - x) / fade_m)
            } else if x > last {
                at_last * smooth_step(1.0 - (x - last) / fade_m)
            } else {
                spline.at(x)
            }
        })
    }

    /// Depth at `x_m` by cubic interpolation.
    #[inline(always)]
    pub fn at(&self, x_m: f64) -> f64 {
        let n = self.depth_m.len();
        let position = (x_m - self.first_x_m) / self.step_m;
        if n < 4 || !(position >= 0.0 && position <= (n - 1) as f64) {
            return 0.0;
        }
        let i = (position as usize).clamp(1, n - 3);
        let y = &self.depth_m[i - 1..i + 3];
        let t = position - i as f64;
        let (below, above) = (t + 1.0, t - 1.0);
        y[0] * (-t * above * (t - 2.0) / 6.0)
            + y[1] * (below * above * (t - 2.0) / 2.0)
            + y[2] * (-below * t * (t - 2.0) / 2.0)
            + y[3] * (below * t * above / 6.0)
    }

    /// Sum of two profiles on the finer grid of both, over the extent of both.
    pub fn plus(&self, other: &Profile) -> Profile {
        match (self.depth_m.is_empty(), other.depth_m.is_empty()) {
            (_, true) => return self.clone(),
            (true, false) => return other.clone(),
            _ => {}
        }
        let end = |p: &Profile| p.first_x_m + (p.depth_m.len() - 1) as f64 * p.step_m;
        let (first, last) = (self.first_x_m.min(other.first_x_m), end(self).max(end(other)));
        let step_m = self.step_m.min(other.step_m);
        let count = ((last - first) / step_m).round() as usize + 1;
        let x = (0..count).map(|i| first + i as f64 * step_m);
        Profile { first_x_m: first, step_m, depth_m: x.map(|x| self.at(x) + other.at(x)).collect() }
    }
}

/// Grid of sampled profiles, m: 250 Hz at 50 m/s is 200 mm, 2 kHz is 25 mm.
pub const GRID_M: f64 = 0.005;

/// 0 below 0, 1 above 1, smooth in between.
pub fn smooth_step(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Surfaces of both rails.
#[derive(Clone, Debug, PartialEq)]
pub struct RunningSurface {
    /// Paths through the crossing; wheels choose one by index. Index 0 is the nominal wheel's.
    pub paths: Vec<Profile>,
    /// Added to every path on the crossing side.
    pub crossing_roughness: Profile,
    /// Whole surface of the stock rail.
    pub stock: Profile,
}

impl RunningSurface {
    /// Level rails.
    pub fn level() -> Self {
        Self { paths: vec![Profile::level()], crossing_roughness: Profile::level(), stock: Profile::level() }
    }
}

/// Radius deviation r = amplitude · sin(order · s / R + phase), s the distance rolled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutOfRoundness {
    /// Waves around the wheel.
    pub order: u32,
    /// m.
    pub amplitude_m: f64,
    /// rad.
    pub phase_rad: f64,
}

/// Flat spot whose edges have been rolled round: depth/2 (1 + cos(2π s/length)) once per revolution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WheelFlat {
    /// m.
    pub depth_m: f64,
    /// Along the circumference, m. A fresh flat has length² = 8 R depth.
    pub length_m: f64,
    /// Where on the wheel, as distance rolled since the beginning, m.
    pub at_m: f64,
}

impl WheelFlat {
    /// Fresh flat of a length, a chord of a wheel of radius `radius_m`.
    pub fn fresh(length_m: f64, at_m: f64, radius_m: f64) -> Self {
        Self { depth_m: length_m * length_m / (8.0 * radius_m), length_m, at_m }
    }

    /// Depth at rolled distance `s_m` of a wheel of radius `radius_m`.
    pub fn at(&self, s_m: f64, radius_m: f64) -> f64 {
        let from = from_nearest(s_m - self.at_m, std::f64::consts::TAU * radius_m);
        if from.abs() >= 0.5 * self.length_m {
            return 0.0;
        }
        0.5 * self.depth_m * (1.0 + (std::f64::consts::TAU * from / self.length_m).cos())
    }
}

/// Distance from the nearest of places that are a whole turn apart, one of them `from_m` away; all in metres.
pub fn from_nearest(from_m: f64, turn_m: f64) -> f64 {
    (from_m + 0.5 * turn_m).rem_euclid(turn_m) - 0.5 * turn_m
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_interpolation_is_exact_for_cubics() {
        let cubic = |x: f64| 1e-3 * (x * x * x - x);
        let profile = Profile::of([-1.0, 1.0], 0.01, cubic).unwrap();
        for x in [-0.995, -0.3337, 0.0, 0.5001, 0.9999] {
            assert!((profile.at(x) - cubic(x)).abs() < 1e-15, "{x}");
        }
        assert_eq!(profile.at(1.1), 0.0);
    }

    #[test]
    fn property_sum_of_profiles_and_fade_of_a_scan() {
        let scan = Profile::of_scan(&[-0.1, 0.0, 0.1], &[1e-3, 2e-3, 1e-3], 0.2).unwrap();
        assert!((scan.at(0.0) - 2e-3).abs() < 1e-12);
        assert!(scan.at(0.299) < 1e-6 && scan.at(0.15) < 1e-3);
        let other = Profile::of([-1.0, 1.0], 0.02, |_| 1e-4).unwrap();
        assert!((scan.plus(&other).at(0.0) - 2.1e-3).abs() < 1e-12);
        assert!(matches!(
            Profile::new(0.0, 0.01, vec![f64::NAN]),
            Err(SimulationError::OutOfRange { value, .. }) if value.is_nan()
        ));
    }

    #[test]
    fn analytic_flat_once_per_revolution() {
        let flat = WheelFlat { depth_m: 1e-4, length_m: 0.04, at_m: 0.5 };
        let turn = std::f64::consts::TAU * 0.46;
        for k in 0..3 {
            assert!((flat.at(0.5 + f64::from(k) * turn, 0.46) - 1e-4).abs() < 1e-15);
            assert!((flat.at(0.51 + f64::from(k) * turn, 0.46) - 0.5e-4).abs() < 1e-12);
            assert_eq!(flat.at(0.53 + f64::from(k) * turn, 0.46), 0.0);
        }
    }
}
