//! Energy of the recordings of all axles, stacked at several speeds at a time.

use faer::c64;
use pulp::Simd;

use crate::vehicle::AxlePattern;

/// Speeds at a time: as many as the widest vectors hold.
pub(super) const LANES: usize = 8;

/// Real or imaginary parts at each of the speeds.
type Parts = [f64; LANES];

/// Σ |A(f)|² |Σ_w e^{2πi f s_w / v}|² at each of the speeds v, with s_w the axle offsets. The lines f are equally spaced, so
/// the phase of each axle advances by a constant factor.
pub(super) struct Stack<'a> {
    /// Frequency and |A|².
    lines: &'a [(f64, f64)],
    /// Phase factor of every axle at the line to come.
    phasor: Vec<[Parts; 2]>,
    /// From a line to the next.
    advance: Vec<[Parts; 2]>,
}

impl<'a> Stack<'a> {
    /// `lines` at successive multiples of `spacing_hz`.
    pub(super) fn new(
        lines: &'a [(f64, f64)],
        spacing_hz: f64,
        pattern: &AxlePattern,
        speeds_m_s: [f64; LANES],
    ) -> Self {
        let phase = |offset: f64, speed: f64| std::f64::consts::TAU * spacing_hz * offset / speed;
        let turn = |o: &f64| speeds_m_s.map(|v| c64::new(0.0, phase(*o, v)).exp());
        let parts = |turn: [c64; LANES]| [turn.map(|t| t.re), turn.map(|t| t.im)];
        let turns: Vec<[c64; LANES]> = pattern.offset_m.iter().map(turn).collect();
        // Powers are cheaper than sines.
        let before = lines.first().map_or(0, |(f, _)| (f / spacing_hz).round() as u32);
        let phasor = turns.iter().map(|t| parts(t.map(|t| t.powu(before)))).collect();
        Self { lines, phasor, advance: turns.into_iter().map(parts).collect() }
    }
}

impl pulp::WithSimd for Stack<'_> {
    type Output = Parts;

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) -> Parts {
        let mut energy = [0.0; LANES];
        for (_, power) in self.lines {
            let mut sum = [[0.0; LANES]; 2];
            for (phasor, advance) in self.phasor.iter_mut().zip(&self.advance) {
                turned(simd, phasor, advance, &mut sum);
            }
            for (e, (re, im)) in energy.iter_mut().zip(sum[0].iter().zip(&sum[1])) {
                *e += power * (re * re + im * im);
            }
        }
        energy
    }
}

/// Adds the phasors to the sum, then turns them.
#[inline(always)]
fn turned<S: Simd>(simd: S, [re, im]: &mut [Parts; 2], [c, s]: &[Parts; 2], sum: &mut [Parts; 2]) {
    let [sum_re, sum_im] = sum.each_mut().map(|p| S::as_mut_simd_f64s(p).0);
    let (re, im) = (S::as_mut_simd_f64s(re).0, S::as_mut_simd_f64s(im).0);
    let (c, s) = (S::as_simd_f64s(c).0, S::as_simd_f64s(s).0);
    for i in 0..LANES / S::F64_LANES {
        sum_re[i] = simd.add_f64s(sum_re[i], re[i]);
        sum_im[i] = simd.add_f64s(sum_im[i], im[i]);
        let turned = simd.mul_add_f64s(re[i], c[i], simd.neg_f64s(simd.mul_f64s(im[i], s[i])));
        im[i] = simd.mul_add_f64s(re[i], s[i], simd.mul_f64s(im[i], c[i]));
        re[i] = turned;
    }
}
