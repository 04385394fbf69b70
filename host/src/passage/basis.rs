//! Sleeper reduced to a few generalised coordinates: lowest modes on the nominal ballast plus the static shapes under
//! the two rail seats (Rubin's form of component mode synthesis).
//!
//! The static shapes make the seats statically exact whatever the number of modes, so that the error of the reduction
//! is dynamic only; with all modes the basis is the full finite-element model.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::SimulationError;
use crate::beam;
use crate::track::{Sleeper, SleeperBeam};

/// Generalised coordinates of one sleeper: orthonormal in mass, elastic stiffness diagonal.
#[derive(Clone, Debug)]
pub struct SleeperBasis {
    /// Elastic stiffness per coordinate, 1/s² (mass is 1).
    pub elastic: Vec<f64>,
    /// Stiffness-proportional damping of the elastic part, s.
    pub damping_s: f64,
    /// Winkler bed of unit stiffness per metre, in the coordinates: metres per kilogram.
    pub bed: DMatrix<f64>,
    /// Deflection at crossing seat and stock seat per coordinate, kg^-1/2.
    pub seat: [Vec<f64>; 2],
    /// Deflection at the sensor per coordinate.
    pub sensor: Vec<f64>,
    /// Deflection of the support points per coordinate, `[point][coordinate]`.
    pub points: DMatrix<f64>,
    /// Length of sleeper carried by each support point, metres.
    pub tributary_m: Vec<f64>,
}

/// Static shapes that are linear combinations of the modes to this part are left out.
const INDEPENDENT: f64 = 1e-6;

impl SleeperBasis {
    /// Basis with `modes` modes; `ballast_n_m2` is the typical stiffness that shapes them.
    pub fn new(sleeper: &Sleeper, modes: usize, ballast_n_m2: f64) -> Result<Self, SimulationError> {
        match sleeper {
            Sleeper::Beam(beam) => Self::of_beam(beam, modes, ballast_n_m2),
            Sleeper::RigidHalves { mass_kg, length_m } => Ok(Self::rigid_halves(*mass_kg, *length_m)),
        }
    }

    /// Number of coordinates.
    pub fn len(&self) -> usize {
        self.elastic.len()
    }

    /// Never: a sleeper has at least one coordinate.
    pub fn is_empty(&self) -> bool {
        self.elastic.is_empty()
    }

    fn rigid_halves(mass_kg: f64, length_m: f64) -> Self {
        let unit = 1.0 / mass_kg.sqrt();
        Self {
            elastic: vec![0.0; 2],
            damping_s: 0.0,
            bed: DMatrix::identity(2, 2) * (length_m / mass_kg),
            seat: [vec![unit, 0.0], vec![0.0, unit]],
            sensor: vec![unit, 0.0],
            points: DMatrix::identity(2, 2) * unit,
            tributary_m: vec![length_m; 2],
        }
    }

    fn of_beam(beam: &SleeperBeam, modes: usize, ballast_n_m2: f64) -> Result<Self, SimulationError> {
        let (elastic, mass, tributary_m) = matrices(beam);
        let mut on_ballast = elastic.clone();
        for (node, length) in tributary_m.iter().enumerate() {
            on_ballast[(2 * node, 2 * node)] += ballast_n_m2 * length;
        }
        let mut shapes = lowest_modes(&on_ballast, &mass, modes)?;
        let attachments = static_shapes(&on_ballast, [beam.crossing_seat, beam.stock_seat])?;
        for shape in attachments {
            append_orthonormal(&mut shapes, shape, &mass);
        }
        let basis = DMatrix::from_columns(&shapes);
        let eigen = SymmetricEigen::new(basis.transpose() * &elastic * &basis);
        let basis = basis * eigen.eigenvectors;
        let deflection = |node: usize| basis.row(2 * node).iter().copied().collect::<Vec<f64>>();
        let n_points = tributary_m.len();
        let points = DMatrix::from_fn(n_points, basis.ncols(), |p, j| basis[(2 * p, j)]);
        let weights = DMatrix::from_diagonal(&DVector::from_vec(tributary_m.clone()));
        Ok(Self {
            // Rigid motion costs no energy; rounding must not make it cost negative energy.
            elastic: eigen.eigenvalues.iter().map(|v| v.max(0.0)).collect(),
            damping_s: beam.damping_stiffness_proportional_s,
            bed: points.transpose() * weights * &points,
            seat: [deflection(beam.crossing_seat), deflection(beam.stock_seat)],
            sensor: deflection(beam.sensor),
            points,
            tributary_m,
        })
    }
}

/// Elastic stiffness, mass and tributary lengths of the free beam.
fn matrices(beam: &SleeperBeam) -> (DMatrix<f64>, DMatrix<f64>, Vec<f64>) {
    let n = beam.y_m.len();
    let mut stiffness = DMatrix::zeros(2 * n, 2 * n);
    let mut mass = DMatrix::zeros(2 * n, 2 * n);
    let mut tributary_m = vec![0.0; n];
    for e in 0..n - 1 {
        let length = beam.y_m[e + 1] - beam.y_m[e];
        let (k, m) = (beam::stiffness(&beam.section, length), beam::mass(&beam.section, length));
        for i in 0..4 {
            for j in 0..4 {
                stiffness[(2 * e + i, 2 * e + j)] += k[i][j];
                mass[(2 * e + i, 2 * e + j)] += m[i][j];
            }
        }
        tributary_m[e] += length / 2.0;
        tributary_m[e + 1] += length / 2.0;
    }
    (stiffness, mass, tributary_m)
}

fn singular(what: &'static str) -> SimulationError {
    SimulationError::Singular { what, place: "the sleeper".into() }
}

/// Mass-orthonormal eigenvectors of the lowest eigenvalues.
fn lowest_modes(
    stiffness: &DMatrix<f64>,
    mass: &DMatrix<f64>,
    count: usize,
) -> Result<Vec<DVector<f64>>, SimulationError> {
    let factor = mass.clone().cholesky().ok_or_else(|| singular("mass"))?;
    let lower = factor.l();
    let reduced = lower.solve_lower_triangular(stiffness).ok_or_else(|| singular("mass"))?;
    let reduced = lower.solve_lower_triangular(&reduced.transpose()).ok_or_else(|| singular("mass"))?;
    let eigen = SymmetricEigen::new((&reduced + reduced.transpose()) * 0.5);
    let mut order: Vec<usize> = (0..eigen.eigenvalues.len()).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    let upper = lower.transpose();
    order
        .into_iter()
        .take(count.max(1))
        .map(|i| {
            let vector = eigen.eigenvectors.column(i).into_owned();
            upper.solve_upper_triangular(&vector).ok_or_else(|| singular("mass"))
        })
        .collect()
}

/// Deflections under a unit force on each seat.
fn static_shapes(stiffness: &DMatrix<f64>, seats: [usize; 2]) -> Result<[DVector<f64>; 2], SimulationError> {
    let factor = stiffness.clone().cholesky().ok_or_else(|| singular("stiffness"))?;
    Ok(seats.map(|seat| {
        let mut load = DVector::zeros(stiffness.nrows());
        load[2 * seat] = 1.0;
        factor.solve(&load)
    }))
}

/// Gram-Schmidt in the mass product, twice for full accuracy; drops what the basis already spans.
fn append_orthonormal(shapes: &mut Vec<DVector<f64>>, mut shape: DVector<f64>, mass: &DMatrix<f64>) {
    let norm = |v: &DVector<f64>| v.dot(&(mass * v)).max(0.0).sqrt();
    let before = norm(&shape);
    for _ in 0..2 {
        for known in shapes.iter() {
            let share = known.dot(&(mass * &shape));
            shape -= known * share;
        }
    }
    let after = norm(&shape);
    if shapes.len() < mass.nrows() && after > INDEPENDENT * before {
        shapes.push(shape / after);
    }
}
