//! Calibration with the crossing's geometry known (paper, eq. 1): the whole simulated displacement against the measured one.
//!
//! The paper's monitoring cannot use it, because the geometry is what it looks for; with a laser scan it shows what the
//! low-pass of eq. 2 costs.

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::{DMatrix, DVector, Dyn, OMatrix, Owned, U3, Vector3};
use rayon::prelude::*;

use super::super::VerifyError;
use crate::ballast::BallastParameters;
use crate::gap::base::{align, nominal_world, observe, window_of};
use crate::gap::data::Observed;
use crate::gap::forward::Simulator;
use crate::gap::measure::displacements;
use crate::gap::world::World;
use crate::recording::Site;

/// Passages compared, spread over the site.
const PASSAGES: usize = 8;
/// Step of the difference quotients in (ln p1, ln p2, p3).
const STEP: f64 = 0.02;

/// Ballast whose simulation over the scan is nearest to the measured displacement; `None` without a scan. Starts from
/// `start`.
pub(super) fn calibrate(
    site: &Site,
    start: BallastParameters,
) -> Result<Option<BallastParameters>, VerifyError> {
    if site.scan.is_none() {
        return Ok(None);
    }
    let all = observe(site)?;
    let mut observed: Vec<Observed> = all.iter().step_by(all.len().div_ceil(PASSAGES)).cloned().collect();
    let world = nominal_world(site, start)?;
    align(&world, &mut observed, window_of(&site.crossing))?;
    let problem = Problem { world, observed, at: Vector3::from(start.stiffness_vector()) };
    let (problem, _) = LevenbergMarquardt::new().with_ftol(1e-6).with_xtol(1e-4).minimize(problem);
    Ok(Some(problem.ballast()))
}

struct Problem {
    world: World,
    observed: Vec<Observed>,
    /// (ln p1, ln p2, p3).
    at: Vector3<f64>,
}

impl Problem {
    fn ballast(&self) -> BallastParameters {
        BallastParameters::from_stiffness_vector([self.at[0], self.at[1], self.at[2]])
    }

    /// Differences of all passages, each relative to its measured displacement; `None` where the simulation fails.
    fn differences(&self, at: Vector3<f64>) -> Option<DVector<f64>> {
        let world = World {
            ballast: BallastParameters::from_stiffness_vector([at[0], at[1], at[2]]),
            ..self.world.clone()
        };
        let of_passage = |o: &Observed| -> Option<Vec<f64>> {
            let response = Simulator::new(&world, o.axle_load_kg).ok()?.response(o.speed_m_s).ok()?;
            let [measured, modelled] = displacements(o, (&world, &response));
            let scale = 1.0 / (crate::signal::rms(&measured) * (measured.len() as f64).sqrt());
            Some(measured.iter().zip(&modelled).map(|(m, s)| scale * (m - s)).collect())
        };
        let parts: Vec<Option<Vec<f64>>> = self.observed.par_iter().map(of_passage).collect();
        parts.into_iter().collect::<Option<Vec<_>>>().map(|p| DVector::from_vec(p.concat()))
    }
}

impl LeastSquaresProblem<f64, Dyn, U3> for Problem {
    type ParameterStorage = Owned<f64, U3>;
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, U3>;

    fn set_params(&mut self, x: &Vector3<f64>) {
        self.at = *x;
    }

    fn params(&self) -> Vector3<f64> {
        self.at
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        self.differences(self.at)
    }

    fn jacobian(&self) -> Option<OMatrix<f64, Dyn, U3>> {
        let columns: Vec<DVector<f64>> = (0..3)
            .map(|k| {
                let moved = |step: f64| {
                    let mut at = self.at;
                    at[k] += step;
                    self.differences(at)
                };
                Some((moved(STEP)? - moved(-STEP)?) / (2.0 * STEP))
            })
            .collect::<Option<_>>()?;
        Some(DMatrix::from_columns(&columns).fixed_columns::<3>(0).into_owned())
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::recording::read_site;
    use crate::verification::tolerance;

    /// Recordings of another program; its p1 is 35 MN/m², p2 26.
    #[test]
    fn reference_ballast_over_the_scan() {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field/reference-2");
        let mut site = read_site(&dir).unwrap();
        let found = calibrate(&site, BallastParameters::NOMINAL).unwrap().unwrap();
        assert!((found.p1_n_m2 / 35e6 - 1.0).abs() < tolerance::KNOWN_GEOMETRY_P1, "{found:?}");
        assert!((found.p2_n_m2 / 26e6 - 1.0).abs() < tolerance::KNOWN_GEOMETRY_P1, "{found:?}");
        site.scan = None;
        assert_eq!(calibrate(&site, BallastParameters::NOMINAL).unwrap(), None);
    }
}
