//! The files of `analyse`: names, types and values as outside tools rely on them.

use std::path::Path;

use cpcm::analysis::{Analysis, Budget, Change, Consequence, Drawn, Outcome, Tolerance};
use cpcm::report::html;
use cpcm::results::{ResultsError, read_forces, summary_json, write_results};
use cpcm::signal::HALF_WIDTH_90;
use cpcm::tolerances::said;
use cpcm_tests::rows;
use cpcm_tests::sample::sample_analysis;
use tempfile::TempDir;

fn written() -> (TempDir, Analysis) {
    let dir = tempfile::tempdir().unwrap();
    let analysis = sample_analysis();
    write_results(&dir.path().join("new/results"), &analysis).unwrap();
    (dir, analysis)
}

#[test]
fn reference_schema_of_forces() {
    let (dir, analysis) = written();
    let file = dir.path().join("new/results/forces.parquet");
    let list = |item: &str| format!("(LIST) {{ REPEATED group list {{ OPTIONAL {item}; }} }}");
    let numbers = |name: &str| format!("OPTIONAL group {name} {}", list("DOUBLE element"));
    let number = |name: &str| format!("OPTIONAL DOUBLE {name};");
    let fields = [
        "OPTIONAL INT32 passage_id;".to_string(),
        "OPTIONAL INT32 wheelset;".to_string(),
        number("speed_m_s"),
        numbers("position_m"),
        numbers("contact_force_n"),
        numbers("lower_n"),
        numbers("upper_n"),
        number("peak_force_n"),
        number("peak_position_m"),
        number("peak_lower_n"),
        number("peak_upper_n"),
        numbers("irregularity_m"),
        number("irregularity_rms_m"),
        format!("OPTIONAL group flags {}", list("BYTE_ARRAY element (STRING)")),
    ];
    assert_eq!(rows::schema(&file), format!("message schema {{ {} }}", fields.join(" ")));
    let rows = rows::read(&file).len();
    assert_eq!(rows, analysis.passages.iter().map(|p| p.wheelsets.len()).sum::<usize>());
}

#[test]
fn regress_values_of_forces_are_the_same_bits() {
    let (dir, analysis) = written();
    let file = dir.path().join("new/results/forces.parquet");
    let rows = read_forces(&file).unwrap();
    let p = &analysis.passages[1];
    let (row, w) = (&rows[p.wheelsets.len() + 3], &p.wheelsets[3]);
    assert_eq!((row.passage_id, row.wheelset, row.speed_m_s), (p.passage_id, w.wheelset, p.speed_m_s));
    assert_eq!(row.position_m, w.position_m);
    assert_eq!(row.contact_force_n, w.contact_force_n);
    assert_eq!((&row.lower_n, &row.upper_n), (&w.lower_n, &w.upper_n));
    assert_eq!(row.peak_force_n, w.peak_force_n.value);
    assert_eq!((row.peak_lower_n, row.peak_upper_n), (w.peak_force_n.lower, w.peak_force_n.upper));
    assert_eq!(row.peak_position_m, w.peak_position_m);
    assert_eq!((&row.irregularity_m, row.irregularity_rms_m), (&w.irregularity_m, w.irregularity_rms_m));
    assert_eq!(row.flags, w.flags);
    // The same through the columns, as another program reads them.
    let first = &rows::read(&file)[0];
    assert_eq!(first.number("passage_id"), f64::from(analysis.passages[0].passage_id));
    let peak = analysis.passages[0].wheelsets[0].peak_force_n.value;
    assert_eq!(first.number("peak_force_n"), peak);
}

/// Rows of a file of numbers, with this header.
fn numbers_of(dir: &TempDir, name: &str, header: &str) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(dir.path().join("new/results").join(name)).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some(header));
    lines.map(|l| l.split(',').map(|c| c.parse().unwrap()).collect()).collect()
}

#[test]
fn reference_ballast_csv() {
    let (dir, analysis) = written();
    let rows = numbers_of(&dir, "ballast.csv", "sleeper,stiffness_n_m2,lower_n_m2,upper_n_m2");
    assert_eq!(rows.len(), analysis.crossing.track.n_sleepers);
    let crossing = &rows[30];
    let k = analysis.ballast.stiffness_n_m2[30];
    assert_eq!(k.value, 18e6);
    assert_eq!(crossing, &[30.0, k.value, k.lower, k.upper]);
}

#[test]
fn reference_indicators_json() {
    let (dir, analysis) = written();
    let results = dir.path().join("new/results");
    let json: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(results.join("indicators.json")).unwrap()).unwrap();
    assert_eq!(json["condition"], "watch");
    assert_eq!(json["urgency"], analysis.indicators.urgency.as_str());
    assert_eq!(json["recommended_action"], analysis.indicators.recommended_action.as_str());
    assert_eq!(json["peak_force_n"]["mean"], analysis.indicators.peak_force_n.mean);
    for (name, spread) in [
        ("peak_force_n", analysis.indicators.peak_force_n),
        ("irregularity_rms_m", analysis.indicators.irregularity_rms_m),
    ] {
        assert_eq!(json[name]["mean90"], serde_json::json!(spread.mean90));
    }
    assert_eq!(json["irregularity_rms_m"]["range80"][1], analysis.indicators.irregularity_rms_m.p90);
    assert_eq!(json["passages"]["used"], 24);
    // The file that the modes refer to exists and has the column.
    let mode = &json["peak_force_n"]["first_svd_mode"];
    let modes = std::fs::read_to_string(results.join(mode["file"].as_str().unwrap())).unwrap();
    assert!(modes.lines().next().unwrap().split(',').any(|c| c == mode["column"]));
    assert_eq!(modes.lines().count(), 1 + analysis.indicators.position_m.len());
}

#[test]
fn reference_mean_irregularity_csv() {
    let (dir, analysis) = written();
    let rows = numbers_of(&dir, "mean_irregularity.csv", "position_m,irregularity_m,lower_m,upper_m");
    let i = &analysis.indicators;
    assert_eq!(rows.len(), i.position_m.len());
    for (row, (x, z)) in rows.iter().zip(i.position_m.iter().zip(&i.mean_irregularity_m)) {
        assert!((row[0] - x).abs() < 1e-6);
        assert_eq!(row[1..], [z.value, z.lower, z.upper]);
    }
}

/// Passages that the model does not explain were counted as used, though no number is of them.
#[test]
fn regress_passages_left_out_are_not_said_to_be_used() {
    let mut analysis = sample_analysis();
    analysis.passages[3].wheelsets[0].flags.push("unlike-model".into());
    let read: serde_json::Value = serde_json::from_str(&summary_json(&analysis)).unwrap();
    let passages = &read["passages"];
    assert_eq!(passages["used"], 23);
    assert_eq!(passages["left_out"], serde_json::json!([analysis.passages[3].passage_id]));
    let others = analysis.passages.iter().enumerate().filter(|(i, _)| *i != 3);
    assert_eq!(passages["wheelsets"], others.map(|(_, p)| p.wheelsets.len()).sum::<usize>());
}

#[test]
fn property_results_of_corrected_recordings_say_so() {
    let mut analysis = sample_analysis();
    let page = |a: &Analysis| html(a).unwrap();
    assert!(!page(&analysis).contains("included") && !summary_json(&analysis).contains("effects_included"));
    analysis.effects_included = vec!["load-transfer (fraction 0.12)".into()];
    let read: serde_json::Value = serde_json::from_str(&summary_json(&analysis)).unwrap();
    assert_eq!(read["effects_included"][0], "load-transfer (fraction 0.12)");
    assert!(page(&analysis).contains("Effects of a diagnosis included: load-transfer (fraction 0.12)."));
}

#[test]
fn regress_results_are_reproducible_and_leave_nothing_else() {
    let (first, analysis) = written();
    let second = tempfile::tempdir().unwrap();
    write_results(second.path(), &analysis).unwrap();
    let mut names: Vec<_> = std::fs::read_dir(second.path())
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    let expected = [
        "ballast.csv",
        "forces.parquet",
        "indicators.json",
        "mean_irregularity.csv",
        "modes.csv",
        "report.html",
    ];
    assert_eq!(names, expected);
    for name in names {
        let read = |dir: &Path| std::fs::read(dir.join(&name)).unwrap();
        assert_eq!(read(&first.path().join("new/results")), read(second.path()), "{name}");
    }
}

#[test]
fn regress_file_in_place_of_the_directory_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("results");
    std::fs::write(&file, "keep").unwrap();
    let error = write_results(&file, &sample_analysis()).unwrap_err();
    assert!(error.to_string().contains("is a file"), "{error}");
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "keep");
}

#[test]
fn regress_vectors_of_different_length_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let mut analysis = sample_analysis();
    analysis.passages[2].wheelsets[1].upper_n.pop();
    let error = write_results(dir.path(), &analysis).unwrap_err();
    assert!(matches!(error, ResultsError::Ragged { passage_id: 2, wheelset: 1, column: "upper_n", .. }));
    assert!(!dir.path().join("forces.parquet").exists());
}

/// Two entries: one whose error goes unnoticed, and one that is noticed, of which half is not, in the one direction.
fn budget() -> Budget {
    let change = |force_peak| Change { force_peak, irregularity_rms: 0.02, p1: -0.1, p2: 0.05 };
    let silent = |by, c| Outcome { by, change: Some(change(c)), noticed: None };
    let sensor = Consequence {
        tolerance: Tolerance { entry: "sensor.y_m".into(), value: 2.5, plus_minus: 0.125 },
        smaller: silent(-0.125, -0.03),
        larger: silent(0.125, 0.03),
    };
    let damping = Consequence {
        tolerance: Tolerance { entry: "ballast.damping_ns_m2".into(), value: 125e3, plus_minus: 50e3 },
        smaller: Outcome { noticed: Some("damping 132, instead".into()), ..silent(-25e3, -0.04) },
        larger: Outcome { by: 0.0, change: None, noticed: Some("model-gap".into()) },
    };
    let drawn = Drawn {
        count: 12,
        unnoticed: [-0.05, 0.05].repeat(5).into_iter().map(change).collect(),
        noticed: Vec::new(),
    };
    Budget::new(vec![sensor, damping], Some(drawn), "[sensor]\ny_m = 0.125\n")
}

#[test]
fn reference_tolerances() {
    let dir = tempfile::tempdir().unwrap();
    let mut analysis = sample_analysis();
    analysis.budget = Some(budget());
    write_results(dir.path(), &analysis).unwrap();
    let text = |name: &str| std::fs::read_to_string(dir.path().join(name)).unwrap();
    assert_eq!(text("tolerances.toml"), "[sensor]\ny_m = 0.125\n");
    let expected = "entry,value,plus_minus,changed_to,force_peak,irregularity_rms,p1,p2,noticed\n\
        ballast.damping_ns_m2,125000,50000,100000,-0.04,0.02,-0.1,0.05,\"damping 132, instead\"\n\
        ballast.damping_ns_m2,125000,50000,125000,,,,,model-gap\n\
        sensor.y_m,2.5,0.125,2.375,-0.03,0.02,-0.1,0.05,\n\
        sensor.y_m,2.5,0.125,2.625,0.03,0.02,-0.1,0.05,\n";
    assert_eq!(text("tolerances.csv"), expected);
    let json: serde_json::Value = serde_json::from_str(&text("indicators.json")).unwrap();
    let stated = &json["tolerances"];
    assert_eq!(stated["file"], "tolerances.csv");
    assert_eq!((&stated["drawn"], &stated["unnoticed"]), (&12.into(), &10.into()));
    assert!((stated["plus_minus"]["peak_force"].as_f64().unwrap() - 0.05 * HALF_WIDTH_90).abs() < 1e-12);
    let mean = json["peak_force_n"]["mean"].as_f64().unwrap();
    let [lower, upper] = [0, 1].map(|k| stated["peak_force_mean90_n"][k].as_f64().unwrap());
    assert!(lower <= 0.95 * mean && upper >= 1.05 * mean, "{lower} {mean} {upper}");
    let page = text("report.html");
    for word in ["If crossing.toml is wrong", "sensor.y_m", "2.5 ± 0.125", "damping 132, instead"] {
        assert!(page.contains(word), "{word}");
    }
}

/// One passage that the model does not explain on the site as described hid whatever a wrong description did.
#[test]
fn regress_notices_are_of_what_is_not_said_already() {
    let known = sample_analysis();
    let flagged = |passages: usize, flag: &str| {
        let mut analysis = known.clone();
        for wheelset in analysis.passages[..passages].iter_mut().flat_map(|p| &mut p.wheelsets) {
            wheelset.flags.push(flag.into());
        }
        analysis
    };
    let one = flagged(1, "unlike-model");
    let of = known.passages.len();
    assert_eq!(said(&known, &known), None);
    assert_eq!(said(&one, &one), None);
    assert_eq!(said(&one, &known), None);
    assert_eq!(said(&known, &one), Some(format!("unlike-model (1 of {of} passages)")));
    assert_eq!(said(&one, &flagged(3, "unlike-model")), Some(format!("unlike-model (3 of {of} passages)")));
    assert_eq!(said(&one, &flagged(2, "model-gap")), Some(format!("model-gap (2 of {of} passages)")));
}

/// A table of an earlier analysis with tolerances would pass for one of these results; tolerances that are there stay: the user may have
/// changed them.
#[test]
fn regress_a_table_of_tolerances_is_of_these_results() {
    let dir = tempfile::tempdir().unwrap();
    let mut analysis = sample_analysis();
    let (table, stated) = (dir.path().join("tolerances.csv"), dir.path().join("tolerances.toml"));
    std::fs::write(&stated, "changed").unwrap();
    for with in [Some(budget()), None] {
        analysis.budget = with;
        write_results(dir.path(), &analysis).unwrap();
        assert_eq!(table.exists(), analysis.budget.is_some());
        assert_eq!(std::fs::read_to_string(&stated).unwrap(), "changed");
    }
    let page = std::fs::read_to_string(dir.path().join("report.html")).unwrap();
    assert!(!page.contains("If crossing.toml is wrong") && !summary_json(&analysis).contains("tolerances"));
}
