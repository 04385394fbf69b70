//! Six crossing panels like those of the paper: everything its tables and text state as stated, the rest assumed.
//!
//! Stated: design, direction, speed, passes and scan length (Table 2), axle load (section 6.1.1), track and bogie
//! (Table 1). The paper shows ballast (fig. 8) and geometry (fig. 5) without numbers; assumed here so that what the text
//! says of them holds: Ho 21B has the stiffest ballast and hardly any wear, Vad 131 next to no support under the crossing
//! and by far the largest displacement (3 mm; the paper's 6 mm are out of reach of linear ballast with its damping), Sg 21B and Vad 131 the worst geometry.

use crate::ballast::BallastParameters;
use crate::recording::{Crossing, Design, Rail, Sensor, Sleeper, TrackLayout, TrafficDirection};
use crate::scenario::Geometry;
use crate::verification::reference::{self, PadCase, SOFT, STIFF};

/// One panel.
#[derive(Clone, Debug, PartialEq)]
pub struct Panel {
    /// Label in the paper; its Table 2 calls Ho 22A "Ho 21A".
    pub name: &'static str,
    /// Pads: 60E is soft, UIC60 stiff (section 2).
    pub design: Design,
    /// Table 2.
    pub direction: TrafficDirection,
    /// Table 2, km/h.
    pub speed_km_h: f64,
    /// Section 6.1.1, kg.
    pub axle_load_kg: f64,
    /// Train passes used, Table 2.
    pub passes: usize,
    /// Table 2, metres.
    pub scan_length_m: f64,
    /// Whether the paper calls the panel damaged (section 7).
    pub damaged: bool,
    /// Assumed.
    pub ballast: BallastParameters,
    /// Assumed.
    pub geometry: Geometry,
}

/// Speed of the study of the low-pass (section 3.1), m/s.
pub const LOW_PASS_SPEED_M_S: f64 = 160.0 / 3.6;

impl Panel {
    /// m/s.
    pub fn speed_m_s(&self) -> f64 {
        self.speed_km_h / 3.6
    }

    /// Rail pads of the design.
    pub fn pads(&self) -> PadCase {
        pads(self.design)
    }

    /// Description of the panel with its own pads and load.
    pub fn crossing(&self, n_sleepers: usize) -> Crossing {
        let mut crossing = crossing(self.pads(), n_sleepers);
        crossing.name = self.name.into();
        crossing.design = self.design;
        crossing.traffic_direction = self.direction;
        crossing.vehicle.axle_load_kg = self.axle_load_kg;
        crossing
    }
}

fn pads(design: Design) -> PadCase {
    match design {
        Design::E60 => SOFT,
        Design::Uic60 => STIFF,
    }
}

/// Track of Table 1 with the dimensions that the paper does not give: 3.5 m bearers, crossing part from 1.5 m before to
/// 3.3 m behind the nose tip, sensor on the middle sleeper, 0.3 m behind the tip. `n_sleepers` is odd.
pub fn crossing(pads: PadCase, n_sleepers: usize) -> Crossing {
    let middle = n_sleepers / 2;
    let plain = reference::site(pads);
    Crossing {
        track: TrackLayout {
            n_sleepers,
            crossing_sleeper_index: middle,
            crossing_sleeper_x_m: 0.3,
            ..plain.track
        },
        rail: Rail { crossing_part_x0_m: -1.5, crossing_part_x1_m: 3.3, ..plain.rail },
        sleeper: Sleeper { length_m: 3.5, width_m: 0.28, height_m: 0.22, ..plain.sleeper },
        sensor: Sensor {
            sleeper_index: middle,
            y_m: 2.3,
            sample_rate_hz: 4000.0,
            // The kink of a worn nose shakes the sleeper by more than the ±50 g of usual sensors; the paper's did not clip.
            range_m_s2: 3000.0,
            bits: 20,
            antialias_order: 4,
            antialias_hz: 1500.0,
            noise_rms_m_s2: 0.1,
            bias_max_m_s2: 0.15,
        },
        ..plain
    }
}

/// p1, p2 in MN/m².
fn ballast(p1: f64, p2: f64, p3: f64) -> BallastParameters {
    BallastParameters::stiffness([1e6 * p1, 1e6 * p2, p3])
}

/// Dip and wear in mm; lengths of wing, nose and wear in metres.
fn geometry(dip_mm: f64, [wing_m, nose_m]: [f64; 2], wear_mm: f64, wear_m: f64, scan_m: f64) -> Geometry {
    Geometry {
        dip_m: 1e-3 * dip_mm,
        wing_length_m: wing_m,
        nose_length_m: nose_m,
        wear_m: 1e-3 * wear_mm,
        wear_length_m: wear_m,
        scan_m: [0.3 - 0.5 * scan_m, 0.3 + 0.5 * scan_m],
        ..Geometry::default()
    }
}

/// All six in the order of the paper.
pub fn all() -> [Panel; 6] {
    use Design::{E60, Uic60};
    use TrafficDirection::{Facing, Trailing};
    let panel = |name, design, direction, speed_km_h, load_t: f64, passes, scan_length_m| Panel {
        name,
        design,
        direction,
        speed_km_h,
        axle_load_kg: 1e3 * load_t,
        passes,
        scan_length_m,
        damaged: false,
        ballast: ballast(30.0, 30.0, 0.5),
        geometry: Geometry::default(),
    };
    [
        Panel {
            ballast: ballast(60.0, 50.0, 0.5),
            geometry: geometry(0.7, [0.8, 0.9], 0.0, 0.4, 1.7),
            ..panel("Ho 21B", E60, Trailing, 180.0, 18.0, 57, 1.7)
        },
        Panel {
            ballast: ballast(45.0, 30.0, 0.4),
            geometry: geometry(1.0, [0.7, 0.8], 0.1, 0.4, 2.3),
            ..panel("Ho 22A", E60, Facing, 190.0, 15.5, 48, 2.3)
        },
        Panel {
            ballast: ballast(40.0, 25.0, 0.5),
            geometry: geometry(0.9, [0.6, 0.8], 0.15, 0.5, 2.5),
            ..panel("Sg 21A", Uic60, Facing, 170.0, 15.5, 41, 2.5)
        },
        Panel {
            damaged: true,
            ballast: ballast(30.0, 15.0, 0.5),
            geometry: geometry(2.0, [0.7, 0.7], 0.4, 0.4, 1.9),
            ..panel("Sg 21B", Uic60, Facing, 160.0, 18.0, 12, 1.9)
        },
        Panel {
            ballast: ballast(25.0, 12.0, 0.4),
            geometry: geometry(0.8, [0.7, 0.9], 0.1, 0.3, 1.6),
            ..panel("Vad 102", Uic60, Trailing, 200.0, 15.5, 38, 1.6)
        },
        Panel {
            damaged: true,
            ballast: ballast(5.0, 0.5, 0.1),
            geometry: geometry(2.4, [0.8, 0.7], 0.5, 0.5, 1.8),
            ..panel("Vad 131", Uic60, Facing, 130.0, 15.5, 9, 1.8)
        },
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// With the axle loads of section 6.1.1 and the pads of Table 1.
    #[test]
    fn paper_panels_are_those_of_table_2() {
        use Design::{E60, Uic60};
        use TrafficDirection::{Facing, Trailing};
        let table = [
            ("Ho 21B", E60, Trailing, 180.0, 57, 1.7, 18_000.0),
            ("Ho 22A", E60, Facing, 190.0, 48, 2.3, 15_500.0),
            ("Sg 21A", Uic60, Facing, 170.0, 41, 2.5, 15_500.0),
            ("Sg 21B", Uic60, Facing, 160.0, 12, 1.9, 18_000.0),
            ("Vad 102", Uic60, Trailing, 200.0, 38, 1.6, 15_500.0),
            ("Vad 131", Uic60, Facing, 130.0, 9, 1.8, 15_500.0),
        ];
        let all = all();
        for (p, row) in all.iter().zip(table) {
            let crossing = p.crossing(37);
            let load_kg = crossing.vehicle.axle_load_kg;
            let found = (p.name, p.design, p.direction, p.speed_km_h, p.passes, p.scan_length_m, load_kg);
            assert_eq!(found, row);
            let [from_m, to_m] = p.geometry.scan_m;
            assert!((to_m - from_m - p.scan_length_m).abs() < 1e-9, "{}", p.name);
            assert_eq!(crossing.pad.stiffness_n_m, if p.design == E60 { 60e6 } else { 1200e6 });
        }
        assert_eq!(
            all.iter().filter(|p| p.damaged).map(|p| p.name).collect::<Vec<_>>(),
            ["Sg 21B", "Vad 131"]
        );
    }
}
