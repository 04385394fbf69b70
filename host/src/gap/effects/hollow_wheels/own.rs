//! Depth and shift that each wheelset shows.

use faer::Mat;
use faer::linalg::solvers::{Llt, Solve as _};

use crate::gap::fit::whitened;
use crate::gap::latent::Scene;
use crate::gap::variation::Variation;

/// Natural depth and shift are left out of the covariance that weighs a wheelset's own.
const WITHOUT: (f64, f64) = (1e-3, 1e-3);
/// Sizes of the natural variation are not taken beyond this: hollow wheels have inflated them all.
const NATURAL: Variation = Variation {
    noise_m_s2: 0.1,
    load: 0.02,
    side_load: 0.01,
    depth: WITHOUT.0,
    shift_m: WITHOUT.1,
    own_m: 10e-6,
    own_stock_m: 10e-6,
};

/// Depth (relative) and shift (metres, later in x) of one wheelset, with their covariance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Own {
    pub(super) value: [f64; 2],
    pub(super) covariance: [f64; 3],
}

/// What a path deeper by its own depth and shifted by 1 m adds to a window: two columns.
fn plain_columns(scene: &Scene, passage: usize, axle: usize) -> Mat<f64> {
    let moves = &scene.shapes[passage].moves[axle];
    Mat::from_fn(moves.depth.len(), 2, |k, c| if c == 0 { moves.depth[k] } else { moves.shift[k] })
}

/// Depth and shift of all wheelsets of a passage, both axles of a bogie together, by least squares.
pub(super) fn own(scene: &Scene, passage: usize) -> Vec<Own> {
    let Some((factor, columns)) = weighed(scene, passage) else { return Vec::new() };
    let gram = columns.transpose() * &columns;
    // A wheel is not shifted by more than some decimetres; that also keeps a level path solvable.
    let gram = Mat::from_fn(4, 4, |i, j| gram[(i, j)] + if i == j { [0.25, 25.0][i % 2] } else { 0.0 });
    let Ok(solver) = gram.llt(faer::Side::Lower) else { return Vec::new() };
    let windows = &scene.residuals[passage];
    let y = whitened(&factor, &Mat::from_fn(columns.nrows(), windows.len(), |k, b| windows[b][k]));
    let values = solver.solve(columns.transpose() * &y);
    let covariance = solver.solve(Mat::<f64>::identity(4, 4));
    let of = |bogie: usize, axle: usize| {
        let (a, b) = (2 * axle, 2 * axle + 1);
        Own {
            value: [values[(a, bogie)], values[(b, bogie)]],
            covariance: [covariance[(a, a)], covariance[(a, b)], covariance[(b, b)]],
        }
    };
    (0..windows.len()).flat_map(|bogie| [of(bogie, 0), of(bogie, 1)]).collect()
}

/// Covariance by which windows are weighed, and whitened columns: depth and shift of the front, then of the rear wheelset.
fn weighed(scene: &Scene, passage: usize) -> Option<(Llt<f64>, Mat<f64>)> {
    let v = &scene.variation;
    let variation = Variation {
        depth: WITHOUT.0,
        shift_m: WITHOUT.1,
        noise_m_s2: v.noise_m_s2.max(NATURAL.noise_m_s2),
        load: v.load.min(NATURAL.load),
        side_load: v.side_load.min(NATURAL.side_load),
        own_m: v.own_m.min(NATURAL.own_m),
        own_stock_m: v.own_stock_m.min(NATURAL.own_stock_m),
    };
    let factor = scene.shapes[passage].factor(&variation)?;
    let plain = [0, 1].map(|axle| plain_columns(scene, passage, axle));
    let columns = whitened(&factor, &Mat::from_fn(plain[0].nrows(), 4, |k, c| plain[c / 2][(k, c % 2)]));
    Some((factor, columns))
}
