//! Properties that the linear-Gaussian estimate must have whatever its numbers, through its public face.

use cpcm::greens::{Chain, GreensFunctions, Quantity};
use cpcm::inverse::{
    CommonProfile, Estimator, Excitation, GroupGeometry, InverseError, Prior, ProfileGrids, Running,
    TrackModel,
};
use cpcm::recording::read_site;
use cpcm::track::{Mesh, Track};
use cpcm_tests::sample::field;
use cpcm_tests::tolerance;

/// Model of one bogie on `reference-1` at its nominal ballast.
struct Bogie {
    greens: GreensFunctions,
}

impl Bogie {
    fn new() -> Self {
        let site = read_site(&field("reference-1")).unwrap();
        let track = Track::try_of_crossing(&site.crossing, Mesh::default()).unwrap();
        let ballast = vec![site.crossing.ballast.stiffness_n_m2; track.sleeper_x_m.len()];
        let sampling = cpcm::greens::GreensSampling::low();
        let greens =
            GreensFunctions::try_new(&track, &ballast, sampling, Quantity::Acceleration, &Chain::Corrected)
                .unwrap();
        Self { greens }
    }

    fn estimator(&self, prior: &Prior, speed_m_s: f64) -> Result<Estimator, InverseError> {
        let offsets = [0.0, 2.9];
        let geometry = GroupGeometry {
            running: Running { direction: 1.0, speed_m_s, static_force_n: 76e3 },
            axle_offset_m: &offsets,
            train_offset_m: &offsets,
        };
        let model = TrackModel { greens: &self.greens, excitation: Excitation::Force };
        Estimator::new(&model, &geometry, prior, &smooth(prior))
    }
}

/// No force that the wheels share.
fn smooth(prior: &Prior) -> CommonProfile {
    CommonProfile::zero(ProfileGrids::force(prior.half_m, 0.1, 0.2, 45.0))
}

/// A fixed vector that looks random.
fn noise(n: usize, seed: f64) -> Vec<f64> {
    (0..n).map(|i| 1.7 * (12.9898 * (i as f64 + seed)).sin()).collect()
}

const GRID_M: [f64; 5] = [-0.6, -0.2, 0.1, 0.4, 1.0];
const LOW_PASS_HZ: f64 = 120.0;

/// window = expected + L z has the density of z, divided by det L.
#[test]
fn property_evidence_is_the_density_of_the_models_own_covariance() {
    let estimator = Bogie::new().estimator(&Prior::each_wheel_for_itself(1.0), 45.0).unwrap();
    let (n, z) = (estimator.len(), noise(estimator.len(), 0.3));
    let root = estimator.covariance_root();
    let window: Vec<f64> = (0..n)
        .map(|i| estimator.expected_m_s2[i] + (0..=i).map(|j| root[(i, j)] * z[j]).sum::<f64>())
        .collect();
    let square: f64 = z.iter().map(|v| v * v).sum();
    let density = -0.5 * square - estimator.log_det_half() - 0.5 * n as f64 * std::f64::consts::TAU.ln();
    let evidence = estimator.log_evidence(&window);
    assert!((evidence - density).abs() < tolerance::DENSITY * square, "{evidence} {density}");
    assert!(evidence < estimator.log_evidence(&estimator.expected_m_s2), "nothing fits better than the mean");
}

#[test]
fn property_estimate_is_linear_in_the_window() {
    let estimator = Bogie::new().estimator(&Prior::each_wheel_for_itself(1.0), 45.0).unwrap();
    for axle in estimator.gains(&GRID_M, LOW_PASS_HZ, &smooth(&Prior::each_wheel_for_itself(1.0))) {
        let n = estimator.len();
        assert_eq!(axle.apply(&vec![0.0; n]), axle.base_n, "an expected window moves nothing");
        let (a, b) = (noise(n, 0.1), noise(n, 7.7));
        let both: Vec<f64> = a.iter().zip(&b).map(|(x, y)| 2.0 * x - 3.0 * y).collect();
        let (fa, fb, f) = (axle.apply(&a), axle.apply(&b), axle.apply(&both));
        for i in 0..GRID_M.len() {
            let expected = axle.base_n[i] + 2.0 * (fa[i] - axle.base_n[i]) - 3.0 * (fb[i] - axle.base_n[i]);
            assert!((f[i] - expected).abs() < tolerance::LINEAR_N, "{} {expected}", f[i]);
        }
    }
}

/// What the window explains and what remains add up to the prior variance, which does not depend on the noise; and
/// more noise leaves more.
#[test]
fn property_explained_and_remaining_variance_add_up_to_the_prior() {
    let bogie = Bogie::new();
    let variances = |noise_m_s2: f64| {
        let prior = Prior { noise_m_s2, ..Prior::each_wheel_for_itself(1.0) };
        let estimator = bogie.estimator(&prior, 45.0).unwrap();
        let root = estimator.covariance_root();
        let axle = estimator.gains(&GRID_M, LOW_PASS_HZ, &smooth(&prior)).remove(1);
        let n = estimator.len();
        let explained: Vec<f64> = (0..GRID_M.len())
            .map(|i| {
                // |gain · L|²: the variance of the estimate.
                (0..n)
                    .map(|j| (j..n).map(|k| axle.gain[(i, k)] * root[(k, j)]).sum::<f64>().powi(2))
                    .sum::<f64>()
            })
            .collect();
        (explained, axle.sd_n)
    };
    let ((little, sd_little), (much, sd_much)) = (variances(0.05), variances(0.5));
    for i in 0..GRID_M.len() {
        let (one, other) = (little[i] + sd_little[i].powi(2), much[i] + sd_much[i].powi(2));
        assert!((one / other - 1.0).abs() < tolerance::VARIANCE, "{one} {other}");
        assert!(sd_much[i] > sd_little[i], "more noise, less knowledge");
    }
}

#[test]
fn property_impossible_speed_and_noise_are_refused() {
    let (bogie, prior) = (Bogie::new(), Prior::each_wheel_for_itself(1.0));
    for speed in [0.0, -40.0, f64::NAN] {
        assert!(matches!(bogie.estimator(&prior, speed), Err(InverseError::Speed(_))), "{speed}");
    }
    let broken = Prior { noise_m_s2: f64::NAN, ..prior };
    assert!(matches!(bogie.estimator(&broken, 45.0), Err(InverseError::Covariance { .. })));
}
