//! The files that `diagnose` leaves behind, each complete or absent.

use std::path::Path;

use serde_json::{Value, json};

use super::data::RATE_HZ;
use super::diagnosis::Diagnosis;
use super::effect::Stated;
use super::measure::Prediction;
use crate::recording::RecordingError;
use crate::recording::files::{create_dir, write_atomic};
use crate::recording::table::{Column, write_columns};
use crate::report::{ReportError, diagnosis};

/// Results that cannot be written.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum DiagnosisFileError {
    #[error(transparent)]
    File(#[from] RecordingError),

    #[error(transparent)]
    Report(#[from] ReportError),
}

/// Writes `diagnosis.json`, `predictions.parquet` and `diagnosis.html`.
pub fn write_diagnosis(dir: &Path, name: &str, found: &Diagnosis) -> Result<(), DiagnosisFileError> {
    create_dir(dir)?;
    write_predictions(&dir.join("predictions.parquet"), &found.predictions)?;
    write_atomic(&dir.join("diagnosis.json"), format!("{:#}\n", diagnosis_json(name, found)).as_bytes())?;
    write_atomic(&dir.join("diagnosis.html"), diagnosis::html(name, found)?.as_bytes())?;
    Ok(())
}

/// The content of `diagnosis.json` of a site of that name.
pub fn diagnosis_json(site: &str, d: &Diagnosis) -> Value {
    let bands: Vec<Value> = d
        .gap
        .bands
        .iter()
        .map(|b| {
            json!({"name": b.name, "low_hz": b.range_hz[0], "high_hz": b.range_hz[1],
                   "before": b.gap[0], "after": b.gap[1], "noise_floor": b.gap[2]})
        })
        .collect();
    let effects: Vec<Value> = d
        .effects
        .iter()
        .map(|e| {
            let alternatives: Vec<Value> = e
                .alternatives
                .iter()
                .map(|a| {
                    json!({"name": a.name, "parameters": parameters_json(&a.parameters), "gap_after": finite(a.gap_after)})
                })
                .collect();
            json!({"name": e.name, "probability": e.probability, "parameters": parameters_json(&e.parameters),
                   "indistinguishable_from": e.indistinguishable_from, "alternatives": alternatives, "gained": finite(e.gained),
                   "meaning": e.meaning(), "recommended_action": d.recommended_action(e)})
        })
        .collect();
    let ranking: Vec<Value> = d
        .ranking
        .iter()
        .map(|r| json!({"name": r.name, "probability": r.probability, "gap_after": finite(r.gap_after)}))
        .collect();
    let cosines: Vec<Value> =
        d.cosines.iter().map(|(a, b, c)| json!({"a": a, "b": b, "cosine": finite(*c)})).collect();
    let ladder: Vec<Value> = d
        .ladder
        .iter()
        .map(|r| json!({"model": r.model, "acceleration": r.acceleration, "displacement": r.displacement}))
        .collect();
    let collapse = d.collapse.map(|[position, time]| json!({"position": position, "time": time}));
    let w = &d.wheels;
    let wheels = json!({"load": w.load, "side_load": w.side_load, "depth": w.depth, "shift_m": w.shift_m,
                        "irregularity_m": w.own_m, "depth_of_trains": d.train_depth});
    let mut out = json!({
        "site": site,
        "cpcm_version": env!("CARGO_PKG_VERSION"),
        "verdict": d.verdict,
        "gap": {"before": d.gap.before, "after": d.gap.after, "noise_floor": d.gap.noise_floor,
                "closed_fraction": d.gap.closed_fraction, "closed_fraction_ci90": d.gap.closed_fraction_ci90},
        "where": {"stage": d.stage, "bands": bands, "position_m": d.position_m, "depends_on": d.depends_on,
                  "node_gap": d.node_gap, "collapse": collapse, "ladder": ladder, "wheels": wheels},
        "effects": effects,
        "ranking": ranking,
        "held_out_passages": d.predictions.iter().map(|p| p.passage_id).collect::<Vec<_>>(),
        "skipped": d.skipped,
        "identifiability": cosines,
        "remarks": d.remarks,
    });
    if let Some(c) = &d.consequences {
        out["consequences"] = json!(c);
    }
    out
}

fn parameters_json(list: &[Stated]) -> Value {
    let of_name = |(name, value, lower, upper): &Stated| {
        ((*name).to_string(), json!({"value": value, "lower": lower, "upper": upper}))
    };
    Value::Object(list.iter().map(of_name).collect())
}

fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

fn write_predictions(file: &Path, predictions: &[Prediction]) -> Result<(), RecordingError> {
    let lists = |pick: &dyn Fn(&Prediction) -> &Vec<f64>| {
        Column::NumberLists(predictions.iter().map(|p| pick(p).as_slice()).collect())
    };
    let columns = [
        ("passage_id", Column::Integers(predictions.iter().map(|p| Some(p.passage_id)).collect())),
        ("sample_rate_hz", Column::Numbers(vec![Some(RATE_HZ); predictions.len()])),
        ("measured_m_s2", lists(&|p| &p.acceleration[0])),
        ("before_m_s2", lists(&|p| &p.acceleration[1])),
        ("after_m_s2", lists(&|p| &p.acceleration[2])),
        ("measured_m", lists(&|p| &p.displacement[0])),
        ("before_m", lists(&|p| &p.displacement[1])),
        ("after_m", lists(&|p| &p.displacement[2])),
    ];
    write_columns(file, &columns)
}
