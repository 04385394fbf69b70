//! Electrical interference: a sinusoid of the recorder's own time, in every recording, also while no train is near.
//!
//! Frequency and amplitude belong to the site, the phase to each recording. All of them follow from the train-free ends, so
//! nothing is learnt from the passage itself.

use rayon::prelude::*;

use crate::gap::data::{Observed, QUIET_S, QuietEnd, RATE_HZ};
use crate::gap::effect::{Advice, Stage};
use crate::gap::forward::BAND_HZ;
use crate::gap::included::{How, Inclusion};
use crate::gap::latent::{Latent, LatentFit, Scene};
use crate::recording::Passage;
use crate::signal::{centre, dot};

/// See the module.
pub struct Tonal;

/// Frequencies searched, Hz, and step.
const SEARCH_HZ: (f64, f64, f64) = (8.0, 248.0, 0.1);
/// The ends are some two seconds apart, so frequencies about half a hertz apart fit them nearly as well, and between the steps of
/// the search a neighbour may fit better: reach and step of the search around its best, and of the last one, Hz.
const FINE_HZ: [(f64, f64); 2] = [(1.2, 0.02), (0.02, 0.002)];
/// Cost of choosing the frequency among some thousand, nats.
const CHOICE: f64 = 10.0;
/// Part of both ends' evidence that either of them has: a tone has half of it, ringing of a hanging sleeper behind the train hardly
/// any before it.
const LEAST_OF_EITHER: f64 = 0.2;
/// Evidence of the ends before the train from which on they alone tell a tone, nats: behind it a sleeper over a deep void rings louder
/// than the tone. Noise of a dozen recordings has less than nought.
const SURE_BEFORE: f64 = 50.0;
/// The frequency is not known better than this, Hz.
const LEAST_HZ: f64 = 0.02;

/// Train-free ends of a recording, each less its mean: before the train and behind it, or before it only.
struct Quiet {
    ends: Vec<QuietEnd>,
    /// Sum of squares.
    energy: f64,
}

impl Quiet {
    fn new(o: &Observed) -> Self {
        Self::of(o.quiet_ends().into())
    }

    fn before(o: &Observed) -> Self {
        let [before, _] = o.quiet_ends();
        Self::of(vec![before])
    }

    fn of(mut ends: Vec<QuietEnd>) -> Self {
        for end in &mut ends {
            centre(&mut end.value_m_s2);
        }
        let energy = ends.iter().map(|e| dot(&e.value_m_s2, &e.value_m_s2)).sum();
        Self { ends, energy }
    }

    fn len(&self) -> usize {
        self.ends.iter().map(|e| e.value_m_s2.len()).sum()
    }

    fn variance(&self) -> f64 {
        self.energy / self.len().max(1) as f64
    }

    /// Cosine and sine amplitude at a frequency by least squares, and what they take off the sum of squares.
    fn amplitudes(&self, f_hz: f64) -> ([f64; 2], f64) {
        Self::amplitudes_of(&self.ends, f_hz)
    }

    fn amplitudes_of(ends: &[QuietEnd], f_hz: f64) -> ([f64; 2], f64) {
        let omega = std::f64::consts::TAU * f_hz;
        let (mut g, mut b) = ([0.0; 3], [0.0; 2]);
        for end in ends {
            let Sums { n, c, s, cc, cs, ss, cy, sy } = Sums::of(omega, end);
            // Less their means: those of what is recorded are taken off already.
            for (sum, product) in g.iter_mut().zip([cc - c * c / n, cs - c * s / n, ss - s * s / n]) {
                *sum += product;
            }
            b[0] += cy;
            b[1] += sy;
        }
        let determinant = (g[0] * g[2] - g[1] * g[1]).max(f64::MIN_POSITIVE);
        let c = (g[2] * b[0] - g[1] * b[1]) / determinant;
        let s = (g[0] * b[1] - g[1] * b[0]) / determinant;
        ([c, s], c * b[0] + s * b[1])
    }

    /// Log likelihood ratio with the best sinusoid at a frequency, its cost taken off.
    fn gain(&self, f_hz: f64) -> f64 {
        likelihood_ratio(self.energy, self.amplitudes(f_hz).1, self.len()) - 2.0
    }

    /// The same of one end with a sinusoid of its own, without the cost.
    fn gain_alone(end: &QuietEnd, f_hz: f64) -> f64 {
        let (_, taken) = Self::amplitudes_of(std::slice::from_ref(end), f_hz);
        likelihood_ratio(dot(&end.value_m_s2, &end.value_m_s2), taken, end.value_m_s2.len())
    }
}

/// Samples that a turning pointer runs through before it is set anew, so that rounding stays below 1e-14.
const TURNS: usize = 64;

/// Sums of products of a cosine c, a sine s and a recording y, and their number.
#[derive(Default)]
struct Sums {
    n: f64,
    c: f64,
    s: f64,
    cc: f64,
    cs: f64,
    ss: f64,
    cy: f64,
    sy: f64,
}

impl Sums {
    /// Over the samples of an end; `omega` in rad/s. The cosine is turned from sample to sample: thousands of frequencies are tried.
    fn of(omega: f64, end: &QuietEnd) -> Self {
        let mut sums = Self { n: end.value_m_s2.len().max(1) as f64, ..Self::default() };
        let (turn_s, turn_c) = (omega / RATE_HZ).sin_cos();
        for (block, values) in end.value_m_s2.chunks(TURNS).enumerate() {
            let (mut s, mut c) = (omega * (end.start_s + (block * TURNS) as f64 / RATE_HZ)).sin_cos();
            for y in values {
                sums.c += c;
                sums.s += s;
                sums.cc += c * c;
                sums.cs += c * s;
                sums.ss += s * s;
                sums.cy += c * y;
                sums.sy += s * y;
                (c, s) = (c * turn_c - s * turn_s, s * turn_c + c * turn_s);
            }
        }
        sums
    }
}

fn likelihood_ratio(energy: f64, taken: f64, samples: usize) -> f64 {
    let left = (energy - taken).max(LEAST_LEFT * energy);
    // Band-limited noise has fewer independent values than samples.
    let n = samples as f64 * 2.0 * BAND_HZ[1] / RATE_HZ;
    0.5 * n * (energy / left.max(f64::MIN_POSITIVE)).max(1.0).ln()
}

/// Whether a sinusoid is there before the train as it is behind it: what rings behind it only is the track.
fn always_there(quiet: &[&Quiet], f_hz: f64) -> bool {
    let alone = [0, 1].map(|end| {
        quiet.iter().filter_map(|q| q.ends.get(end)).map(|e| Quiet::gain_alone(e, f_hz)).sum::<f64>()
    });
    alone[0].min(alone[1]) > LEAST_OF_EITHER * (alone[0] + alone[1])
}

/// Part of the energy that rounding may leave.
const LEAST_LEFT: f64 = 1e-12;

/// Log evidence before the cost of choosing, frequency and its 90 % interval, Hz.
type Strongest = (f64, f64, [f64; 2]);

/// Best frequency of recordings.
fn strongest(quiet: &[&Quiet]) -> Option<Strongest> {
    let scored = |from: f64, to: f64, step: f64| -> Vec<(f64, f64)> {
        let steps = ((to - from) / step).round() as usize;
        let total = |f: f64| quiet.iter().map(|q| q.gain(f)).sum::<f64>();
        (0..=steps).into_par_iter().map(|k| from + k as f64 * step).map(|f| (total(f), f)).collect()
    };
    let top = |list: &[(f64, f64)]| list.iter().copied().max_by(|a, b| a.0.total_cmp(&b.0));
    let mut best = top(&scored(SEARCH_HZ.0, SEARCH_HZ.1, SEARCH_HZ.2))?;
    let mut around = Vec::new();
    for (reach, step) in FINE_HZ {
        let list = scored(best.1 - reach, best.1 + reach, step);
        best = top(&list)?;
        around.extend(list);
    }
    let likely = around.iter().filter(|(score, _)| *score > best.0 - WITHIN).map(|(_, f)| *f);
    let ends = likely
        .fold([best.1 - LEAST_HZ, best.1 + LEAST_HZ], |[low, high], f| [f64::min(low, f), f64::max(high, f)]);
    Some((best.0, best.1, ends))
}

/// The strongest sinusoid of the recordings `train`, if it is `one` by its score, those recordings and its frequency.
fn tone(quiet: &[Quiet], train: &[usize], one: impl Fn(f64, &[&Quiet], f64) -> bool) -> Option<Strongest> {
    let learnt: Vec<&Quiet> = train.iter().map(|i| &quiet[*i]).collect();
    strongest(&learnt).filter(|(score, f_hz, _)| one(*score, &learnt, *f_hz))
}

/// Log likelihood below the best within which a 90 % interval reaches.
const WITHIN: f64 = 1.35;

impl Latent for Tonal {
    fn name(&self) -> &'static str {
        "tonal"
    }

    fn stage(&self) -> Stage {
        Stage::Sensor
    }

    fn advice(&self) -> Advice {
        Advice {
            what: "electrical interference",
            action: "Check shield, earthing and supply of the sensor's cable; look for machines of this frequency nearby.",
        }
    }

    fn inclusion(&self) -> Inclusion {
        let how = How::Added(|site, effect| {
            let frequency_hz = effect.value("frequency_hz", [1.0, 2000.0])?;
            site.passages.iter_mut().for_each(|p| without_tone(p, frequency_hz));
            Ok(())
        });
        Inclusion { does: Some("Until then `analyse --with-effects` takes it out of the recordings."), how }
    }

    fn explore(&self, scene: &Scene) -> Option<LatentFit> {
        let quiet: Vec<Quiet> = scene.observed.par_iter().map(Quiet::new).collect();
        let both =
            tone(&quiet, scene.train, |score, learnt, f_hz| score > CHOICE && always_there(learnt, f_hz));
        let (quiet, (score, frequency, likely)) = match both {
            Some(found) => (quiet, found),
            None => {
                let before: Vec<Quiet> = scene.observed.par_iter().map(Quiet::before).collect();
                let found = tone(&before, scene.train, |score, _, _| score > SURE_BEFORE)?;
                (before, found)
            }
        };
        let learnt: Vec<&Quiet> = scene.train.iter().map(|i| &quiet[*i]).collect();
        let squares: Vec<f64> =
            learnt.iter().map(|q| q.amplitudes(frequency).0).map(|[c, s]| c * c + s * s).collect();
        let sampling = learnt.iter().map(|q| 4.0 * q.variance() / q.len().max(1) as f64);
        let noise = sampling.sum::<f64>() / scene.train.len().max(1) as f64;
        let amplitude = (crate::signal::mean(&squares) - noise).max(0.0).sqrt();
        let sd = (noise / scene.train.len().max(1) as f64).sqrt().max(0.01 * amplitude);
        let traces: Vec<Vec<f64>> = scene
            .traces
            .iter()
            .zip(&quiet)
            .map(|(trace, q)| {
                let ([c, s], _) = q.amplitudes(frequency);
                let omega = std::f64::consts::TAU * frequency;
                (0..trace.residual.len())
                    .map(|k| {
                        let (sin, cos) = (omega * (trace.start_s + k as f64 / RATE_HZ)).sin_cos();
                        c * cos + s * sin
                    })
                    .collect()
            })
            .collect();
        Some(LatentFit {
            apart: true,
            gain: score - CHOICE,
            parameters: vec![
                ("frequency_hz", frequency, likely[0], likely[1]),
                ("amplitude_m_s2", amplitude, amplitude - 1.645 * sd, amplitude + 1.645 * sd),
            ],
            decay_s: None,
            wheel_share: None,
            windows: scene.cut(&traces),
            traces,
        })
    }
}

/// Takes the sinusoid off that fits the train-free ends best.
fn without_tone(passage: &mut Passage, frequency_hz: f64) {
    let (n, rate) = (passage.acceleration_m_s2.len(), passage.sample_rate_hz);
    let quiet = ((QUIET_S * rate) as usize).min(n / 2);
    let omega = std::f64::consts::TAU * frequency_hz / rate;
    let ends = (0..quiet).chain(n - quiet..n);
    let mean = ends.clone().map(|i| f64::from(passage.acceleration_m_s2[i])).sum::<f64>()
        / (2 * quiet).max(1) as f64;
    let (mut c, mut s) = (0.0, 0.0);
    for i in ends {
        let (sin, cos) = (omega * i as f64).sin_cos();
        let value = f64::from(passage.acceleration_m_s2[i]) - mean;
        (c, s) = (c + value * cos / quiet as f64, s + value * sin / quiet as f64);
    }
    for (i, a) in passage.acceleration_m_s2.iter_mut().enumerate() {
        let (sin, cos) = (omega * i as f64).sin_cos();
        *a -= (c * cos + s * sin) as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::passage::random::Random;

    /// Between two steps of the search, and far above the noise: a neighbour half a hertz away would turn the phase around
    /// while the train passes.
    #[test]
    fn regress_strong_tone_is_found_at_its_own_frequency() {
        for (frequency_hz, amplitude_m_s2) in [(122.942, 6.5), (75.263, 12.3), (75.25, 0.3)] {
            let mut random = Random::new(3, 0);
            let quiet: Vec<Quiet> = (0..8)
                .map(|_| {
                    let (turn, last) = (random.unit(), random.between(1.9, 3.1));
                    let end = |start_s: f64, random: &mut Random| {
                        let at = |k: usize| frequency_hz * (start_s + k as f64 / RATE_HZ) + turn;
                        let noise = |random: &mut Random| 0.1 * random.normal();
                        let wave = |k: usize| (std::f64::consts::TAU * at(k)).cos();
                        let value_m_s2 = (0..216).map(|k| amplitude_m_s2 * wave(k) + noise(random)).collect();
                        QuietEnd { start_s, value_m_s2 }
                    };
                    Quiet::of(vec![end(0.01, &mut random), end(last, &mut random)])
                })
                .collect();
            let (_, found, [low, high]) = strongest(&quiet.iter().collect::<Vec<_>>()).unwrap();
            assert!((found - frequency_hz).abs() < 0.02, "{found} of {frequency_hz}");
            assert!(low <= frequency_hz && frequency_hz <= high && high - low < 0.1, "{low} {high}");
        }
    }

    /// Interference before and behind the train, and a sleeper that rings behind it.
    #[test]
    fn regress_what_rings_behind_the_train_is_no_interference() {
        let mut random = Random::new(4, 0);
        let mut site = |before_m_s2: f64| -> Vec<Quiet> {
            (0..8)
                .map(|_| {
                    let turn = random.unit();
                    let mut end = |start_s: f64, amplitude_m_s2: f64| {
                        let wave = |k: usize| {
                            let at = 47.0 * (start_s + k as f64 / RATE_HZ) + turn;
                            (std::f64::consts::TAU * at).cos()
                        };
                        let value_m_s2 =
                            (0..216).map(|k| amplitude_m_s2 * wave(k) + 0.05 * random.normal()).collect();
                        QuietEnd { start_s, value_m_s2 }
                    };
                    Quiet::of(vec![end(0.01, before_m_s2), end(2.3, 0.4)])
                })
                .collect()
        };
        let (tone, ringing) = (site(0.4), site(0.0));
        assert!(always_there(&tone.iter().collect::<Vec<_>>(), 47.0));
        assert!(!always_there(&ringing.iter().collect::<Vec<_>>(), 47.0));
    }
}
