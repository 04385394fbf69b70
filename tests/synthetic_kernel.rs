//! A kernel package for tests of everything around the node's arithmetic: right in form and size, the numbers are noise.
//!
//! Speeds and axle pattern are those of the field recordings, so trains are recognised and forces are computed.

use cpcm_shared::operator::block_crc;
use cpcm_shared::package::{self, Bin, Block, Group, Header, Operator, Provenance, Sensor, Train};
use cpcm_shared::sample::{M_S2_PER_CODE, RAW_RATE_HZ};

const BINS_M_S: [f32; 4] = [28.0, 38.0, 48.0, 62.0];
const AXLES_PER_GROUP: usize = 2;
const WINDOW: u16 = 400;
const BEFORE: u16 = 150;
const RANK: u16 = 60;
const GRID: u16 = 121;

/// The package of a site of this name.
pub fn package(site: &str) -> Vec<u8> {
    let mut payload = Payload { bytes: Vec::new(), random: 1 };
    let bins = BINS_M_S
        .iter()
        .map(|&speed_m_s| Bin { speed_m_s, operators: [payload.operator(speed_m_s)].into_iter().collect() });
    let header = Header {
        format: package::FORMAT,
        provenance: Provenance {
            site: site.try_into().unwrap(),
            model_hash: 1,
            calibrated_on: Default::default(),
            written_by: "test".try_into().unwrap(),
        },
        sensor: Sensor {
            sample_rate_hz: RAW_RATE_HZ as f32,
            decimation: 4,
            m_s2_per_code: M_S2_PER_CODE,
            range_m_s2: 392.266,
        },
        direction: 1,
        train: train(),
        grid_first_m: -0.9,
        grid_step_m: 0.02,
        grid_len: GRID,
        bins: bins.collect(),
        payload_len: payload.bytes.len() as u32,
    };
    let mut file = vec![0; package::PREFIX_LEN + package::MAX_HEADER_LEN];
    let length = header.encode(&mut file).unwrap();
    file.truncate(length);
    file.extend(&payload.bytes);
    file
}

/// The three-car train of the field recordings.
fn train() -> Train {
    let car = |k: u8| [0.0, 2.9, 17.7, 20.6].map(|x| x + 24.95 * f32::from(k));
    Train {
        name: "X2".try_into().unwrap(),
        axle_offset_m: (0..3).flat_map(car).collect(),
        static_force_n: 76_000.0,
        groups: (0..6)
            .map(|k| Group { first_axle: 2 * k, axles: AXLES_PER_GROUP as u8, operator: 0 })
            .collect(),
    }
}

struct Payload {
    bytes: Vec<u8>,
    random: u32,
}

impl Payload {
    fn operator(&mut self, speed_m_s: f32) -> Operator {
        let forces = AXLES_PER_GROUP as u16 * GRID;
        Operator {
            before: BEFORE,
            project: self.noise(RANK, WINDOW, 0.0, 0.1),
            expand: self.noise(forces, RANK, 0.0, 50.0),
            offset_n: self.noise(forces, 1, 76_000.0, 0.0),
            half_width_n: self.noise(forces, 1, 3_000.0, 500.0),
            template_m_s2: self.template(speed_m_s),
        }
    }

    fn noise(&mut self, rows: u16, cols: u16, mean: f32, spread: f32) -> Block {
        let values: Vec<f32> = (0..usize::from(rows) * usize::from(cols))
            .map(|_| {
                self.random = self.random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                mean + spread * (self.random >> 8) as f32 / (1 << 24) as f32
            })
            .collect();
        self.add(rows, cols, &values)
    }

    /// Each axle presses the sleeper down: the second derivative of a bell 0.7 m wide.
    fn template(&mut self, speed_m_s: f32) -> Block {
        let bell = |x: f32| (x * x / 0.49 - 0.5) * (-x * x / 0.49).exp();
        let at = |k: u16| (f32::from(k) - f32::from(BEFORE)) * 1e-3 * speed_m_s;
        let values: Vec<f32> = (0..WINDOW).map(|k| 20.0 * (bell(at(k)) + bell(at(k) - 2.9))).collect();
        self.add(1, WINDOW, &values)
    }

    fn add(&mut self, rows: u16, cols: u16, values: &[f32]) -> Block {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let offset = self.bytes.len() as u32;
        self.bytes.extend(&bytes);
        Block { offset, rows, cols, crc: block_crc(&bytes) }
    }
}
