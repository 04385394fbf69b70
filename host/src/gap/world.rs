//! What the diagnosis assumes of a site: everything that the forward simulation needs, as plain values.

use std::borrow::Cow;

use faer::{Mat, c64};

use super::data::RATE_HZ;
use super::splines::PathSplines;
use crate::ballast::BallastParameters;
use crate::passage::Profile;
use crate::recording::Crossing;
use crate::signal::{irfft, rfft, rfft_frequencies_hz};
use crate::track::Side;

/// Site as assumed. The base model has all deviations at nought; an effect changes some of them.
#[derive(Clone, Debug, PartialEq)]
pub struct World {
    /// Description; pads, rails and masses may differ from the operator's.
    pub crossing: Crossing,
    /// Ballast around the crossing.
    pub ballast: BallastParameters,
    /// Departures of the ballast from a linear bed with three parameters.
    pub bed: Bed,
    /// Wheels of a bogie.
    pub wheels: Wheels,
    /// What the wheels run over.
    pub path: Path,
    /// Recorder.
    pub sensor: SensorModel,
    /// Sleepers simulated on either side of the sensor's.
    pub sleepers: usize,
}

/// Departures from the linear three-parameter ballast.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Bed {
    /// Sleepers and the gap under them, metres.
    pub gap_m: Vec<(i64, f64)>,
    /// Part of the bed's damping that these keep while they hang, as they rub along the crib.
    pub crib_damping: f64,
    /// Displacement at which the secant stiffness has doubled, metres.
    pub doubling_m: Option<f64>,
    /// Ballast moving with every sleeper, kg per metre of sleeper.
    pub mass_kg_m: f64,
}

impl Bed {
    /// Whether every sleeper's support is as stiff under any load.
    pub fn is_linear(&self) -> bool {
        self.gap_m.is_empty() && self.doubling_m.is_none()
    }
}

/// Wheels of a bogie, front and rear.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wheels {
    /// Static force of the wheels over nominal: `[front, rear][crossing, stock]`.
    pub load: [[f64; 2]; 2],
    /// Factor on the path's depth, front and rear.
    pub depth: [f64; 2],
    /// Standard deviation of that depth among wheels, relative.
    pub depth_sd: f64,
    /// Factor on mass and roll inertia of the wheelsets.
    pub unsprung: f64,
}

impl Default for Wheels {
    fn default() -> Self {
        Self { load: [[1.0; 2]; 2], depth: [1.0; 2], depth_sd: 0.0, unsprung: 1.0 }
    }
}

/// What the wheels run over: a scan where there is one, and what the recordings add to it.
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    /// Scan, faded out beyond its ends.
    pub scan: Profile,
    /// Standard deviation of where single wheels meet the scan, metres: their mean rolls over a blurred one.
    pub blur_m: f64,
    /// Deviation from it on the crossing side, and the whole surface of the stock rail.
    pub deviation: PathSplines,
    /// Extent in which the deviation counts, metres from x = 0.
    pub half_m: f64,
    /// A dip in the stock rail: depth, position x, length, metres.
    pub stock_dip: Option<[f64; 3]>,
}

impl Path {
    /// Depth at `x_m`, metres.
    pub fn at(&self, side: Side, x_m: f64) -> f64 {
        let fade = crate::passage::surface::smooth_step((self.half_m - x_m.abs()) / FADE_M);
        let scan = if side == Side::Crossing { self.blurred_scan(x_m) } else { 0.0 };
        let dip = if side == Side::Stock { self.stock_dip.map_or(0.0, |d| cosine_dip(d, x_m)) } else { 0.0 };
        scan + fade * (self.deviation.at(side, x_m) + dip)
    }

    /// Mean of the scan over wheels that meet it earlier or later: Gauss-Hermite with three points, right to the fourth power of
    /// wavenumber times blur, which is below 0.4 in the band.
    fn blurred_scan(&self, x_m: f64) -> f64 {
        let reach_m = 3f64.sqrt() * self.blur_m;
        (4.0 * self.scan.at(x_m) + self.scan.at(x_m - reach_m) + self.scan.at(x_m + reach_m)) / 6.0
    }
}

/// depth (1 + cos)/2 over a length around a position.
fn cosine_dip([depth_m, at_x_m, length_m]: [f64; 3], x_m: f64) -> f64 {
    let turn = (x_m - at_x_m) / length_m;
    if turn.abs() >= 0.5 { 0.0 } else { 0.5 * depth_m * (1.0 + (std::f64::consts::TAU * turn).cos()) }
}

/// The estimated profile ends over this length, metres.
const FADE_M: f64 = 0.2;

/// Recorder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorModel {
    /// Sensitivity at 20 °C, 1 is right.
    pub gain: f64,
    /// Change of the sensitivity, 1/K.
    pub gain_per_kelvin: f64,
    /// The clock runs faster than stated by this part.
    pub clock_error: f64,
    /// Resonance of the mounting: frequency in Hz, damping ratio.
    pub mount: Option<(f64, f64)>,
    /// Range of the transducer, m/s².
    pub range_m_s2: Option<f64>,
}

/// Temperature at which the sensitivity is referred to, °C.
pub const REFERENCE_C: f64 = 20.0;

impl Default for SensorModel {
    fn default() -> Self {
        Self { gain: 1.0, gain_per_kelvin: 0.0, clock_error: 0.0, mount: None, range_m_s2: None }
    }
}

impl SensorModel {
    /// Motion of the sensor over that of the sleeper.
    pub fn mounted(&self, f_hz: f64) -> c64 {
        match self.mount {
            None => c64::new(1.0, 0.0),
            Some((frequency_hz, damping)) => {
                let s = f_hz / frequency_hz;
                let damped = c64::new(0.0, 2.0 * damping * s);
                (damped + 1.0) / (damped + (1.0 - s * s))
            }
        }
    }

    /// What the mount makes of windows at [`RATE_HZ`], one per column. A light mount rings for some hundredths of a second, so that
    /// zeros follow the window while it does.
    pub fn through_mount<'a>(&self, windows: &'a Mat<f64>) -> Cow<'a, Mat<f64>> {
        if self.mount.is_none() {
            return Cow::Borrowed(windows);
        }
        let n = windows.nrows();
        let padded = (n + n / 2).next_multiple_of(2);
        let gains: Vec<c64> =
            rfft_frequencies_hz(padded, RATE_HZ).into_iter().map(|f| self.mounted(f)).collect();
        let mut out = windows.clone();
        for c in 0..windows.ncols() {
            let mut column = windows.col_as_slice(c).to_vec();
            column.resize(padded, 0.0);
            let mut spectrum = rfft(&column);
            spectrum.iter_mut().zip(&gains).for_each(|(v, g)| *v *= *g);
            let ringing = irfft(&spectrum, padded);
            (0..n).for_each(|k| out[(k, c)] = ringing[k]);
        }
        Cow::Owned(out)
    }

    /// Sensitivity at a temperature.
    pub fn gain_at(&self, temperature_c: f64) -> f64 {
        self.gain + self.gain_per_kelvin * (temperature_c - REFERENCE_C)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// In the middle of a long window the steady answer to a wave has died in: |1 + 2iζr| / |1 − r² + 2iζr|.
    #[test]
    fn analytic_mount_amplifies_a_wave_by_its_gain() {
        let sensor = SensorModel { mount: Some((282.0, 0.08)), ..SensorModel::default() };
        for f_hz in [50.0, 240.0] {
            let wave = Mat::from_fn(400, 1, |k, _| (std::f64::consts::TAU * f_hz * k as f64 / RATE_HZ).sin());
            let out = sensor.through_mount(&wave);
            let rms = |m: &Mat<f64>| crate::signal::rms(&m.col_as_slice(0)[160..240]);
            let (r, d): (f64, f64) = (f_hz / 282.0, 2.0 * 0.08 * f_hz / 282.0);
            let expected = ((1.0 + d * d) / ((1.0 - r * r).powi(2) + d * d)).sqrt();
            assert!((rms(&out) / rms(&wave) / expected - 1.0).abs() < 0.02, "{f_hz} {expected}");
        }
    }

    /// The mean of cos k(x − s) over Gaussian shifts s of standard deviation σ is exp(−k²σ²/2) cos kx.
    #[test]
    fn analytic_mean_wheel_rolls_over_a_blurred_path() {
        let (depth_m, blur_m) = (1e-3, 0.01);
        // Waves of 0.5 m, and of 0.18 m: 250 Hz at 45 m/s.
        for (wave_m, tolerance) in [(0.5, 1e-4), (0.18, 1e-3)] {
            let k = std::f64::consts::TAU / wave_m;
            let scan = Profile::of([-2.0, 2.0], 1e-3, |x| depth_m * (k * x).cos()).unwrap();
            let deviation = PathSplines::level(3.4, [0.055, 0.11]);
            let path = Path { scan, blur_m, deviation, half_m: 3.4, stock_dip: None };
            for x in [-0.31, 0.0, 0.2] {
                let expected = depth_m * (-0.5 * (k * blur_m).powi(2)).exp() * (k * x).cos();
                let error = (path.at(Side::Crossing, x) - expected).abs() / depth_m;
                assert!(error < tolerance, "wave of {wave_m} m at {x}: {error:e}");
            }
            assert_eq!(path.at(Side::Stock, 0.0), 0.0);
        }
    }
}
