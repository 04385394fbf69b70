//! The other way round: what the forces of a wheelset tell of the path under its wheel on the crossing rail.

use faer::Mat;
use faer::linalg::solvers::{PartialPivLu, Solve as _};

use super::{Contacts, Interaction};

/// A wheelset moving at a speed. Its forces on the crossing rail are known, those on the stock rail follow from them: there is
/// no irregularity there, but sleepers and roll move that contact too.
pub struct Wheelset {
    /// Samples per second.
    pub rate_hz: f64,
    /// Way of the wheel on the crossing rail relative to that rail, per force deviation there, m/N.
    crossing: Mat<f64>,
    /// The same per force deviation on the stock rail.
    across: Mat<f64>,
    /// The stock side's way per force deviation on the crossing side.
    back: Mat<f64>,
    /// Compliance of the stock side, its contact included, factorised.
    stock: PartialPivLu<f64>,
    /// Variation of the rails' deflection under the static load.
    load_m: Contacts,
}

impl Interaction {
    /// Wheels at `position_m`, one per time step on their own clocks, in the order of passing; `static_force_n`: mean of both.
    pub fn wheelset(&self, position_m: &[f64], direction: f64, static_force_n: f64) -> Wheelset {
        let n = position_m.len();
        let rails = self.rail_kernels(position_m);
        let between = |read: usize, loaded: usize| self.within_wheelset(&rails, read, loaded);
        let mut stock = between(1, 1);
        let [_, contact] = self.contact_compliance_m_n(static_force_n);
        for i in 0..n {
            stock[(i, i)] += contact;
        }
        Wheelset {
            rate_hz: self.bogie.sampling.rate_hz,
            crossing: between(0, 0),
            across: between(0, 1),
            back: between(1, 0),
            stock: stock.partial_piv_lu(),
            load_m: self.load_deflection_m(&rails, position_m, direction, static_force_n),
        }
    }
}

impl Wheelset {
    /// Path of the wheel on the crossing rail relative to that rail, metres, positive down, for the force deviations of the
    /// leading or the trailing wheelset of a bogie, newtons, one column: −(C d + C× d_s + w_s) of [`super`], without the
    /// compression of the contact.
    pub fn relative_path_m(&self, leading: bool, deviation_n: &Mat<f64>) -> Mat<f64> {
        let load_m = &self.load_m[usize::from(!leading)];
        self.path_change_m(deviation_n) + &self.across * self.stock.solve(&load_m[1]) - &load_m[0]
    }

    /// Change of that path with changes of the force, a column each.
    pub fn path_change_m(&self, change_n: &Mat<f64>) -> Mat<f64> {
        &self.across * self.stock.solve(&self.back * change_n) - &self.crossing * change_n
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::greens::GreensSampling;
    use crate::interaction::BogieResponses;
    use crate::track::Mesh;
    use crate::verification::reference::{STIFF, ballast, panel, vehicle};

    const STATIC_N: f64 = 76e3;

    /// A dip under the leading wheel on the crossing rail, and the forces that the whole bogie answers it with.
    #[test]
    fn property_path_behind_the_forces_is_that_which_made_them() {
        let track = panel(STIFF, Mesh::default());
        let bogie = Arc::new(BogieResponses::new(&vehicle(), GreensSampling::low()));
        let interaction = Interaction::new(&track, &ballast(&track), &bogie, 4.0);
        let speed_m_s = 44.0;
        let step = speed_m_s / GreensSampling::low().rate_hz;
        let n = 2 * (4.0 / step) as usize + 1;
        let position_m: Vec<f64> = (0..n).map(|k| (k as f64 - (n / 2) as f64) * step).collect();
        let motion = interaction.moving(&position_m, 1.0, speed_m_s, STATIC_N);
        let dip = |x: f64| 1e-3 * (-(x / 0.4).powi(2)).exp();
        let load = motion.load_deflection_m();
        let mut path = load.clone();
        path[0][0] += Mat::from_fn(n, 1, |k, _| dip(position_m[k]));
        let force = motion.solve(&path);
        let contact = bogie.contact_compliance_m_n(STATIC_N);
        let found = interaction.wheelset(&position_m, 1.0, STATIC_N).relative_path_m(true, &force[0][0]);
        let wheelset = interaction.wheelset(&position_m, 1.0, STATIC_N);
        let changed = wheelset.relative_path_m(true, &(2.0 * &force[0][0])) - &found;
        let change = wheelset.path_change_m(&force[0][0]);
        assert!(
            (0..n).all(|k| (changed[(k, 0)] - change[(k, 0)]).abs() < 1e-12),
            "the path is linear in the force"
        );
        for (k, x) in position_m.iter().enumerate().filter(|(_, x)| x.abs() < 1.2) {
            let z = found[(k, 0)] - contact * force[0][0][(k, 0)];
            // What the other wheelset does through the bogie frame is left out, a slow drift.
            assert!((z - dip(*x)).abs() < 0.03e-3, "at {x} m: {z} instead of {}", dip(*x));
        }
    }
}
