//! The diagnosis on field recordings: contract of its files, what it may know, the model behind it, a hammer beside it.

use std::path::{Path, PathBuf};
use std::process::Command;

use cpcm::ballast::BallastParameters;
use cpcm::gap::base::{Given, base, nominal_world};
use cpcm::gap::diagnosis::{DiagnoseOptions, PATH_PRIOR, diagnose};
use cpcm::gap::effects::COMMON;
use cpcm::gap::fit::{FitOptions, fit, replaced};
use cpcm::gap::forward::Detail;
use cpcm::gap::hammer::{Hammer, modelled};
use cpcm::gap::included::read_effects;
use cpcm::gap::receptance::read_receptance;
use cpcm::gap::results::{diagnosis_json, write_diagnosis};
use cpcm::gap::split::split;
use cpcm::gap::trial::{Panels, draw};
use cpcm::gap::verdict::Verdict;
use cpcm::progress::Silent;
use cpcm::recording::{Format, Site, read_site, write_site};
use cpcm_tests::diagnosed::{all_but, assert_sound, field, full, quick, recorded, small, trial};
use cpcm_tests::rows;
use cpcm_tests::tolerance;

/// Root of the mean of the two squared RMS ratios of a column against the measured one, straight from the file.
fn gap_from_file(file: &Path, model: &str) -> f64 {
    let (mut left, mut all) = ([0.0; 2], [0.0; 2]);
    for row in rows::read(file) {
        for (q, unit) in ["m_s2", "m"].iter().enumerate() {
            let list = |name: &str| row.numbers(&format!("{name}_{unit}"));
            for (m, p) in list("measured").iter().zip(list(model)) {
                left[q] += (m - p).powi(2);
                all[q] += m * m;
            }
        }
    }
    (0.5 * (left[0] / all[0] + left[1] / all[1])).sqrt()
}

/// The effect, its strength (pads three times as stiff) and the parts of the contract, on recordings of another program.
#[test]
fn reference_known_pads_are_named_and_the_numbers_can_be_recomputed() {
    let found = diagnose(&field("known-pad-stiffness"), &DiagnoseOptions::default(), &Silent).unwrap();
    assert_eq!(found.verdict, Verdict::Explained);
    assert_eq!(found.effects[0].name, "pad-stiffness");
    let (name, value, lower, upper) = found.effects[0].parameters[0];
    assert!(name == "factor" && lower <= 3.0 && 3.0 <= upper, "{lower} {upper}");
    assert!(found.gap.closed_fraction >= 0.7);
    let out = tempfile::tempdir().unwrap();
    write_diagnosis(out.path(), "site", &found).unwrap();
    let (read, _) = read_effects(&out.path().join("diagnosis.json")).unwrap();
    let factor = read[0].effect.value("factor", [0.0, f64::INFINITY]).unwrap();
    assert_eq!((read.len(), read[0].effect.name.as_str()), (found.effects.len(), "pad-stiffness"));
    assert!((factor / value - 1.0).abs() < tolerance::THROUGH_JSON, "{factor} {value}");
    let json = diagnosis_json("site", &found);
    let file = out.path().join("predictions.parquet");
    let (before, after) = (gap_from_file(&file, "before"), gap_from_file(&file, "after"));
    let number = |key: &str| json["gap"][key].as_f64().unwrap();
    assert!((before / number("before") - 1.0).abs() < tolerance::GAP_RECOMPUTED);
    assert!((after / number("after") - 1.0).abs() < tolerance::GAP_RECOMPUTED);
    let closed = (before - after) / (before - number("noise_floor"));
    assert!((closed - number("closed_fraction")).abs() < tolerance::CLOSED_FRACTION);
    assert!(out.path().join("diagnosis.html").is_file());
    recompute_with_python(out.path());
}

/// The vendored script agrees.
fn recompute_with_python(diagnosis: &Path) {
    let python = std::env::var("CPCM_PYTHON").unwrap_or("python3".into());
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../bench/closed_fraction.py");
    let run = Command::new(&python).args([script.as_os_str(), diagnosis.as_os_str()]).output();
    let run = run.unwrap_or_else(|e| panic!("{python}, which test.sh looks for and installs: {e}"));
    let said = [run.stdout, run.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).concat();
    assert!(
        run.status.success(),
        "{said}\n(numpy and pyarrow: `{python} -m pip install numpy pyarrow`, as test.sh does)"
    );
}

#[test]
fn reference_recordings_without_effect_have_no_gap() {
    assert_sound("reference-2");
}

/// Corrupted truth beside the recordings, other names and one core instead of several do not move a single digit of a full
/// diagnosis.
#[test]
fn property_nothing_but_the_recordings_matters() {
    let mut site = small("known-load-transfer", 6);
    let diagnosed = |site: &Site| diagnosis_json("site", &full(site));
    let one = diagnosed(&site);
    assert_eq!(one["effects"][0]["name"], "load-transfer");
    site.crossing.name = "another".into();
    let dir = tempfile::tempdir().unwrap();
    let place: PathBuf = dir.path().join("effect-is-void");
    write_site(&place, &site, Format::Csv).unwrap();
    std::fs::write(place.join("truth.toml"), "effects = [\"voided_sleepers\"]\n[[[").unwrap();
    std::fs::write(place.join("truth.parquet"), "garbage").unwrap();
    let one_core = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let other = one_core.install(|| diagnosed(&read_site(&place).unwrap()));
    assert_eq!(one, other);
}

/// Shuffled passages change rounding errors only.
#[test]
fn property_order_of_the_passages_does_not_matter() {
    let mut site = small("known-wheel-out-of-roundness", 6);
    let one = diagnosis_json("site", &quick(&site).unwrap());
    site.passages.reverse();
    let other = diagnosis_json("site", &quick(&site).unwrap());
    // Sums are taken in another order.
    let gap = |d: &serde_json::Value| d["gap"]["before"].as_f64().unwrap();
    assert!((gap(&one) / gap(&other) - 1.0).abs() < tolerance::SUM_ORDER, "{} {}", gap(&one), gap(&other));
    assert_eq!(one["verdict"], other["verdict"]);
}

/// Receptance of a track with its pads changed, as a table that an analyser might export.
fn hammer(site: &Site, ballast: BallastParameters, pads: f64) -> Hammer {
    let mut world = nominal_world(site, ballast).unwrap();
    world.crossing.pad.stiffness_n_m *= pads;
    let frequency_hz: Vec<f64> = (10..=260).map(f64::from).collect();
    let rows: String = modelled(&world, &frequency_hz, SENSOR_X_M)
        .unwrap()
        .iter()
        .zip(&frequency_hz)
        .map(|(r, f)| format!("{f},{:e},{:e},0.98\n", r.re, r.im))
        .collect();
    let file = tempfile::Builder::new().suffix(".csv").tempfile().unwrap();
    std::fs::write(file.path(), format!("frequency_hz,real_m_n,imaginary_m_n,coherence\n{rows}")).unwrap();
    Hammer::new(&read_receptance(&[file.path().into()], 250.0).unwrap(), SENSOR_X_M).unwrap()
}

/// Nobody measures the damping of a bed: of 0.7 times the true one a dip of the stock rail was made (probability 0.93), of 1.4 times
/// something that nothing explains.
#[test]
fn regress_damping_that_is_described_wrong_is_no_effect() {
    for factor in [0.7, 1.4] {
        let mut site = field("reference-1");
        site.crossing.ballast.damping_ns_m2 *= factor;
        let found = full(&site);
        assert_eq!(found.verdict, Verdict::NoGap, "{factor}: {:?}", found.remarks);
        assert!(
            found.remarks.iter().any(|r| r.contains("damping of the ballast")),
            "{factor}: {:?}",
            found.remarks
        );
    }
}

/// True ballast of two field sites.
const REFERENCE_1: BallastParameters = BallastParameters::stiffness([30e6, 18e6, 0.35]);

const KNOWN_PADS: BallastParameters = BallastParameters::stiffness([32e6, 36e6, 0.3]);

/// Place of the sensor's sleeper at the field sites, metres.
const SENSOR_X_M: f64 = 0.3;

#[test]
fn property_a_hammer_says_whether_the_track_is_as_modelled() {
    let site = small("reference-1", 8);
    let say = |pads: f64| {
        let hammer = Some(hammer(&site, REFERENCE_1, pads));
        let options = DiagnoseOptions { quick: true, hammer, ..DiagnoseOptions::default() };
        let found = diagnose(&site, &options, &Silent).unwrap();
        found.remarks.into_iter().find(|r| r.starts_with("hammer")).unwrap()
    };
    let (sound, worn) = (say(1.0), say(0.02));
    assert!(sound.contains("are as modelled"), "{sound}");
    assert!(worn.contains("is not as modelled"), "{worn}");
}

/// Recordings that speak for pads three times as stiff: a hammer that felt them agrees, one that felt the nominal ones
/// overrules.
#[test]
fn property_a_hammer_weighs_the_candidates() {
    let site = small("known-pad-stiffness", 6);
    let say = |pads: f64| {
        let hammer = Some(hammer(&site, KNOWN_PADS, pads));
        let exclude = all_but(&["pad-stiffness", "unsprung-mass"]);
        diagnose(&site, &DiagnoseOptions { hammer, exclude, ..DiagnoseOptions::default() }, &Silent).unwrap()
    };
    let (agrees, differs) = (say(3.0), say(1.0));
    assert_eq!(agrees.effects[0].name, "pad-stiffness");
    assert!(agrees.remarks.iter().any(|r| r.contains("account for it")), "{:?}", agrees.remarks);
    assert!(differs.effects.iter().all(|e| e.name != "pad-stiffness"), "{:?}", differs.effects);
}

/// Wheels that meet the crossing 1 cm apart have the mean of a blurred path, which passed for pads of 0.63 of their stiffness
/// on this simulated site without any effect.
#[test]
fn regress_shifted_wheels_do_not_pass_for_soft_pads() {
    let scenario = trial(301, 5, &[]);
    let site = recorded(&scenario);
    let train = split(&site).train;
    let base = base(&site, &train, &train, &PATH_PRIOR, &Given::default()).unwrap();
    let pads = *COMMON.iter().find(|e| e.name() == "pad-stiffness").unwrap();
    let mut start = base.fit.state.clone();
    start.effects = vec![pads.nought().unwrap()];
    let found = fit(&base.frame, &[pads], start, &train, FitOptions::THOROUGH).unwrap();
    let (pads, gain) = (found.state.effects[0][0], found.log_evidence - base.fit.log_evidence);
    println!("pads: ln k = {pads:.3}, gain {gain:.1} nats; wheels {:?}", base.variation);
    assert!(pads.abs() < tolerance::PADS_OF_NOTHING, "ln k = {pads:.3}");
    assert!(gain < tolerance::GAIN_OF_NOTHING, "{gain:.1} nats");
    let shift = base.variation.shift_m / scenario.simulation.wheels.shift_m;
    assert!((shift - 1.0).abs() < tolerance::SHIFT, "shift {shift:.2} of what was drawn");
}

/// Where wheels are alike, the model differs from the simulator of the trials (finer mesh, shorter step, damped integrator,
/// whole trains over the whole track, roughness) by little.
#[test]
fn property_alike_wheels_leave_next_to_nothing() {
    let mut scenario = trial(301, 5, &[]);
    scenario.simulation.passages = 6;
    let wheels = &mut scenario.simulation.wheels;
    (wheels.load, wheels.side_load, wheels.depth, wheels.shift_m) = (0.0, 0.0, 0.0, 0.0);
    let site = recorded(&scenario);
    let all: Vec<usize> = (0..site.passages.len()).collect();
    let base = base(&site, &all, &all, &PATH_PRIOR, &Given::default()).unwrap();
    let state = &base.fit.state;
    let responses = cpcm::gap::fit::simulate(&state.world(&base.frame, &[]), &base.frame, &all).unwrap();
    let (mut left, mut signal) = (0.0, 0.0);
    for (i, response) in responses.iter().enumerate() {
        let o = &base.frame.observed[i];
        let predicted = o.predicted_mean(response, 1.0, state.shift_m[i] / o.speed_m_s);
        left += o.mean.iter().zip(&predicted).map(|(m, p)| (m - p).powi(2)).sum::<f64>();
        signal += o.mean.iter().map(|m| m * m).sum::<f64>();
    }
    let left = f64::sqrt(left / signal);
    println!("alike wheels: {:.2} % of the signal left", 100.0 * left);
    assert!(left < tolerance::ALIKE_WHEELS, "{left:.4}");
}

/// What a trial hands to the diagnosis holds no trace of its answer.
#[test]
fn property_a_trial_hands_over_the_site_only() {
    let work = tempfile::tempdir().unwrap();
    let trial = draw(Panels::Nominal, 5, 7, work.path()).unwrap();
    let effects = trial.answer.effects;
    assert_eq!(effects.len(), 2);
    let place = work.path().join("site");
    write_site(&place, &trial.site, Format::Parquet).unwrap();
    let mut files: Vec<String> =
        std::fs::read_dir(&place).unwrap().map(|f| f.unwrap().file_name().into_string().unwrap()).collect();
    files.sort();
    assert_eq!(files, ["crossing.toml", "irregularity.csv", "passages.parquet"]);
    for file in files {
        let text = String::from_utf8_lossy(&std::fs::read(place.join(&file)).unwrap()).into_owned();
        assert!(
            !effects.iter().any(|e| text.contains(e.as_str())) && !text.contains("[simulation"),
            "{file}"
        );
    }
}

#[test]
fn property_a_passage_a_wave_off_is_found_again() {
    let site = small("reference-2", 4);
    let all: Vec<usize> = (0..site.passages.len()).collect();
    let base = base(&site, &all, &all, &PATH_PRIOR, &Given::default()).unwrap();
    let there = base.fit.state.shift_m.clone();
    for off_m in [-0.2, 0.2] {
        let mut state = base.fit.state.clone();
        state.shift_m[1] += off_m;
        let again = replaced(&base.frame, &[], state, (&all, Detail::Full));
        for (a, b) in again.shift_m.iter().zip(&there) {
            assert!((a - b).abs() < tolerance::FOUND_AGAIN_M, "{a} {b}");
        }
    }
}
