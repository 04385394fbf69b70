//! Receptance from an instrumented hammer: force and acceleration of several hits, H1 estimate with coherence.
//!
//! H1 = Σ conj(F) A / Σ |F|² is free of bias by noise in the acceleration; the coherence |Σ conj(F) A|² / (Σ|F|² Σ|A|²) says
//! which part of the response comes from the force (Bendat and Piersol, Random Data, ch. 6). With one hit it is 1 whatever was
//! measured, so one hit is refused; so is a band in which the hits do not agree or that the hammer did not excite.

mod error;
mod uff;

use std::path::{Path, PathBuf};

use faer::c64;

use crate::recording::files::read_bytes;
use crate::signal::{rfft, rfft_frequencies_hz};
pub use error::ReceptanceError;

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

/// Coherence that a line needs.
pub const LEAST_COHERENCE: f64 = 0.8;
/// Part of the lines of a band that may lack it: anti-resonances, where there is nothing to measure.
const INCOHERENT_PART: f64 = 0.2;
/// Widest gap between the lines of a band, and at its ends, Hz: the track's resonances are about as wide, and hits of 1/25 s are no record.
const MOST_SPACING_HZ: f64 = 25.0;
/// Coherence that may be rounded.
const COHERENCE: std::ops::RangeInclusive<f64> = -1e-3..=1.001;
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
    let text = text_of(&read_bytes(file)?);
    let name = file.display().to_string();
    if universal {
        return uff::read(&name, &text);
    }
    if text.lines().next().map(str::trim) == Some(ESTIMATE) {
        return estimate(&name, &text).map(Content::Estimate);
    }
    hit(&name, &text).map(|h| Content::Hits(vec![h]))
}

/// Text without the mark that some programs put before it.
fn text_of(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(bytes);
    text.strip_prefix('\u{feff}').unwrap_or(&text).to_string()
}

fn estimate(file: &str, text: &str) -> Result<Receptance, ReceptanceError> {
    let rows = table::<4>(file, text, ESTIMATE)?;
    // Below the header.
    check_coherence(file, rows.iter().zip(2..).map(|(row, line)| (line, row[3])))?;
    let lines = rows.iter().map(|[f, re, im, coherence]| (*f, c64::new(*re, *im), *coherence));
    Ok(Receptance::estimated(lines))
}

/// Coherences with their lines; one of 97 % would otherwise count as 1, whatever the hits were worth.
fn check_coherence(file: &str, mut lines: impl Iterator<Item = (usize, f64)>) -> Result<(), ReceptanceError> {
    match lines.find(|(_, coherence)| !COHERENCE.contains(coherence)) {
        Some((line, coherence)) => Err(ReceptanceError::Coherence { file: file.into(), line, coherence }),
        None => Ok(()),
    }
}

/// Reads a hit from a table with the columns `time_s,force_n,acceleration_m_s2`, evenly sampled.
pub fn read_hit(file: &Path) -> Result<Hit, ReceptanceError> {
    hit(&file.display().to_string(), &text_of(&read_bytes(file)?))
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

    /// The part between two frequencies, if it is there and the hits agree in it.
    pub fn trusted(&self, [low_hz, high_hz]: [f64; 2]) -> Result<Self, ReceptanceError> {
        let inside: Vec<usize> = (0..self.frequency_hz.len())
            .filter(|k| self.frequency_hz[*k] >= low_hz && self.frequency_hz[*k] <= high_hz)
            .collect();
        self.check_cover(&inside, [low_hz, high_hz])?;
        let share = |lines: usize| lines as f64 / inside.len() as f64;
        let live: Vec<usize> = inside.iter().copied().filter(|k| self.is_live(*k)).collect();
        let dead = share(inside.len() - live.len());
        if dead > INCOHERENT_PART {
            return Err(ReceptanceError::Dead { low_hz, high_hz, share: 100.0 * dead });
        }
        let poor = share(inside.iter().filter(|k| self.coherence[**k] < LEAST_COHERENCE).count());
        if poor > INCOHERENT_PART {
            let lowest = inside.iter().map(|k| self.coherence[*k]).fold(1.0, f64::min);
            return Err(ReceptanceError::Incoherent { low_hz, high_hz, share: 100.0 * poor, lowest });
        }
        Ok(self.picked(&live))
    }

    /// Refuses a band that is not there, or only in part. Ascending lines.
    fn check_cover(&self, inside: &[usize], [low_hz, high_hz]: [f64; 2]) -> Result<(), ReceptanceError> {
        if inside.is_empty() {
            let end_hz = |end: Option<&f64>| end.copied().unwrap_or(0.0);
            let [first_hz, last_hz] = [self.frequency_hz.first(), self.frequency_hz.last()].map(end_hz);
            return Err(ReceptanceError::Outside {
                low_hz,
                high_hz,
                lines: self.frequency_hz.len(),
                first_hz,
                last_hz,
            });
        }
        let mut from_hz = low_hz;
        for to_hz in inside.iter().map(|k| self.frequency_hz[*k]).chain([high_hz]) {
            if to_hz - from_hz > MOST_SPACING_HZ {
                return Err(ReceptanceError::Sparse { low_hz, high_hz, from_hz, to_hz });
            }
            from_hz = to_hz;
        }
        Ok(())
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

    /// As an analyser estimated it, in any order: frequencies, Hz, receptances, m/N, coherences. Nothing moves at 0 Hz.
    fn estimated(lines: impl Iterator<Item = (f64, c64, f64)>) -> Self {
        let mut out =
            Self { frequency_hz: Vec::new(), receptance_m_n: Vec::new(), coherence: Vec::new(), hits: 1 };
        let mut lines: Vec<(f64, c64, f64)> = lines.filter(|l| l.0 > 0.0).collect();
        lines.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (f, receptance, coherence) in lines {
            out.frequency_hz.push(f);
            out.receptance_m_n.push(receptance);
            // It may be rounded.
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

    /// A table of an analyser at these frequencies.
    fn exported(frequency_hz: impl Iterator<Item = f64>, coherence: &str) -> String {
        let rows: String = frequency_hz.map(|f| format!("{f},1e-8,0,{coherence}\n")).collect();
        format!("{ESTIMATE}\n{rows}")
    }

    /// 62 % was clamped to 1: hits that did not agree passed for a measurement without error.
    #[test]
    fn regress_coherence_in_percent_is_refused_with_its_line() {
        let text = exported((20..=250).map(f64::from), "0.98").replace("\n30,1e-8,0,0.98", "\n30,1e-8,0,62");
        let error = estimate("a.csv", &text).unwrap_err();
        assert!(matches!(error, ReceptanceError::Coherence { line: 12, coherence: 62.0, .. }), "{error}");
        assert!(error.to_string().contains("percent"), "{error}");
        let rounded = estimate("a.csv", &exported((20..=250).map(f64::from), "1.0005")).unwrap();
        assert!(rounded.coherence.iter().all(|c| *c == 1.0));
        assert!(estimate("a.csv", &exported((20..=250).map(f64::from), "-0.5")).is_err());
    }

    /// Of lines in descending order the hammer kept the first alone.
    #[test]
    fn regress_lines_in_any_order_are_sorted() {
        let up = estimate("a.csv", &exported((20..=250).map(f64::from), "0.98")).unwrap();
        let down = estimate("a.csv", &exported((20..=250).rev().map(f64::from), "0.98")).unwrap();
        assert_eq!(up, down);
    }

    /// A single line said what the whole track was like.
    #[test]
    fn regress_a_band_without_enough_lines_is_refused_with_the_gap() {
        let trusted = |frequency_hz: &[f64]| {
            let text = exported(frequency_hz.iter().copied(), "0.98");
            estimate("a.csv", &text).unwrap().trusted([20.0, 250.0])
        };
        let gap = |frequency_hz: &[f64]| match trusted(frequency_hz) {
            Err(ReceptanceError::Sparse { from_hz, to_hz, .. }) => (from_hz, to_hz),
            other => panic!("{other:?}"),
        };
        assert_eq!(gap(&[100.0]), (20.0, 100.0));
        let tens: Vec<f64> = (2..=25).map(|k| 10.0 * f64::from(k)).collect();
        assert_eq!(trusted(&tens).unwrap().frequency_hz, tens);
        assert_eq!(gap(&tens[..20]), (210.0, 250.0));
        assert_eq!(gap(&[&tens[..5], &tens[9..]].concat()), (60.0, 110.0));
    }

    /// Frequencies in kHz were called incoherent on 0 % of the band.
    #[test]
    fn regress_a_file_without_the_band_says_what_it_holds() {
        let in_khz = exported((20..=250).map(|f| 1e-3 * f64::from(f)), "0.98");
        let error = estimate("a.csv", &in_khz).unwrap().trusted([20.0, 250.0]).unwrap_err();
        assert!(
            matches!(error, ReceptanceError::Outside { lines: 231, first_hz: 0.02, last_hz: 0.25, .. }),
            "{error}"
        );
        assert!(error.to_string().contains("kHz"), "{error}");
    }

    /// Tables saved with a mark of their encoding had no header.
    #[test]
    fn regress_a_byte_order_mark_is_no_part_of_the_header() {
        let dir = tempfile::tempdir().unwrap();
        let read = |name: &str, text: String| {
            let file = dir.path().join(name);
            std::fs::write(&file, format!("\u{feff}{text}")).unwrap();
            read_one(&file)
        };
        let found = read("h.csv", exported((20..=250).map(f64::from), "0.98")).unwrap();
        assert!(matches!(found, Content::Estimate(e) if e.frequency_hz.len() == 231));
        let rows: String = (0..100).map(|k| format!("{:.6},1,2\n", f64::from(k) * 1e-4)).collect();
        assert!(matches!(read("h.csv", format!("{HIT}\n{rows}")).unwrap(), Content::Hits(_)));
        let error = read("h.uff", "    -1\n    58\n".into()).unwrap_err();
        assert!(error.to_string().contains("end (-1)"), "{error}");
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
