//! Nonlinear beds of the sleepers, as forces beside the constant matrices.

use pulp::Simd;

use super::model::{BLOCK, CHUNK, Lanes, TrackModel};
use super::sleepers::{SleeperState, Sleepers, block_range};
use super::support::{Support, SupportLaw};
use super::vectors::{of_chunks, of_chunks_mut, parts, vectors};

/// Chunks of sleepers among which some bed is not linear.
#[derive(Clone, Debug)]
pub(super) struct NonlinearBeds {
    /// Sleepers whose bed is not linear.
    pub sleepers: Vec<usize>,
    chunks: Vec<(usize, Laws)>,
    tributary_m: Vec<f64>,
}

/// Laws of neighbouring sleepers: sum of contact, quadratic and second-slope terms, each zero where it does not apply.
#[derive(Clone, Copy, Debug, Default)]
struct Laws {
    stiffness: Lanes,
    damping: Lanes,
    gap_m: Lanes,
    /// Smallest force of the contact, negative preload.
    least: Lanes,
    quadratic: Lanes,
    slope: Lanes,
    slope_from_m: Lanes,
}

impl Laws {
    fn set(&mut self, lane: usize, support: &Support) {
        let k = support.stiffness_n_m2;
        match support.law {
            SupportLaw::Linear => {}
            SupportLaw::Unilateral { gap_m, preload_n_m } => {
                (self.stiffness[lane], self.damping[lane]) = (k, support.closed_damping_ns_m2());
                (self.gap_m[lane], self.least[lane]) = (gap_m, -preload_n_m);
            }
            SupportLaw::Quadratic { doubling_m } => self.quadratic[lane] = k / doubling_m,
            SupportLaw::Bilinear { from_m, factor } => {
                (self.slope[lane], self.slope_from_m[lane]) = ((factor - 1.0) * k, from_m);
            }
        }
    }

    /// Force per metre of the bed against the sleepers at displacement `w` and `rate`: minus [`Support::correction`].
    #[inline(always)]
    fn force<S: Simd>(&self, simd: S, part: usize, w: S::f64s, rate: S::f64s) -> S::f64s {
        let of = |lanes: &Lanes| vectors::<S>(lanes)[part];
        let (zero, least) = (simd.splat_f64s(0.0), of(&self.least));
        let elastic = simd.mul_f64s(of(&self.stiffness), simd.sub_f64s(w, of(&self.gap_m)));
        let pushing = simd.max_f64s(simd.mul_add_f64s(of(&self.damping), rate, elastic), least);
        let contact = simd.select_f64s(simd.greater_than_f64s(elastic, least), pushing, least);
        let down = simd.max_f64s(w, zero);
        let bent = simd.mul_f64s(simd.mul_f64s(of(&self.quadratic), down), down);
        let beyond = simd.max_f64s(simd.sub_f64s(w, of(&self.slope_from_m)), zero);
        simd.mul_add_f64s(of(&self.slope), beyond, simd.add_f64s(contact, bent))
    }
}

impl NonlinearBeds {
    pub fn new(model: &TrackModel) -> Self {
        let sleepers: Vec<usize> =
            (0..model.supports.len()).filter(|s| !model.supports[*s].is_linear()).collect();
        let mut chunks: Vec<(usize, Laws)> = Vec::new();
        for &s in &sleepers {
            if chunks.last().is_none_or(|(chunk, _)| *chunk != s / CHUNK) {
                chunks.push((s / CHUNK, Laws::default()));
            }
            if let Some((_, laws)) = chunks.last_mut() {
                laws.set(s % CHUNK, &model.supports[s]);
            }
        }
        Self { sleepers, chunks, tributary_m: model.basis.tributary_m.clone() }
    }

    /// Adds the forces at `ahead_s` from now, with the rates extrapolated from the last two steps, to b.
    #[inline(always)]
    pub fn apply<S: Simd>(&self, simd: S, sleepers: &Sleepers, state: &mut SleeperState, ahead_s: f64) {
        let (n, p) = (sleepers.coordinates, parts::<S>());
        let SleeperState { u, v, b, correction, earlier, .. } = state;
        let (u, v) = (of_chunks::<S>(u), of_chunks::<S>(v));
        let [b, total, earlier] = [b, correction, earlier].map(|row| of_chunks_mut::<S>(row));
        let ahead = simd.splat_f64s(ahead_s);
        for (chunk, laws) in &self.chunks {
            let of = chunk * n * p..(chunk + 1) * n * p;
            let (u, v, total) = (&u[of.clone()], &v[of.clone()], &mut total[of.clone()]);
            // Becomes the rate expected now.
            let rates = &mut earlier[of.clone()];
            for (rate, v) in rates.iter_mut().zip(v) {
                *rate = simd.sub_f64s(simd.add_f64s(*v, *v), *rate);
            }
            total.fill(simd.splat_f64s(0.0));
            for (shapes, length) in sleepers.points.iter().zip(&self.tributary_m) {
                for part in 0..p {
                    let (mut w, mut rate) = (simd.splat_f64s(0.0), simd.splat_f64s(0.0));
                    for (block, shape) in shapes.iter().enumerate() {
                        let of = block_range::<S>(block * BLOCK);
                        let (u, rates) = (&u[of.clone()], &rates[of]);
                        for (i, shape) in shape.iter().enumerate() {
                            let shape = simd.splat_f64s(*shape);
                            w = simd.mul_add_f64s(shape, u[i * p + part], w);
                            rate = simd.mul_add_f64s(shape, rates[i * p + part], rate);
                        }
                    }
                    let force = laws.force(simd, part, simd.mul_add_f64s(ahead, rate, w), rate);
                    let force = simd.mul_f64s(simd.splat_f64s(-length), force);
                    for (block, shape) in shapes.iter().enumerate() {
                        let total = &mut total[block_range::<S>(block * BLOCK)];
                        for (i, shape) in shape.iter().enumerate() {
                            let at = i * p + part;
                            total[at] = simd.mul_add_f64s(simd.splat_f64s(*shape), force, total[at]);
                        }
                    }
                }
            }
            rates.copy_from_slice(v);
            for (b, force) in b[of].iter_mut().zip(total) {
                *b = simd.add_f64s(*b, *force);
            }
        }
    }

    /// At the end of the step the forces count 1/θ times in b; once they are in it.
    #[inline(always)]
    pub fn carry<S: Simd>(&self, simd: S, sleepers: &Sleepers, state: &mut SleeperState, theta: f64) {
        let of_chunk = sleepers.coordinates * parts::<S>();
        let rest = simd.splat_f64s(1.0 / theta - 1.0);
        let (b, total) = (of_chunks_mut::<S>(&mut state.b), of_chunks::<S>(&state.correction));
        for (chunk, _) in &self.chunks {
            let of = chunk * of_chunk..(chunk + 1) * of_chunk;
            for (b, force) in b[of.clone()].iter_mut().zip(&total[of]) {
                *b = simd.mul_add_f64s(rest, *force, *b);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn property_lanes_follow_the_law_of_each_sleeper() {
        let bed = |law| Support { law, open_damping_ns_m2: 2e4, ..Support::linear(30e6, 1e5) };
        let laws = [
            SupportLaw::Linear,
            SupportLaw::Unilateral { gap_m: 1e-3, preload_n_m: 0.0 },
            SupportLaw::Unilateral { gap_m: 0.0, preload_n_m: 1500.0 },
            SupportLaw::Quadratic { doubling_m: 1e-3 },
            SupportLaw::Bilinear { from_m: 0.5e-3, factor: 3.0 },
        ];
        let mut lanes = Laws::default();
        for (lane, law) in laws.iter().enumerate() {
            lanes.set(lane, &bed(*law));
        }
        for (w, rate) in [(-1e-3, 0.1), (-1e-5, -0.3), (0.4e-3, 0.2), (1.2e-3, -1.0), (3e-3, 0.05)] {
            for (lane, law) in laws.iter().enumerate() {
                let found = lanes.force(pulp::Scalar::new(), lane, w, rate);
                let expected = -bed(*law).correction(w, rate);
                assert!((found - expected).abs() < 1e-9 * (1.0 + expected.abs()), "{law:?} {w} {rate}");
            }
        }
    }
}
