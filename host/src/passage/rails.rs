//! Rails between the steps: elastic forces from the deformation of the elements, then b and u.

use aligned_vec::avec;
use pulp::Simd;

use super::model::{CHUNK, Layout, TrackModel};
use super::vectors::{Aligned, vectors, vectors_from, vectors_mut};

/// Stiffness of the rail elements in terms of shear and bending deformation, `[element in bay · row + lane]`.
#[derive(Clone, Debug)]
pub(super) struct Rails {
    layout: Layout,
    shear: Aligned<f64>,
    bending: Aligned<f64>,
    half_length_m: f64,
    damping_s: f64,
}

/// Motion of the rails: displacement u, rate v at t + θ dt, momentum term b.
#[derive(Clone, Debug)]
pub(super) struct RailState {
    pub u: Aligned<f64>,
    pub v: Aligned<f64>,
    pub b: Aligned<f64>,
    /// Shear force and bending moment of the elements that the step advances with, `[element][CHUNK + lane]`: the lane before the first one is
    /// read.
    force: [Aligned<f64>; 2],
}

impl Rails {
    pub fn new(model: &TrackModel) -> Self {
        let layout = model.layout;
        let len = layout.nodes_per_bay * layout.row;
        let (mut shear, mut bending) = (avec![0.0; len], avec![0.0; len]);
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
        let zero = || avec![0.0; self.layout.rows() * self.layout.row];
        let force = || avec![0.0; self.layout.nodes_per_bay * (CHUNK + self.layout.lanes())];
        RailState { u: zero(), v: zero(), b: zero(), force: [force(), force()] }
    }

    /// Shear forces and bending moments of the deformation u/θ + (d/θ + 2 dt) v.
    #[inline(always)]
    fn deform<S: Simd>(&self, simd: S, state: &mut RailState, (dt_s, theta): (f64, f64)) {
        let Layout { nodes_per_bay: nodes, row, .. } = self.layout;
        let (n, h) = (self.layout.lanes(), simd.splat_f64s(-self.half_length_m));
        let (of_u, of_v) =
            (simd.splat_f64s(1.0 / theta), simd.splat_f64s(self.damping_s / theta + 2.0 * dt_s));
        let RailState { u, v, force: [shear, moment], .. } = state;
        for e in 0..nodes {
            // The node behind the last one of a bay is the seat of the next sleeper, one lane on.
            let right = if e + 1 < nodes { 2 * (e + 1) * row } else { 1 };
            let [w1, t1, w2, t2] = [2 * e * row, (2 * e + 1) * row, right, right + row];
            let start = e * (CHUNK + n) + CHUNK;
            let shear = vectors_mut::<S>(&mut shear[start..start + n]);
            let count = shear.len();
            let moment = &mut vectors_mut::<S>(&mut moment[start..start + n])[..count];
            let of = |x, at| vectors_from::<S>(x, at, count);
            let us = [of(u, w1), of(u, t1), of(u, w2), of(u, t2)];
            let vs = [of(v, w1), of(v, t1), of(v, w2), of(v, t2)];
            let (ks, kb) = (of(&self.shear, e * row), of(&self.bending, e * row));
            for l in 0..count {
                let mut ends = [simd.splat_f64s(0.0); 4];
                for (a, end) in ends.iter_mut().enumerate() {
                    *end = simd.mul_add_f64s(of_v, vs[a][l], simd.mul_f64s(of_u, us[a][l]));
                }
                let [w1, t1, w2, t2] = ends;
                let bent = simd.mul_add_f64s(h, simd.add_f64s(t1, t2), simd.sub_f64s(w2, w1));
                shear[l] = simd.mul_f64s(ks[l], bent);
                moment[l] = simd.mul_f64s(kb[l], simd.sub_f64s(t2, t1));
            }
        }
    }

    /// New b and u from the rates v: b ← b − K u/θ − (C/θ + 2 dt K) v, u ← u + dt v.
    #[inline(always)]
    pub fn advance<S: Simd>(&self, simd: S, state: &mut RailState, (dt_s, theta): (f64, f64)) {
        self.deform(simd, state, (dt_s, theta));
        let Layout { nodes_per_bay: nodes, row, .. } = self.layout;
        let n = self.layout.lanes();
        let (dt, h) = (simd.splat_f64s(dt_s), simd.splat_f64s(self.half_length_m));
        let RailState { u, v, b, force: [shear, moment] } = state;
        let of = |node: usize| node * (CHUNK + n) + CHUNK;
        for node in 0..nodes {
            // Before the seat ends the last element of the bay before, one lane back.
            let left = if node == 0 { of(nodes - 1) - 1 } else { of(node - 1) };
            let sl = vectors::<S>(&shear[left..left + n]);
            let count = sl.len();
            let sr = vectors_from::<S>(shear, of(node), count);
            let (ml, mr) =
                (vectors_from::<S>(moment, left, count), vectors_from::<S>(moment, of(node), count));
            let of = 2 * node * row..2 * node * row + n;
            let b_w = &mut vectors_mut::<S>(&mut b[of])[..count];
            for l in 0..count {
                b_w[l] = simd.sub_f64s(b_w[l], simd.sub_f64s(sl[l], sr[l]));
            }
            let of = (2 * node + 1) * row..(2 * node + 1) * row + n;
            let b_t = &mut vectors_mut::<S>(&mut b[of])[..count];
            for l in 0..count {
                let bent = simd.sub_f64s(mr[l], ml[l]);
                b_t[l] = simd.add_f64s(b_t[l], simd.mul_add_f64s(h, simd.add_f64s(sl[l], sr[l]), bent));
            }
        }
        for (u, v) in vectors_mut::<S>(u).iter_mut().zip(vectors::<S>(v)) {
            *u = simd.mul_add_f64s(dt, *v, *u);
        }
    }
}
