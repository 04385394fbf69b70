//! A site with the effects of a diagnosis taken into account: what the identification then starts from.
//!
//! Corrections go into the inputs: description (pads, rail, masses, loads) and recordings (sensitivity, clock, mounting,
//! interference, clipping, beds that are not linear). The identification itself stays as it is: linear, with the three-parameter
//! ballast (times known factors). An effect that does not fit in there is refused; leaving it out silently
//! would promise a correction that is none.

use super::GapError;
use super::base::Form;
use super::data::QUIET_S;
use super::effect::Effect;
use super::effects::{forms, in_form, support_loss};
use super::equivalent::{Departure, on_linear_bed};
use super::included::Included;
use super::steady::without_steps;
use super::world::REFERENCE_C;
use crate::progress::Progress;
use crate::recording::{Passage, Site};
use crate::signal::{filtered, resample};

/// Why a site cannot be corrected.
#[derive(Debug, thiserror::Error)]
pub enum CorrectionError {
    /// The identification has no place for an effect.
    #[error("effect {effect} cannot be included in the identification: {why}")]
    NotApplicable {
        /// Name in the contract.
        effect: String,
        /// Reason.
        why: &'static str,
    },
    /// There is no model by which something could be taken off the recordings.
    #[error("what is to be taken off the recordings cannot be modelled")]
    Model(#[from] GapError),
    /// An effect without its strength, or with one outside physics.
    #[error("effect {effect}: {parameter} is {value}, expected {low} … {high}")]
    Parameter {
        /// Name in the contract.
        effect: String,
        /// Name of the parameter.
        parameter: &'static str,
        /// As read; NaN where it is missing.
        value: f64,
        /// Ends of the range.
        low: f64,
        /// Ends of the range.
        high: f64,
    },
}

impl Included {
    fn value(&self, parameter: &'static str, [low, high]: [f64; 2]) -> Result<f64, CorrectionError> {
        let value = self.parameters.iter().find(|(n, _)| n == parameter).map_or(f64::NAN, |p| p.1);
        if value >= low && value <= high {
            return Ok(value);
        }
        Err(CorrectionError::Parameter { effect: self.name.clone(), parameter, value, low, high })
    }

    /// Whether the recordings have to be made those of a linear bed.
    pub fn bends_the_bed(&self) -> bool {
        self.bend().is_some()
    }

    fn bend(&self) -> Option<&'static Bend> {
        BENDS.iter().find(|bend| bend.effect == self.name)
    }

    fn refused(&self, why: &'static str) -> CorrectionError {
        CorrectionError::NotApplicable { effect: self.name.clone(), why }
    }
}

/// What a corrected site is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Forces, irregularity and ballast from its recordings.
    Analysis,
    /// A kernel that the node applies to what its sensor shows, which nobody corrects.
    Kernel,
}

/// The site with all `effects` in it.
pub fn corrected(
    site: &Site,
    effects: &[Included],
    purpose: Purpose,
    progress: &dyn Progress,
) -> Result<Site, CorrectionError> {
    let mut out = site.clone();
    let (mut departures, mut steps) = (Vec::new(), None);
    for effect in effects {
        match departure(effect, purpose)? {
            Some(departure) => departures.push(departure),
            None if effect.name == BIAS_STEP => steps = Some(effect),
            None => include(&mut out, effect)?,
        }
    }
    // Last: they take a model of everything else.
    if let Some(effect) = steps {
        let found = steady(&out, effect, purpose, &departures, progress)?;
        out =
            found.ok_or_else(|| effect.refused("no steps of the baseline are found in these recordings"))?;
    }
    if departures.is_empty() { Ok(out) } else { Ok(on_linear_bed(&out, &departures, progress)?) }
}

/// What including an effect does, for whoever wants forces before it is mended; nothing for effects that need not be included.
pub fn what_including_does(effect: &str) -> Option<&'static str> {
    Some(match effect {
        "pad-stiffness" => "Forces: `--with-effects` uses the stiffness found.",
        "crossing-rail" => "Forces: `--with-effects` uses the rail found.",
        "axle-load" => "Forces: `--with-effects` uses the load found.",
        "unsprung-mass" => "Forces: `--with-effects` uses the mass found.",
        "ballast-mass" => "Forces: `--with-effects` includes the mass.",
        "support-loss" => "Forces: `--with-effects` uses the supports found.",
        "load-transfer" => "Forces: `--with-effects` uses the transfer found.",
        "clock-error" => "Forces: `--with-effects` takes the error out of the recordings.",
        "gain-temperature" => "Until then `--with-effects` takes the change out of the recordings.",
        "tonal" => "Until then `--with-effects` takes it out of the recordings.",
        "saturation" => "`--with-effects` leaves clipped recordings out while enough others stay.",
        "voided-sleepers" | "ballast-stiffening" => {
            "Forces: `analyse --with-effects` takes what the bed adds off the recordings."
        }
        BIAS_STEP => "Forces and displacements: `analyse --with-effects` takes the steps off the recordings.",
        _ => return None,
    })
}

/// Steps of the baseline, whose sizes are found in each recording.
const BIAS_STEP: &str = "bias-step";

/// The site without the steps of its baseline; `None` where there are none.
fn steady(
    site: &Site,
    effect: &Included,
    purpose: Purpose,
    departures: &[Departure],
    progress: &dyn Progress,
) -> Result<Option<Site>, CorrectionError> {
    effect.value("step_m_s2", [1e-3, 1e4])?;
    effect.value("decay_s", [1e-3, 60.0])?;
    if purpose == Purpose::Kernel {
        return Err(effect.refused(
            "the node meets the steps itself; mend the sensor's mounting, record again, and make the kernel then",
        ));
    }
    // The first form of a bed that is not linear will do for what is slow.
    let forms: Vec<Form> = departures.iter().filter_map(|forms| forms.first().cloned()).collect();
    Ok(without_steps(site, &forms, progress)?)
}

/// An effect by which the bed is not linear, with its main parameter and what that may be.
struct Bend {
    effect: &'static str,
    parameter: &'static str,
    range: [f64; 2],
}

const BENDS: [Bend; 2] = [
    Bend { effect: "voided-sleepers", parameter: "gap_m", range: [1e-5, 0.1] },
    Bend { effect: "ballast-stiffening", parameter: "doubling_m", range: [1e-5, 10.0] },
];

/// An effect by which the bed is not linear: its forms, and where the fit of each begins.
fn departure(effect: &Included, purpose: Purpose) -> Result<Option<Departure>, CorrectionError> {
    let Some(Bend { parameter, range, .. }) = effect.bend() else { return Ok(None) };
    if purpose == Purpose::Kernel {
        return Err(
            effect.refused("the node's kernel is linear; tamp, record again, and make the kernel then")
        );
    }
    let main = effect.value(parameter, *range)?;
    let form = |form: &'static dyn Effect| (form, in_form(form, &[form.parameters()[0].coordinate(main)]));
    Ok(Some(forms(&effect.name).into_iter().map(form).collect()))
}

/// A factor on a stiffness, mass or load.
const FACTOR: [f64; 2] = [0.05, 20.0];
/// A share of the load moved to the other rail; wheels stay on both.
const TRANSFER: [f64; 2] = [-0.9, 0.9];

fn include(site: &mut Site, effect: &Included) -> Result<(), CorrectionError> {
    let crossing = &mut site.crossing;
    match effect.name.as_str() {
        "pad-stiffness" => crossing.pad.stiffness_n_m *= effect.value("factor", FACTOR)?,
        "crossing-rail" => {
            crossing.rail.crossing_part_stiffness_factor *= effect.value("stiffness_factor", FACTOR)?;
            crossing.rail.crossing_part_mass_factor *= effect.value("mass_factor", FACTOR)?;
        }
        "axle-load" => {
            let factor = effect.value("factor", FACTOR)?;
            crossing.vehicle.axle_load_kg *= factor;
            site.passages.iter_mut().for_each(|p| p.axle_load_kg *= factor);
        }
        "unsprung-mass" => {
            let factor = effect.value("factor", FACTOR)?;
            crossing.vehicle.wheelset_mass_kg *= factor;
            crossing.vehicle.wheelset_roll_inertia_kg_m2 *= factor;
        }
        "ballast-mass" => {
            // It moves with the sleeper and adds nothing to its stiffness.
            let s = &mut crossing.sleeper;
            s.density_kg_m3 += effect.value("mass_kg_m", [0.0, 2000.0])? / (s.width_m * s.height_m);
        }
        "gain-temperature" => {
            let per_kelvin = effect.value("per_kelvin", [-0.02, 0.02])?;
            for p in &mut site.passages {
                let gain = 1.0 + per_kelvin * (p.temperature_c - REFERENCE_C);
                p.acceleration_m_s2.iter_mut().for_each(|a| *a = (f64::from(*a) / gain) as f32);
            }
        }
        "clock-error" => {
            let relative = effect.value("relative", [-0.1, 0.1])?;
            site.passages.iter_mut().for_each(|p| to_true_time(p, relative));
        }
        "mount-resonance" => {
            let frequency_hz = effect.value("frequency_hz", [20.0, 5000.0])?;
            let damping = effect.value("damping_ratio", [1e-3, 2.0])?;
            site.passages.iter_mut().for_each(|p| without_mount(p, frequency_hz, damping));
        }
        "tonal" => {
            let frequency_hz = effect.value("frequency_hz", [1.0, 2000.0])?;
            site.passages.iter_mut().for_each(|p| without_tone(p, frequency_hz));
        }
        "saturation" => leave_out_clipped(site, effect.value("range_m_s2", [1.0, 1e4])?),
        // The identification estimates every wheel's force and both rails' profiles anyway.
        "front-rear" | "wheel-out-of-roundness" | "wheel-flat" | "hollow-wheels" | "stock-irregularity" => {}
        "support-loss" => {
            let sides =
                [effect.value("factor_negative_x", FACTOR)?, effect.value("factor_positive_x", FACTOR)?];
            crossing.ballast.support_factor = support_loss::factors(sides);
        }
        "load-transfer" => crossing.track.load_transfer = effect.value("fraction", TRANSFER)?,
        _ => return Err(effect.refused("it is not in the catalogue of this version")),
    }
    Ok(())
}

/// Samples were taken (1 + relative) times as fast as stated; the same recording at the stated rate.
fn to_true_time(passage: &mut Passage, relative: f64) {
    let samples: Vec<f64> = passage.acceleration_m_s2.iter().map(|a| f64::from(*a)).collect();
    let len = (samples.len() as f64 / (1.0 + relative)).round().max(1.0) as usize;
    passage.acceleration_m_s2 = resample(&samples, len).iter().map(|a| *a as f32).collect();
}

/// Takes the amplification by the mounting back; its inverse is bounded, so nothing blows up.
fn without_mount(passage: &mut Passage, frequency_hz: f64, damping: f64) {
    let samples: Vec<f64> = passage.acceleration_m_s2.iter().map(|a| f64::from(*a)).collect();
    let restored = filtered(&samples, passage.sample_rate_hz, |f| {
        // Far above the resonance the mounting isolates; what is there is left as it is.
        let s = (f / frequency_hz).min(3.0);
        let damped = faer::c64::new(0.0, 2.0 * damping * s);
        (damped + (1.0 - s * s)) / (damped + 1.0)
    });
    passage.acceleration_m_s2 = restored.iter().map(|a| *a as f32).collect();
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

/// Passages that must stay for an identification.
const LEAST_PASSAGES: usize = 3;
/// Clipped samples that a recording may have: the corner of one wheel.
const FEW_SAMPLES: usize = 4;

/// Clipping cannot be undone: clipped recordings are left out while enough others stay, and marked otherwise.
fn leave_out_clipped(site: &mut Site, range_m_s2: f64) {
    let clipped = |p: &Passage| {
        let at_end = |a: &&f32| f64::from(a.abs()) >= 0.97 * range_m_s2;
        p.acceleration_m_s2.iter().filter(at_end).count() > FEW_SAMPLES
    };
    let sound = site.passages.iter().filter(|p| !clipped(p)).count();
    site.crossing.sensor.range_m_s2 = site.crossing.sensor.range_m_s2.min(range_m_s2);
    if sound >= LEAST_PASSAGES {
        site.passages.retain(|p| !clipped(p));
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::effects::{COMMON, LATENT};
    use super::*;
    use crate::ballast::BallastParameters;
    use crate::progress::Silent;
    use crate::recording::read_site;
    use crate::track::{Mesh, Track};

    fn site() -> Site {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/field/reference-1");
        let mut site = read_site(&dir).unwrap();
        site.passages.truncate(1);
        site
    }

    fn corrected(site: &Site, effects: &[Included]) -> Result<Site, CorrectionError> {
        super::corrected(site, effects, Purpose::Analysis, &Silent)
    }

    fn effect(name: &str, parameters: &[(&str, f64)]) -> Included {
        Included {
            name: name.into(),
            parameters: parameters.iter().map(|(n, v)| ((*n).to_string(), *v)).collect(),
        }
    }

    fn sine(site: &mut Site, f_hz: f64) {
        let rate = site.passages[0].sample_rate_hz;
        let value = |k: usize| (std::f64::consts::TAU * f_hz * k as f64 / rate).sin();
        let n = site.passages[0].acceleration_m_s2.len();
        site.passages[0].acceleration_m_s2 = (0..n).map(|k| value(k) as f32).collect();
    }

    #[test]
    fn analytic_gain_and_masses() {
        let mut site = site();
        site.passages[0].temperature_c = 30.0;
        let all = [
            effect("gain-temperature", &[("per_kelvin", 0.01)]),
            effect("ballast-mass", &[("mass_kg_m", 61.6)]),
            effect("pad-stiffness", &[("factor", 2.0)]),
        ];
        let out = corrected(&site, &all).unwrap();
        let (a, b) = (site.passages[0].acceleration_m_s2[5000], out.passages[0].acceleration_m_s2[5000]);
        assert!((f64::from(a) / f64::from(b) - 1.1).abs() < 1e-5);
        // 0.28 m x 0.22 m: 61.6 kg/m are 1000 kg/m³.
        let density = |s: &Site| s.crossing.sleeper.density_kg_m3;
        assert!((density(&out) - density(&site) - 1000.0).abs() < 1e-6);
        assert_eq!(out.crossing.pad.stiffness_n_m, 2.0 * site.crossing.pad.stiffness_n_m);
    }

    #[test]
    fn analytic_transferred_load_is_on_the_track_that_everything_uses() {
        let out = corrected(&site(), &[effect("load-transfer", &[("fraction", 0.25)])]).unwrap();
        let track = Track::of_crossing(&out.crossing, Mesh::default());
        assert_eq!(track.load_factor, [1.25, 0.75]);
        // What the file says stays: the transfer is no part of it.
        assert_eq!(toml::to_string(&out.crossing).unwrap(), toml::to_string(&site().crossing).unwrap());
    }

    #[test]
    fn analytic_lost_support_is_in_the_bed_that_everything_uses() {
        let lost = [effect("support-loss", &[("factor_negative_x", 0.5), ("factor_positive_x", 1.0)])];
        let out = corrected(&site(), &lost).unwrap();
        let track = Track::of_crossing(&out.crossing, Mesh::default());
        let bed = BallastParameters::NOMINAL.bed(&track);
        let at = |offset: i64| bed[(track.sensor_sleeper as i64 + offset) as usize] / 30e6;
        assert_eq!([-7, -6, -3, -2, 3, 6].map(at), [1.0, 0.5, 0.5, 1.0, 1.0, 1.0]);
        let one_sided = corrected(&site(), &[effect("support-loss", &[("factor_negative_x", 0.5)])]);
        assert!(matches!(one_sided, Err(CorrectionError::Parameter { .. })));
    }

    /// A fast clock stretches the recording; 50 Hz were recorded as 50/1.02 Hz by the stated rate.
    #[test]
    fn analytic_clock_mount_and_tone() {
        let mut clock = site();
        sine(&mut clock, 50.0 / 1.02);
        let out = corrected(&clock, &[effect("clock-error", &[("relative", 0.02)])]).unwrap();
        let (n, rate) = (out.passages[0].acceleration_m_s2.len(), 4000.0);
        for k in n / 4..n / 2 {
            let expected = (std::f64::consts::TAU * 50.0 * k as f64 / rate).sin();
            assert!((f64::from(out.passages[0].acceleration_m_s2[k]) - expected).abs() < 0.05, "{k}");
        }
        let mut mount = site();
        sine(&mut mount, 100.0);
        let list = [effect("mount-resonance", &[("frequency_hz", 300.0), ("damping_ratio", 0.05)])];
        let out = corrected(&mount, &list).unwrap();
        let s: f64 = 1.0 / 3.0;
        let gain = ((1.0 - s * s).powi(2) + (0.1 * s).powi(2)).sqrt() / (1.0 + (0.1 * s).powi(2)).sqrt();
        let part: Vec<f64> =
            out.passages[0].acceleration_m_s2[3000..7000].iter().map(|v| f64::from(*v)).collect();
        assert!((crate::signal::rms(&part) * 2f64.sqrt() / gain - 1.0).abs() < 0.01);
        let mut tone = site();
        sine(&mut tone, 40.0);
        let out = corrected(&tone, &[effect("tonal", &[("frequency_hz", 40.0)])]).unwrap();
        let left: Vec<f64> = out.passages[0].acceleration_m_s2.iter().map(|v| f64::from(*v)).collect();
        assert!(crate::signal::rms(&left) < 0.03);
    }

    #[test]
    fn property_effects_that_are_included_are_in_the_catalogue() {
        let names: Vec<&str> =
            COMMON.iter().map(|e| e.name()).chain(LATENT.iter().map(|e| e.name())).collect();
        let told: Vec<&&str> = names.iter().filter(|name| what_including_does(name).is_some()).collect();
        // Wheels and the stock rail need no inclusion; what a mount does above its resonance is lost.
        assert_eq!(names.len() - told.len(), 6, "{told:?}");
        assert!(told.iter().all(|name| what_including_does(name).is_some_and(|does| does.ends_with('.'))));
    }

    #[test]
    fn property_what_does_not_fit_is_refused_with_its_name() {
        let voids = [effect("voided-sleepers", &[("gap_m", 1e-3)])];
        let error = super::corrected(&site(), &voids, Purpose::Kernel, &Silent).unwrap_err();
        assert!(error.to_string().contains("voided-sleepers"), "{error}");
        let steps = [effect("bias-step", &[("step_m_s2", 0.5), ("decay_s", 0.4)])];
        let error = super::corrected(&site(), &steps, Purpose::Kernel, &Silent).unwrap_err();
        assert!(error.to_string().contains("mend the sensor's mounting"), "{error}");
        let error = corrected(&site(), &steps).unwrap_err();
        assert!(error.to_string().contains("no steps of the baseline are found"), "{error}");
        let error = corrected(&site(), &[effect("load-transfer", &[("fraction", 1.5)])]).unwrap_err();
        assert!(matches!(error, CorrectionError::Parameter { value, .. } if value == 1.5), "{error}");
        let error = corrected(&site(), &[effect("voided-sleepers", &[])]).unwrap_err();
        assert!(matches!(error, CorrectionError::Parameter { value, .. } if value.is_nan()), "{error}");
        let error = corrected(&site(), &[effect("pad-stiffness", &[("factor", -1.0)])]).unwrap_err();
        assert!(matches!(error, CorrectionError::Parameter { value, .. } if value == -1.0), "{error}");
    }
}
