//! Truncation and Tikhonov regularisation on singular values, with their rules for how much of it.

use faer::Mat;
use faer::linalg::solvers::Solve as _;

use super::{DisplacementError, DisplacementModel, column};

/// Named method.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// The paper's: Moore-Penrose inverse for the force itself; among the tolerances tried the one with the least
    /// displacement residual of the low-passed force.
    Pinv,
    /// The same for the deviation f − Q: what the data cannot tell becomes static instead of zero.
    PinvDeviation,
    /// Truncated singular values for f − Q, their number by generalised cross-validation.
    TruncatedGcv,
    /// Tikhonov on the second difference of f − Q (zero beyond both ends), weight by generalised cross-validation.
    TikhonovGcv,
}

impl Rule {
    /// In the order of the tables.
    pub const ALL: [Rule; 4] = [Rule::Pinv, Rule::PinvDeviation, Rule::TruncatedGcv, Rule::TikhonovGcv];

    /// Name for tables.
    pub fn name(self) -> &'static str {
        match self {
            Rule::Pinv => "paper: pseudo-inverse, tolerance by residual",
            Rule::PinvDeviation => "the same for f \u{2212} Q",
            Rule::TruncatedGcv => "f \u{2212} Q, truncated SVD, GCV",
            Rule::TikhonovGcv => "f \u{2212} Q, Tikhonov second difference, GCV",
        }
    }
}

/// Force found by a rule.
#[derive(Clone, Debug, PartialEq)]
pub struct RuleForce {
    /// Low-passed, newtons, one per force sample.
    pub force_n: Vec<f64>,
    /// What the rule chose: relative tolerance, number of singular values, or weight relative to the largest.
    pub parameter: f64,
    /// Whether the choice lies at an end of what was tried, so that the rule had no say.
    pub at_limit: bool,
    /// RMS of displacement not explained, metres.
    pub residual_m: f64,
}

/// Tolerances tried, as powers of ten. The paper names no range; the least residual would go on towards no truncation
/// at all, and with smaller tolerances forces of several hundred kN come out of recordings.
const TOLERANCES: (f64, f64, usize) = (-1.0, -8.0, 36);
/// Weights tried relative to the largest singular value, as powers of ten.
const WEIGHTS: (f64, f64, usize) = (-8.0, 0.0, 81);

fn powers((first, last, count): (f64, f64, usize)) -> impl Iterator<Item = f64> {
    (0..count).map(move |i| 10f64.powf(first + (last - first) * i as f64 / (count - 1) as f64))
}

/// Singular values of the kernel, possibly with a penalty folded in: kernel · shape = U S Vᵀ, force = W c.
struct Decomposition {
    u: Mat<f64>,
    s: Vec<f64>,
    /// shape · V.
    w: Mat<f64>,
}

impl Decomposition {
    fn new(kernel: &Mat<f64>, shape: Option<&Mat<f64>>) -> Result<Self, DisplacementError> {
        let shaped = shape.map_or_else(|| kernel.clone(), |l| kernel * l);
        let svd = shaped.thin_svd().map_err(|_| DisplacementError::Decomposition("singular values"))?;
        let v = svd.V().to_owned();
        Ok(Self {
            u: svd.U().to_owned(),
            s: svd.S().column_vector().iter().copied().collect(),
            w: shape.map_or_else(|| v.clone(), |l| l * &v),
        })
    }

    /// Components of a window along the left singular vectors.
    fn components(&self, window: &Mat<f64>) -> Vec<f64> {
        let b = self.u.transpose() * window;
        (0..self.s.len()).map(|i| b[(i, 0)]).collect()
    }

    /// Σ wᵢ φᵢ bᵢ/sᵢ with filter factors φ.
    fn force(&self, b: &[f64], filter: impl Fn(usize) -> f64) -> Mat<f64> {
        let c = Mat::from_fn(self.s.len(), 1, |i, _| {
            let phi = filter(i);
            if phi > 0.0 { phi * b[i] / self.s[i] } else { 0.0 }
        });
        &self.w * c
    }

    /// Generalised cross-validation score: Golub, Heath & Wahba, Technometrics 21 (1979).
    fn gcv(&self, window: &Mat<f64>, b: &[f64], filter: impl Fn(usize) -> f64) -> f64 {
        let outside = (window.norm_l2().powi(2) - b.iter().map(|v| v * v).sum::<f64>()).max(0.0);
        let (mut misfit, mut degrees) = (outside, window.nrows() as f64);
        for (i, value) in b.iter().enumerate() {
            let phi = filter(i);
            misfit += ((1.0 - phi) * value).powi(2);
            degrees -= phi;
        }
        misfit / (degrees + 1e-9).powi(2)
    }
}

/// All rules on one model; the decompositions are made once and serve any number of windows.
pub struct RuleSolver<'a> {
    model: &'a DisplacementModel,
    low_pass: Mat<f64>,
    static_window: Vec<f64>,
    plain: Decomposition,
    smooth: Decomposition,
}

impl<'a> RuleSolver<'a> {
    /// Prepares the decompositions.
    pub fn new(model: &'a DisplacementModel) -> Result<Self, DisplacementError> {
        model.check()?;
        let n = model.kernel.ncols();
        let difference = Mat::from_fn(n, n, |i, j| match i.abs_diff(j) {
            0 => -2.0,
            1 => 1.0,
            _ => 0.0,
        });
        let shape = difference.partial_piv_lu().solve(Mat::<f64>::identity(n, n));
        Ok(Self {
            model,
            low_pass: model.low_pass(),
            static_window: model.static_window(),
            plain: Decomposition::new(&model.kernel, None)?,
            smooth: Decomposition::new(&model.kernel, Some(&shape))?,
        })
    }

    /// Ratio of the largest to the smallest singular value of the kernel.
    pub fn condition(&self) -> f64 {
        let s = &self.plain.s;
        s.first().copied().unwrap_or(0.0) / s.last().copied().unwrap_or(0.0)
    }

    /// Force for a window (metres) from which the responses to all known forces have been subtracted.
    pub fn solve(&self, rule: Rule, window_m: &[f64]) -> Result<RuleForce, DisplacementError> {
        self.model.check_window(window_m)?;
        let base_n = if rule == Rule::Pinv { 0.0 } else { self.model.static_force_n };
        let window = Mat::from_fn(window_m.len(), 1, |i, _| {
            window_m[i] - if rule == Rule::Pinv { 0.0 } else { self.static_window[i] }
        });
        let (deviation, parameter, at_limit) = match rule {
            Rule::Pinv | Rule::PinvDeviation => {
                self.least_residual(&window, self.model.static_force_n - base_n)
            }
            Rule::TruncatedGcv => self.truncated(&window),
            Rule::TikhonovGcv => self.tikhonov(&window),
        };
        let left = &window - &self.model.kernel * &deviation;
        Ok(RuleForce {
            force_n: (0..deviation.nrows()).map(|i| base_n + deviation[(i, 0)]).collect(),
            parameter,
            at_limit,
            residual_m: left.norm_l2() / (left.nrows() as f64).sqrt(),
        })
    }

    /// Low-pass of a force that has the constant value `outside_n` outside the unknown stretch.
    fn filtered(&self, force: &Mat<f64>, outside_n: f64) -> Mat<f64> {
        let deviation = Mat::from_fn(force.nrows(), 1, |i, _| force[(i, 0)] - outside_n);
        let low = &self.low_pass * deviation;
        Mat::from_fn(force.nrows(), 1, |i, _| low[(i, 0)] + outside_n)
    }

    fn least_residual(&self, window: &Mat<f64>, outside_n: f64) -> (Mat<f64>, f64, bool) {
        let d = &self.plain;
        let b = d.components(window);
        let largest = d.s.first().copied().unwrap_or(0.0);
        let mut best = (f64::INFINITY, column(&vec![0.0; d.w.nrows()]), 0.0, 0usize);
        for (step, tolerance) in powers(TOLERANCES).enumerate() {
            let kept = d.s.partition_point(|s| *s > tolerance * largest);
            let force = d.force(&b, |i| if i < kept { 1.0 } else { 0.0 });
            let force = self.filtered(&force, outside_n);
            let residual = (&self.model.kernel * &force - window).norm_l2();
            if residual < best.0 {
                best = (residual, force, tolerance, step);
            }
        }
        (best.1, best.2, best.3 == 0 || best.3 + 1 == TOLERANCES.2)
    }

    fn truncated(&self, window: &Mat<f64>) -> (Mat<f64>, f64, bool) {
        let d = &self.plain;
        let b = d.components(window);
        let filter = |kept: usize| move |i: usize| if i < kept { 1.0 } else { 0.0 };
        let last = d.s.len() - 2;
        let score = |kept: &usize| d.gcv(window, &b, filter(*kept));
        let kept = (1..=last).min_by(|a, c| score(a).total_cmp(&score(c))).unwrap_or(1);
        let force = self.filtered(&d.force(&b, filter(kept)), 0.0);
        (force, kept as f64, kept == 1 || kept == last)
    }

    fn tikhonov(&self, window: &Mat<f64>) -> (Mat<f64>, f64, bool) {
        let d = &self.smooth;
        let b = d.components(window);
        let largest = d.s.first().copied().unwrap_or(0.0);
        let filter = |weight: f64| {
            let square = (weight * largest).powi(2);
            move |i: usize| d.s[i] * d.s[i] / (d.s[i] * d.s[i] + square)
        };
        let score = |weight: f64| d.gcv(window, &b, filter(weight));
        let tried: Vec<f64> = powers(WEIGHTS).collect();
        let best = (0..tried.len()).min_by(|a, c| score(tried[*a]).total_cmp(&score(tried[*c]))).unwrap_or(0);
        let force = self.filtered(&d.force(&b, filter(tried[best])), 0.0);
        (force, tried[best], best == 0 || best + 1 == tried.len())
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{example, manufactured};
    use super::*;

    #[test]
    fn analytic_every_deviation_rule_recovers_a_manufactured_force() {
        let model = example();
        let (force, window) = manufactured(&model);
        let solver = RuleSolver::new(&model).unwrap();
        for rule in [Rule::PinvDeviation, Rule::TruncatedGcv, Rule::TikhonovGcv] {
            let found = solver.solve(rule, &window).unwrap();
            let worst = (0..60).map(|i| (found.force_n[i] - force[i]).abs()).fold(0.0, f64::max);
            // The force's own content above the low-pass is what is left.
            assert!(worst < 2e3, "{}: {worst} N", rule.name());
            assert!(found.residual_m < 1e-8, "{}", rule.name());
        }
    }

    #[test]
    fn property_no_information_means_static_force_and_zero_for_the_paper() {
        let mut model = example();
        // The sensor does not feel the last ten samples at all.
        for j in 50..60 {
            for i in 0..60 {
                model.kernel[(i, j)] = 0.0;
            }
        }
        let (_, window) = manufactured(&model);
        let solver = RuleSolver::new(&model).unwrap();
        let paper = solver.solve(Rule::Pinv, &window).unwrap().force_n[54];
        let deviation = solver.solve(Rule::PinvDeviation, &window).unwrap().force_n[54];
        assert!(paper.abs() < 0.3 * model.static_force_n, "{paper}");
        assert!((deviation - model.static_force_n).abs() < 0.1 * model.static_force_n, "{deviation}");
    }
}
