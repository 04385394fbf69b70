//! The diagnosis on field recordings: contract of its files, what it may know, what it says of poor sites.

use std::path::{Path, PathBuf};

use arrow_array::cast::AsArray;
use arrow_array::types::Float64Type;
use cpcm::gap::GapError;
use cpcm::gap::diagnosis::{DiagnoseOptions, Diagnosis, diagnose};
use cpcm::gap::results::{diagnosis_json, write_diagnosis};
use cpcm::gap::verdict::Verdict;
use cpcm::progress::Silent;
use cpcm::recording::{Format, Site, read_site, write_site};
use cpcm_tests::tolerance;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;

fn field(name: &str) -> Site {
    read_site(&Path::new(env!("CARGO_MANIFEST_DIR")).join("data/field").join(name)).unwrap()
}

fn quick(site: &Site) -> Result<Diagnosis, GapError> {
    diagnose(site, &DiagnoseOptions { quick: true, ..DiagnoseOptions::default() }, &Silent)
}

/// A site that is fast to diagnose.
fn small(name: &str, passages: usize) -> Site {
    let mut site = field(name);
    site.passages.truncate(passages);
    site
}

/// Root of the mean of the two squared RMS ratios of a column against the measured one, straight from the file.
fn gap_from_file(file: &Path, model: &str) -> f64 {
    let reader =
        ParquetRecordBatchReaderBuilder::try_new(std::fs::File::open(file).unwrap()).unwrap().build();
    let (mut left, mut all) = ([0.0; 2], [0.0; 2]);
    for batch in reader.unwrap().map(Result::unwrap) {
        for (q, unit) in ["m_s2", "m"].iter().enumerate() {
            let column =
                |name: &str| batch.column_by_name(&format!("{name}_{unit}")).unwrap().as_list::<i32>();
            for row in 0..batch.num_rows() {
                let list =
                    |name: &str| column(name).value(row).as_primitive::<Float64Type>().values().to_vec();
                for (m, p) in list("measured").iter().zip(list(model)) {
                    left[q] += (m - p).powi(2);
                    all[q] += m * m;
                }
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
    let (name, _, lower, upper) = found.effects[0].parameters[0];
    assert!(name == "factor" && lower <= 3.0 && 3.0 <= upper, "{lower} {upper}");
    assert!(found.gap.closed_fraction >= 0.7);
    let out = tempfile::tempdir().unwrap();
    write_diagnosis(out.path(), "site", &found).unwrap();
    let json = diagnosis_json(&found);
    let file = out.path().join("predictions.parquet");
    let (before, after) = (gap_from_file(&file, "before"), gap_from_file(&file, "after"));
    let number = |key: &str| json["gap"][key].as_f64().unwrap();
    assert!((before / number("before") - 1.0).abs() < tolerance::GAP_RECOMPUTED);
    assert!((after / number("after") - 1.0).abs() < tolerance::GAP_RECOMPUTED);
    let closed = (before - after) / (before - number("noise_floor"));
    assert!((closed - number("closed_fraction")).abs() < tolerance::CLOSED_FRACTION);
    assert!(out.path().join("diagnosis.html").is_file());
}

#[test]
fn reference_recordings_without_effect_have_no_gap() {
    let found = diagnose(&field("reference-2"), &DiagnoseOptions::default(), &Silent).unwrap();
    assert_eq!(found.verdict, Verdict::NoGap, "{:?}", found.effects);
}

/// Truth beside the recordings, and names, change nothing.
#[test]
fn property_nothing_but_the_recordings_matters() {
    let mut site = small("known-pad-stiffness", 5);
    let one = diagnosis_json(&quick(&site).unwrap());
    site.crossing.name = "another".into();
    let dir = tempfile::tempdir().unwrap();
    let place: PathBuf = dir.path().join("effect-is-void");
    write_site(&place, &site, Format::Csv).unwrap();
    std::fs::write(place.join("truth.toml"), "effects = [\"voided_sleepers\"]\n[[[").unwrap();
    std::fs::write(place.join("truth.parquet"), "garbage").unwrap();
    let other = diagnosis_json(&quick(&read_site(&place).unwrap()).unwrap());
    assert_eq!(one, other);
}

fn says(found: &Diagnosis, word: &str) -> bool {
    found.remarks.iter().any(|r| r.contains(word))
}

#[test]
fn property_one_passage_is_told_to_be_too_few() {
    assert!(says(&quick(&small("reference-1", 1)).unwrap(), "few passages"));
}

#[test]
fn property_a_missing_scan_is_told() {
    let mut site = small("reference-1", 4);
    site.scan = None;
    assert!(says(&quick(&site).unwrap(), "no laser scan"));
}

#[test]
fn property_missing_speeds_are_told() {
    let mut site = small("reference-1", 4);
    site.passages.iter_mut().for_each(|p| p.speed_m_s = None);
    assert!(says(&quick(&site).unwrap(), "no speeds"));
}

#[test]
fn property_constant_temperature_is_told() {
    let mut site = small("reference-1", 4);
    site.passages.iter_mut().for_each(|p| p.temperature_c = 12.0);
    assert!(says(&quick(&site).unwrap(), "constant temperature"));
}

#[test]
fn property_a_silent_site_is_refused() {
    let mut site = small("reference-1", 2);
    site.passages.iter_mut().for_each(|p| p.acceleration_m_s2.fill(0.0));
    assert!(matches!(quick(&site), Err(GapError::Silent)));
}
