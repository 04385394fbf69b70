//! Rails between the steps: elastic forces from the deformation of the elements, then r, b and u.

use pulp::Simd;

use super::model::{CHUNK, Layout, TrackModel};
use super::vectors::{vectors, vectors_mut};

/// Stiffness of the rail elements in terms of shear and bending deformation, `[element in bay · row + lane]`.
#[derive(Clone, Debug)]
pub(super) struct Rails {
    layout: Layout,
    shear: Vec<f64>,
    bending: Vec<f64>,
    half_length_m: f64,
    damping_s: f64,
}

/// Motion of the rails: displacement u, rate v at t + θ dt, elastic force r, momentum term b.
#[derive(Clone, Debug)]
pub(super) struct RailState {
    pub u: Vec<f64>,
    pub v: Vec<f64>,
    pub r: Vec<f64>,
    pub b: Vec<f64>,
    /// Rates of shear force and bending moment of the elements, `[element][CHUNK + lane]`: the lane before the first one is
    /// read.
    force: [Vec<f64>; 2],
}

impl Rails {
    pub fn new(model: &TrackModel) -> Self {
        let layout = model.layout;
        let len = layout.nodes_per_bay * layout.row;
        let (mut shear, mut bending) = (vec![0.0; len], vec![0.0; len]);
        for side in 0..2 {
            for bay in 0..layout.sleepers - 1 {
                for e in 0..layout.nodes_per_bay {
                    let Some(section) = model.section(side, bay, e) else { continue };
                    let (at, l) = (e * layout.row + side * layout.stride + bay, model.step_m);
                    let phi = crate::beam::shear_ratio(section, l);
                    shear[at] = 12.0 * section.bending_n_m2 / ((1.0 + phi) * l * l * l);
                    bending[at] = section.bending_n_m2 / l;
                }
            }
        }
        Self { layout, shear, bending, half_length_m: 0.5 * model.step_m, damping_s: model.rail_damping_s }
    }

    pub fn at_rest(&self) -> RailState {
        let zero = || vec![0.0; self.layout.rows() * self.layout.row];
        let force = || vec![0.0; self.layout.nodes_per_bay * (CHUNK + self.layout.lanes())];
        RailState { u: zero(), v: zero(), r: zero(), b: zero(), force: [force(), force()] }
    }

    /// Rates of shear force and bending moment.
    #[inline(always)]
    fn deform<S: Simd>(&self, simd: S, state: &mut RailState) {
        let Layout { nodes_per_bay: nodes, row, .. } = self.layout;
        let (n, h) = (self.layout.lanes(), simd.splat_f64s(-self.half_length_m));
        let RailState { v, force: [shear, moment], .. } = state;
        for e in 0..nodes {
            // The node behind the last one of a bay is the seat of the next sleeper, one lane on.
            let right = if e + 1 < nodes { 2 * (e + 1) * row } else { 1 };
            let [w1, t1, w2, t2] =
                [2 * e * row, (2 * e + 1) * row, right, right + row].map(|at| vectors::<S>(&v[at..at + n]));
            let [ks, kb] = [&self.shear, &self.bending].map(|k| vectors::<S>(&k[e * row..e * row + n]));
            let start = e * (CHUNK + n) + CHUNK;
            let [shear, moment] =
                [&mut *shear, &mut *moment].map(|f| vectors_mut::<S>(&mut f[start..start + n]));
            let count = shear.len();
            let [w1, t1, w2, t2, ks, kb] = [w1, t1, w2, t2, ks, kb].map(|row| &row[..count]);
            let moment = &mut moment[..count];
            for l in 0..count {
                let bent = simd.mul_add_f64s(h, simd.add_f64s(t1[l], t2[l]), simd.sub_f64s(w2[l], w1[l]));
                shear[l] = simd.mul_f64s(ks[l], bent);
                moment[l] = simd.mul_f64s(kb[l], simd.sub_f64s(t2[l], t1[l]));
            }
        }
    }

    /// New r, b, u from the rates v; the seats' deflections have used up their old r with the pads.
    #[inline(always)]
    pub fn advance<S: Simd>(&self, simd: S, state: &mut RailState, (dt_s, theta): (f64, f64)) {
        self.deform(simd, state);
        let Layout { nodes_per_bay: nodes, row, .. } = self.layout;
        let n = self.layout.lanes();
        let RailState { u, v, r, b, force: [shear, moment] } = state;
        let of = |node: usize| node * (CHUNK + n) + CHUNK;
        for node in 0..nodes {
            // Before the seat ends the last element of the bay before, one lane back.
            let left = if node == 0 { of(nodes - 1) - 1 } else { of(node - 1) };
            let right = of(node);
            let [sl, sr] = [left, right].map(|at| vectors::<S>(&shear[at..at + n]));
            let [ml, mr] = [left, right].map(|at| vectors::<S>(&moment[at..at + n]));
            let count = sl.len();
            let [sr, ml, mr] = [sr, ml, mr].map(|row| &row[..count]);
            let h = simd.splat_f64s(-self.half_length_m);
            let step = |old: f64| Step::new(simd, (dt_s, theta, self.damping_s), old);
            for (index, step) in [
                (2 * node, step(if node == 0 { 0.0 } else { 1.0 / theta })),
                (2 * node + 1, step(1.0 / theta)),
            ] {
                let of = index * row..index * row + n;
                let v = &vectors::<S>(&v[of.clone()])[..count];
                let [u, r, b] = [&mut *u, &mut *r, &mut *b]
                    .map(|row| &mut vectors_mut::<S>(&mut row[of.clone()])[..count]);
                for l in 0..count {
                    let k = if index % 2 == 0 {
                        simd.sub_f64s(sl[l], sr[l])
                    } else {
                        let bent = simd.sub_f64s(ml[l], mr[l]);
                        simd.mul_add_f64s(h, simd.add_f64s(sl[l], sr[l]), bent)
                    };
                    step.advance(simd, (k, v[l]), (&mut u[l], &mut r[l], &mut b[l]));
                }
            }
        }
    }
}

/// Constants of a step as vectors.
struct Step<S: Simd> {
    dt: S::f64s,
    /// Share of the old elastic force in the momentum term, negative.
    old: S::f64s,
    /// Share of its rate, negative.
    elastic: S::f64s,
}

impl<S: Simd> Step<S> {
    #[inline(always)]
    fn new(simd: S, (dt_s, theta, damping_s): (f64, f64, f64), old: f64) -> Self {
        let elastic = damping_s / theta + 2.0 * dt_s;
        Self { dt: simd.splat_f64s(dt_s), old: simd.splat_f64s(-old), elastic: simd.splat_f64s(-elastic) }
    }

    /// One row: k is the rate of the elastic force, v of the displacement.
    #[inline(always)]
    fn advance(
        &self,
        simd: S,
        (k, v): (S::f64s, S::f64s),
        (u, r, b): (&mut S::f64s, &mut S::f64s, &mut S::f64s),
    ) {
        *b = simd.mul_add_f64s(self.old, *r, simd.mul_add_f64s(self.elastic, k, *b));
        *r = simd.mul_add_f64s(self.dt, k, *r);
        *u = simd.mul_add_f64s(self.dt, v, *u);
    }
}
