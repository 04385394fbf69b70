//! Receptance from an instrumented hammer: force and acceleration of several hits, H1 estimate with coherence.
//!
//! H1 = Σ conj(F) A / Σ |F|² is free of bias by noise in the acceleration; the coherence |Σ conj(F) A|² / (Σ|F|² Σ|A|²) says
//! which part of the response comes from the force (Bendat and Piersol, Random Data, ch. 6). With one hit it is 1 whatever was
//! measured, so one hit is refused; so is a band in which the hits do not agree or that the hammer did not excite.

mod uff;

use std::path::{Path, PathBuf};

use faer::c64;

use crate::recording::RecordingError;
use crate::recording::files::read_bytes;
use crate::signal::{rfft, rfft_frequencies_hz};

/// One hit.
#[derive(Clone, Debug, PartialEq)]
pub struct Hit {
    /// Sampling rate, Hz.
    pub rate_hz: f64,
    /// Hammer force, newtons.
    pub force_n: Vec<f64>,
    /// Acceleration, m/s².
    pub acceleration_m_s2: Vec<f64>,
}

/// Receptance over frequency.
#[derive(Clone, Debug, PartialEq)]
pub struct Receptance {
    /// Hz.
    pub frequency_hz: Vec<f64>,
    /// Displacement over force, m/N.
    pub receptance_m_n: Vec<c64>,
    /// 0 … 1.
    pub coherence: Vec<f64>,
    /// Hits, 1 where it is not known how many.
    pub hits: usize,
}

/// What a file holds.
#[derive(Debug)]
enum Content {
    /// Time series of hammer and sensor.
    Hits(Vec<Hit>),
    /// Estimated by the analyser.
    Estimate(Receptance),
}

/// Why hits give no receptance.
#[derive(Debug, thiserror::Error)]
pub enum ReceptanceError {
    /// No file.
    #[error(transparent)]
    File(#[from] RecordingError),
    /// Not the expected table.
    #[error("{file}, line {line}: expected {header}")]
    Format {
        /// Which file.
        file: String,
        /// Line, from 1.
        line: usize,
        /// Columns of the table.
        header: &'static str,
    },
    /// Not a universal file that can be used.
    #[error("{file}, line {line}: {what}")]
    Universal {
        /// Which file.
        file: String,
        /// Line, from 1.
        line: usize,
        /// What is wrong.
        what: &'static str,
    },
    /// Samples are missing or doubled.
    #[error(
        "{file}: sample {sample} comes {step_s:.2e} s after the one before, the others every {mean_s:.2e} s; export the hit as recorded"
    )]
    Uneven {
        /// Which file.
        file: String,
        /// Sample, from 1.
        sample: usize,
        /// Time since the one before, s.
        step_s: f64,
        /// Mean of all, s.
        mean_s: f64,
    },
    /// No files, or several of which one is an estimate already.
    #[error("{files} files; give all hits, one file each, or one file with the estimated receptance")]
    Files {
        /// Number of files.
        files: usize,
    },
    /// Too few hits.
    #[error("{hits} hit; coherence needs at least 2, better 5: it is 1 for one hit whatever was measured")]
    Hits {
        /// Number of hits.
        hits: usize,
    },
    /// Hits that differ in rate.
    #[error("hits at {first_hz} and {other_hz} Hz; all must have the same rate")]
    Rates {
        /// Rate of the first, Hz.
        first_hz: f64,
        /// Rate that differs, Hz.
        other_hz: f64,
    },
    /// The hammer has no energy there.
    #[error(
        "the hammer excites {low_hz} … {high_hz} Hz too little: down to {decibel:.0} dB of its strongest; use a softer or heavier tip"
    )]
    NotExcited {
        /// Asked band, Hz.
        low_hz: f64,
        /// Asked band, Hz.
        high_hz: f64,
        /// Weakest line over the strongest, dB.
        decibel: f64,
    },
    /// Nothing was measured there.
    #[error(
        "the receptance is zero or no number on {share:.0} % of {low_hz} … {high_hz} Hz: look at the exported file, force in N and \
         acceleration in m/s²"
    )]
    Dead {
        /// Asked band, Hz.
        low_hz: f64,
        /// Asked band, Hz.
        high_hz: f64,
        /// Part of the lines, %.
        share: f64,
    },
    /// The hits do not agree.
    #[error(
        "coherence is below {LEAST_COHERENCE} on {share:.0} % of {low_hz} … {high_hz} Hz (lowest {lowest:.2}); hit again, at one point, without double hits"
    )]
    Incoherent {
        /// Asked band, Hz.
        low_hz: f64,
        /// Asked band, Hz.
        high_hz: f64,
        /// Part of the lines, %.
        share: f64,
        /// Lowest coherence.
        lowest: f64,
    },
}

/// Coherence that a line needs.
pub const LEAST_COHERENCE: f64 = 0.8;
/// Part of the lines of a band that may lack it: anti-resonances, where there is nothing to measure.
const INCOHERENT_PART: f64 = 0.2;
/// Weakest force in a band over its strongest line anywhere.
const LEAST_FORCE: f64 = 0.03;

/// Columns of a hit.
const HIT: &str = "time_s,force_n,acceleration_m_s2";
/// Columns of an estimated receptance.
const ESTIMATE: &str = "frequency_hz,real_m_n,imaginary_m_n,coherence";
/// Samples of a hit.
const LEAST_SAMPLES: usize = 64;

/// Reads hits, or one receptance that was estimated elsewhere: tables, or universal files (`.uff`, `.unv`). Lines below
/// `high_hz`.
pub fn read_receptance(files: &[PathBuf], high_hz: f64) -> Result<Receptance, ReceptanceError> {
    let mut hits = Vec::new();
    for file in files {
        let estimate = match read_one(file)? {
            Content::Hits(mut some) => {
                hits.append(&mut some);
                continue;
            }
            Content::Estimate(estimate) => estimate,
        };
        if files.len() > 1 {
            return Err(ReceptanceError::Files { files: files.len() });
        }
        return Ok(estimate);
    }
    if files.is_empty() {
        return Err(ReceptanceError::Files { files: 0 });
    }
    Receptance::of_hits(&hits, high_hz)
}

fn read_one(file: &Path) -> Result<Content, ReceptanceError> {
    let universal =
        file.extension().is_some_and(|e| e.eq_ignore_ascii_case("uff") || e.eq_ignore_ascii_case("unv"));
    let text = String::from_utf8_lossy(&read_bytes(file)?).into_owned();
    let name = file.display().to_string();
    if universal {
        return uff::read(&name, &text);
    }
    if text.lines().next().map(str::trim) == Some(ESTIMATE) {
        let rows = table::<4>(&name, &text, ESTIMATE)?;
        let lines = rows.iter().map(|[f, re, im, coherence]| (*f, c64::new(*re, *im), *coherence));
        return Ok(Content::Estimate(Receptance::estimated(lines)));
    }
    hit(&name, &text).map(|h| Content::Hits(vec![h]))
}

/// Reads a hit from a table with the columns `time_s,force_n,acceleration_m_s2`, evenly sampled.
pub fn read_hit(file: &Path) -> Result<Hit, ReceptanceError> {
    hit(&file.display().to_string(), &String::from_utf8_lossy(&read_bytes(file)?))
}

fn hit(file: &str, text: &str) -> Result<Hit, ReceptanceError> {
    let rows = table::<3>(file, text, HIT)?;
    let wrong = |line: usize| ReceptanceError::Format { file: file.into(), line, header: HIT };
    if rows.len() < LEAST_SAMPLES {
        return Err(wrong(rows.len() + 1));
    }
    let time_s: Vec<f64> = rows.iter().map(|r| r[0]).collect();
    Ok(Hit {
        rate_hz: even_rate_hz(file, &time_s)?,
        force_n: rows.iter().map(|r| r[1]).collect(),
        acceleration_m_s2: rows.iter().map(|r| r[2]).collect(),
    })
}

/// Steps between samples lie within this part of their mean: times may be rounded, but no sample may be missing.
const EVEN_WITHIN: f64 = 0.5;

/// Rate of two samples or more, which must come at an even pace.
fn even_rate_hz(file: &str, time_s: &[f64]) -> Result<f64, ReceptanceError> {
    let steps = || time_s.windows(2).map(|w| w[1] - w[0]);
    let mean_s = steps().sum::<f64>() / (time_s.len() - 1) as f64;
    let even = |step_s: f64| (step_s - mean_s).abs() < EVEN_WITHIN * mean_s;
    match steps().enumerate().find(|(_, step_s)| !even(*step_s)) {
        Some((k, step_s)) => {
            Err(ReceptanceError::Uneven { file: file.into(), sample: k + 2, step_s, mean_s })
        }
        None => Ok(1.0 / mean_s),
    }
}

/// Finite numbers under a header.
fn table<const N: usize>(
    file: &str,
    text: &str,
    header: &'static str,
) -> Result<Vec<[f64; N]>, ReceptanceError> {
    let wrong = |line: usize| ReceptanceError::Format { file: file.into(), line, header };
    let mut lines = text.lines();
    if lines.next().map(str::trim) != Some(header) {
        return Err(wrong(1));
    }
    lines
        .enumerate()
        .map(|(i, line)| {
            let cells: Vec<f64> = line
                .split(',')
                .map(|c| c.trim().parse::<f64>().ok().filter(|v| v.is_finite()).ok_or_else(|| wrong(i + 2)))
                .collect::<Result<_, _>>()?;
            <[f64; N]>::try_from(cells).map_err(|_| wrong(i + 2))
        })
        .collect()
}

impl Receptance {
    /// H1 estimate of all hits, lines below `high_hz`.
    pub fn of_hits(hits: &[Hit], high_hz: f64) -> Result<Self, ReceptanceError> {
        if hits.len() < 2 {
            return Err(ReceptanceError::Hits { hits: hits.len() });
        }
        let first_hz = hits[0].rate_hz;
        if let Some(other) = hits.iter().find(|h| (h.rate_hz / first_hz - 1.0).abs() > 1e-6) {
            return Err(ReceptanceError::Rates { first_hz, other_hz: other.rate_hz });
        }
        let n = hits.iter().map(|h| h.force_n.len()).max().unwrap_or(0).next_power_of_two();
        let spectrum = |values: &[f64]| {
            // The record begins and ends at rest but for the offset of the amplifiers.
            let offset = crate::signal::quantile(values, 0.5);
            let mut padded: Vec<f64> = values.iter().map(|v| v - offset).collect();
            padded.resize(n, 0.0);
            rfft(&padded)
        };
        let lines: Vec<f64> =
            rfft_frequencies_hz(n, first_hz).into_iter().filter(|f| *f > 0.0 && *f <= high_hz).collect();
        let mut sums = vec![(c64::new(0.0, 0.0), 0.0, 0.0); lines.len()];
        for hit in hits {
            let (force, response) = (spectrum(&hit.force_n), spectrum(&hit.acceleration_m_s2));
            for (k, sum) in sums.iter_mut().enumerate() {
                let (f, a) = (force[k + 1], response[k + 1]);
                *sum = (sum.0 + f.conj() * a, sum.1 + f.norm_sqr(), sum.2 + a.norm_sqr());
            }
        }
        let strongest = sums.iter().map(|s| s.1).fold(0.0, f64::max);
        let weakest = sums.iter().map(|s| s.1).fold(f64::INFINITY, f64::min);
        if weakest < LEAST_FORCE * LEAST_FORCE * strongest {
            let decibel = 10.0 * (weakest / strongest).log10();
            return Err(ReceptanceError::NotExcited { low_hz: 0.0, high_hz, decibel });
        }
        let receptance = |(f, s): (&f64, &(c64, f64, f64))| {
            let omega = std::f64::consts::TAU * f;
            s.0 / s.1 * (-1.0 / (omega * omega))
        };
        let coherence = |s: &(c64, f64, f64)| {
            // Rounding may take it above 1.
            (s.0.norm_sqr() / (s.1 * s.2).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0)
        };
        Ok(Self {
            receptance_m_n: lines.iter().zip(&sums).map(receptance).collect(),
            coherence: sums.iter().map(coherence).collect(),
            frequency_hz: lines,
            hits: hits.len(),
        })
    }

    /// The part between two frequencies, if the hits agree there.
    pub fn trusted(&self, [low_hz, high_hz]: [f64; 2]) -> Result<Self, ReceptanceError> {
        let inside: Vec<usize> = (0..self.frequency_hz.len())
            .filter(|k| self.frequency_hz[*k] >= low_hz && self.frequency_hz[*k] <= high_hz)
            .collect();
        let share = |lines: usize| lines as f64 / inside.len().max(1) as f64;
        let live: Vec<usize> = inside.iter().copied().filter(|k| self.is_live(*k)).collect();
        let dead = share(inside.len() - live.len());
        if dead > INCOHERENT_PART {
            return Err(ReceptanceError::Dead { low_hz, high_hz, share: 100.0 * dead });
        }
        let poor = share(inside.iter().filter(|k| self.coherence[**k] < LEAST_COHERENCE).count());
        if inside.is_empty() || poor > INCOHERENT_PART {
            let lowest = inside.iter().map(|k| self.coherence[*k]).fold(1.0, f64::min);
            return Err(ReceptanceError::Incoherent { low_hz, high_hz, share: 100.0 * poor, lowest });
        }
        Ok(self.picked(&live))
    }

    /// Whether something was measured at a line: analysers write zeros where they have nothing.
    fn is_live(&self, line: usize) -> bool {
        let size = self.receptance_m_n[line].norm();
        size > 0.0 && size.is_finite() && self.coherence[line].is_finite()
    }

    /// The lines at frequencies to `keep`, Hz.
    pub(super) fn lines(&self, mut keep: impl FnMut(f64) -> bool) -> Self {
        let kept: Vec<usize> = (0..self.frequency_hz.len()).filter(|k| keep(self.frequency_hz[*k])).collect();
        self.picked(&kept)
    }

    fn picked(&self, kept: &[usize]) -> Self {
        Self {
            frequency_hz: kept.iter().map(|k| self.frequency_hz[*k]).collect(),
            receptance_m_n: kept.iter().map(|k| self.receptance_m_n[*k]).collect(),
            coherence: kept.iter().map(|k| self.coherence[*k]).collect(),
            hits: self.hits,
        }
    }

    /// As an analyser estimated it: frequencies, Hz, receptances, m/N, coherences. Nothing moves at 0 Hz.
    fn estimated(lines: impl Iterator<Item = (f64, c64, f64)>) -> Self {
        let mut out =
            Self { frequency_hz: Vec::new(), receptance_m_n: Vec::new(), coherence: Vec::new(), hits: 1 };
        for (f, receptance, coherence) in lines.filter(|l| l.0 > 0.0) {
            out.frequency_hz.push(f);
            out.receptance_m_n.push(receptance);
            out.coherence.push(coherence.clamp(0.0, 1.0));
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A mass on a spring and damper, hit by half-sines of different strength.
    fn oscillator(strength: f64, noise: f64, seed: u64) -> Hit {
        let (rate, n) = (4000.0, 4096);
        let (mass, stiffness, damping) = (10.0, 10.0 * (std::f64::consts::TAU * 60.0).powi(2), 400.0);
        let mut random = crate::passage::random::Random::new(seed, 0);
        let force: Vec<f64> = (0..n)
            .map(|k| if k < 8 { strength * (std::f64::consts::PI * k as f64 / 8.0).sin() } else { 0.0 })
            .collect();
        // Spectrum times the known accelerance, so that nothing but the estimate is tested.
        let mut spectrum = rfft(&force);
        for (value, f) in spectrum.iter_mut().zip(rfft_frequencies_hz(n, rate)) {
            let omega = std::f64::consts::TAU * f;
            *value *=
                c64::new(-omega * omega, 0.0) / c64::new(stiffness - mass * omega * omega, damping * omega);
        }
        let response = crate::signal::irfft(&spectrum, n);
        let acceleration_m_s2 = response.iter().map(|a| a + noise * random.normal()).collect();
        Hit { rate_hz: rate, force_n: force, acceleration_m_s2 }
    }

    #[test]
    fn analytic_receptance_of_an_oscillator() {
        let hits: Vec<Hit> = (0..4).map(|i| oscillator(1000.0 + 200.0 * i as f64, 0.0, i)).collect();
        let found = Receptance::of_hits(&hits, 250.0).unwrap().trusted([10.0, 200.0]).unwrap();
        let k = found.frequency_hz.iter().position(|f| *f > 60.0).unwrap();
        let omega = std::f64::consts::TAU * found.frequency_hz[k];
        let stiffness = 10.0 * (std::f64::consts::TAU * 60.0).powi(2);
        let exact = c64::new(1.0, 0.0) / c64::new(stiffness - 10.0 * omega * omega, 400.0 * omega);
        assert!((found.receptance_m_n[k] / exact - 1.0).norm() < 1e-2);
        assert!(found.coherence.iter().all(|c| *c > 0.999));
    }

    #[test]
    fn property_missing_samples_are_refused_with_their_place() {
        let table = |times: &mut dyn Iterator<Item = usize>| -> String {
            let rows = times.map(|k| format!("{:.6},1,2\n", k as f64 / 30_000.0));
            format!("{HIT}\n{}", rows.collect::<String>())
        };
        // Microseconds round steps of 33.3 µs.
        let whole = hit("a.csv", &table(&mut (0..100))).unwrap();
        assert!((whole.rate_hz / 30_000.0 - 1.0).abs() < 1e-3);
        let gap = hit("a.csv", &table(&mut (0..100).filter(|k| *k != 40)));
        assert!(matches!(gap, Err(ReceptanceError::Uneven { sample: 41, .. })), "{gap:?}");
        let backwards = hit("a.csv", &table(&mut (0..100).rev()));
        assert!(matches!(backwards, Err(ReceptanceError::Uneven { .. })), "{backwards:?}");
    }

    #[test]
    fn property_noise_one_hit_and_other_rates_are_refused() {
        let noisy: Vec<Hit> = (0..3).map(|i| oscillator(20.0, 5.0, i)).collect();
        let error = Receptance::of_hits(&noisy, 250.0).unwrap().trusted([10.0, 200.0]).unwrap_err();
        assert!(matches!(error, ReceptanceError::Incoherent { .. }), "{error}");
        assert!(matches!(Receptance::of_hits(&noisy[..1], 250.0), Err(ReceptanceError::Hits { hits: 1 })));
        let mut other = noisy.clone();
        other[1].rate_hz = 2000.0;
        assert!(matches!(Receptance::of_hits(&other, 250.0), Err(ReceptanceError::Rates { .. })));
    }

    /// Two measured hits on a beam (tests/data/hammer-beam): its first modes, 695.6 and 1897.9 Hz.
    #[test]
    fn reference_modes_of_a_measured_beam() {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/hammer-beam");
        let hits = ["acceleration.csv", "camera.csv"].map(|f| read_hit(&dir.join(f)).unwrap());
        let found = Receptance::of_hits(&hits, 2500.0).unwrap();
        let peak = |low: f64, high: f64| {
            let lines = (0..found.frequency_hz.len())
                .filter(|k| found.frequency_hz[*k] > low && found.frequency_hz[*k] < high);
            let size = |k: &usize| found.frequency_hz[*k].powi(2) * found.receptance_m_n[*k].norm();
            lines.max_by(|a, b| size(a).total_cmp(&size(b))).map(|k| found.frequency_hz[k]).unwrap()
        };
        // A line is 1.5 Hz wide.
        assert!((peak(500.0, 1000.0) - 695.6).abs() < 3.0, "{}", peak(500.0, 1000.0));
        assert!((peak(1500.0, 2300.0) - 1897.9).abs() < 3.0, "{}", peak(1500.0, 2300.0));
        // Between two modes the sensor hardly moves, and the hits do not agree: it is refused with a number, not given as a receptance.
        assert!(found.trusted([690.0, 702.0]).is_ok());
        let low = found.trusted([1100.0, 1400.0]);
        assert!(matches!(low, Err(ReceptanceError::Incoherent { .. })), "{low:?}");
    }

    /// Lines at 20 to 250 Hz with a coherence of 0.98, of which `dead` say nothing.
    fn with_dead_lines(dead: usize) -> Receptance {
        let lines = (20..=250).map(|f| {
            let live = if f < 20 + dead as i32 { 0.0 } else { 1e-8 };
            (f64::from(f), c64::new(live, 0.0), 0.98)
        });
        Receptance::estimated(lines)
    }

    /// A line of zeros is infinitely far from every model, which then all fit alike.
    #[test]
    fn regress_lines_of_zeros_are_no_measurement() {
        let found = with_dead_lines(10).trusted([20.0, 250.0]).unwrap();
        assert_eq!(found.frequency_hz.len(), 221);
        assert!(found.receptance_m_n.iter().all(|r| r.norm() > 0.0));
        let error = with_dead_lines(100).trusted([20.0, 250.0]).unwrap_err();
        assert!(
            matches!(error, ReceptanceError::Dead { share, .. } if (share - 43.3).abs() < 0.1),
            "{error}"
        );
    }

    proptest! {
        /// Whatever the size of what was recorded.
        #[test]
        fn property_what_is_trusted_is_finite(force in -320.0_f64..308.0, motion in -320.0_f64..308.0) {
            let hits: Vec<Hit> = (0..2)
                .map(|i| {
                    let hit = oscillator(1.0, 0.0, i);
                    let scaled = |values: &[f64], by: f64| values.iter().map(|v| v * 10f64.powf(by)).collect();
                    Hit {
                        force_n: scaled(&hit.force_n, force),
                        acceleration_m_s2: scaled(&hit.acceleration_m_s2, motion),
                        ..hit
                    }
                })
                .collect();
            if let Ok(found) = Receptance::of_hits(&hits, 250.0).and_then(|r| r.trusted([20.0, 250.0])) {
                prop_assert!(found.receptance_m_n.iter().all(|r| r.norm() > 0.0 && r.norm().is_finite()));
                prop_assert!(found.coherence.iter().all(|c| (0.0..=1.0).contains(c)));
            }
        }

        #[test]
        fn property_arbitrary_tables_never_panic(cells in proptest::collection::vec("[-+.0-9eEnaif]{0,8}", 0..400)) {
            let rows: String = cells.chunks(3).map(|row| row.join(",") + "\n").collect();
            let _ = hit("hit.csv", &format!("{HIT}\n{rows}"));
            let _ = table::<4>("h.csv", &format!("{ESTIMATE}\n{rows}"), ESTIMATE);
            let _ = uff::read("h.uff", &rows);
        }
    }
}
