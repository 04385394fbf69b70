//! What the windows of bogies show for a defect at every place around the wheel.

use std::sync::Arc;

use faer::Mat;
use faer::linalg::solvers::Llt;
use rayon::prelude::*;

use super::Added;
use crate::gap::fit::whitened;
use crate::gap::latent::Scene;
use crate::gap::variation::Variation;
use crate::signal::dot;

/// exp of less than this is lost beside 1.
const NOTHING: f64 = -50.0;

/// What a window shows for a defect of unit size at every place of one of its wheelsets: b = cᵀy, g = cᵀc.
#[derive(Clone)]
pub(super) struct Shown {
    b: Vec<f64>,
    g: Vec<f64>,
}

impl Shown {
    fn at(&self, factor: f64, place: usize) -> f64 {
        factor * self.b[place] - 0.5 * factor * factor * self.g[place]
    }

    /// The place that explains the most, and how much, log likelihood ratio.
    fn top(&self, factor: f64) -> (usize, f64) {
        let all = (0..self.b.len()).map(|i| (i, self.at(factor, i)));
        all.max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, 0.0))
    }

    /// Log likelihood ratio, averaged over the places, where the likeliest has `top`. What cannot change the sum is left out.
    fn gain(&self, factor: f64, top: f64) -> f64 {
        let all = (0..self.b.len()).map(|i| self.at(factor, i) - top).filter(|less| *less > NOTHING);
        top + (all.map(f64::exp).sum::<f64>() / self.b.len() as f64).ln()
    }

    /// The same without what some places say.
    fn without(mut self, mute: &[bool]) -> Self {
        for (place, _) in mute.iter().enumerate().filter(|(_, m)| **m) {
            (self.b[place], self.g[place]) = (0.0, 0.0);
        }
        self
    }

    /// Probability of every place.
    pub(super) fn places(&self, factor: f64) -> Vec<f64> {
        let (_, top) = self.top(factor);
        let weight: Vec<f64> = (0..self.b.len()).map(|i| (self.at(factor, i) - top).exp()).collect();
        let sum: f64 = weight.iter().sum();
        weight.iter().map(|w| w / sum).collect()
    }
}

/// What the window of a bogie shows for defects of its two wheelsets. A flat's burst of one of them looks much like one of the other.
#[derive(Clone)]
pub(super) struct OfBogie {
    pub(super) axles: [Shown; 2],
    /// c₁ᵀc₂ for all places of the front wheelset and of the rear one.
    both: Arc<Mat<f64>>,
}

impl OfBogie {
    /// Both wheelsets with defects: the one that explains more, and the other beside the likeliest place of that.
    pub(super) fn one_after_another(&self, factor: f64) -> (usize, Shown) {
        self.beside(factor, self.tops(factor))
    }

    fn tops(&self, factor: f64) -> [(usize, f64); 2] {
        self.axles.each_ref().map(|s| s.top(factor))
    }

    fn beside(&self, factor: f64, tops: [(usize, f64); 2]) -> (usize, Shown) {
        let first = usize::from(tops[1].1 > tops[0].1);
        let place = tops[first].0;
        let mut second = self.axles[1 - first].clone();
        for (j, b) in second.b.iter_mut().enumerate().filter(|(j, _)| self.axles[1 - first].g[*j] > 0.0) {
            *b -= factor * if first == 0 { self.both[(place, j)] } else { self.both[(j, place)] };
        }
        (first, second)
    }

    /// Log likelihood ratios of a defect of the front wheelset, of the rear one, and of both.
    pub(super) fn gains(&self, factor: f64) -> [f64; 3] {
        let tops = self.tops(factor);
        let [front, rear] = [0, 1].map(|axle| self.axles[axle].gain(factor, tops[axle].1));
        let (first, second) = self.beside(factor, tops);
        [front, rear, [front, rear][first] + second.gain(factor, second.top(factor).1)]
    }

    /// Probabilities of no defect, and of those of [`Self::gains`], where a share of the wheelsets have them; and the log likelihood
    /// ratio of all together.
    pub(super) fn posterior(gains: [f64; 3], share: f64) -> ([f64; 4], f64) {
        let (q, p) = (share, 1.0 - share);
        let logs = [2.0 * p.ln(), (q * p).ln() + gains[0], (q * p).ln() + gains[1], 2.0 * q.ln() + gains[2]];
        let top = logs.into_iter().fold(f64::NEG_INFINITY, f64::max);
        let sum: f64 = logs.iter().map(|l| (l - top).exp()).sum();
        (logs.map(|l| (l - top).exp() / sum), top + sum.ln())
    }
}

/// Windows of a passage, whitened by the covariance of one.
pub(super) struct Seen {
    factor: Option<Llt<f64>>,
    windows: Mat<f64>,
}

/// All passages as they look if wheels differ by `variation`.
pub(super) fn seen(scene: &Scene, variation: &Variation) -> Vec<Seen> {
    let of = |i: usize| {
        let residuals = &scene.residuals[i];
        let factor = scene.shapes[i].factor(variation);
        let y = Mat::from_fn(scene.observed[i].mean.len(), residuals.len(), |k, c| residuals[c][k]);
        let windows = factor.as_ref().map_or_else(|| y.clone(), |f| whitened(f, &y));
        Seen { factor, windows }
    };
    (0..scene.observed.len()).into_par_iter().map(of).collect()
}

impl Seen {
    /// All bogies.
    pub(super) fn shown(&self, added: &Added, mute: &[bool]) -> Vec<OfBogie> {
        let [front, rear] = added.each_ref().map(|places| {
            let plain = Mat::from_fn(self.windows.nrows(), places.len(), |k, p| places[p][k]);
            self.factor.as_ref().map_or_else(|| plain.clone(), |f| whitened(f, &plain))
        });
        let both = Arc::new(front.transpose() * &rear);
        let of = |columns: &Mat<f64>, y: &[f64]| {
            let all = (0..columns.ncols()).map(|p| columns.col_as_slice(p));
            let (b, g) = all.map(|c| (dot(c, y), dot(c, c))).unzip();
            Shown { b, g }.without(mute)
        };
        (0..self.windows.ncols())
            .map(|k| {
                let y = self.windows.col_as_slice(k);
                OfBogie { axles: [of(&front, y), of(&rear, y)], both: Arc::clone(&both) }
            })
            .collect()
    }

    /// Log likelihood of the windows without defects.
    pub(super) fn log_likelihood(&self) -> f64 {
        let Some(factor) = &self.factor else { return f64::NEG_INFINITY };
        let windows = (0..self.windows.ncols()).map(|c| self.windows.col_as_slice(c));
        let squares: f64 = windows.map(|w| dot(w, w)).sum();
        let l = factor.L();
        let log_det: f64 = (0..l.nrows()).map(|k| l[(k, k)].ln()).sum();
        -0.5 * squares - self.windows.ncols() as f64 * log_det
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_gain_of_one_place() {
        // One place only: a b − a²g/2.
        let shown = Shown { b: vec![3.0], g: vec![2.0] };
        assert!((shown.gain(1.5, shown.top(1.5).1) - (4.5 - 2.25)).abs() < 1e-12);
        assert_eq!(shown.places(1.5), vec![1.0]);
    }

    /// A bogie whose front and rear wheelsets show `b` for flats at two places, with columns of unit length.
    fn bogie(front: [f64; 2], rear: [f64; 2], alike: f64) -> OfBogie {
        let of = |b: [f64; 2]| Shown { b: b.to_vec(), g: vec![1.0; 2] };
        let both = Mat::from_fn(2, 2, |i, j| if i == 0 && j == 0 { alike } else { 0.0 });
        OfBogie { axles: [of(front), of(rear)], both: Arc::new(both) }
    }

    /// A burst of the front wheelset, y = 10 c, of which the rear one would make nine tenths: c₁ᵀc₂ = 0.9.
    #[test]
    fn analytic_one_burst_is_not_counted_for_both_wheelsets() {
        let one = bogie([10.0, 0.0], [9.0, 0.0], 0.9);
        let ([_, front, rear, both], _) = OfBogie::posterior(one.gains(10.0), 0.5);
        assert!(front > 0.9 && rear < 0.01 && both < 0.1, "{front} {rear} {both}");
        // Both: y = 10 c₁ + 10 c₂ at places that have nothing in common.
        let two = bogie([10.0, 0.0], [0.0, 10.0], 0.9);
        let ([.., both], likely) = OfBogie::posterior(two.gains(10.0), 0.5);
        // Each is worth half of 10², less ln 2 for the place; all four cases are alike before.
        let expected = 2.0 * (50.0 - 2f64.ln()) + 0.25f64.ln();
        assert!(both > 0.999 && (likely - expected).abs() < 1e-6, "{both} {likely}");
    }
}
