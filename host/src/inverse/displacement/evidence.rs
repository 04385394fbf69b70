//! Linear-Gaussian estimate from displacement, hyper-parameters by marginal likelihood.
//!
//! Model: window = kernel · (Q + u) + e with u ~ N(0, s² C) and white noise e ~ N(0, n²). C is a stationary
//! correlation under a bell-shaped envelope: the deviation lives at the crossing nose. Per window, s and n maximise
//! the evidence (s in closed form); correlation and envelope maximise the evidence of all windows of the site.

use std::cmp::Ordering;
use std::ops::Range;

use faer::Mat;
use rayon::prelude::*;

use super::{DisplacementError, DisplacementModel, column};

/// Shape of the correlation with distance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Correlation {
    /// exp(−r²/2).
    Gaussian,
    /// Matérn 5/2.
    Matern,
}

/// Prior of the force deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForcePrior {
    /// Shape of the correlation.
    pub correlation: Correlation,
    /// Correlation length, metres.
    pub correlation_m: f64,
    /// Standard deviation of the bell that the deviation's size follows, metres.
    pub spread_m: f64,
    /// Middle of the bell, metres.
    pub centre_m: f64,
}

/// Values tried.
const LENGTHS_M: [f64; 5] = [0.065, 0.08, 0.1, 0.125, 0.16];
const SPREADS_M: [f64; 5] = [0.25, 0.35, 0.5, 0.7, 1.0];
/// Ratios n²/s² tried, as powers of ten of m²/N²: 61 steps.
const RATIOS: (f64, f64, usize) = (-28.0, -16.0, 61);
/// Relative to the variance; keeps a Cholesky factorisation of a smooth correlation alive.
const JITTER: f64 = 1e-9;

impl ForcePrior {
    /// All combinations tried, for a bell around `centre_m`.
    pub fn candidates(centre_m: f64) -> Vec<ForcePrior> {
        let mut out = Vec::new();
        for correlation in [Correlation::Gaussian, Correlation::Matern] {
            for correlation_m in LENGTHS_M {
                for spread_m in SPREADS_M {
                    out.push(ForcePrior { correlation, correlation_m, spread_m, centre_m });
                }
            }
        }
        out
    }

    /// Lower Cholesky factor of the covariance at `position_m`, for unit standard deviation at the centre.
    fn root(&self, position_m: &[f64]) -> Result<Mat<f64>, DisplacementError> {
        let bell = |x: f64| (-0.5 * ((x - self.centre_m) / self.spread_m).powi(2)).exp();
        let correlated = |distance: f64| match self.correlation {
            Correlation::Gaussian => (-0.5 * (distance / self.correlation_m).powi(2)).exp(),
            Correlation::Matern => {
                let r = 5f64.sqrt() * distance / self.correlation_m;
                (1.0 + r + r * r / 3.0) * (-r).exp()
            }
        };
        let n = position_m.len();
        let size: Vec<f64> = position_m.iter().map(|x| bell(*x)).collect();
        // The factorisation reads the lower triangle only.
        let covariance = Mat::from_fn(n, n, |i, j| match i.cmp(&j) {
            Ordering::Less => 0.0,
            Ordering::Equal => size[i] * size[j] + JITTER,
            Ordering::Greater => size[i] * size[j] * correlated((position_m[i] - position_m[j]).abs()),
        });
        let factor = covariance.llt(faer::Side::Lower);
        Ok(factor.map_err(|_| DisplacementError::Decomposition("prior"))?.L().to_owned())
    }
}

/// Force of one window with its uncertainty.
#[derive(Clone, Debug, PartialEq)]
pub struct EvidenceForce {
    /// Low-passed posterior mean at the reported samples, newtons.
    pub force_n: Vec<f64>,
    /// Posterior standard deviation, newtons.
    pub sd_n: Vec<f64>,
    /// Noise that the evidence prefers, metres.
    pub noise_m: f64,
    /// Size of the deviation that the evidence prefers, newtons.
    pub size_n: f64,
}

/// Result for all windows.
#[derive(Clone, Debug)]
pub struct EvidenceFit {
    /// Prior with the largest evidence.
    pub prior: ForcePrior,
    /// Log evidence of every prior tried, summed over the windows.
    pub tried: Vec<(ForcePrior, f64)>,
    /// One per window.
    pub forces: Vec<EvidenceForce>,
}

impl EvidenceFit {
    /// Whether a chosen length lies at an end of the values tried.
    pub fn at_limit(&self) -> bool {
        let ends = |values: [f64; 5], v: f64| v == values[0] || v == values[4];
        ends(LENGTHS_M, self.prior.correlation_m) || ends(SPREADS_M, self.prior.spread_m)
    }
}

/// Windows turned into the column space of the kernel: nothing else can tell about the force.
struct Compressed {
    triangle: Mat<f64>,
    /// Force samples × windows.
    inside: Mat<f64>,
    /// Energy outside the column space, per window, m².
    outside_m2: Vec<f64>,
    rows: usize,
}

impl Compressed {
    fn new(model: &DisplacementModel, windows_m: &[Vec<f64>]) -> Result<Self, DisplacementError> {
        model.check()?;
        windows_m.iter().try_for_each(|w| model.check_window(w))?;
        let rows = model.kernel.nrows();
        let known = model.static_window();
        let data = Mat::from_fn(rows, windows_m.len(), |i, j| windows_m[j][i] - known[i]);
        let qr = model.kernel.qr();
        let inside = qr.compute_thin_Q().transpose() * &data;
        let outside_m2 = (0..windows_m.len())
            .map(|j| (data.col(j).squared_norm_l2() - inside.col(j).squared_norm_l2()).max(0.0))
            .collect();
        Ok(Self { triangle: qr.thin_R().to_owned(), inside, outside_m2, rows })
    }

    fn spectrum(&self, root: &Mat<f64>) -> Result<Spectrum, DisplacementError> {
        let svd = (&self.triangle * root)
            .thin_svd()
            .map_err(|_| DisplacementError::Decomposition("singular values"))?;
        Ok(Spectrum {
            s2: svd.S().column_vector().iter().map(|s| s * s).collect(),
            b: svd.U().transpose() * &self.inside,
            v: svd.V().to_owned(),
        })
    }
}

/// Singular values squared of kernel · root, data and prior in their basis.
struct Spectrum {
    s2: Vec<f64>,
    /// Components × windows.
    b: Mat<f64>,
    v: Mat<f64>,
}

/// Best size and noise of one window.
#[derive(Clone, Copy)]
struct Scale {
    log_evidence: f64,
    /// s², N².
    size2: f64,
    /// n²/s², m²/N².
    ratio: f64,
}

impl Spectrum {
    /// Size and noise of every window that maximise its evidence over the ratios ρ = n²/s² of `RATIOS`, with
    /// s² = (Σ bᵢ²/(σᵢ²+ρ) + r/ρ)/N, the maximum for a given ratio. What depends on the ratio alone is computed once
    /// for all windows, and the sums over components are one product of matrices.
    fn best_scales(&self, data: &Compressed) -> Vec<Scale> {
        let ratios = ratios();
        let n = data.rows as f64;
        let weights = Mat::from_fn(ratios.len(), self.s2.len(), |r, i| 1.0 / (self.s2[i] + ratios[r]));
        let squares = Mat::from_fn(self.b.nrows(), self.b.ncols(), |i, j| self.b[(i, j)].powi(2));
        let inside = weights * squares;
        let log_det: Vec<f64> = ratios
            .iter()
            .map(|ratio| {
                self.s2.iter().map(|s2| (s2 + ratio).ln()).sum::<f64>()
                    + (n - self.s2.len() as f64) * ratio.ln()
            })
            .collect();
        let scale = |r: usize, j: usize| {
            let size2 = (inside[(r, j)] + data.outside_m2[j] / ratios[r]) / n;
            let log_evidence = -0.5 * (n * (size2.ln() + 1.0 + std::f64::consts::TAU.ln()) + log_det[r]);
            Scale { log_evidence, size2, ratio: ratios[r] }
        };
        let larger = |a: Scale, b: Scale| if b.log_evidence > a.log_evidence { b } else { a };
        (0..self.b.ncols())
            .map(|j| (1..ratios.len()).map(|r| scale(r, j)).fold(scale(0, j), larger))
            .collect()
    }

    fn log_evidence(&self, data: &Compressed) -> f64 {
        self.best_scales(data).iter().map(|scale| scale.log_evidence).sum()
    }
}

/// The ratios of `RATIOS`, m²/N².
fn ratios() -> Vec<f64> {
    let (first, last, count) = RATIOS;
    (0..count).map(|i| 10f64.powf(first + (last - first) * i as f64 / (count - 1) as f64)).collect()
}

/// Forces of all windows at the samples `report`; `position_m` are the positions of the force samples, the deviation
/// is expected around `centre_m`.
pub fn fit_by_evidence(
    model: &DisplacementModel,
    position_m: &[f64],
    centre_m: f64,
    windows_m: &[Vec<f64>],
    report: Range<usize>,
) -> Result<EvidenceFit, DisplacementError> {
    let data = Compressed::new(model, windows_m)?;
    let tried = ForcePrior::candidates(centre_m)
        .into_par_iter()
        .map(|prior| Ok((prior, data.spectrum(&prior.root(position_m)?)?.log_evidence(&data))))
        .collect::<Result<Vec<_>, DisplacementError>>()?;
    let best = tried.iter().max_by(|a, b| a.1.total_cmp(&b.1));
    let prior = best.map(|b| b.0).ok_or(DisplacementError::Decomposition("evidence"))?;
    let root = prior.root(position_m)?;
    let spectrum = data.spectrum(&root)?;
    let rows = Mat::from_fn(report.len(), position_m.len(), {
        let low_pass = model.low_pass();
        move |i, j| low_pass[(report.start + i, j)]
    });
    let shape = rows * &root * &spectrum.v;
    let scales = spectrum.best_scales(&data);
    let forces = scales
        .iter()
        .enumerate()
        .map(|(j, scale)| posterior(&spectrum, j, *scale, &shape, model.static_force_n))
        .collect();
    Ok(EvidenceFit { prior, tried, forces })
}

fn posterior(
    spectrum: &Spectrum,
    j: usize,
    scale: Scale,
    shape: &Mat<f64>,
    static_force_n: f64,
) -> EvidenceForce {
    let weights: Vec<f64> = (0..spectrum.s2.len())
        .map(|i| spectrum.s2[i].sqrt() * spectrum.b[(i, j)] / (spectrum.s2[i] + scale.ratio))
        .collect();
    let mean = shape * column(&weights);
    let sd_n = (0..shape.nrows())
        .map(|i| {
            let left: f64 = (0..spectrum.s2.len())
                .map(|k| shape[(i, k)].powi(2) * scale.ratio / (spectrum.s2[k] + scale.ratio))
                .sum();
            (scale.size2 * left).sqrt()
        })
        .collect();
    EvidenceForce {
        force_n: (0..shape.nrows()).map(|i| static_force_n + mean[(i, 0)]).collect(),
        sd_n,
        noise_m: (scale.size2 * scale.ratio).sqrt(),
        size_n: scale.size2.sqrt(),
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand::rngs::StdRng;
    use rand_distr::{Distribution as _, StandardNormal};

    use super::super::tests::example;
    use super::*;

    fn normal(rng: &mut StdRng, n: usize) -> Mat<f64> {
        Mat::from_fn(n, 1, |_, _| StandardNormal.sample(rng))
    }

    /// Forces drawn from the prior itself: evidence must find its scales, intervals must hold.
    #[test]
    fn property_forces_drawn_from_the_prior_are_recovered_with_honest_intervals() {
        let model = DisplacementModel { low_pass_hz: 500.0, ..example() };
        let position: Vec<f64> = (0..60).map(|i| 0.04 * (i as f64 - 30.0)).collect();
        let prior = ForcePrior {
            correlation: Correlation::Gaussian,
            correlation_m: 0.125,
            spread_m: 0.5,
            centre_m: 0.0,
        };
        let root = prior.root(&position).unwrap();
        let mut rng = StdRng::seed_from_u64(5);
        let (size, noise) = (30e3, 1e-6);
        let draws: Vec<(Vec<f64>, Vec<f64>)> = (0..40)
            .map(|_| {
                let deviation = &root * normal(&mut rng, 60) * size;
                let force = Mat::from_fn(60, 1, |i, _| model.static_force_n + deviation[(i, 0)]);
                let window = &model.kernel * &force + normal(&mut rng, 60) * noise;
                ((0..60).map(|i| force[(i, 0)]).collect(), (0..60).map(|i| window[(i, 0)]).collect())
            })
            .collect();
        let windows: Vec<Vec<f64>> = draws.iter().map(|d| d.1.clone()).collect();
        let fit = fit_by_evidence(&model, &position, 0.0, &windows, 0..60).unwrap();
        assert_eq!(fit.prior.spread_m, 0.5);
        assert!((0.1..=0.16).contains(&fit.prior.correlation_m), "{:?}", fit.prior);
        let (mut inside, mut ratio) = (0, 0.0);
        for (draw, found) in draws.iter().zip(&fit.forces) {
            inside +=
                (15..45).filter(|i| (found.force_n[*i] - draw.0[*i]).abs() < 1.645 * found.sd_n[*i]).count();
            ratio += found.noise_m / noise / 40.0;
        }
        let coverage = inside as f64 / (40 * 30) as f64;
        assert!((0.8..=0.97).contains(&coverage), "90 % interval holds {coverage}");
        assert!((ratio - 1.0).abs() < 0.15, "noise found is {ratio} of the true noise");
    }
}
