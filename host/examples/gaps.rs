//! What the diagnosis says of recordings whose effect is known, one line per site:
//!
//!     cargo run --release --example gaps -- tests/data/field/known-* tests/data/field/reference-*
//!
//! Every site is diagnosed by a process of its own (this program again), so that time and memory are those of a user. The
//! truth is opened only here, after the diagnosis.

use std::error::Error;
use std::path::Path;

use cpcm::bench::child::measure;
use cpcm::gap::diagnosis::{DiagnoseOptions, diagnose};
use cpcm::gap::results::diagnosis_json;
use cpcm::gap::trial::main_parameter;
use cpcm::progress::Silent;
use cpcm::recording::read_site;
use cpcm::report::diagnosis::significant;
use serde_json::Value;

/// Asked of a site with a known effect.
const CLOSED: f64 = 0.7;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [flag, dir] = &arguments[..]
        && flag == "--one"
    {
        return one(Path::new(dir));
    }
    if arguments.is_empty() {
        return Err("name one site directory with truth.toml, or more".into());
    }
    println!(
        "{:<32} {:<17} {:<38} {:<5} {:<40} {:>20} {:>7} {:>6} {:>6} {:>6}",
        "site",
        "verdict",
        "first",
        "right",
        "parameter (90 %), truth",
        "closed, 90 %",
        "floor",
        "wall",
        "CPU",
        "memory"
    );
    for dir in &arguments {
        println!("{}", line(Path::new(dir))?);
    }
    Ok(())
}

/// Diagnoses a site and prints diagnosis.json, CPU time and peak memory.
fn one(dir: &Path) -> Result<(), Box<dyn Error>> {
    let site = read_site(dir)?;
    let found = diagnose(&site, &DiagnoseOptions::default(), &Silent)?;
    println!("{}", diagnosis_json(&site.crossing.name, &found));
    Ok(())
}

fn line(dir: &Path) -> Result<String, Box<dyn Error>> {
    let used = measure(std::process::Command::new(std::env::current_exe()?).arg("--one").arg(dir))?;
    let found: Value = serde_json::from_str(&used.answer)?;
    let truth = Truth::read(dir)?;
    let first = &found["effects"][0];
    let name = first["name"].as_str().unwrap_or("-");
    let mut group = vec![name];
    group.extend(first["indistinguishable_from"].as_array().into_iter().flatten().filter_map(Value::as_str));
    let verdict = found["verdict"].as_str().unwrap_or("-");
    let right = match &truth.effect {
        None => verdict == "no-gap",
        Some(e) => group.len() <= 3 && group.contains(&e.as_str()),
    };
    let gap = &found["gap"];
    let number = |v: &Value| v.as_f64().unwrap_or(f64::NAN);
    let closed = number(&gap["closed_fraction"]);
    let ends = &gap["closed_fraction_ci90"];
    Ok(format!(
        "{:<32} {:<17} {:<38} {:<5} {:<40} {:>4.0} % ({:>3.0} … {:>3.0}){} {:>7.3} {:>4.0} s {:>4.0} s {:>4.0} M",
        dir.file_name().unwrap_or_default().display(),
        verdict,
        group.join(" / "),
        if right { "yes" } else { "NO" },
        truth.parameter(first),
        100.0 * closed,
        100.0 * number(&ends[0]),
        100.0 * number(&ends[1]),
        if truth.effect.is_some() && closed < CLOSED { "!" } else { " " },
        number(&gap["noise_floor"]),
        used.wall_s,
        used.cpu_s,
        used.peak_mib,
    ))
}

/// `truth.toml` of a site, as far as effects go.
struct Truth {
    effect: Option<String>,
    values: toml::Table,
}

impl Truth {
    fn read(dir: &Path) -> Result<Self, Box<dyn Error>> {
        let table: toml::Table = std::fs::read_to_string(dir.join("truth.toml"))?.parse()?;
        let values = table.get("effect_1").and_then(|v| v.as_table()).cloned().unwrap_or_default();
        let effect = values.get("name").and_then(|v| v.as_str()).map(|n| n.replace('_', "-"));
        Ok(Self { effect, values })
    }

    /// Value, interval and truth of the main parameter of the first effect, or of the one in its group that is the true one.
    fn parameter(&self, first: &Value) -> String {
        let others = first["alternatives"].as_array().into_iter().flatten();
        let true_one =
            [first].into_iter().chain(others).find(|e| e["name"].as_str() == self.effect.as_deref());
        let (Some(name), Some(effect)) = (self.effect.as_deref(), true_one) else { return "-".into() };
        // Name of the truth, factor to SI units.
        let (own, scale) = match name {
            "clock-error" => ("percent", 0.01),
            "gain-temperature" => ("percent_per_k", 0.01),
            "load-transfer" => ("fraction", 1.0),
            "pad-stiffness" => ("k_factor", 1.0),
            "saturation" => ("range_g", 9.81),
            "voided-sleepers" => ("gap_mm", 1e-3),
            "wheel-out-of-roundness" => ("amp_mm", 1e-3),
            _ => return "-".into(),
        };
        let number = |v: &toml::Value| v.as_float().or(v.as_integer().map(|i| i as f64));
        let truth = self.values.get(own).and_then(number).map_or(f64::NAN, |v| v * scale);
        let Some(main) = main_parameter(name) else { return "-".into() };
        let p = &effect["parameters"][main];
        let at = |key: &str| p[key].as_f64().unwrap_or(f64::NAN);
        let (lower, upper) = (at("lower"), at("upper"));
        let mark = if lower <= truth && truth <= upper { "" } else { " NO" };
        let [value, low, high, truth] = [at("value"), lower, upper, truth].map(significant);
        format!("{value} ({low} … {high}), {truth}{mark}")
    }
}
