//! A site with the effects of a diagnosis taken into account: what the identification then starts from.
//!
//! Corrections go into the inputs: description (pads, rail, masses, loads) and recordings (sensitivity, clock, mounting,
//! interference, clipping, beds that are not linear). The identification itself stays as it is: linear, with the three-parameter
//! ballast (times known factors). An effect that does not fit in there is refused; leaving it out silently
//! would promise a correction that is none.

use super::GapError;
use super::base::Form;
use super::effect::Effect;
use super::effects::{forms, in_form, inclusion};
use super::equivalent::{Departure, on_linear_bed};
use super::included::{How, Included, OutOfRange};
use super::steady::without_steps;
use crate::progress::Progress;
use crate::recording::Site;

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
    #[error(transparent)]
    Size(#[from] OutOfRange),
}

impl Included {
    /// Whether the recordings have to be made those of a linear bed.
    pub fn bends_the_bed(&self) -> bool {
        inclusion(&self.name).is_some_and(|i| matches!(i.how, How::Linearised(..)))
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
    let how = |effect: &Included| {
        let unknown = || effect.refused("it is not in the catalogue of this version");
        Ok::<_, CorrectionError>(inclusion(&effect.name).ok_or_else(unknown)?.how)
    };
    for effect in effects {
        if let How::Added(by) = how(effect)? {
            of_recordings(by, &mut out, effect, purpose)?;
        }
    }
    for effect in effects {
        match how(effect)? {
            How::Needless | How::Added(_) => {}
            How::Corrected(by) => by(&mut out, effect)?,
            How::Recorded(by) => of_recordings(by, &mut out, effect, purpose)?,
            How::Linearised(parameter, range) => {
                departures.push(departure(effect, (parameter, range), purpose)?);
            }
            How::Steadied => steps = Some(effect),
            How::Refused(why) => return Err(effect.refused(why)),
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

/// Corrects recordings, but for a kernel: the node's own are like the uncorrected ones.
fn of_recordings(
    by: fn(&mut Site, &Included) -> Result<(), OutOfRange>,
    site: &mut Site,
    effect: &Included,
    purpose: Purpose,
) -> Result<(), CorrectionError> {
    if purpose == Purpose::Kernel {
        return Err(effect.refused(
            "the node's own recordings have it, which nobody corrects; mend it, record again, and make the kernel then",
        ));
    }
    Ok(by(site, effect)?)
}

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

/// An effect by which the bed is not linear: its forms, and where the fit of each begins.
fn departure(
    effect: &Included,
    (parameter, range): (&'static str, [f64; 2]),
    purpose: Purpose,
) -> Result<Departure, CorrectionError> {
    if purpose == Purpose::Kernel {
        return Err(
            effect.refused("the node's kernel is linear; tamp, record again, and make the kernel then")
        );
    }
    let main = effect.value(parameter, range)?;
    let form = |form: &'static dyn Effect| (form, in_form(form, &[form.parameters()[0].coordinate(main)]));
    Ok(forms(&effect.name).into_iter().map(form).collect())
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::effects::names;
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
        assert!(matches!(one_sided, Err(CorrectionError::Size(_))));
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
        let [tonal, clock] =
            [effect("tonal", &[("frequency_hz", 40.0)]), effect("clock-error", &[("relative", 0.02)])];
        // The frequency is that of the recorder's clock, whatever is named first.
        for effects in [vec![tonal.clone()], vec![tonal.clone(), clock.clone()], vec![clock, tonal]] {
            let out = corrected(&tone, &effects).unwrap();
            let left: Vec<f64> = out.passages[0].acceleration_m_s2.iter().map(|v| f64::from(*v)).collect();
            assert!(crate::signal::rms(&left) < 0.03, "{}", crate::signal::rms(&left));
        }
    }

    /// Kernels were made of recordings without what the node's own have: force peaks were 33 % too high, or the node found no train.
    #[test]
    fn regress_a_kernel_of_recordings_that_a_node_does_not_have_is_refused() {
        for (name, parameters) in [
            ("clock-error", &[("relative", 0.02)][..]),
            ("tonal", &[("frequency_hz", 40.0)]),
            ("mount-resonance", &[("frequency_hz", 250.0), ("damping_ratio", 0.1)]),
        ] {
            let error =
                super::corrected(&site(), &[effect(name, parameters)], Purpose::Kernel, &Silent).unwrap_err();
            assert!(
                error.to_string().contains(name) && error.to_string().contains("the node's own"),
                "{error}"
            );
        }
    }

    #[test]
    fn property_effects_that_are_included_are_in_the_catalogue() {
        let names: Vec<&str> = names().collect();
        let does = |name: &str| inclusion(name).and_then(|i| i.does);
        let told: Vec<&&str> = names.iter().filter(|name| does(name).is_some()).collect();
        // Wheels and the stock rail need no inclusion; what a mount does above its resonance is lost.
        assert_eq!(names.len() - told.len(), 6, "{told:?}");
        assert!(told.iter().all(|name| does(name).is_some_and(|does| does.ends_with('.'))));
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
        assert!(matches!(error, CorrectionError::Size(OutOfRange { value, .. }) if value == 1.5), "{error}");
        let error = corrected(&site(), &[effect("voided-sleepers", &[])]).unwrap_err();
        assert!(
            matches!(error, CorrectionError::Size(OutOfRange { value, .. }) if value.is_nan()),
            "{error}"
        );
        let error = corrected(&site(), &[effect("pad-stiffness", &[("factor", -1.0)])]).unwrap_err();
        assert!(matches!(error, CorrectionError::Size(OutOfRange { value, .. }) if value == -1.0), "{error}");
    }
}
