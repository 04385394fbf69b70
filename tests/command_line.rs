//! The program as a user meets it: what it prints, leaves behind and answers to the shell.

use std::fs;
use std::path::{Path, PathBuf};

use cpcm::recording::{Format, Site, read_site, write_site};
use cpcm::results::read_forces;
use cpcm_tests::program::{cpcm, program, succeeds};
use cpcm_tests::sample::field;
use tempfile::TempDir;

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Code 1, all words on standard error, no panic.
fn fails(args: &[&str], words: &[&str]) {
    let run = cpcm(args);
    let error = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(1), "cpcm {args:?}: {error}");
    assert!(error.starts_with("error: ") || error.starts_with("warning: "), "{error}");
    assert!(!error.contains("panicked"), "{error}");
    for word in words {
        assert!(error.contains(word), "`{word}` is missing in: {error}");
    }
}

// --- demo -----------------------------------------------------------------------------------------------------

#[test]
fn property_demo_prints_the_peaks_and_leaves_a_report() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("new/demo");
    let printed = succeeds(&["demo", "--out", text(&out)]);
    let report = out.join("report.html");
    assert!(printed.ends_with(&format!("report: {}\n", report.display())), "{printed}");
    let rows = printed.lines().filter(|line| line.matches(" %").count() == 2 && line.contains('…')).count();
    assert_eq!(rows, 24 * 12, "a line for every wheelset");
    for word in ["condition ", "action ", "ballast ", "host: 288 peaks", "node: 288 peaks"] {
        assert!(printed.contains(word), "`{word}` is missing in: {printed}");
    }
    for name in ["report.html", "forces.parquet", "ballast.csv", "indicators.json", "kernel.bin", "peaks.txt"]
    {
        assert!(fs::metadata(out.join(name)).unwrap().len() > 100, "{name}");
    }
    assert!(fs::read_to_string(report).unwrap().trim_end().ends_with("</html>"));
    // What it unpacks is a site like any other.
    assert_eq!(read_site(&out.join("site")).unwrap().passages.len(), 24);
}

#[test]
fn property_demo_as_json() {
    let dir = tempfile::tempdir().unwrap();
    let printed = succeeds(&["demo", "--json", "--out", text(dir.path())]);
    let json: serde_json::Value = serde_json::from_str(&printed).unwrap();
    assert_eq!(json["peaks"].as_array().unwrap().len(), 24 * 12);
    for peak in json["peaks"].as_array().unwrap() {
        let [lower, value, upper] =
            ["host_lower_n", "host_n", "host_upper_n"].map(|k| peak[k].as_f64().unwrap());
        assert!(lower < value && value < upper, "{peak}");
        assert!(peak["node_n"].is_f64() && peak["truth_n"].is_f64(), "{peak}");
    }
    assert!(Path::new(json["report"].as_str().unwrap()).is_file());
}

#[test]
fn property_demo_into_a_file_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("occupied");
    fs::write(&file, "keep").unwrap();
    fails(&["demo", "--out", text(&file)], &["occupied"]);
    assert_eq!(fs::read_to_string(&file).unwrap(), "keep");
}

/// Recordings cannot be made again: `simulate` and `demo` replaced those of a real site without a word.
#[test]
fn regress_recordings_are_not_replaced() {
    let out = tempfile::tempdir().unwrap();
    let real = out.path().join("site");
    fs::create_dir(&real).unwrap();
    for name in ["crossing.toml", "passages.parquet"] {
        fs::copy(field("reference-2").join(name), real.join(name)).unwrap();
    }
    let before = fs::read(real.join("passages.parquet")).unwrap();
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/examples/site.toml");
    fails(&["simulate", text(&example), "--out", text(&real)], &["already holds passages.parquet"]);
    fails(&["demo", "--out", text(out.path())], &["already holds another crossing.toml"]);
    assert_eq!(fs::read(real.join("passages.parquet")).unwrap(), before);
    // Nor do results take work that cannot be written.
    let nowhere = real.join("passages.parquet/out");
    for command in ["analyse", "diagnose"] {
        fails(&[command, text(&field("reference-1")), "--out", text(&nowhere)], &["is a file"]);
    }
    fails(&["kernel", text(&field("reference-1")), "--out", text(&nowhere)], &["is a file"]);
}

// --- wrong usage ----------------------------------------------------------------------------------------------

#[test]
fn property_wrong_usage_is_code_2_and_help_is_code_0() {
    for args in [
        &["demo", "--no-such"][..],
        &["kernel", "site"],
        &["analyse", "site", "--out", "results", "--take", "load-transfer"],
        &["analyse", "site", "--out", "results", "--tolerances", "tolerances.toml"],
        &["node"],
        &["node", "download", "--baud", "x"],
        &["node", "simulate", "site", "--kernel", "kernel.bin", "--out", "records", "--listen", "nonsense"],
        &["diagnose", "site", "--out", "diagnosis", "--exclude", "gremlins"],
        &[],
    ] {
        assert_eq!(cpcm(args).status.code(), Some(2), "{args:?}");
    }
    for args in [&["--help"][..], &["--version"], &["demo", "--help"], &["node", "simulate", "--help"]] {
        assert!(!succeeds(args).is_empty(), "{args:?}");
    }
}

// --- bad input ------------------------------------------------------------------------------------------------

/// Four passages of a field site, and a way to spoil them.
fn site(change: impl FnOnce(&mut Site)) -> (TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let mut site = read_site(&field("reference-2")).unwrap();
    site.passages.truncate(4);
    change(&mut site);
    let path = dir.path().join("site");
    write_site(&path, &site, Format::Parquet).unwrap();
    (dir, path)
}

/// `analyse` and `kernel` both refuse the site with these words and write nothing.
fn refused(dir: &Path, site: &Path, words: &[&str]) {
    for command in ["analyse", "kernel"] {
        let out = dir.join(command);
        fails(&[command, text(site), "--out", text(&out)], words);
        assert!(!out.exists(), "{command} leaves nothing behind");
    }
}

#[test]
fn property_missing_site() {
    let dir = tempfile::tempdir().unwrap();
    refused(dir.path(), &dir.path().join("nowhere"), &["nowhere"]);
}

#[test]
fn property_unknown_design() {
    let (dir, site) = site(|_| {});
    let file = site.join("crossing.toml");
    let toml = fs::read_to_string(&file).unwrap();
    let spoilt: Vec<String> = toml
        .lines()
        .map(|line| if line.starts_with("design") { "design = \"UIC99\"".into() } else { line.to_string() })
        .collect();
    fs::write(&file, spoilt.join("\n")).unwrap();
    refused(dir.path(), &site, &["crossing.toml", "design", "UIC99"]);
}

#[test]
fn property_truncated_parquet() {
    let (dir, site) = site(|_| {});
    let file = site.join("passages.parquet");
    let bytes = fs::read(&file).unwrap();
    fs::write(&file, &bytes[..bytes.len() / 2]).unwrap();
    refused(dir.path(), &site, &["passages.parquet"]);
}

#[test]
fn property_no_passages() {
    let (dir, site) = site(|site| site.passages.clear());
    refused(dir.path(), &site, &["passages.parquet"]);
}

#[test]
fn property_all_passages_bad() {
    let (dir, site) = site(|site| site.passages.iter_mut().for_each(|p| p.acceleration_m_s2[100] = f32::NAN));
    refused(dir.path(), &site, &["passages.parquet"]);
}

/// The tolerances that were followed lie beside what follows of them; those that cannot be followed leave nothing behind.
#[test]
fn property_tolerances_are_followed_or_refused() {
    let (dir, site) = site(|_| {});
    let (file, out) = (dir.path().join("mine.toml"), dir.path().join("out"));
    let flag = format!("--tolerances={}", text(&file));
    let args = ["analyse", text(&site), "--out", text(&out), &flag];
    fails(&args, &["cannot read the tolerances", "mine.toml"]);
    for (stated, words) in [
        ("[sensor]\ny_mm = 50\n", &["mine.toml", "`sensor.y_mm`"][..]),
        ("[sensor]\ny_m = 50\n", &["`sensor.y_m` = 2.3", "unit of the entry"]),
        ("[sensor]\ny_m = \"some\"\n", &["mine.toml", "`sensor.y_m` = \"some\""]),
    ] {
        fs::write(&file, stated).unwrap();
        fails(&args, words);
        assert!(!out.exists(), "{stated}");
    }
    fs::write(&file, "[sensor]\ny_m = 0.05\n").unwrap();
    let printed = succeeds(&args);
    for word in ["tolerances    what crossing.toml may be wrong by alone", "force peak ±", "sensor.y_m (±"]
    {
        assert!(printed.contains(word), "`{word}` is missing in: {printed}");
    }
    assert_eq!(fs::read_to_string(out.join("tolerances.toml")).unwrap(), "[sensor]\ny_m = 0.05\n");
    let table = || fs::read_to_string(out.join("tolerances.csv")).unwrap();
    assert_eq!(table().lines().count(), 3);
    // Those in the directory are taken where none are named.
    fs::write(out.join("tolerances.toml"), "[sensor]\ny_m = 0.02\n").unwrap();
    succeeds(&["analyse", text(&site), "--out", text(&out), "--tolerances"]);
    assert!(table().contains("sensor.y_m,2.3,0.02,"), "{}", table());
}

/// One bad passage costs that passage, not the site.
#[test]
fn property_bad_passage_is_left_out_and_named() {
    let (dir, site) = site(|site| site.passages[2].acceleration_m_s2[5000] = f32::NAN);
    let out = dir.path().join("out");
    let run = cpcm(&["analyse", text(&site), "--out", text(&out)]);
    let error = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(0), "{error}");
    assert!(error.contains("warning: passage 2 is left out"), "{error}");
    let rows = read_forces(&out.join("forces.parquet")).unwrap();
    assert_eq!(rows.len(), 3 * 12);
    assert!(rows.iter().all(|row| row.passage_id != 2));
    let json: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(out.join("indicators.json")).unwrap()).unwrap();
    assert_eq!(json["passages"]["used"], 3);
    assert!(
        fs::read_to_string(out.join("report.html")).unwrap().contains("NaN"),
        "the report gives the reason"
    );
}

/// A recording without a train in it, as a sensor with a wrong trigger makes.
#[test]
fn property_passage_without_a_train_is_left_out_and_named() {
    let (dir, site) = site(|site| {
        let recording = &mut site.passages[1].acceleration_m_s2;
        let quiet: Vec<f32> = recording[..1000].to_vec();
        recording.iter_mut().enumerate().for_each(|(i, a)| *a = quiet[i % 1000]);
    });
    let out = dir.path().join("out");
    let run = cpcm(&["analyse", text(&site), "--out", text(&out)]);
    let error = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(0), "{error}");
    assert!(error.contains("warning: passage 1 is left out"), "{error}");
}

// --- blind-trial ----------------------------------------------------------------------------------------------

/// One trial without an effect, as a run leaves it that took it for one: every run calls this site rightly `no-gap`.
fn trials(version: &str) -> String {
    let score = r#""answer": {"question": "nothing", "effects": [], "parameters": [], "strength": 0.0, "alone": []},
        "strength_to_floor": 0.0, "weaker_to_floor": 0.0, "verdict": "unexplained", "named": [], "first_group": [],
        "probability": 0.0, "right": false, "covered": null, "interval": null, "closed_fraction": 0.0"#;
    format!(r#"[{{"seed": 3, "trial": 0, "version": "{version}", {score}}}]"#)
}

#[test]
fn property_resumed_trials_take_over_what_is_there() {
    let dir = tempfile::tempdir().unwrap();
    let checksum = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&fs::read(program()).unwrap());
    let build = format!("{}-{checksum:08x}", env!("CARGO_PKG_VERSION"));
    fs::write(dir.path().join("trials.json"), trials(&build)).unwrap();
    let args = ["blind-trial", "--seed", "3", "--trials", "1", "--resume", "--out", text(dir.path())];
    let printed = succeeds(&args);
    let quiet = printed.lines().find(|l| l.starts_with("no effect: no-gap")).unwrap();
    assert!(quiet.contains("0 of    1"), "{quiet}");
}

#[test]
fn property_trials_do_not_replace_the_scores_of_a_run() {
    let dir = tempfile::tempdir().unwrap();
    let before = trials("0.1.0");
    fs::write(dir.path().join("trials.json"), &before).unwrap();
    for which in [["--only", "0"], ["--trials", "2"]] {
        let args = ["blind-trial", "--seed", "3", which[0], which[1], "--out", text(dir.path())];
        fails(&args, &["trials.json", "choose another --out"]);
    }
    assert_eq!(fs::read_to_string(dir.path().join("trials.json")).unwrap(), before);
}

#[test]
fn property_damaged_trials_are_not_resumed() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("trials.json"), &trials("0.1.0")[..40]).unwrap();
    fails(
        &["blind-trial", "--seed", "3", "--trials", "1", "--resume", "--out", text(dir.path())],
        &["trials.json", "choose another --out"],
    );
}

#[test]
fn property_effects_that_a_diagnosis_does_not_offer_are_refused_before_any_work() {
    let out = tempfile::tempdir().unwrap();
    let (file, site, at) = (out.path().join("diagnosis.json"), field("reference-1"), out.path().join("out"));
    let analyse = |more: &[&str], words: &[&str]| {
        let args = ["analyse", text(&site), "--out", text(&at)];
        fails(&[&args[..], more].concat(), words);
        assert!(!at.exists(), "nothing is written");
    };
    let with = ["--with-effects", text(&file)];
    analyse(&with, &["diagnosis.json"]);
    fs::write(&file, r#"{"effects": [{"name": "axle-load", "parameters": {"factor": {"value": 1.1}}, "alternatives": [{}]}]}"#)
        .unwrap();
    analyse(&with, &["diagnosis.json", "not a diagnosis.json", "no name"]);
    let effects = r#"{"site": "GN 649", "effects": [{"name": "axle-load", "parameters": {"factor": {"value": 1.1}},
        "alternatives": [{"name": "load-transfer", "parameters": {"fraction": {"value": 1.5}}}]}]}"#;
    fs::write(&file, effects).unwrap();
    analyse(&[with[0], with[1], "--take", "pads"], &["does not offer pads", "axle-load or load-transfer"]);
    // It was taken without a word.
    analyse(
        &[with[0], with[1], "--take", "load-transfer"],
        &["is the diagnosis of GN 649, not of GN 648", "load-transfer", "fraction is 1.5", "-0.9 … 0.9"],
    );
}

#[test]
fn property_poor_hammer_hits_are_refused_before_any_work() {
    let out = tempfile::tempdir().unwrap();
    let beam = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/hammer-beam");
    let diagnose = |files: &[&Path], words: &[&str]| {
        let (site, at) = (field("reference-1"), out.path().join("diagnosis"));
        let mut args = vec!["diagnose", text(&site), "--out", text(&at)];
        files.iter().for_each(|f| args.extend(["--hammer", text(f)]));
        fails(&args, words);
        assert!(!at.exists(), "nothing is written");
    };
    diagnose(&[&beam.join("camera.csv")], &["hammer's hits", "1 hit", "at least 2"]);
    diagnose(&[&out.path().join("none.csv")], &["none.csv"]);
    let table = out.path().join("h.csv");
    fs::write(&table, "frequency_hz,real_m_n,imaginary_m_n,coherence\n50,1e-9\n").unwrap();
    diagnose(&[&table], &["h.csv", "line 2", "coherence"]);
    // Metres per kilonewton; an analyser that has nothing to say.
    for (value, words) in [
        ("1e-5", ["times that of the track", "must be in N"]),
        ("0", ["hammer's hits", "zero or no number on 100 %"]),
    ] {
        let rows: String = (20..=250).map(|f| format!("{f},{value},0,0.98\n")).collect();
        fs::write(&table, format!("frequency_hz,real_m_n,imaginary_m_n,coherence\n{rows}")).unwrap();
        diagnose(&[&table], &words);
    }
    let universal = out.path().join("h.uff");
    fs::write(&universal, "    -1\n    58\n").unwrap();
    diagnose(&[&universal], &["h.uff", "end (-1)"]);
}
