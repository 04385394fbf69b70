//! The node's evaluation against a crossing whose answer is known in closed form.
//!
//! Every wheel makes the acceleration `A v² g(v t)`, as a quasi-static deflection does, and "force" is by definition
//! `Q + C A g(x)`. Operators that read g off the window give exactly that back, whatever the speed.

use cpcm_shared::detect::Detector;
use cpcm_shared::evaluate::{Kernel, Scratch, evaluate};
use cpcm_shared::operator::{InMemory, block_crc};
use cpcm_shared::package::{self, Bin, Block, Group, Header, Operator, Provenance, Sensor, Train};
use cpcm_shared::passage::{Buffer, Passage};
use cpcm_shared::record::{Record, flag};
use cpcm_shared::sample::{M_S2_PER_CODE, SensorCode};
use cpcm_shared::sampler::{Event, Sampler};
use cpcm_tests::tolerance;
use embassy_futures::block_on;

const OFFSETS_M: [f64; 8] = [0.0, 2.9, 17.7, 20.6, 24.95, 27.85, 42.65, 45.55];
/// Different wheels.
const SIZE: [f64; 8] = [1.0, 0.95, 1.08, 1.0, 0.9, 1.1, 1.02, 0.97];
const BINS_M_S: [f64; 3] = [38.0, 40.0, 42.0];
const STATIC_N: f64 = 76_000.0;
const DYNAMIC_N: f64 = 50_000.0;
/// Where g has its largest value, 1.
const PEAK_M: f64 = 0.217;
const HALF_WIDTH_N: f64 = 1234.0;
const BEFORE: usize = 60;
const WINDOW: usize = 200;
const GRID: (f64, f64, usize) = (-0.9, 0.02, 121);
/// Acceleration of the signal relative to v², 1/m: 16 m/s² at 40 m/s.
const SHAPE_PER_M: f64 = 0.01;
/// First axle at x = 0, s after start-up.
const FIRST_AXLE_S: f64 = 3.000_37;

fn g(x: f64) -> f64 {
    let u = x - PEAK_M;
    (-(u / 0.35).powi(2)).exp() * (7.0 * u).cos()
}

fn signal(v: f64, offsets_m: &[f64], seconds: f64) -> Vec<SensorCode> {
    let mut noise = 1_u32;
    let at = |k: u32| {
        let t = f64::from(k) / 4000.0 - FIRST_AXLE_S;
        noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let quiet = 0.08 + 0.02 * (f64::from(noise >> 8) / f64::from(1 << 23) - 1.0);
        let wheel = |(w, offset): (usize, &f64)| SIZE[w % 8] * SHAPE_PER_M * v * v * g(v * t - offset);
        SensorCode::from_m_s2(quiet + offsets_m.iter().enumerate().map(wheel).sum::<f64>())
    };
    (0..(seconds * 4000.0) as u32).map(at).collect()
}

/// Matrices one after another.
#[derive(Default)]
struct Payload(Vec<u8>);

impl Payload {
    fn add(&mut self, rows: usize, cols: usize, value: impl Fn(usize, usize) -> f64) -> Block {
        let bytes: Vec<u8> = (0..rows)
            .flat_map(|r| (0..cols).map(move |c| (r, c)))
            .flat_map(|(r, c)| (value(r, c) as f32).to_le_bytes())
            .collect();
        let offset = self.0.len() as u32;
        self.0.extend(&bytes);
        Block { offset, rows: rows as u16, cols: cols as u16, crc: block_crc(&bytes) }
    }
}

/// Weight of sample `k` when a value at `position` is interpolated by a cubic through four samples.
fn lagrange(k: usize, position: f64) -> f64 {
    let first = position.floor() - 1.0;
    let own = k as f64 - first;
    if !(0.0..=3.0).contains(&own) {
        return 0.0;
    }
    let u = position - first;
    (0..4).map(f64::from).filter(|i| *i != own).map(|i| (u - i) / (own - i)).product()
}

fn operator(payload: &mut Payload, v: f64) -> Operator {
    let forces = 2 * GRID.2;
    // Rank is the window less its edges: `project` cuts them off, `expand` interpolates.
    let rank = WINDOW - 10;
    let position = |row: usize| {
        let x = GRID.0 + GRID.1 * (row % GRID.2) as f64;
        BEFORE as f64 + (x + OFFSETS_M[row / GRID.2]) / v * 1000.0
    };
    let scale = DYNAMIC_N / (SHAPE_PER_M * v * v);
    Operator {
        before: BEFORE as u16,
        project: payload.add(rank, WINDOW, |r, c| f64::from(r + 5 == c)),
        expand: payload.add(forces, rank, |r, c| scale * lagrange(c + 5, position(r))),
        offset_n: payload.add(forces, 1, |_, _| STATIC_N),
        half_width_n: payload.add(forces, 1, |_, _| HALF_WIDTH_N),
        template_m_s2: payload.add(1, WINDOW, |_, c| {
            let x = (c as f64 - BEFORE as f64) / 1000.0 * v;
            SHAPE_PER_M * v * v * (g(x) + g(x - OFFSETS_M[1]))
        }),
    }
}

fn kernel_package() -> (Header, Vec<u8>) {
    let mut payload = Payload::default();
    let bin = |v: &f64| {
        let operators = [operator(&mut payload, *v)].into_iter().collect();
        Bin { speed_m_s: *v as f32, operators }
    };
    let bins = BINS_M_S.iter().map(bin).collect();
    let header = Header {
        format: package::FORMAT,
        provenance: Provenance {
            site: "synthetic".try_into().expect("short"),
            model_hash: 0,
            calibrated_on: Default::default(),
            written_by: Default::default(),
        },
        sensor: Sensor {
            sample_rate_hz: 4000.0,
            decimation: 4,
            m_s2_per_code: M_S2_PER_CODE,
            range_m_s2: 392.266,
        },
        direction: 1,
        train: Train {
            name: Default::default(),
            axle_offset_m: OFFSETS_M.iter().map(|x| *x as f32).collect(),
            static_force_n: STATIC_N as f32,
            groups: (0..4).map(|i| Group { first_axle: 2 * i, axles: 2, operator: 0 }).collect(),
        },
        grid_first_m: GRID.0 as f32,
        grid_step_m: GRID.1 as f32,
        grid_len: GRID.2 as u16,
        bins,
        payload_len: payload.0.len() as u32,
    };
    let mut bytes = vec![0; package::MAX_HEADER_LEN];
    header.encode(&mut bytes).expect("fits");
    let (decoded, _) = Header::decode(&bytes).expect("sound");
    assert_eq!(decoded, header);
    (header, payload.0)
}

fn record_passage(codes: &[SensorCode]) -> (Passage, Box<Buffer>) {
    let mut sampler = Sampler::new(Detector::default(), 1);
    let mut buffer = Box::new(Buffer::new());
    for burst in codes.chunks(32) {
        if let Some(event) = sampler.push_burst(burst, Some(&mut buffer)) {
            let Event::Recorded(passage) = event else { panic!("{event:?}") };
            return (passage, buffer);
        }
    }
    match sampler.stop(Some(&mut buffer)) {
        Some(Event::Recorded(passage)) => (passage, buffer),
        other => panic!("no passage: {other:?}"),
    }
}

fn run(codes: &[SensorCode], header: &Header, payload: &[u8]) -> Record {
    let (passage, buffer) = record_passage(codes);
    let mut payload = InMemory(payload);
    let kernel = Kernel { header, id: 99, payload: &mut payload };
    block_on(evaluate(&passage, buffer.samples(), Some(kernel), &mut Scratch::new()))
}

#[test]
fn analytic_forces_times_and_positions() {
    let (header, payload) = kernel_package();
    for v in [38.0, 39.13, 40.9, 42.0, 42.1] {
        let record = run(&signal(v, &OFFSETS_M, 8.0), &header, &payload);
        assert_eq!((record.flags, record.kernel_id, record.sequence), (0, 99, 1), "{v}");
        assert!(
            (f64::from(record.speed_m_s) / v - 1.0).abs() < tolerance::SYNTHETIC_SPEED,
            "{v}: {record:?}"
        );
        let first = record.first_axle_sample as f64 / 4000.0;
        assert!((first - FIRST_AXLE_S).abs() < tolerance::SYNTHETIC_TIME_S + 1.0 / 4000.0, "{v}: {first}");
        assert_eq!(record.wheelsets.len(), 8);
        for (w, wheelset) in record.wheelsets.iter().enumerate() {
            let force = STATIC_N + DYNAMIC_N * SIZE[w];
            let error = f64::from(wheelset.peak_force_n) / force - 1.0;
            assert!(error.abs() < tolerance::SYNTHETIC_FORCE, "{v} m/s, wheel {w}: {wheelset:?}");
            let position = f64::from(wheelset.peak_position_m) - PEAK_M;
            assert!(position.abs() < tolerance::SYNTHETIC_POSITION_M, "{v} m/s, wheel {w}: {wheelset:?}");
            let time = f64::from(wheelset.time_s) - OFFSETS_M[w] / v;
            assert!(time.abs() < tolerance::SYNTHETIC_TIME_S, "{v} m/s, wheel {w}: {time}");
            assert!((f64::from(wheelset.peak_half_width_n) - HALF_WIDTH_N).abs() < 0.1);
            assert!(wheelset.match_quality > 0.98, "{v} m/s, wheel {w}: {wheelset:?}");
        }
    }
}

#[test]
fn property_what_does_not_fit_is_flagged_not_evaluated() {
    let (header, payload) = kernel_package();
    let train = signal(40.5, &OFFSETS_M, 8.0);
    let flags = |codes: &[SensorCode], header: &Header, payload: &[u8]| {
        let record = run(codes, header, payload);
        assert!(record.wheelsets.is_empty());
        record.flags
    };
    assert_eq!(flags(&signal(45.0, &OFFSETS_M, 8.0), &header, &payload), flag::SPEED_OUTSIDE);
    assert_eq!(flags(&signal(40.0, &OFFSETS_M[..6], 8.0), &header, &payload), flag::UNKNOWN_TRAIN);
    let longer: Vec<_> = OFFSETS_M.into_iter().chain([49.9, 52.8, 67.6, 70.5]).collect();
    assert_eq!(flags(&signal(40.0, &longer, 8.0), &header, &payload), flag::UNKNOWN_TRAIN);
    assert_eq!(flags(&train, &header, &payload[..payload.len() / 2]), flag::KERNEL_READ);
    let mut damaged = payload.clone();
    damaged.iter_mut().step_by(1001).for_each(|byte| *byte ^= 4);
    assert_eq!(flags(&train, &header, &damaged), flag::KERNEL_READ);
    let (passage, buffer) = record_passage(&train);
    let none = block_on(evaluate::<InMemory>(&passage, buffer.samples(), None, &mut Scratch::new()));
    assert_eq!(none.flags, flag::NO_KERNEL);
}

#[test]
fn property_slow_trains_and_cut_windows_are_flagged() {
    let (mut header, payload) = kernel_package();
    for (bin, v) in header.bins.iter_mut().zip([10.2, 10.5, 10.8]) {
        bin.speed_m_s = v;
    }
    // Ten times the shape: a wheel that moves the track so little at this speed is rightly not noticed.
    let codes: Vec<_> =
        signal(10.5, &OFFSETS_M, 12.0).iter().map(|code| SensorCode::new(10 * code.get())).collect();
    let slow = run(&codes, &header, &payload);
    assert_eq!((slow.flags, slow.wheelsets.len()), (flag::LOW_SPEED, 8), "{slow:?}");

    let (header, payload) = kernel_package();
    let end = FIRST_AXLE_S + OFFSETS_M[7] / 40.0 + 0.05;
    let cut = run(&signal(40.0, &OFFSETS_M, end), &header, &payload);
    assert_eq!((cut.flags, cut.wheelsets.len()), (flag::WINDOW_CUT, 8));
}

#[test]
fn property_odd_recordings_and_packages_never_panic() {
    let (mut header, payload) = kernel_package();
    let odd = [0.0, 1.0, -1.0, 1e-30, 1e30, f32::MAX, f32::INFINITY, f32::NAN, 20.0, -35.0];
    let mut state = 7_u32;
    let mut next = |below: usize| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as usize % below
    };
    let train = record_passage(&signal(40.0, &OFFSETS_M, 8.0)).1;
    let mut evaluated = 0;
    for round in 0..200 {
        let mut samples = train.samples().to_vec();
        samples.truncate(next(samples.len() + 1));
        for _ in 0..next(5) {
            if let Some(sample) = samples.get_mut(next(4000)) {
                *sample = odd[next(odd.len())];
            }
        }
        header.train.axle_offset_m[7] = [45.55, 45.55, 1e9, f32::MAX][next(4)];
        header.bins[0].speed_m_s = [38.0, 1e-30][next(2)];
        header.bins[2].speed_m_s = [42.0, 1e30][next(2)];
        let mut reader = InMemory(&payload);
        let kernel = Kernel { header: &header, id: round, payload: &mut reader };
        let record = block_on(evaluate(&Passage::default(), &samples, Some(kernel), &mut Scratch::new()));
        assert!(record.wheelsets.iter().all(|w| w.peak_force_n.is_finite()));
        evaluated += usize::from(!record.wheelsets.is_empty());
    }
    assert!(evaluated > 0, "no round comes as far as forces");
}
