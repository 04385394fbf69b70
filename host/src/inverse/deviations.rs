//! What the wheels of a train deviate by, each for itself, on one rail, and what the sensor shows of it.

use std::sync::{Arc, Mutex, PoisonError};

use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::{Accum, Mat, Par};
use rayon::prelude::*;

use super::prior::Prior;
use super::train::Axle;
use super::wheel::{SIDES, Wheel};

/// Of the wheels of a train on one rail under a prior; its groups share this.
pub(super) struct Deviations {
    /// Factors of the covariance of a wheel's own deviation, N: `[leading, trailing]`.
    pub(super) root_n: [Mat<f64>; 2],
    /// kernel · root: window per whitened deviation, per axle.
    pub(super) shaped: Vec<Mat<f64>>,
    /// Covariance of the window by it, m²/s⁴, per axle, lower triangle.
    covariance: Vec<Mat<f64>>,
}

impl Deviations {
    /// Of `[crossing, stock]` number `rail`; `None` if a covariance is not finite.
    fn new(wheel: &Wheel, axles: &[Axle], rail: usize, prior: &Prior) -> Option<Self> {
        let root_n = wheel.roots_n(prior, rail)?;
        let (shaped, covariance) = axles
            .par_iter()
            .map(|axle| {
                let root = &root_n[usize::from(!axle.class.leading)];
                let shaped = wheel.shaped(&axle.kernels[rail], root);
                let covariance = square(&shaped);
                (shaped, covariance)
            })
            .unzip();
        Some(Self { root_n, shaped, covariance })
    }

    /// Adds the covariance of the leading part of a window by the deviation of one axle, lower triangle.
    pub(super) fn add_covariance(&self, axle: usize, covariance: &mut Mat<f64>) {
        let len = covariance.nrows();
        for j in 0..len {
            let own = &self.covariance[axle].col_as_slice(j)[j..len];
            covariance.col_as_slice_mut(j)[j..].iter_mut().zip(own).for_each(|(c, o)| *c += o);
        }
    }
}

/// The deviations on both rails under the prior asked for last: a search over hyper-parameters moves one of them at a time, of which
/// most concern one rail only.
#[derive(Default)]
pub(super) struct Latest([Mutex<Option<(Prior, Arc<Deviations>)>>; 2]);

impl Latest {
    /// On `[crossing, stock]`; `None` if a covariance is not finite.
    pub(super) fn under(&self, prior: &Prior, wheel: &Wheel, axles: &[Axle]) -> Option<[Arc<Deviations>; 2]> {
        let of = |rail: usize| {
            let own = prior.of_own(SIDES[rail]);
            let mut latest = self.0[rail].lock().unwrap_or_else(PoisonError::into_inner);
            match &*latest {
                Some((known, deviations)) if *known == own => Some(Arc::clone(deviations)),
                _ => {
                    let new = Arc::new(Deviations::new(wheel, axles, rail, prior)?);
                    *latest = Some((own, Arc::clone(&new)));
                    Some(new)
                }
            }
        };
        Some([of(0)?, of(1)?])
    }
}

/// shaped · shapedᵀ, lower triangle.
fn square(shaped: &Mat<f64>) -> Mat<f64> {
    let mut out = Mat::zeros(shaped.nrows(), shaped.nrows());
    triangular::matmul(
        &mut out,
        BlockStructure::TriangularLower,
        Accum::Replace,
        shaped,
        BlockStructure::Rectangular,
        shaped.transpose(),
        BlockStructure::Rectangular,
        1.0,
        Par::Seq,
    );
    out
}
