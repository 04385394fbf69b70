//! What the values of a scenario may be.

use super::effects::Effects;
use super::file::{Scenario, Simulation};
use super::generate::TRUTH_STEP_M;
use crate::passage::{SimulationError, in_range};
use crate::recording::{POSITION_M, TEMPERATURE_C};

/// One checked value: name, value, smallest and largest, unit.
type Limit = (&'static str, f64, [f64; 2], &'static str);

/// The part of a whole.
const PART: [f64; 2] = [0.0, 1.0];
/// A scan reaches as far as the reader of sites accepts it, and holds x = 0 on its grid, m.
const SCAN_M: [[f64; 2]; 2] = [[-POSITION_M, -TRUTH_STEP_M], [TRUTH_STEP_M, POSITION_M]];
/// Sleepers from the crossing sleeper: more than a crossing has.
const OFFSETS: [f64; 2] = [-400.0, 400.0];

/// Refuses values that give no site, or one that cannot be read again. They are wider than anything a crossing can have: what is
/// unlikely may be simulated.
pub(super) fn check(scenario: &Scenario) -> Result<(), SimulationError> {
    let (s, e) = (&scenario.simulation, &scenario.simulation.effects);
    let limits =
        [of_site(s), of_supports(e), of_track_and_train(e), of_wheels(e), of_sensor(e, s.temperature_c)];
    limits.into_iter().flatten().try_for_each(|(what, value, range, unit)| in_range(what, value, range, unit))
}

fn of_site(s: &Simulation) -> Vec<Limit> {
    let [mean_c, half_c] = s.temperature_c;
    let mut limits = vec![
        ("passages", s.passages as f64, [1.0, crate::recording::MAX_PASSAGES as f64], ""),
        ("speed_m_s", s.speed_m_s, [5.0, 90.0], "m/s"),
        ("speed_spread", s.speed_spread, [0.0, 0.5], ""),
        ("temperature_c (half range)", half_c, [0.0, 75.0], "degC"),
        ("temperature_c (lowest)", mean_c - half_c, [TEMPERATURE_C.0, TEMPERATURE_C.1], "degC"),
        ("temperature_c (highest)", mean_c + half_c, [TEMPERATURE_C.0, TEMPERATURE_C.1], "degC"),
        ("ballast.p1_n_m2", s.ballast.p1_n_m2, [1e5, 1e10], "N/m2"),
        ("ballast.p2_n_m2", s.ballast.p2_n_m2, [1e5, 1e10], "N/m2"),
        ("ballast.p3", s.ballast.p3, PART, ""),
        ("geometry.scan_m (begin)", s.geometry.scan_m[0], SCAN_M[0], "m"),
        ("geometry.scan_m (end)", s.geometry.scan_m[1], SCAN_M[1], "m"),
        ("geometry.scan_noise_m", s.geometry.scan_noise_m, [0.0, 1e-3], "m"),
        ("wheels.load", s.wheels.load, [0.0, 0.3], ""),
        ("wheels.side_load", s.wheels.side_load, [0.0, 0.3], ""),
        ("wheels.depth", s.wheels.depth, [0.0, 0.5], ""),
        ("wheels.shift_m", s.wheels.shift_m, [0.0, 0.5], "m"),
        ("solver.rail_step_m", s.solver.rail_step_m, [0.01, 1.2], "m"),
        ("solver.sleeper_step_m", s.solver.sleeper_step_m, [0.01, 1.0], "m"),
        ("solver.sleeper_modes", s.solver.sleeper_modes as f64, [1.0, 400.0], ""),
    ];
    limits.extend(s.operator_speed_error.map(|e| ("operator_speed_error", e, PART, "")));
    limits.extend(s.solver.sleepers_each_side.map(|n| {
        // The ballast varies over ±2 sleepers, and the rails end at the outermost ones.
        ("solver.sleepers_each_side", n as f64, [4.0, 1000.0], "")
    }));
    limits
}

/// Ballast.
fn of_supports(e: &Effects) -> Vec<Limit> {
    let mut limits = Vec::new();
    if let Some(v) = &e.voided_sleepers {
        limits.push(("voided-sleepers.gap_m", v.gap_m, [0.0, 0.05], "m"));
        limits.push(("voided-sleepers.crib_damping", v.crib_damping, PART, "of the bed's"));
        for (offset, share) in &v.sleepers {
            limits.push(("voided-sleepers.sleepers (number)", *offset as f64, OFFSETS, ""));
            limits.push(("voided-sleepers.sleepers (share)", *share, [0.0, 2.0], ""));
        }
    }
    if let Some(s) = e.ballast_stiffening {
        limits.push(("ballast-stiffening.doubling_m", s.doubling_m, [1e-5, 1.0], "m"));
        limits.extend(s.bilinear_factor.map(|f| ("ballast-stiffening.bilinear_factor", f, [0.0, 100.0], "")));
    }
    limits.extend(e.ballast_mass.map(|m| ("ballast-mass.mass_kg_m", m.mass_kg_m, [0.0, 1e4], "kg/m")));
    if let Some(loss) = &e.support_loss {
        limits.push(("support-loss.factor", loss.factor, [0.0, 10.0], ""));
        limits.extend(loss.sleepers.iter().map(|o| ("support-loss.sleepers", *o as f64, OFFSETS, "")));
    }
    limits
}

/// Factors on nominal values, shares of load, and the other rail.
fn of_track_and_train(e: &Effects) -> Vec<Limit> {
    let factor = [0.01, 100.0];
    let mut limits = Vec::new();
    if let Some(p) = e.pad_stiffness {
        limits.push(("pad-stiffness.factor", p.factor, [1e-3, 1e3], ""));
        limits.push(("pad-stiffness.damping_factor", p.damping_factor, [0.0, 1e3], ""));
    }
    if let Some(c) = e.crossing_rail {
        limits.push(("crossing-rail.stiffness_factor", c.stiffness_factor, factor, ""));
        limits.push(("crossing-rail.mass_factor", c.mass_factor, factor, ""));
    }
    limits.extend(e.axle_load.map(|a| ("axle-load.factor", a.factor, factor, "")));
    limits.extend(e.unsprung_mass.map(|m| ("unsprung-mass.factor", m.factor, factor, "")));
    if let Some(t) = e.load_transfer {
        limits.push(("load-transfer.to_crossing_side", t.to_crossing_side, [-0.95, 0.95], ""));
        limits.push(("load-transfer.to_front", t.to_front, [-0.95, 0.95], ""));
    }
    if let Some(d) = e.stock_irregularity {
        limits.push(("stock-irregularity.depth_m", d.depth_m, [-0.02, 0.02], "m"));
        limits.push(("stock-irregularity.at_x_m", d.at_x_m, [-50.0, 50.0], "m"));
        limits.push(("stock-irregularity.length_m", d.length_m, [0.02, 10.0], "m"));
    }
    limits
}

fn of_wheels(e: &Effects) -> Vec<Limit> {
    let mut limits = Vec::new();
    limits.extend(e.front_rear.map(|f| ("front-rear.depth_difference", f.depth_difference, [-4.0, 4.0], "")));
    if let Some(o) = e.wheel_out_of_roundness {
        limits.push(("wheel-out-of-roundness.order", f64::from(o.order), [1.0, 200.0], ""));
        limits.push(("wheel-out-of-roundness.amplitude_m", o.amplitude_m, [0.0, 5e-3], "m"));
        limits.push(("wheel-out-of-roundness.share", o.share, PART, ""));
    }
    if let Some(f) = e.wheel_flat {
        limits.push(("wheel-flat.length_m", f.length_m, [1e-3, 0.3], "m"));
        limits.push(("wheel-flat.share", f.share, PART, ""));
    }
    if let Some(h) = e.hollow_wheels {
        limits.push(("hollow-wheels.depth_factor", h.depth_factor, [-10.0, 10.0], ""));
        limits.push(("hollow-wheels.shift_m", h.shift_m, [-1.0, 1.0], "m"));
        limits.push(("hollow-wheels.share", h.share, PART, ""));
    }
    limits
}

fn of_sensor(e: &Effects, [mean_c, half_c]: [f64; 2]) -> Vec<Limit> {
    let mut limits = Vec::new();
    if let Some(g) = e.gain_temperature {
        limits.push(("gain-temperature.per_kelvin", g.per_kelvin, [-0.1, 0.1], "1/K"));
        limits.push(("gain-temperature.reference_c", g.reference_c, [-100.0, 150.0], "degC"));
        // A sensitivity of naught or less is another fault than one that drifts.
        for end_c in [mean_c - half_c, mean_c + half_c] {
            let gain = 1.0 + g.per_kelvin * (end_c - g.reference_c);
            limits.push((
                "gain-temperature (sensitivity at the ends of temperature_c)",
                gain,
                [0.05, 20.0],
                "",
            ));
        }
    }
    limits.extend(e.saturation.map(|s| ("saturation.range_m_s2", s.range_m_s2, [0.1, 1e6], "m/s2")));
    if let Some(b) = e.bias_step {
        limits.push(("bias-step.step_m_s2", b.step_m_s2, [-1e3, 1e3], "m/s2"));
        limits.push(("bias-step.decay_s", b.decay_s, [1e-4, 1e3], "s"));
    }
    limits.extend(e.clock_error.map(|c| ("clock-error.relative", c.relative, [-0.2, 0.2], "")));
    if let Some(m) = e.mount_resonance {
        limits.push(("mount-resonance.frequency_hz", m.frequency_hz, [10.0, 1e5], "Hz"));
        limits.push(("mount-resonance.damping_ratio", m.damping_ratio, [1e-4, 10.0], ""));
    }
    if let Some(t) = e.tonal {
        limits.push(("tonal.frequency_hz", t.frequency_hz, [0.01, 1e5], "Hz"));
        limits.push(("tonal.amplitude_m_s2", t.amplitude_m_s2, [0.0, 1e4], "m/s2"));
    }
    limits
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::effects::*;
    use super::super::{read_scenario, simulate};
    use super::*;

    fn example(name: &str) -> Scenario {
        read_scenario(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/examples").join(name)).unwrap()
    }

    /// Puts a bad value into a sound scenario.
    type Spoil = fn(&mut Simulation);

    const SITE: [(&str, Spoil); 14] = [
        ("operator_speed_error", |s| s.operator_speed_error = Some(f64::NAN)),
        ("operator_speed_error", |s| s.operator_speed_error = Some(-0.1)),
        ("temperature_c", |s| s.temperature_c = [30.0, -10.0]),
        ("temperature_c", |s| s.temperature_c = [f64::NAN, 10.0]),
        ("temperature_c", |s| s.temperature_c = [10.0, f64::NAN]),
        ("temperature_c", |s| s.temperature_c = [293.0, 10.0]),
        ("scan_m", |s| s.geometry.scan_m = [-1e9, 1e12]),
        ("scan_m", |s| s.geometry.scan_m = [1.5, -0.9]),
        ("scan_m", |s| s.geometry.scan_m = [-0.9, 60.0]),
        ("scan_m", |s| s.geometry.scan_m = [0.5, 1.5]),
        ("scan_m", |s| s.geometry.scan_m = [-0.9, f64::NAN]),
        ("scan_noise_m", |s| s.geometry.scan_noise_m = f64::NAN),
        ("wheels.load", |s| s.wheels.load = f64::NAN),
        ("sleepers_each_side", |s| s.solver.sleepers_each_side = Some(0)),
    ];

    const TRACK_AND_TRAIN: [(&str, Spoil); 12] = [
        ("voided-sleepers.sleepers", |s| voided(s, vec![(0, f64::NAN)])),
        ("voided-sleepers.sleepers", |s| voided(s, vec![(0, 1.0), (1, -1.0)])),
        ("voided-sleepers.sleepers", |s| voided(s, vec![(i64::MAX, 1.0)])),
        ("ballast-stiffening.bilinear_factor", |s| {
            s.effects.ballast_stiffening =
                Some(BallastStiffening { doubling_m: 1e-3, bilinear_factor: Some(f64::NAN) });
        }),
        ("ballast-mass.mass_kg_m", |s| s.effects.ballast_mass = Some(BallastMass { mass_kg_m: -1.0 })),
        ("support-loss.sleepers", |s| {
            s.effects.support_loss = Some(SupportLoss { factor: 0.5, sleepers: vec![i64::MIN] });
        }),
        ("pad-stiffness.damping_factor", |s| {
            s.effects.pad_stiffness = Some(PadStiffness { factor: 1.0, damping_factor: f64::NAN });
        }),
        ("crossing-rail.mass_factor", |s| {
            s.effects.crossing_rail = Some(CrossingRail { stiffness_factor: 1.0, mass_factor: 0.0 });
        }),
        ("axle-load.factor", |s| s.effects.axle_load = Some(Factor { factor: 1e9 })),
        ("unsprung-mass.factor", |s| s.effects.unsprung_mass = Some(Factor { factor: f64::NAN })),
        ("load-transfer.to_front", |s| {
            s.effects.load_transfer = Some(LoadTransfer { to_crossing_side: 0.0, to_front: 1e9 });
        }),
        ("stock-irregularity.depth_m", |s| {
            s.effects.stock_irregularity =
                Some(StockIrregularity { depth_m: f64::NAN, at_x_m: 0.0, length_m: 0.4 });
        }),
    ];

    const WHEELS: [(&str, Spoil); 6] = [
        ("front-rear.depth_difference", |s| {
            s.effects.front_rear = Some(FrontRear { depth_difference: f64::NAN });
        }),
        ("wheel-out-of-roundness.order", |s| {
            s.effects.wheel_out_of_roundness =
                Some(WheelOutOfRoundness { order: u32::MAX, amplitude_m: 1e-4, share: 0.5 });
        }),
        ("wheel-out-of-roundness.amplitude_m", |s| {
            s.effects.wheel_out_of_roundness =
                Some(WheelOutOfRoundness { order: 5, amplitude_m: 1e9, share: 0.5 });
        }),
        ("wheel-flat.length_m", |s| s.effects.wheel_flat = Some(WheelFlats { length_m: 1e9, share: 0.5 })),
        ("wheel-flat.share", |s| s.effects.wheel_flat = Some(WheelFlats { length_m: 0.05, share: f64::NAN })),
        ("hollow-wheels.depth_factor", |s| {
            s.effects.hollow_wheels = Some(HollowWheels { depth_factor: 1e30, shift_m: 0.0, share: 0.5 });
        }),
    ];

    const SENSOR: [(&str, Spoil); 14] = [
        ("saturation.range_m_s2", |s| s.effects.saturation = Some(Saturation { range_m_s2: 0.0 })),
        ("saturation.range_m_s2", |s| s.effects.saturation = Some(Saturation { range_m_s2: -30.0 })),
        ("saturation.range_m_s2", |s| s.effects.saturation = Some(Saturation { range_m_s2: f64::NAN })),
        ("clock-error.relative", |s| s.effects.clock_error = Some(ClockError { relative: 1e9 })),
        ("clock-error.relative", |s| s.effects.clock_error = Some(ClockError { relative: -1.0 })),
        ("clock-error.relative", |s| s.effects.clock_error = Some(ClockError { relative: f64::NAN })),
        ("mount-resonance.frequency_hz", |s| {
            s.effects.mount_resonance = Some(Mount { frequency_hz: 0.0, damping_ratio: 0.1 });
        }),
        ("mount-resonance.damping_ratio", |s| {
            s.effects.mount_resonance = Some(Mount { frequency_hz: 300.0, damping_ratio: 0.0 });
        }),
        ("tonal.frequency_hz", |s| {
            s.effects.tonal = Some(Tonal { frequency_hz: f64::NAN, amplitude_m_s2: 1.0 });
        }),
        ("tonal.amplitude_m_s2", |s| {
            s.effects.tonal = Some(Tonal { frequency_hz: 50.0, amplitude_m_s2: 1e9 });
        }),
        ("gain-temperature.per_kelvin", |s| {
            s.effects.gain_temperature = Some(GainTemperature { per_kelvin: 1e300, reference_c: 20.0 });
        }),
        ("gain-temperature.reference_c", |s| {
            s.effects.gain_temperature = Some(GainTemperature { per_kelvin: 1e-3, reference_c: f64::NAN });
        }),
        ("gain-temperature", |s| {
            s.effects.gain_temperature = Some(GainTemperature { per_kelvin: 0.05, reference_c: 20.0 });
        }),
        ("bias-step.decay_s", |s| {
            s.effects.bias_step = Some(BiasSteps { step_m_s2: 5.0, decay_s: -0.2 });
        }),
    ];

    fn voided(s: &mut Simulation, sleepers: Vec<(i64, f64)>) {
        s.effects.voided_sleepers = Some(VoidedSleepers { gap_m: 1e-3, sleepers, crib_damping: 0.0 });
    }

    /// A range of naught was a panic, a scan of 10¹² m and a clock faster by 10⁹ an abort, and most other values that cannot be a site
    /// that nothing could read.
    #[test]
    fn regress_values_that_give_no_site_are_refused_by_name() {
        let sound = example("site.toml");
        for (name, spoil) in SITE.into_iter().chain(TRACK_AND_TRAIN).chain(WHEELS).chain(SENSOR) {
            let mut bad = sound.clone();
            spoil(&mut bad.simulation);
            let error = simulate(&bad, &crate::progress::Silent).map(|_| ()).unwrap_err().to_string();
            assert!(error.contains(name), "{name}: {error}");
        }
    }

    #[test]
    fn property_examples_are_inside_all_ranges() {
        for name in ["site.toml", "voided.toml"] {
            assert_eq!(check(&example(name)), Ok(()), "{name}");
        }
    }
}
