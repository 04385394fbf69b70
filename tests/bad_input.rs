//! Bad site directories: one clear error or one listed passage each, never a panic.
//!
//! Every case starts from a sound site of three passages, spoils one thing, reads it through the library and,
//! for the exit code and the message, through the program.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use cpcm::recording::table::{Column, write_columns};
use cpcm::recording::{Format, Passage, RecordingError, Site, read_site, write_site};
use cpcm_tests::program::cpcm;
use cpcm_tests::sample::field;
use tempfile::TempDir;

/// A sound site of three passages in a directory of its own.
fn sound(format: Format) -> (TempDir, Site) {
    let dir = tempfile::tempdir().unwrap();
    let mut site = read_site(&field("reference-2")).unwrap();
    site.passages.truncate(3);
    write_site(dir.path(), &site, format).unwrap();
    (dir, site)
}

/// Rewrites a text file of the site.
fn edit(dir: &Path, file: &str, change: impl FnOnce(String) -> String) {
    let path = dir.join(file);
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(path, change(text)).unwrap();
}

/// Rewrites the passages of a Parquet site.
fn spoil(dir: &Path, site: &Site, change: impl FnOnce(&mut Site)) {
    let mut site = site.clone();
    change(&mut site);
    write_site(dir, &site, Format::Parquet).unwrap();
}

/// The program must fail with code 1, all words on standard error, and no panic.
fn program_refuses(dir: &Path, words: &[&str]) {
    let out = tempfile::tempdir().unwrap();
    let out_dir = out.path().join("out");
    let run = cpcm(&["convert", dir.to_str().unwrap(), out_dir.to_str().unwrap()]);
    let text = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(1), "{text}");
    assert!(text.starts_with("error: "), "{text}");
    assert!(!text.contains("panicked"), "{text}");
    for word in words {
        assert!(text.contains(word), "`{word}` is missing in: {text}");
    }
    assert!(!out_dir.exists(), "nothing is written after an error");
}

/// The whole site is refused, by library and program, with all these words.
fn site_refused(dir: &Path, words: &[&str]) -> RecordingError {
    let error = read_site(dir).map(|_| ()).unwrap_err();
    let text = error.to_string();
    for word in words {
        assert!(text.contains(word), "`{word}` is missing in: {text}");
    }
    program_refuses(dir, words);
    error
}

/// Passage `row` is skipped with all these words; the other two stay, and the program says so and succeeds.
fn passage_skipped(dir: &Path, row: usize, words: &[&str]) {
    let site = read_site(dir).unwrap();
    assert_eq!((site.passages.len(), site.skipped.len()), (2, 1), "{:?}", site.skipped);
    let skipped = &site.skipped[0];
    assert_eq!(skipped.row, row);
    for word in words.iter().chain(&[format!("row {row}").as_str()]) {
        assert!(skipped.reason.contains(word), "`{word}` is missing in: {}", skipped.reason);
    }
    let out = tempfile::tempdir().unwrap();
    let run = cpcm(&[
        "convert",
        dir.to_str().unwrap(),
        out.path().join("out").to_str().unwrap(),
        "--to",
        "parquet",
    ]);
    assert_eq!(run.status.code(), Some(0));
    assert!(String::from_utf8_lossy(&run.stderr).contains(&skipped.reason));
}

/// One wrong value in passage 1.
fn value_skipped(change: impl FnOnce(&mut Passage), words: &[&str]) {
    let (dir, site) = sound(Format::Parquet);
    spoil(dir.path(), &site, |s| change(&mut s.passages[1]));
    passage_skipped(dir.path(), 1, words);
}

fn parquet_file(dir: &Path) -> PathBuf {
    dir.join("passages.parquet")
}

/// Columns of a Parquet site, to be spoiled one by one.
fn columns(site: &Site) -> Vec<(&'static str, Column<'_>)> {
    let p = &site.passages;
    let number = |value: fn(&Passage) -> Option<f64>| Column::Numbers(p.iter().map(value).collect());
    let samples = p.iter().map(|p| Some(Cow::Borrowed(p.acceleration_m_s2.as_slice())));
    vec![
        ("passage_id", Column::Integers(p.iter().map(|p| Some(p.passage_id)).collect())),
        ("train_type", Column::Texts(p.iter().map(|p| p.train_type.as_str()).collect())),
        ("axle_load_kg", number(|p| Some(p.axle_load_kg))),
        ("speed_m_s", number(|p| p.speed_m_s)),
        ("temperature_c", number(|p| Some(p.temperature_c))),
        ("sample_rate_hz", number(|p| Some(p.sample_rate_hz))),
        ("acceleration_m_s2", Column::SingleLists(samples.collect())),
    ]
}

/// Replaces one column of a sound site.
fn with_column(name: &'static str, column: Column) -> TempDir {
    let (dir, site) = sound(Format::Parquet);
    let mut all = columns(&site);
    all.iter_mut().find(|c| c.0 == name).unwrap().1 = column;
    write_columns(&parquet_file(dir.path()), &all).unwrap();
    drop(all);
    dir
}

// --- The whole site -------------------------------------------------------------------------------------------

#[test]
fn missing_directory() {
    site_refused(Path::new("/no/such/site"), &["/no/such/site", "check the path"]);
}

#[test]
fn directory_without_crossing_toml() {
    let dir = tempfile::tempdir().unwrap();
    site_refused(dir.path(), &["crossing.toml is missing"]);
}

#[test]
fn directory_without_recordings() {
    let (dir, _) = sound(Format::Parquet);
    std::fs::remove_file(parquet_file(dir.path())).unwrap();
    site_refused(dir.path(), &["passages.parquet is missing"]);
}

#[test]
fn both_formats_at_once() {
    let (dir, _) = sound(Format::Parquet);
    std::fs::write(dir.path().join("passages.csv"), "").unwrap();
    site_refused(dir.path(), &["both passages.parquet and passages.csv"]);
}

#[test]
fn toml_syntax() {
    let (dir, _) = sound(Format::Parquet);
    edit(dir.path(), "crossing.toml", |t| t.replace("[rail]", "[rail"));
    site_refused(dir.path(), &["crossing.toml", "not valid TOML", "line"]);
}

#[test]
fn toml_that_is_not_text() {
    let (dir, _) = sound(Format::Parquet);
    std::fs::write(dir.path().join("crossing.toml"), [0xff, 0xfe, 0x00, 0x80]).unwrap();
    site_refused(dir.path(), &["crossing.toml", "not valid TOML"]);
}

#[test]
fn unknown_design() {
    let (dir, _) = sound(Format::Parquet);
    edit(dir.path(), "crossing.toml", |t| t.replace("\"60E\"", "\"BWG\""));
    site_refused(dir.path(), &["crossing.toml", "`design`", "BWG", "UIC60"]);
}

#[test]
fn missing_key() {
    let (dir, _) = sound(Format::Parquet);
    edit(dir.path(), "crossing.toml", |t| t.replace("area_m2 = ", "area_cm2 = "));
    site_refused(dir.path(), &["crossing.toml", "rail", "area_m2"]);
}

#[test]
fn key_with_the_wrong_type() {
    let (dir, _) = sound(Format::Parquet);
    edit(dir.path(), "crossing.toml", |t| t.replace("poisson = 0.3", "poisson = \"0.3\""));
    site_refused(dir.path(), &["crossing.toml", "rail.poisson", "string"]);
}

#[test]
fn key_in_the_wrong_unit() {
    let (dir, _) = sound(Format::Parquet);
    edit(dir.path(), "crossing.toml", |t| {
        t.replace("youngs_modulus_pa = 210000000000.0", "youngs_modulus_pa = 210.0")
    });
    site_refused(dir.path(), &["crossing.toml", "rail.youngs_modulus_pa", "210", "Pa"]);
}

/// Impacts fold into the band of the forces: nothing of such a recorder is analysed.
#[test]
fn recorder_below_the_least_rate() {
    let (dir, _) = sound(Format::Parquet);
    edit(dir.path(), "crossing.toml", |t| t.replace("sample_rate_hz = 4000.0", "sample_rate_hz = 1599.0"));
    site_refused(dir.path(), &["crossing.toml", "sensor.sample_rate_hz", "= 1599 ", "1600", "Hz"]);
}

#[test]
fn key_that_is_not_a_number() {
    let (dir, _) = sound(Format::Parquet);
    edit(dir.path(), "crossing.toml", |t| t.replace("height_m = 0.22", "height_m = nan"));
    site_refused(dir.path(), &["crossing.toml", "sleeper.height_m", "NaN"]);
}

#[test]
fn format_of_the_future() {
    let (dir, _) = sound(Format::Parquet);
    edit(dir.path(), "crossing.toml", |t| t.replace("format_version = 1", "format_version = 2"));
    site_refused(dir.path(), &["format_version", "version 2"]);
}

#[test]
fn upward_sign_convention() {
    let (dir, _) = sound(Format::Parquet);
    edit(dir.path(), "crossing.toml", |t| t.replace("positive downwards", "positive upwards"));
    site_refused(dir.path(), &["sign_convention", "positive upwards"]);
}

#[test]
fn sensor_off_the_sleeper() {
    let (dir, _) = sound(Format::Parquet);
    edit(dir.path(), "crossing.toml", |t| t.replace("y_m = 2.3", "y_m = 3.8"));
    site_refused(dir.path(), &["sensor.y_m", "3.8"]);
}

/// `truth.*` beside the recordings changes nothing, whatever it holds.
#[test]
fn truth_is_never_read() {
    let (dir, site) = sound(Format::Parquet);
    std::fs::write(dir.path().join("truth.parquet"), "garbage").unwrap();
    std::fs::create_dir(dir.path().join("truth.toml")).unwrap();
    let read = read_site(dir.path()).unwrap();
    assert_eq!((read.passages, read.crossing), (site.passages, site.crossing));
}

// --- The Parquet file -----------------------------------------------------------------------------------------

#[test]
fn missing_column() {
    let (dir, site) = sound(Format::Parquet);
    let mut all = columns(&site);
    all.retain(|c| c.0 != "temperature_c");
    write_columns(&parquet_file(dir.path()), &all).unwrap();
    let error = site_refused(dir.path(), &["passages.parquet", "temperature_c", "missing"]);
    assert!(matches!(error, RecordingError::MissingColumn { column: "temperature_c", .. }));
}

#[test]
fn wrong_column_type() {
    let dir = with_column("acceleration_m_s2", Column::Texts(vec!["1", "2", "3"]));
    let error =
        site_refused(dir.path(), &["passages.parquet", "acceleration_m_s2", "string", "list<float32>"]);
    assert!(matches!(error, RecordingError::ColumnType { column: "acceleration_m_s2", .. }));
}

#[test]
fn zero_rows() {
    let (dir, site) = sound(Format::Parquet);
    spoil(dir.path(), &site, |s| s.passages.clear());
    let error = site_refused(dir.path(), &["passages.parquet", "no rows"]);
    assert!(matches!(error, RecordingError::NoRows { .. }));
}

#[test]
fn truncated_parquet() {
    let (dir, _) = sound(Format::Parquet);
    let whole = std::fs::read(parquet_file(dir.path())).unwrap();
    for length in [0, 4, 100, whole.len() / 2, whole.len() - 1] {
        std::fs::write(parquet_file(dir.path()), &whole[..length]).unwrap();
        let error = read_site(dir.path()).map(|_| ()).unwrap_err();
        assert!(matches!(error, RecordingError::Damaged { .. }), "{length} bytes: {error}");
    }
    program_refuses(dir.path(), &["passages.parquet", "truncated"]);
}

/// Sites with flipped bits may be refused, lose passages or read differently, but they never end the program.
#[test]
fn property_bit_flips_never_panic() {
    let (dir, _) = sound(Format::Parquet);
    for whole in [parquet_file(dir.path()), foreign()].map(|file| std::fs::read(file).unwrap()) {
        // Footer and page headers decide about lengths: every bit there, samples of the rest.
        let footer = whole.len().saturating_sub(2200);
        let positions = (0..footer).step_by(997).chain(0..400).chain(footer..whole.len());
        for (k, at) in positions.enumerate() {
            let mut bytes = whole.clone();
            bytes[at] ^= 1 << (k % 8);
            std::fs::write(parquet_file(dir.path()), &bytes).unwrap();
            let _ = read_site(dir.path());
        }
    }
}

#[test]
fn all_passages_bad_is_an_error() {
    let (dir, site) = sound(Format::Parquet);
    spoil(dir.path(), &site, |s| s.passages.iter_mut().for_each(|p| p.axle_load_kg /= 1e3));
    let error = site_refused(dir.path(), &["none of the 3 passages", "row 0", "axle_load_kg", "tonnes"]);
    assert!(matches!(error, RecordingError::NoUsablePassages { rows: 3, .. }));
}

// --- One passage ----------------------------------------------------------------------------------------------

#[test]
fn speed_in_km_h() {
    value_skipped(|p| p.speed_m_s = p.speed_m_s.map(|v| 3.6 * v), &["speed_m_s", "km/h"]);
}

#[test]
fn axle_load_in_tonnes() {
    value_skipped(|p| p.axle_load_kg = 18.0, &["axle_load_kg", "= 18 ", "tonnes"]);
}

#[test]
fn axle_load_in_newtons() {
    value_skipped(|p| p.axle_load_kg = 18e3 * 9.81, &["axle_load_kg", "newtons"]);
}

#[test]
fn temperature_in_kelvin() {
    value_skipped(|p| p.temperature_c += 273.15, &["temperature_c", "kelvin"]);
}

#[test]
fn acceleration_in_g() {
    value_skipped(
        |p| p.acceleration_m_s2.iter_mut().for_each(|a| *a /= 9.81),
        &["acceleration_m_s2", "in g"],
    );
}

#[test]
fn acceleration_in_mm_s2() {
    value_skipped(
        |p| p.acceleration_m_s2.iter_mut().for_each(|a| *a *= 1e3),
        &["acceleration_m_s2", "mm/s²"],
    );
}

#[test]
fn acceleration_nan() {
    value_skipped(|p| p.acceleration_m_s2[77] = f32::NAN, &["acceleration_m_s2", "sample 77", "NaN"]);
}

#[test]
fn acceleration_infinite() {
    value_skipped(|p| p.acceleration_m_s2[5] = f32::INFINITY, &["acceleration_m_s2", "sample 5", "inf"]);
}

#[test]
fn speed_nan() {
    value_skipped(|p| p.speed_m_s = Some(f64::NAN), &["speed_m_s", "NaN"]);
}

#[test]
fn empty_recording() {
    value_skipped(|p| p.acceleration_m_s2.clear(), &["acceleration_m_s2", "empty"]);
}

#[test]
fn recording_cut_short() {
    // 20 ms on both sides of the hardest impact in a stretch of the recording.
    let loudest = |p: &Passage, [from, to]: [usize; 2]| {
        let (level, len) = (|i: &usize| p.acceleration_m_s2[*i].abs(), p.acceleration_m_s2.len());
        (from * len / 4..to * len / 4).max_by(|a, b| level(a).total_cmp(&level(b))).unwrap()
    };
    let cut = |p: &mut Passage| {
        p.speed_m_s = None;
        p.acceleration_m_s2.truncate(loudest(p, [2, 4]) + 80);
    };
    value_skipped(cut, &["acceleration_m_s2", "ends under the train", "0.3 s"]);
    let late = |p: &mut Passage| {
        p.speed_m_s = None;
        drop(p.acceleration_m_s2.drain(..loudest(p, [0, 2]) - 80));
    };
    value_skipped(late, &["acceleration_m_s2", "begins under the train"]);
    value_skipped(|p| p.acceleration_m_s2.truncate(4000), &["acceleration_m_s2", "cut short"]);
}

#[test]
fn value_held_under_the_train() {
    for filled in [None, Some(0.0)] {
        let held = |p: &mut Passage| {
            let middle = p.acceleration_m_s2.len() / 2;
            let value = filled.unwrap_or(p.acceleration_m_s2[middle]);
            p.acceleration_m_s2[middle..middle + 120].fill(value);
        };
        value_skipped(held, &["acceleration_m_s2", "30 ms", "held a value"]);
    }
}

#[test]
fn dead_sensor() {
    value_skipped(|p| p.acceleration_m_s2.fill(0.1), &["acceleration_m_s2", "no train"]);
}

#[test]
fn sample_rate_that_does_not_fit() {
    value_skipped(|p| p.sample_rate_hz = 4096.0, &["sample_rate_hz", "4096", "4000"]);
}

#[test]
fn duplicate_identifier() {
    value_skipped(|p| p.passage_id = 0, &["passage_id", "row 0"]);
}

#[test]
fn null_temperature() {
    let dir = with_column("temperature_c", Column::Numbers(vec![Some(1.0), None, Some(2.0)]));
    passage_skipped(dir.path(), 1, &["temperature_c", "null"]);
}

#[test]
fn null_recording() {
    let (dir, site) = sound(Format::Parquet);
    let mut all = columns(&site);
    let (_, Column::SingleLists(samples)) = all.last_mut().unwrap() else { panic!("recordings are last") };
    samples[1] = None;
    write_columns(&parquet_file(dir.path()), &all).unwrap();
    passage_skipped(dir.path(), 1, &["acceleration_m_s2` is null"]);
}

/// Written by another program (data/foreign/write.py) with the types and encodings that this one does not write itself; in its last
/// row a sample is null.
#[test]
fn reference_tables_of_other_programs_are_read() {
    let (dir, site) = sound(Format::Parquet);
    std::fs::copy(foreign(), parquet_file(dir.path())).unwrap();
    passage_skipped(dir.path(), 2, &["acceleration_m_s2", "sample 7", "null"]);
    let read = read_site(dir.path()).unwrap();
    assert_eq!(read.passages, site.passages[..2]);
}

fn foreign() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data/foreign/passages.parquet")
}

#[test]
fn missing_speed_is_allowed() {
    let (dir, site) = sound(Format::Parquet);
    spoil(dir.path(), &site, |s| s.passages[1].speed_m_s = None);
    assert_eq!(read_site(dir.path()).unwrap().passages[1].speed_m_s, None);
}

// --- Text recordings and scan ---------------------------------------------------------------------------------

#[test]
fn index_without_a_column() {
    let (dir, _) = sound(Format::Csv);
    edit(dir.path(), "passages.csv", |t| t.replace("sample_rate_hz", "rate"));
    site_refused(dir.path(), &["passages.csv", "sample_rate_hz", "missing"]);
}

#[test]
fn index_with_a_word_for_a_number() {
    let (dir, _) = sound(Format::Csv);
    edit(dir.path(), "passages.csv", |t| t.replacen(",18000,", ",heavy,", 1));
    passage_skipped(dir.path(), 0, &["passages.csv", "axle_load_kg", "heavy"]);
}

#[test]
fn sample_file_missing() {
    let (dir, _) = sound(Format::Csv);
    std::fs::remove_file(dir.path().join("passages/001.csv")).unwrap();
    passage_skipped(dir.path(), 1, &["file", "001.csv"]);
}

#[test]
fn sample_file_with_a_word() {
    let (dir, _) = sound(Format::Csv);
    edit(dir.path(), "passages/002.csv", |t| format!("{t}overload\n"));
    passage_skipped(dir.path(), 2, &["overload", "not a number"]);
}

#[test]
fn sample_file_out_of_the_site() {
    let (dir, _) = sound(Format::Csv);
    edit(dir.path(), "passages.csv", |t| t.replace("passages/001.csv", "../001.csv"));
    passage_skipped(dir.path(), 1, &["file", "leads out of the site"]);
}

#[test]
fn sample_file_of_unknown_kind() {
    let (dir, _) = sound(Format::Csv);
    std::fs::rename(dir.path().join("passages/001.csv"), dir.path().join("passages/001.wav")).unwrap();
    edit(dir.path(), "passages.csv", |t| t.replace("001.csv", "001.wav"));
    passage_skipped(dir.path(), 1, &["001.wav", "unknown ending"]);
}

#[test]
fn scan_in_mm() {
    let (dir, _) = sound(Format::Parquet);
    edit(dir.path(), "irregularity.csv", |t| t.replacen(",0.0000", ",0.9", 1));
    site_refused(dir.path(), &["irregularity.csv", "irregularity_m", "row", "mm"]);
}

#[test]
fn scan_not_sorted() {
    let (dir, _) = sound(Format::Parquet);
    std::fs::write(dir.path().join("irregularity.csv"), "position_m,irregularity_m\n0.01,0\n0.00,0\n")
        .unwrap();
    site_refused(dir.path(), &["irregularity.csv", "position_m", "row 1", "sort"]);
}

#[test]
fn scan_without_a_column() {
    let (dir, _) = sound(Format::Parquet);
    edit(dir.path(), "irregularity.csv", |t| t.replace("irregularity_m", "z"));
    site_refused(dir.path(), &["irregularity.csv", "irregularity_m", "missing"]);
}

// --- The program ----------------------------------------------------------------------------------------------

#[test]
fn wrong_usage_is_code_2() {
    assert_eq!(cpcm(&["analyse"]).status.code(), Some(2));
    assert_eq!(cpcm(&["no-such-command"]).status.code(), Some(2));
}

#[test]
fn results_directory_that_is_a_file() {
    let (dir, _) = sound(Format::Parquet);
    let file = dir.path().join("out");
    std::fs::write(&file, "").unwrap();
    let run = cpcm(&["convert", dir.path().to_str().unwrap(), file.to_str().unwrap()]);
    assert_eq!(run.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&run.stderr).contains("is a file"));
}

#[test]
fn output_that_would_mix_two_recordings() {
    let (dir, _) = sound(Format::Parquet);
    let path = dir.path().to_str().unwrap();
    let run = cpcm(&["convert", path, path]);
    assert_eq!(run.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&run.stderr).contains("already holds"));
}
