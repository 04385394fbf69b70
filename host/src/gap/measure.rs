//! The gap in numbers: predictions of passages, RMS ratios, noise floor, bands, bootstrap.

use rayon::prelude::*;

use super::GapError;
use super::data::{Observed, RATE_HZ, energies, own_energy};
use super::fit::{Frame, simulate};
use super::forward::Response;
use super::latent::LatentFit;
use super::trains::Deeper;
use super::world::World;
use crate::passage::random::Random;
use crate::signal::{irfft, rfft, rfft_frequencies_hz, taper};

/// One passage, measured and predicted, on one time axis at [`RATE_HZ`].
#[derive(Clone, Debug)]
pub struct Prediction {
    /// As in the recordings.
    pub passage_id: i32,
    /// m/s.
    pub speed_m_s: f64,
    /// Acceleration, m/s²: measured, base model, corrected model.
    pub acceleration: [Vec<f64>; 3],
    /// Displacement from the same by the same integration, metres.
    pub displacement: [Vec<f64>; 3],
    /// First sample of every bogie's window, and their length.
    pub windows: (Vec<usize>, usize),
    /// Travel of the front axle at the first window sample, metres.
    pub first_m: f64,
    /// What trains differ by as a whole; nothing where that is chance, and until all passages are known ([`tell_apart`](super::trains::tell_apart)).
    pub deeper: Deeper,
}

/// High-pass of the double integration, Hz.
const HIGH_PASS_HZ: [f64; 2] = [2.0, 4.0];
/// How far a passage is looked for from where it was thought to be, metres of travel: a model that is far off misses by a wave.
pub const ALIGN_M: f64 = 0.3;

/// Displacement from acceleration: double integration in the frequency domain, fading out between 4 and 2 Hz.
pub fn displacement(acceleration: &[f64]) -> Vec<f64> {
    let n = (2 * acceleration.len()).next_multiple_of(2);
    let mut padded = acceleration.to_vec();
    padded.resize(n, 0.0);
    let mut spectrum = rfft(&padded);
    for (v, f) in spectrum.iter_mut().zip(rfft_frequencies_hz(n, RATE_HZ)) {
        let omega = std::f64::consts::TAU * f;
        let pass = 1.0 - taper(f, HIGH_PASS_HZ[0], HIGH_PASS_HZ[1]);
        *v *= if pass > 0.0 { -pass / (omega * omega) } else { 0.0 };
    }
    let mut out = irfft(&spectrum, n);
    out.truncate(acceleration.len());
    out
}

/// Predictions of all passages by two models; of a passage only speed and axle times are used, and for effects that belong
/// to single wheels or recordings their phases.
pub fn predictions(
    frame: &Frame,
    before: (&World, &[Response]),
    after: (&World, &[Response]),
    latent: &[&LatentFit],
) -> Vec<Prediction> {
    (0..frame.observed.len())
        .into_par_iter()
        .map(|i| {
            let o = &frame.observed[i];
            let recorded = o.trace();
            let base = train(o, &recorded, (before.0, &before.1[i]));
            let corrected = with_latent(train(o, &recorded, (after.0, &after.1[i])), latent, i);
            let base_m = displacement(&base);
            compared(o, recorded, (base, base_m), corrected)
        })
        .collect()
}

/// Prediction of one passage by one model, which stands for both.
pub fn prediction(frame: &Frame, i: usize, model: (&World, &Response), latent: &[&LatentFit]) -> Prediction {
    let o = &frame.observed[i];
    let recorded = o.trace();
    let corrected = with_latent(train(o, &recorded, model), latent, i);
    let base = (corrected.clone(), displacement(&corrected));
    compared(o, recorded, base, corrected)
}

/// Displacement of one passage while the train passes, measured and by a model, metres.
pub fn displacements(o: &Observed, model: (&World, &Response)) -> [Vec<f64>; 2] {
    let recorded = o.trace();
    let modelled = train(o, &recorded, model);
    [displacement(&recorded.1), displacement(&modelled)]
}

/// Squares of the corrected model's residual relative to those of the signal, mean over passages.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Missed {
    /// The whole residual.
    pub all: f64,
    /// What differs from bogie to bogie.
    pub own: f64,
}

impl Missed {
    /// How far the whole is above what differs from bogie to bogie, relative.
    pub fn excess(&self) -> f64 {
        self.all / self.own.max(f64::MIN_POSITIVE) - 1.0
    }
}

/// What the corrected model misses, `[acceleration, displacement]`.
pub fn missed(passages: &[Prediction]) -> [Missed; 2] {
    let parts: Vec<[Squares; 2]> = passages.par_iter().map(|p| squares(p, None)).collect();
    [0, 1].map(|q: usize| {
        let mean = |k: usize| {
            let relative = |p: &[Squares; 2]| p[q][k] / p[q][0].max(f64::MIN_POSITIVE);
            parts.iter().map(|p| relative(p) / parts.len() as f64).sum()
        };
        Missed { all: mean(2), own: mean(3) }
    })
}

/// What a world, with what single wheels and recordings add to it, misses of some passages, `[acceleration, displacement]`.
pub fn missed_by(
    frame: &Frame,
    world: &World,
    latent: &[&LatentFit],
    passages: &[usize],
) -> Result<[Missed; 2], GapError> {
    let responses = simulate(world, frame, passages)?;
    let of = |(i, response): (&usize, &Response)| prediction(frame, *i, (world, response), latent);
    let predictions: Vec<Prediction> = passages.par_iter().zip(&responses).map(of).collect();
    Ok(missed(&predictions))
}

/// RMS over passages relative to the measured signal, `[acceleration, displacement]`: of the base model's residual, of the
/// corrected model's, of what differs from bogie to bogie.
pub fn residual_ratios(passages: &[Prediction]) -> [[f64; 2]; 3] {
    let parts: Vec<[Squares; 2]> = passages.par_iter().map(|p| squares(p, None)).collect();
    [1, 2, 3].map(|which: usize| {
        [0, 1].map(|q: usize| {
            let sum = |k: usize| parts.iter().map(|p| p[q][k]).sum::<f64>();
            (sum(which) / sum(0).max(f64::MIN_POSITIVE)).sqrt()
        })
    })
}

/// What a model says the train makes of the sensor over a recorded trace.
fn train(
    o: &Observed,
    (start_s, measured): &(f64, Vec<f64>),
    (world, response): (&World, &Response),
) -> Vec<f64> {
    let gain = world.sensor.gain_at(o.temperature_c);
    let late = o.lag(response, gain, ALIGN_M);
    let bogies: Vec<f64> = o.bogie_s().iter().map(|b| b + late).collect();
    let mut out = vec![0.0; measured.len()];
    response.add_train(&bogies, gain, start_s - o.first_axle_s, 1.0 / RATE_HZ, &mut out);
    out
}

fn with_latent(mut trace: Vec<f64>, latent: &[&LatentFit], i: usize) -> Vec<f64> {
    for fit in latent {
        trace.iter_mut().zip(&fit.traces[i]).for_each(|(c, t)| *c += t);
    }
    trace
}

fn compared(
    o: &Observed,
    (start_s, measured): (f64, Vec<f64>),
    (base, base_m): (Vec<f64>, Vec<f64>),
    corrected: Vec<f64>,
) -> Prediction {
    let first = |b: &f64| (((o.first_axle_s + b + o.first_s - start_s) * RATE_HZ).round().max(0.0)) as usize;
    let windows = (o.bogie_s().iter().map(first).collect(), o.mean.len());
    Prediction {
        passage_id: o.passage_id,
        speed_m_s: o.speed_m_s,
        displacement: [displacement(&measured), base_m, displacement(&corrected)],
        acceleration: [measured, base, corrected],
        windows,
        first_m: o.first_s * o.speed_m_s,
        deeper: Deeper::default(),
    }
}

/// Sums of squares of one passage in one band: measured, base residual, corrected residual, and what differs from bogie to bogie
/// and from train to train in the corrected and in the base residual.
type Squares = [f64; 5];

/// Gap in a band.
#[derive(Clone, Debug, PartialEq)]
pub struct Band {
    /// Name in the contract.
    pub name: &'static str,
    /// Ends, Hz, at the mean speed.
    pub range_hz: [f64; 2],
    /// Before, after, floor.
    pub gap: [f64; 3],
}

/// Gap of a set of passages.
#[derive(Clone, Debug, PartialEq)]
pub struct Gap {
    /// Base model.
    pub before: f64,
    /// Corrected model.
    pub after: f64,
    /// What a perfect model would leave.
    pub noise_floor: f64,
    /// (before − after) / (before − floor).
    pub closed_fraction: f64,
    /// 90 % interval by resampling passages.
    pub closed_fraction_ci90: [f64; 2],
    /// Three bands.
    pub bands: Vec<Band>,
}

/// Wavelength that separates quasi-static from dynamic, metres (paper, section 3.1).
const SEPARATION_M: f64 = 2.3;
/// Upper end of the dynamic band, Hz.
const DYNAMIC_HZ: f64 = 100.0;
/// Upper end of the high band, Hz.
const HIGH_HZ: f64 = 250.0;
/// Resamples.
const RESAMPLES: usize = 2000;

/// Numbers of a set of passages; `changed`: whether the corrected model differs from the base model.
pub fn measure(passages: &[Prediction], changed: bool) -> Gap {
    let whole: Vec<[Squares; 2]> = passages.par_iter().map(|p| squares(p, None)).collect();
    let all: Vec<usize> = (0..whole.len()).collect();
    let [before, after, floor] = ratios(&whole, &all);
    let closed = |[before, after, floor]: [f64; 3]| {
        if !changed || before <= floor { 0.0 } else { (before - after) / (before - floor) }
    };
    let mut random = Random::new(1, 0);
    let mut resampled: Vec<f64> = (0..RESAMPLES)
        .map(|_| {
            let pick: Vec<usize> = all.iter().map(|_| random.below(all.len())).collect();
            closed(ratios(&whole, &pick))
        })
        .collect();
    resampled.sort_by(f64::total_cmp);
    let speed = crate::signal::mean(&passages.iter().map(|p| p.speed_m_s).collect::<Vec<_>>());
    let limit = speed / SEPARATION_M;
    let bands =
        [("quasi-static", [0.0, limit]), ("dynamic", [limit, DYNAMIC_HZ]), ("high", [DYNAMIC_HZ, HIGH_HZ])]
            .into_iter()
            .enumerate()
            .map(|(k, (name, range_hz))| {
                let parts: Vec<[Squares; 2]> = passages.par_iter().map(|p| squares(p, Some(k))).collect();
                Band { name, range_hz, gap: ratios(&parts, &all) }
            })
            .collect();
    Gap {
        before,
        after,
        noise_floor: floor,
        closed_fraction: closed([before, after, floor]),
        closed_fraction_ci90: [
            crate::signal::quantile(&resampled, 0.05),
            crate::signal::quantile(&resampled, 0.95),
        ],
        bands,
    }
}

/// sqrt((g_d² + g_a²) / 2) of base model, corrected model and floor. A perfect model leaves no more than either model's wheels
/// differ: an effect that is not there makes them differ more.
fn ratios(parts: &[[Squares; 2]], pick: &[usize]) -> [f64; 3] {
    let sum = |quantity: usize, k: usize| pick.iter().map(|i| parts[*i][quantity][k]).sum::<f64>();
    let whole = |k: usize| {
        let ratio = |q: usize| sum(q, k) / sum(q, 0).max(f64::MIN_POSITIVE);
        (0.5 * (ratio(0) + ratio(1))).sqrt()
    };
    [whole(1), whole(2), whole(3).min(whole(4))]
}

/// Sums of squares of acceleration and displacement, in one of the three bands or in all.
fn squares(p: &Prediction, band: Option<usize>) -> [Squares; 2] {
    let limit = p.speed_m_s / SEPARATION_M;
    let range = band.map(|k| [[0.0, limit], [limit, DYNAMIC_HZ], [DYNAMIC_HZ, HIGH_HZ]][k]);
    [0, 1].map(|quantity: usize| {
        let [measured, before, after] = [&p.acceleration, &p.displacement][quantity];
        let residual =
            |model: &Vec<f64>| -> Vec<f64> { measured.iter().zip(model).map(|(m, p)| m - p).collect() };
        let banded = |v: &[f64]| match range {
            Some([low, high]) => crate::signal::brick_band(v, RATE_HZ, low, high - 1e-9),
            None => v.to_vec(),
        };
        let total = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>();
        let (before, after) = (banded(&residual(before)), banded(&residual(after)));
        let deeper = total(&banded(&p.deeper.trace[quantity]));
        let of_train = p.deeper.square.map(|square| square * deeper);
        let natural = |residual: &[f64], of_train: f64| (floor(residual, &p.windows) + of_train).max(0.0);
        let own = [natural(&after, of_train[1]), natural(&before, of_train[0])];
        [total(&banded(measured)), total(&before), total(&after), own[0], own[1]]
    })
}

/// What differs from bogie to bogie, and everything outside the windows.
fn floor(residual: &[f64], (starts, len): &(Vec<usize>, usize)) -> f64 {
    let windows: Vec<Vec<f64>> =
        starts.iter().filter_map(|s| residual.get(*s..s + len)).map(<[f64]>::to_vec).collect();
    let total = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>();
    if windows.len() < 2 {
        return total(residual);
    }
    let inside = energies(&windows);
    (total(residual) - inside.0).max(0.0) + own_energy(inside, windows.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_displacement_of_a_sinusoid() {
        let omega = std::f64::consts::TAU * 20.0;
        let window = |k: usize| (std::f64::consts::PI * k as f64 / 1600.0).sin().powi(2);
        let a: Vec<f64> = (0..1600).map(|k| window(k) * (omega * k as f64 / RATE_HZ).sin()).collect();
        let d = displacement(&a);
        for k in 600..1000 {
            let expected = -a[k] / (omega * omega);
            assert!((d[k] - expected).abs() < 0.02 / (omega * omega), "{k}");
        }
    }

    /// Two bogies that differ a little, a base model that misses half of what they share, and a correction that is another one
    /// for each bogie.
    #[test]
    fn property_effect_that_is_not_there_does_not_raise_the_floor() {
        let len = 400;
        let wave = |k: usize, f_hz: f64| (std::f64::consts::TAU * f_hz * k as f64 / RATE_HZ).sin();
        let bogie = |k: usize| if k < len { 1.0 } else { -1.0 };
        let curve = |f: &dyn Fn(usize) -> f64| -> Vec<f64> { (0..2 * len).map(f).collect() };
        let measured = curve(&|k| 2.0 * wave(k % len, 20.0) + 0.1 * bogie(k) * wave(k % len, 30.0));
        let base = curve(&|k| 1.0 * wave(k % len, 20.0));
        let wrong = curve(&|k| base[k] + 3.0 * bogie(k) * wave(k % len, 25.0));
        let gap = |corrected: &Vec<f64>| {
            let acceleration = [measured.clone(), base.clone(), corrected.clone()];
            let displacement = acceleration.each_ref().map(|a| displacement(a));
            let windows = (vec![0, len], len);
            let (passage_id, speed_m_s, first_m) = (1, 40.0, 0.0);
            let deeper = Deeper::default();
            let p =
                Prediction { passage_id, speed_m_s, acceleration, displacement, windows, first_m, deeper };
            measure(&[p], true)
        };
        let (with, without) = (gap(&wrong), gap(&base));
        assert!(
            with.noise_floor <= without.noise_floor + 1e-12,
            "{} {}",
            with.noise_floor,
            without.noise_floor
        );
        assert!(with.closed_fraction_ci90[1] < -1.0, "{:?}", with.closed_fraction_ci90);
        assert!(without.closed_fraction.abs() < 1e-12);
    }

    #[test]
    fn analytic_floor_leaves_out_what_bogies_share() {
        // Four windows of 2: common part 3, own parts ±1.
        let residual = [4.0, 4.0, 2.0, 2.0, 4.0, 4.0, 2.0, 2.0];
        let found = floor(&residual, &(vec![0, 2, 4, 6], 2));
        assert!((found - 8.0 * 4.0 / 3.0).abs() < 1e-12);
    }
}
