//! Which low-pass separates quasi-static from dynamic displacement (paper, eq. 3 and fig. 9).
//!
//! Every ballast with every geometry, low-passed, against the same ballast with a level rail. The brick-wall filter keeps
//! or drops whole lines of the spectrum, so by Parseval's theorem the misfit of every cut-off is a running sum over the
//! lines: up to the cut-off of |D(geometry) − D(level)|², above it of |D(level)|². No optimiser is needed.

use rayon::prelude::*;

use super::StudyError;
use super::bogie::BogieTrack;
use super::panels::{self, LOW_PASS_SPEED_M_S, Panel};
use crate::passage::Profile;
use crate::progress::Progress;
use crate::scenario::crossing_path;
use crate::signal::{brick_band, rfft};
use crate::verification::Table;
use crate::verification::reference::{PadCase, SOFT, STIFF};

/// The paper's result, metres.
pub const PAPER_WAVELENGTH_M: f64 = 2.3;
/// Signals are continued by rest to this length: lines 0.038 Hz apart, 0.2 % of the cut-off.
const PADDED: usize = 1 << 18;
/// Highest cut-off looked at, Hz.
const HIGHEST_HZ: f64 = 60.0;
/// Length kept of the filtered curves, samples.
const KEPT: usize = 8192;

/// Displacement of all simulations with one kind of pads.
pub struct PadResult {
    /// Pads.
    pub pads: PadCase,
    /// Misfit of all 36 simulations at every cut-off.
    pub all: Misfit,
    /// Per ballast.
    pub per_ballast: Vec<Misfit>,
    /// Per ballast: level rail, then six geometries.
    pub curves: Vec<Vec<Curve>>,
}

/// One displacement over the position of the front wheels.
pub struct Curve {
    /// Metres, positive in the direction of travel.
    pub position_m: Vec<f64>,
    /// As simulated, metres.
    pub displacement_m: Vec<f64>,
    /// Below the best cut-off of all, metres.
    pub low_m: Vec<f64>,
}

/// Eq. 3 over the cut-off, relative to the power of the level rail's displacement.
#[derive(Clone, Debug, PartialEq)]
pub struct Misfit {
    /// Cut-offs, Hz, ascending from 0.
    pub cut_off_hz: Vec<f64>,
    /// RMS ratio.
    pub ratio: Vec<f64>,
    /// RMS ratio without a filter.
    pub unfiltered: f64,
    /// Speed, m/s.
    pub speed_m_s: f64,
}

impl Misfit {
    fn best(&self) -> usize {
        (0..self.ratio.len()).min_by(|a, b| self.ratio[*a].total_cmp(&self.ratio[*b])).unwrap_or(0)
    }

    /// Best cut-off, Hz.
    pub fn best_hz(&self) -> f64 {
        self.cut_off_hz.get(self.best()).copied().unwrap_or(f64::NAN)
    }

    /// The same as a wavelength, metres.
    pub fn best_m(&self) -> f64 {
        self.speed_m_s / self.best_hz()
    }

    /// Misfit there.
    pub fn least(&self) -> f64 {
        self.ratio.get(self.best()).copied().unwrap_or(f64::NAN)
    }

    /// Wavelengths between which the misfit is within 10 % of the least, metres: how well the optimum is determined.
    pub fn flat_m(&self) -> [f64; 2] {
        let within = |i: &usize| self.ratio[*i] <= 1.1 * self.least();
        let (best, n) = (self.best(), self.ratio.len());
        let low = (0..=best).rev().take_while(within).last().unwrap_or(best);
        let high = (best..n).take_while(within).last().unwrap_or(best);
        [high, low].map(|i| self.speed_m_s / self.cut_off_hz[i])
    }
}

/// What the study finds.
pub struct LowPass {
    /// Soft, then stiff pads, at the paper's 160 km/h.
    pub pads: [PadResult; 2],
    /// Best wavelength of soft and stiff pads at other speeds (km/h, m, m).
    pub speeds: Vec<(f64, [f64; 2])>,
}

/// Spectra of one ballast up to the highest cut-off: the level rail's, then those of the geometries; and the power of the
/// level rail's above.
struct Spectra {
    power: Vec<[f64; 2]>,
    above: f64,
    total: [f64; 2],
    line_hz: f64,
}

/// Simulated displacements of one ballast: level rail first.
fn displacements(
    panels: &[Panel],
    of_ballast: &Panel,
    pads: PadCase,
    speed_m_s: f64,
) -> Result<Vec<(Vec<f64>, f64, f64)>, StudyError> {
    let track = BogieTrack::new(&panels::crossing(pads, 37), &of_ballast.ballast)?;
    let mut paths = vec![Profile::level()];
    for panel in panels {
        paths.push(crossing_path(&panel.geometry, None)?);
    }
    paths
        .iter()
        .map(|path| {
            let run = track.run(path, speed_m_s)?;
            Ok((run.record.sensor_m, run.record.dt_s, run.front_at_origin_s))
        })
        .collect()
}

impl Spectra {
    fn new(signals: &[(Vec<f64>, f64, f64)]) -> Self {
        let line_hz = signals.first().map_or(1.0, |s| 1.0 / (s.1 * PADDED as f64));
        let lines = (HIGHEST_HZ / line_hz) as usize;
        let spectra: Vec<Vec<faer::c64>> = signals
            .iter()
            .map(|(d, ..)| {
                let mut padded = d.clone();
                padded.resize(PADDED, 0.0);
                rfft(&padded)
            })
            .collect();
        let Some((level, others)) = spectra.split_first() else {
            return Self { power: Vec::new(), above: 0.0, total: [0.0; 2], line_hz };
        };
        // All lines but the first and the last stand for two of the two-sided spectrum.
        let weight = |k: usize| if k == 0 || k + 1 == level.len() { 0.5 } else { 1.0 };
        let of_level = |k: usize| others.len() as f64 * weight(k) * level[k].norm_sqr();
        let difference =
            |k: usize| weight(k) * others.iter().map(|d| (d[k] - level[k]).norm_sqr()).sum::<f64>();
        let lines = lines.min(level.len());
        Self {
            power: (0..lines).map(|k| [difference(k), of_level(k)]).collect(),
            above: (lines..level.len()).map(of_level).sum(),
            total: [(0..level.len()).map(difference).sum(), (0..level.len()).map(of_level).sum()],
            line_hz,
        }
    }

    /// Eq. 3 for several ballasts together.
    fn misfit(all: &[&Spectra], speed_m_s: f64) -> Misfit {
        let lines = all.iter().map(|s| s.power.len()).min().unwrap_or(0);
        let sum = |of: &dyn Fn(&Spectra) -> f64| all.iter().map(|s| of(s)).sum::<f64>();
        let level = sum(&|s| s.total[1]);
        // With nothing kept, all of the level rail's response is missing.
        let mut value = sum(&|s| s.above + s.power.iter().map(|p| p[1]).sum::<f64>());
        let mut out = Misfit {
            cut_off_hz: Vec::with_capacity(lines),
            ratio: Vec::with_capacity(lines),
            unfiltered: (sum(&|s| s.total[0]) / level).sqrt(),
            speed_m_s,
        };
        for k in 0..lines {
            value += sum(&|s| s.power[k][0] - s.power[k][1]);
            out.cut_off_hz.push(k as f64 * all[0].line_hz);
            out.ratio.push((value.max(0.0) / level).sqrt());
        }
        out
    }
}

/// Curves of one ballast for the figure.
fn curves(signals: &[(Vec<f64>, f64, f64)], speed_m_s: f64, cut_off_hz: f64) -> Vec<Curve> {
    signals
        .iter()
        .map(|(d, dt, origin)| {
            let mut padded = d.clone();
            padded.resize(KEPT, 0.0);
            let mut low = brick_band(&padded, 1.0 / dt, 0.0, cut_off_hz);
            low.truncate(d.len());
            let position = |k: usize| (k as f64 * dt - origin) * speed_m_s;
            Curve { position_m: (0..d.len()).map(position).collect(), displacement_m: d.clone(), low_m: low }
        })
        .collect()
}

fn with_pads(pads: PadCase, speed_m_s: f64, progress: &dyn Progress) -> Result<PadResult, StudyError> {
    let panels = panels::all();
    let done: Vec<(Vec<(Vec<f64>, f64, f64)>, Spectra)> = panels
        .par_iter()
        .map(|of_ballast| {
            let signals = displacements(&panels, of_ballast, pads, speed_m_s)?;
            let spectra = Spectra::new(&signals);
            progress.step();
            Ok((signals, spectra))
        })
        .collect::<Result<_, StudyError>>()?;
    let spectra: Vec<&Spectra> = done.iter().map(|d| &d.1).collect();
    let all = Spectra::misfit(&spectra, speed_m_s);
    let per_ballast = spectra.iter().map(|s| Spectra::misfit(&[*s], speed_m_s)).collect();
    let curves = done.iter().map(|(signals, _)| curves(signals, speed_m_s, all.best_hz())).collect();
    Ok(PadResult { pads, all, per_ballast, curves })
}

/// Runs all simulations.
pub fn run(progress: &dyn Progress) -> Result<LowPass, StudyError> {
    let speeds: Vec<f64> = panels::all().iter().map(|p| p.speed_km_h).collect();
    progress.begin("low-pass study", 12 * (1 + speeds.len() as u64));
    let at = |speed_m_s| -> Result<[PadResult; 2], StudyError> {
        Ok([with_pads(SOFT, speed_m_s, progress)?, with_pads(STIFF, speed_m_s, progress)?])
    };
    let pads = at(LOW_PASS_SPEED_M_S)?;
    let mut other = Vec::new();
    for km_h in speeds {
        other.push((km_h, at(km_h / 3.6)?.map(|p| p.all.best_m())));
    }
    other.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(LowPass { pads, speeds: other })
}

impl LowPass {
    /// Optimum of both pads beside the paper's, then per ballast, then over speed.
    pub fn tables(&self) -> Vec<Table> {
        vec![self.optimum(), self.ballasts(), self.over_speed()]
    }

    fn optimum(&self) -> Table {
        let mut table = Table::new(
            "Low-pass that separates quasi-static from dynamic displacement (eq. 3)",
            "Six ballasts with six geometries, one bogie at 160 km/h. Misfit: RMS of low-passed minus level-rail displacement over RMS \
             of the latter. Flat: wavelengths within 10 % of the least misfit.",
            &["pads", "wavelength, m", "flat, m", "cut-off, Hz", "misfit", "without filter", "paper"],
        );
        for p in &self.pads {
            let [short, long] = p.all.flat_m();
            table.row(&[
                p.pads.name.into(),
                format!("{:.2}", p.all.best_m()),
                format!("{short:.2} \u{2026} {long:.2}"),
                format!("{:.1}", p.all.best_hz()),
                format!("{:.1} %", 100.0 * p.all.least()),
                format!("{:.1} %", 100.0 * p.all.unfiltered),
                "2.3 m, 19.3 Hz".into(),
            ]);
        }
        let [soft, stiff] = [0, 1].map(|k: usize| self.pads[k].all.best_m());
        table.row(&[
            "difference".into(),
            format!("{:.1} %", 100.0 * (stiff / soft - 1.0).abs()),
            String::new(),
            String::new(),
            String::new(),
            String::new(),
            "< 1 %".into(),
        ]);
        table
    }

    fn ballasts(&self) -> Table {
        let mut table = Table::new(
            "The same for each ballast alone",
            "Best wavelength in metres and least misfit over the six geometries.",
            &["ballast", "soft pads", "misfit", "stiff pads", "misfit"],
        );
        for (k, panel) in panels::all().iter().enumerate() {
            let mut row = vec![panel.name.to_string()];
            for p in &self.pads {
                row.push(format!("{:.2}", p.per_ballast[k].best_m()));
                row.push(format!("{:.1} %", 100.0 * p.per_ballast[k].least()));
            }
            table.row(&row);
        }
        table
    }

    fn over_speed(&self) -> Table {
        let mut table = Table::new(
            "Best wavelength over speed",
            "All ballasts and geometries, metres. A wavelength that does not depend on speed would be a property of the track alone.",
            &["km/h", "soft pads", "stiff pads"],
        );
        for (km_h, [soft, stiff]) in &self.speeds {
            table.row(&[format!("{km_h:.0}"), format!("{soft:.2}"), format!("{stiff:.2}")]);
        }
        table
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::verification::tolerance;

    #[test]
    fn paper_wavelength_is_found_again() {
        for pads in [SOFT, STIFF] {
            let found = with_pads(pads, LOW_PASS_SPEED_M_S, &crate::progress::Silent).unwrap().all;
            let error = (found.best_m() / PAPER_WAVELENGTH_M - 1.0).abs();
            assert!(error < tolerance::LOW_PASS_WAVELENGTH, "{}: {} m", pads.name, found.best_m());
            assert!(found.least() < 0.5 * found.unfiltered);
        }
    }

    /// The running sum is the misfit of the filtered signals themselves.
    #[test]
    fn analytic_running_sum_is_the_misfit_of_the_filtered_signal() {
        let bell = |t: f64, w: f64| (-(t / w).powi(2)).exp();
        let level: Vec<f64> = (0..6000).map(|i| bell(1e-4 * f64::from(i) - 0.3, 0.04)).collect();
        let other: Vec<f64> = (0..6000)
            .map(|i| {
                let t = 1e-4 * f64::from(i) - 0.3;
                bell(t, 0.04) + 0.3 * bell(t, 0.01) * (300.0 * t).cos()
            })
            .collect();
        let spectra = Spectra::new(&[(level.clone(), 1e-4, 0.3), (other.clone(), 1e-4, 0.3)]);
        let misfit = Spectra::misfit(&[&spectra], 40.0);
        let k = misfit.best();
        let cut_off = misfit.cut_off_hz[k] + 0.5 * spectra.line_hz;
        let padded = |v: &[f64]| [v, &vec![0.0; PADDED - v.len()]].concat();
        let low = brick_band(&padded(&other), 1e4, 0.0, cut_off);
        let power = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>();
        let difference: Vec<f64> = low.iter().zip(&padded(&level)).map(|(a, b)| a - b).collect();
        let expected = (power(&difference) / power(&level)).sqrt();
        assert!((misfit.least() / expected - 1.0).abs() < 1e-6, "{} {expected}", misfit.least());
        assert!(misfit.least() < misfit.unfiltered);
        let [short, long] = misfit.flat_m();
        assert!(short <= misfit.best_m() && misfit.best_m() <= long);
    }
}
