//! The linear-Gaussian estimator of one kind of axle group at one speed.

use faer::linalg::matmul::{matmul, triangular};
use faer::linalg::solvers::{Llt, Solve};
use faer::prelude::SolveLlt;
use faer::{Accum, Mat, Par};

use super::Prior;
use crate::greens::GreensFunctions;
use crate::greens::moving::{WheelPath, constant_force_response, kernel};
use crate::track::Side;
