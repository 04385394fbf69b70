//! Range checks against physics: whether one passage can be what its columns say.

use std::collections::HashMap;

use super::{Crossing, Passage, PassageFault, Sensor, Skipped};

/// Longest recording accepted, samples: a 1000 m freight train at 10 m/s and 20 kHz, twice over.
pub const MAX_SAMPLES: usize = 4_000_000;
/// Most passages accepted in one site directory.
pub const MAX_PASSAGES: usize = 100_000;

/// Slowest and fastest train, m/s. 90 m/s is 324 km/h; 110 km/h written into the column exceeds it.
const SPEED_M_S: (f64, f64) = (5.0, 90.0);
/// Empty light axle to heavy-haul axle, kg. Rules out tonnes (below) and newtons (above).
const AXLE_LOAD_KG: (f64, f64) = (4_000.0, 45_000.0);
/// At the sensor, °C. Rules out kelvin.
pub const TEMPERATURE_C: (f64, f64) = (-60.0, 90.0);
/// Sampling rates agree when they differ by less than this; a real clock error is not visible here, because
/// both numbers are nominal.
const RATE_TOLERANCE: f64 = 1e-3;
/// The quietest tenth of a second of a recording holds the sensor noise and nothing else. Below this part of
/// the nominal noise the unit is wrong (g gives 0.1).
const QUIET_FRACTION: f64 = 0.3;
/// The analog filter overshoots the range a little before quantisation clips; 2 % is rounding.
const RANGE_MARGIN: f64 = 1.02;
/// A train that the sensor cannot see; any passage in the unit m/s² exceeds it.
const NO_TRAIN_M_S2: f64 = 2.0;

/// Accepts or refuses passages one by one and keeps the list of the refused.
pub(super) struct Gate<'a> {
    crossing: &'a Crossing,
    file: &'a str,
    rows_by_id: HashMap<i32, usize>,
    pub(super) passages: Vec<Passage>,
    pub(super) skipped: Vec<Skipped>,
}

impl<'a> Gate<'a> {
    pub(super) fn new(crossing: &'a Crossing, file: &'a str) -> Self {
        Gate { crossing, file, rows_by_id: HashMap::new(), passages: Vec::new(), skipped: Vec::new() }
    }

    /// Files a row under the usable passages or under the skipped ones.
    pub(super) fn admit(&mut self, row: usize, passage_id: Option<i32>, read: Result<Passage, PassageFault>) {
        let checked = read.and_then(|passage| {
            self.check_identifier(row, passage.passage_id)?;
            check_passage(&passage, self.crossing)?;
            Ok(passage)
        });
        match checked {
            Ok(passage) => self.passages.push(passage),
            Err(fault) => {
                let reason = format!("{}, row {row}: {fault}", self.file);
                self.skipped.push(Skipped { passage_id, row, reason });
            }
        }
    }

    /// The first row keeps the identifier: results then still name one recording each.
    fn check_identifier(&mut self, row: usize, passage_id: i32) -> Result<(), PassageFault> {
        match self.rows_by_id.get(&passage_id) {
            Some(&first_row) => Err(PassageFault::DuplicateId { passage_id, first_row }),
            None => {
                self.rows_by_id.insert(passage_id, row);
                Ok(())
            }
        }
    }
}

/// Stretch at both ends of a recording that must be quiet, s.
const END_S: f64 = 0.05;
/// It is not where its RMS is that many times that of the quietest stretch, and this share of the whole recording's: under a bogie, where
/// half of all cuts fall. Between bogies a cut is no louder than a sleeper or a mount that rings on after the train, which is sound (0.25 of
/// the whole on a simulated site); there the misfit of the identification tells.
const END_OF_QUIET: f64 = 3.0;
const END_OF_TRAIN: f64 = 0.5;

/// While the track shakes, no sensor gives the same value for this long, s, but at its range.
const HELD_S: f64 = 0.02;
/// The track shakes where the RMS of as long a stretch before or after is that many times the sensor's noise: quiet track may well be one
/// value, in a file with few digits.
const SHAKES: f64 = 5.0;
/// Values above this share of the largest may be those of a transducer that clips.
const TOP: f64 = 0.95;

/// Refuses a passage whose values cannot be in the units that the columns name.
pub fn check_passage(passage: &Passage, crossing: &Crossing) -> Result<(), PassageFault> {
    in_range("axle_load_kg", passage.axle_load_kg, AXLE_LOAD_KG, "kg", "is it in tonnes or newtons?")?;
    if let Some(speed) = passage.speed_m_s {
        in_range("speed_m_s", speed, SPEED_M_S, "m/s", "is it in km/h? Divide by 3.6")?;
    }
    in_range(
        "temperature_c",
        passage.temperature_c,
        TEMPERATURE_C,
        "°C",
        "is it in kelvin? Subtract 273.15",
    )?;
    let expected = crossing.sensor.sample_rate_hz;
    let value = passage.sample_rate_hz;
    if !value.is_finite() || (value - expected).abs() > RATE_TOLERANCE * expected {
        return Err(PassageFault::SampleRate { value, expected });
    }
    check_samples(&passage.acceleration_m_s2)?;
    check_duration(passage, crossing)?;
    check_level(&passage.acceleration_m_s2, crossing)
}

fn in_range(
    column: &'static str,
    value: f64,
    (min, max): (f64, f64),
    unit: &'static str,
    hint: &'static str,
) -> Result<(), PassageFault> {
    if !value.is_finite() {
        return Err(PassageFault::NotFinite { column, value });
    }
    if value < min || value > max {
        return Err(PassageFault::OutOfRange { column, value, min, max, unit, hint });
    }
    Ok(())
}

fn check_samples(samples: &[f32]) -> Result<(), PassageFault> {
    if samples.is_empty() {
        return Err(PassageFault::EmptyRecording);
    }
    if samples.len() > MAX_SAMPLES {
        return Err(PassageFault::LongRecording { samples: samples.len(), limit: MAX_SAMPLES });
    }
    match samples.iter().position(|a| !a.is_finite()) {
        Some(sample) => Err(PassageFault::SampleNotFinite { sample, value: samples[sample] }),
        None => Ok(()),
    }
}

/// All axles must fit into the recording at the given speed (5 % allowed), or at the highest one.
fn check_duration(passage: &Passage, crossing: &Crossing) -> Result<(), PassageFault> {
    let seconds = passage.acceleration_m_s2.len() as f64 / passage.sample_rate_hz;
    let needed = crossing.vehicle.axle_base_m() / (1.05 * passage.speed_m_s.unwrap_or(SPEED_M_S.1));
    if seconds < needed { Err(PassageFault::ShortRecording { seconds, needed }) } else { Ok(()) }
}

fn check_level(samples: &[f32], crossing: &Crossing) -> Result<(), PassageFault> {
    let sensor = &crossing.sensor;
    let mean = samples.iter().map(|&a| f64::from(a)).sum::<f64>() / samples.len() as f64;
    let absolute = samples.iter().fold(0.0, |peak: f64, &a| peak.max(f64::from(a).abs()));
    let peak = samples.iter().fold(0.0, |peak: f64, &a| peak.max((f64::from(a) - mean).abs()));
    if absolute > RANGE_MARGIN * sensor.range_m_s2 {
        return Err(PassageFault::BeyondRange { peak: absolute, range: sensor.range_m_s2 });
    }
    if peak < NO_TRAIN_M_S2 {
        return Err(PassageFault::NoTrain { peak });
    }
    check_held(samples, sensor)?;
    let noise = quietest_rms(samples, (sensor.sample_rate_hz / 10.0) as usize);
    if noise < QUIET_FRACTION * sensor.noise_rms_m_s2 {
        return Err(PassageFault::TooQuiet { noise, nominal: sensor.noise_rms_m_s2 });
    }
    check_ends(samples, sensor.sample_rate_hz, noise)
}

/// A recorder that holds one value, or fills a gap with one.
fn check_held(samples: &[f32], sensor: &Sensor) -> Result<(), PassageFault> {
    let longest = (HELD_S * sensor.sample_rate_hz) as usize;
    let largest = samples.iter().fold(0.0_f32, |l, a| l.max(a.abs()));
    let shakes = |stretch: &[f32]| !stretch.is_empty() && rms(stretch) > SHAKES * sensor.noise_rms_m_s2;
    let mut end = 0;
    for run in samples.chunk_by(|a, b| a == b) {
        let start = end;
        end += run.len();
        let clipped = f64::from(run[0].abs()) >= TOP * f64::from(largest);
        let beside =
            [&samples[start.saturating_sub(longest)..start], &samples[end..samples.len().min(end + longest)]];
        if run.len() > longest && !clipped && beside.into_iter().any(shakes) {
            let seconds = run.len() as f64 / sensor.sample_rate_hz;
            return Err(PassageFault::Held { value: f64::from(run[0]), seconds });
        }
    }
    Ok(())
}

/// A recording that begins or ends under a bogie: the track is anything but quiet there.
fn check_ends(samples: &[f32], rate_hz: f64, quiet: f64) -> Result<(), PassageFault> {
    let window = ((END_S * rate_hz) as usize).clamp(1, samples.len());
    let least = (END_OF_QUIET * quiet).max(END_OF_TRAIN * rms(samples));
    let ends = [("begins", &samples[..window]), ("ends", &samples[samples.len() - window..])];
    match ends.into_iter().map(|(end, w)| (end, rms(w))).find(|(_, level)| *level > least) {
        Some((end, level)) => Err(PassageFault::TrainCut { end, level, quiet }),
        None => Ok(()),
    }
}

/// RMS about the mean, m/s².
fn rms(values: &[f32]) -> f64 {
    let mean = values.iter().map(|&a| f64::from(a)).sum::<f64>() / values.len() as f64;
    (values.iter().map(|&a| (f64::from(a) - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
}

/// RMS about the mean of the quietest window of `window` samples, m/s².
fn quietest_rms(samples: &[f32], window: usize) -> f64 {
    samples.chunks_exact(window.max(1)).map(rms).fold(f64::INFINITY, f64::min)
}
