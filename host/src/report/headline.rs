//! The box on top: condition, urgency, action, and what they rest on.

use crate::analysis::{Analysis, BallastEstimate, Condition, Interval, Spread};
use crate::recording::Design;

use super::page::escape;

/// Name of the site and the box.
pub(super) fn html(analysis: &Analysis) -> String {
    let i = &analysis.indicators;
    let (class, verdict) = match i.condition {
        Condition::Healthy => ("healthy", "Healthy"),
        Condition::Watch => ("watch", "Watch"),
        Condition::Damaged => ("damaged", "Damaged"),
    };
    let facts: String = facts(analysis)
        .into_iter()
        .map(|(name, value, detail)| {
            format!(
                "<div><dt>{}</dt><dd>{}<small>{}</small></dd></div>\n",
                escape(name),
                escape(&value),
                escape(&detail)
            )
        })
        .collect();
    format!(
        "<h1>{}</h1>\n<p class=\"sub\">{}</p>\n{}<section class=\"headline {class}\">\n\
         <p class=\"verdict\">{verdict}</p>\n<p class=\"action\"><strong>{}</strong> {}</p>\n\
         <dl class=\"facts\">\n{facts}</dl>\n</section>\n",
        escape(&analysis.crossing.name),
        escape(&subtitle(analysis)),
        included(&analysis.effects_included),
        escape(&sentence(&i.urgency)),
        escape(&sentence(&i.recommended_action)),
    )
}

/// A page of corrected recordings must not pass for one of those that were made.
fn included(effects: &[String]) -> String {
    match effects {
        [] => String::new(),
        _ => format!(
            "<p class=\"sub\">Effects of a diagnosis included: {}.</p>\n",
            escape(&effects.join(", "))
        ),
    }
}

fn subtitle(analysis: &Analysis) -> String {
    let c = &analysis.crossing;
    let design = match c.design {
        Design::Uic60 => "UIC60 (stiff pads)",
        Design::E60 => "60E (soft pads)",
    };
    let direction = c.traffic_direction;
    let speeds = speeds_km_h(analysis).map(|v| format!("{v:.0}"));
    let speeds = if speeds[0] == speeds[1] { speeds[0].clone() } else { speeds.join("\u{2013}") };
    let load = c.vehicle.axle_load_kg / 1e3;
    format!(
        "Crossing panel {design}, {direction} traffic, {speeds} km/h, {} trains of {load:.1} t axle load",
        c.vehicle.kind
    )
}

/// Slowest and fastest.
fn speeds_km_h(analysis: &Analysis) -> [f64; 2] {
    let speeds = analysis.passages.iter().map(|p| 3.6 * p.speed_m_s);
    let (low, high) = speeds.fold((f64::INFINITY, 0.0_f64), |(l, h), v| (l.min(v), h.max(v)));
    if low.is_finite() { [low, high] } else { [0.0, 0.0] }
}

fn facts(analysis: &Analysis) -> Vec<(&'static str, String, String)> {
    let i = &analysis.indicators;
    let (used, left_out) = analysis.used_and_left_out();
    let passages = format!("{used} used, {left_out} left out");
    let (force, rms) = (i.peak_force_n, i.irregularity_rms_m);
    vec![
        ("Force peak", format!("{:.0} kN", 1e-3 * force.mean), spread(force, 1e-3, "kN")),
        ("Irregularity RMS", format!("{:.0} µm", 1e6 * rms.mean), spread(rms, 1e6, "µm")),
        ballast(&analysis.ballast),
        ("Passages", passages, format!("{} wheelsets", analysis.wheelsets())),
    ]
}

fn spread(s: Spread, factor: f64, unit: &str) -> String {
    let (p10, p90, threshold) = (factor * s.p10, factor * s.p90, factor * s.threshold);
    let wheels = format!(
        "middle 80 % of the wheels: {p10:.0}\u{2013}{p90:.0} {unit}; threshold {threshold:.0} {unit}"
    );
    match s.mean90.map(|v| factor * v) {
        [lower, upper] if lower.is_finite() && upper.is_finite() => {
            format!("mean; 90 %: {lower:.1}\u{2013}{upper:.1} {unit}; {wheels}")
        }
        _ => wheels,
    }
}

fn ballast(b: &BallastEstimate) -> (&'static str, String, String) {
    let damping = match b.damping.contradicts_description() {
        true => format!("; damping {} kNs/m², not as described", interval(b.damping.recorded_ns_m2, 1e-3)),
        false => String::new(),
    };
    let detail = format!(
        "90 %: {}; elsewhere {:.1} ({}); shape p3 {:.2} ({:.2}\u{2013}{:.2}){}",
        interval(b.p2_n_m2, 1e-6),
        1e-6 * b.p1_n_m2.value,
        interval(b.p1_n_m2, 1e-6),
        b.p3.value,
        b.p3.lower,
        b.p3.upper,
        damping
    );
    ("Crossing ballast", format!("{:.1} MN/m²", 1e-6 * b.p2_n_m2.value), detail)
}

/// The ends of a 90 % interval.
fn interval(v: Interval, factor: f64) -> String {
    format!("{:.1}\u{2013}{:.1}", factor * v.lower, factor * v.upper)
}

/// Capital letter, full stop.
fn sentence(text: &str) -> String {
    let mut chars = text.trim().chars();
    let Some(first) = chars.next() else { return String::new() };
    let mut out: String = first.to_uppercase().chain(chars).collect();
    if !out.ends_with(['.', '!', '?']) {
        out.push('.');
    }
    out
}
