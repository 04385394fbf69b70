//! The node's kernel package: the estimator at a set of speeds, reduced to what a node can apply.

mod coverage;

use std::ops::Range;

use cpcm_shared::decimate;
use cpcm_shared::operator::block_crc;
use cpcm_shared::package::{
    Bin, Block, FORMAT, Group, Header, MAX_BINS, MAX_GROUP_AXLES, MAX_HEADER_LEN, MAX_RANK, MAX_WINDOW,
    Operator, PREFIX_LEN, Provenance, Sensor, Train,
};
use cpcm_shared::sample::{CODES_PER_G, FULL_SCALE_CODE, M_S2_PER_CODE, RAW_RATE_HZ};
use cpcm_shared::storage::Map;
use faer::Mat;
use rayon::prelude::*;

use self::coverage::{Demand, Room, choose, covers};
use crate::forces::{LOW_PASS_HZ, Spread};
use crate::greens::{Chain, GreensFunctions, GreensSampling, Quantity};
use crate::identify::{IdentifiedSite, Misdescription};
use crate::inverse::hierarchy::{GroupKind, kinds};
use crate::inverse::{
    AxleGain, Beyond, Estimator, Excitation, GroupGeometry, InverseError, Prior, Running, TrackModel,
};
use crate::progress::Progress;
use crate::signal::{AntiAlias, HALF_WIDTH_90};

/// Why a package cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum KernelError {
    /// The estimator broke down.
    #[error(transparent)]
    Inverse(#[from] InverseError),
    /// The site does not fit the node's limits.
    #[error("the site has {found} {what}, the node takes at most {limit}")]
    TooMany {
        /// What is too many.
        what: &'static str,
        /// How many.
        found: usize,
        /// How many fit.
        limit: usize,
    },
    /// The node samples at another rate.
    #[error("the site was recorded at {found} Hz, the node samples at {expected} Hz")]
    SampleRate {
        /// Site's rate, Hz.
        found: f64,
        /// Node's rate, Hz.
        expected: f64,
    },
    /// Not one speed bin is small enough for the node.
    #[error(
        "the node has no room for the kernel of any recorded train ({:.1} to {:.1} m/s): at {:.1} m/s it is {} x {} (rank x \
         samples) and {} bytes, the node takes {} x {} and {} bytes; faster trains need less",
        recorded_m_s[0], recorded_m_s[1], smallest.speed_m_s, smallest.rank, smallest.window, smallest.bytes,
        MAX_RANK, MAX_WINDOW, ROOM.bytes
    )]
    TooLarge {
        /// Slowest and fastest recorded train, m/s.
        recorded_m_s: [f64; 2],
        /// The fastest bin that is not above all of them.
        smallest: BinSize,
    },
    /// The calibrated model is none.
    #[error(
        "the calibrated model does not explain the {passages} recordings: a node with its kernel would report wrong forces; see the \
         flags and the report of `cpcm analyse`, or `cpcm diagnose`"
    )]
    Unexplained {
        /// All of them.
        passages: usize,
    },
    /// The panel is another one.
    #[error(
        "the recordings contradict crossing.toml: {0}; a node with this kernel would report wrong forces"
    )]
    Misdescribed(Misdescription),
    /// The header is too long or inconsistent.
    #[error("the package header is refused by the node's own check: {0}")]
    Header(String),
}

/// Relative distances of neighbouring speed bins, in the order in which they are tried: the next where the node has no room for all
/// recorded trains. It blends two bins; at 5 % the blend is accurate to a few per mille (`docs/method.md`).
const BIN_STEPS: [f64; 4] = [0.05, 0.06, 0.07, 0.08];
/// Bins reach this far beyond the slowest and the fastest recorded train.
const BIN_MARGIN: f64 = 0.03;
/// Rate of the node's windows, Hz.
const NODE_RATE_HZ: f64 = RAW_RATE_HZ as f64 / decimate::DECIMATION as f64;
/// Step of the force grid, metres.
const GRID_STEP_M: f64 = 0.025;
/// Singular directions of the operator that change no force by more than this (one standard deviation) are left out,
/// newtons: a thousandth of a usual peak.
const TRUNCATION_N: f64 = 150.0;

/// What the node's sensor takes beside gravity, which it feels as well, m/s².
pub const SENSOR_RANGE_M_S2: f64 = (FULL_SCALE_CODE - CODES_PER_G) as f64 * M_S2_PER_CODE as f64;
/// Noise that stands for the node's windows beyond the host's band, m/s²: more than the largest of signals leaves there.
const BEYOND_M_S2: f64 = 10.0;

/// What the node has room for. The header is well below its largest length, which is set aside for it.
const ROOM: Room = {
    let bank = &Map::node().banks.banks[0];
    Room { bins: MAX_BINS, bytes: (bank.end - bank.start) as usize - MAX_HEADER_LEN - PREFIX_LEN }
};

/// How large the operators of a speed bin are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BinSize {
    /// Speed, m/s.
    pub speed_m_s: f64,
    /// Largest rank of an operator.
    pub rank: usize,
    /// Samples of the longest window.
    pub window: usize,
    /// Bytes of all operators.
    pub bytes: usize,
}

/// A package, and which trains it is for.
#[derive(Clone, Debug, PartialEq)]
pub struct Package {
    /// As uploaded.
    pub bytes: Vec<u8>,
    /// Slowest and fastest speed bin, m/s.
    pub speeds_m_s: [f64; 2],
    /// Speeds of the recorded trains that the node will flag `speed-outside`, m/s, ascending: it has no room for their bins.
    pub outside_m_s: Vec<f64>,
    /// Largest accelerations of the recorded trains under which the node's sensor will clip, m/s², ascending.
    pub beyond_m_s2: Vec<f64>,
}

/// Encodes the package of a calibrated site: the bins of as many of its trains as the node has room for.
pub fn package(site: &IdentifiedSite, progress: &dyn Progress) -> Result<Package, KernelError> {
    let raw_rate = site.site.crossing.sensor.sample_rate_hz;
    if (raw_rate - f64::from(RAW_RATE_HZ)).abs() > 0.5 {
        return Err(KernelError::SampleRate { found: raw_rate, expected: f64::from(RAW_RATE_HZ) });
    }
    let longest = site.pattern.groups().iter().map(|g| g.len).max().unwrap_or(0);
    if longest > MAX_GROUP_AXLES {
        return Err(too_many("axles less than 10 m from one another in a row", longest, MAX_GROUP_AXLES));
    }
    let recorded_m_s = recorded_speeds(site);
    let passages = site.timings.len();
    if recorded_m_s.is_empty() {
        return Err(KernelError::Unexplained { passages });
    }
    if let Some(misdescription) = site.misdescription {
        return Err(KernelError::Misdescribed(misdescription));
    }
    let kinds = kinds(&site.pattern);
    let grid = grid(site.region_m());
    let track = NodeTrack {
        kinds: &kinds,
        grid_m: &grid,
        greens: node_greens(site),
        spreads: Spread::of_classes(site)?,
    };
    let Bins { speeds_m_s, operators, outside_m_s } = track.bins(site, &recorded_m_s, progress)?;
    let mut payload = Vec::new();
    let mut header = header(site, &kinds, &grid)?;
    for (speed, operators) in speeds_m_s.iter().zip(operators) {
        let mut bin = Bin { speed_m_s: *speed as f32, operators: heapless::Vec::new() };
        for parts in operators {
            let operator = parts.store(&mut payload);
            bin.operators
                .push(operator)
                .map_err(|_| too_many("kinds of axle groups", kinds.len(), bin.operators.len()))?;
        }
        header.bins.push(bin).map_err(|_| too_many("speed bins", speeds_m_s.len(), header.bins.len()))?;
    }
    header.payload_len = payload.len() as u32;
    header.check().map_err(|e| KernelError::Header(format!("{e:?}")))?;
    let mut bytes = vec![0; MAX_HEADER_LEN + 64];
    let len = header.encode(&mut bytes).map_err(|e| KernelError::Header(format!("{e:?}")))?;
    bytes.truncate(len);
    bytes.extend(payload);
    let largest_m_s2 = site.recordings.iter().map(|r| r.max_m_s2);
    Ok(Package {
        bytes,
        speeds_m_s: [speeds_m_s[0], speeds_m_s[speeds_m_s.len() - 1]],
        outside_m_s,
        beyond_m_s2: beyond_range(largest_m_s2),
    })
}

/// Those of the largest accelerations of recordings that the node's sensor does not reach, ascending.
fn beyond_range(largest_m_s2: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut beyond: Vec<f64> = largest_m_s2.filter(|a| *a > SENSOR_RANGE_M_S2).collect();
    beyond.sort_by(f64::total_cmp);
    beyond
}

/// Speed bins of a package, ascending.
struct Bins {
    speeds_m_s: Vec<f64>,
    /// Per bin, those of every kind of groups.
    operators: Vec<Vec<Parts>>,
    /// Speeds of recorded trains that none of the bins is for, ascending.
    outside_m_s: Vec<f64>,
}

/// What the operators of all speeds are made of.
struct NodeTrack<'a> {
    kinds: &'a [GroupKind],
    grid_m: &'a [f64],
    greens: GreensFunctions,
    spreads: Vec<Spread>,
}

impl NodeTrack<'_> {
    /// As near one another as there is room for bins of all recorded trains; where there is for none of the distances, those that
    /// are for most trains.
    fn bins(
        &self,
        site: &IdentifiedSite,
        recorded_m_s: &[f64],
        progress: &dyn Progress,
    ) -> Result<Bins, KernelError> {
        let [near, wider @ ..] = BIN_STEPS;
        let mut most = self.bins_apart(near, site, recorded_m_s, progress)?;
        for step in wider {
            if most.outside_m_s.is_empty() {
                break;
            }
            match self.bins_apart(step, site, recorded_m_s, progress) {
                Ok(bins) if bins.outside_m_s.len() < most.outside_m_s.len() => most = bins,
                // Between bins that are farther apart there may be no train at all.
                Ok(_) | Err(KernelError::TooLarge { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(most)
    }

    fn bins_apart(
        &self,
        step: f64,
        site: &IdentifiedSite,
        recorded_m_s: &[f64],
        progress: &dyn Progress,
    ) -> Result<Bins, KernelError> {
        let speeds = bin_speeds(recorded_m_s, step);
        progress.begin("kernel package", speeds.len() as u64);
        let of_speed = |v: &f64| {
            let bin = self.operators(site, *v);
            progress.step();
            bin
        };
        let mut operators: Vec<Vec<Parts>> =
            speeds.par_iter().map(of_speed).collect::<Result<_, InverseError>>()?;
        let (chosen, outside_m_s) = within_room(recorded_m_s, &speeds, &operators)?;
        let operators = operators.drain(chosen.clone()).collect();
        Ok(Bins { speeds_m_s: speeds[chosen].to_vec(), operators, outside_m_s })
    }

    fn operators(&self, site: &IdentifiedSite, speed_m_s: f64) -> Result<Vec<Parts>, InverseError> {
        let spread = &self.spreads[site.class_of(speed_m_s)];
        let of_kind = |(k, kind)| {
            let shared_n = |axle: usize| spread.causes(k, axle, self.grid_m).shared_n();
            operator(site, &self.greens, kind, speed_m_s, (self.grid_m, &shared_n))
        };
        self.kinds.iter().enumerate().map(of_kind).collect()
    }
}

/// Which bins the node has room for, and the speeds of the trains that none of them is for.
fn within_room(
    recorded_m_s: &[f64],
    speeds: &[f64],
    parts: &[Vec<Parts>],
) -> Result<(Range<usize>, Vec<f64>), KernelError> {
    let sizes: Vec<BinSize> = speeds.iter().zip(parts).map(|(v, p)| size(*v, p)).collect();
    let demand = |s: &BinSize| {
        let fits = s.rank <= MAX_RANK && s.window <= MAX_WINDOW;
        Demand { speed_m_s: s.speed_m_s, bytes: fits.then_some(s.bytes) }
    };
    let demands: Vec<Demand> = sizes.iter().map(demand).collect();
    if let Some(range) = choose(&demands, recorded_m_s, ROOM) {
        let outside = recorded_m_s.iter().copied().filter(|v| !covers(&demands[range.clone()], *v)).collect();
        return Ok((range, outside));
    }
    let end = |speed: Option<&f64>| speed.copied().unwrap_or(0.0);
    let (slowest, fastest) = (end(recorded_m_s.first()), end(recorded_m_s.last()));
    // The last bin is above every train.
    let smallest = sizes[sizes.len().saturating_sub(2)];
    Err(KernelError::TooLarge { recorded_m_s: [slowest, fastest], smallest })
}

fn size(speed_m_s: f64, operators: &[Parts]) -> BinSize {
    BinSize {
        speed_m_s,
        rank: operators.iter().map(|p| p.project.nrows()).max().unwrap_or(0),
        window: operators.iter().map(|p| p.project.ncols()).max().unwrap_or(0),
        bytes: operators.iter().map(Parts::bytes).sum(),
    }
}

/// Green's functions as the node sees the track: recorder and decimation filter included.
fn node_greens(site: &IdentifiedSite) -> GreensFunctions {
    let sensor = &site.site.crossing.sensor;
    let chain = Chain::Node {
        antialias: AntiAlias::new(sensor.antialias_order, sensor.antialias_hz),
        taps: decimate::TAPS.iter().map(|t| f64::from(*t)).collect(),
        raw_rate_hz: sensor.sample_rate_hz,
    };
    let sampling = GreensSampling { rate_hz: NODE_RATE_HZ, len: 512, band_hz: [430.0, 498.0] };
    let ballast = &site.ballast.parameters;
    let (track, bed) = (ballast.under(&site.track), ballast.bed(&site.track));
    GreensFunctions::new(&track, &bed, sampling, Quantity::Acceleration, &chain)
}

/// Speeds of the passages that the model explains, m/s, ascending.
fn recorded_speeds(site: &IdentifiedSite) -> Vec<f64> {
    let explained = site.timings.iter().enumerate().filter(|(i, _)| site.explains(*i));
    let mut speeds: Vec<f64> = explained.map(|(_, t)| t.speed_m_s).collect();
    speeds.sort_by(f64::total_cmp);
    speeds
}

/// Speeds of bins at most `step` apart for trains of `recorded_m_s`, ascending, with room on both sides.
fn bin_speeds(recorded_m_s: &[f64], step: f64) -> Vec<f64> {
    let (Some(slowest), Some(fastest)) = (recorded_m_s.first(), recorded_m_s.last()) else {
        return Vec::new();
    };
    let (slowest, fastest) = (slowest * (1.0 - BIN_MARGIN), fastest * (1.0 + BIN_MARGIN));
    let steps = ((fastest / slowest).ln() / step).ceil().max(1.0) as usize;
    (0..=steps).map(|i| slowest * (fastest / slowest).powf(i as f64 / steps as f64)).collect()
}

fn grid([low, high]: [f64; 2]) -> Vec<f64> {
    let count = ((high - low) / GRID_STEP_M).round() as usize + 1;
    (0..count).map(|i| low + i as f64 * GRID_STEP_M).collect()
}

/// Matrices of one operator in double precision.
struct Parts {
    before: usize,
    project: Mat<f64>,
    expand: Mat<f64>,
    offset_n: Vec<f64>,
    half_width_n: Vec<f64>,
    template_m_s2: Vec<f64>,
}

/// `shared_n`: what every wheel of an axle's kind is not known by alike, one standard deviation along the grid, newtons.
fn operator(
    site: &IdentifiedSite,
    greens: &GreensFunctions,
    kind: &GroupKind,
    speed_m_s: f64,
    (grid_m, shared_n): (&[f64], &dyn Fn(usize) -> Vec<f64>),
) -> Result<Parts, InverseError> {
    let geometry = GroupGeometry {
        running: Running { direction: site.direction, speed_m_s, static_force_n: site.usual_force_n() },
        axle_offset_m: &kind.offsets.own,
        train_offset_m: &kind.offsets.train,
    };
    let model = TrackModel { greens, excitation: Excitation::Force };
    let class = &site.classes[site.class_of(speed_m_s)];
    let estimator = Estimator::new(&model, &geometry, &node_prior(site, &class.prior), class.profile())?;
    let gains = estimator.gains(grid_m, LOW_PASS_HZ, class.profile());
    let (g, n) = (grid_m.len(), estimator.len());
    let gain = Mat::from_fn(gains.len() * g, n, |i, k| gains[i / g].gain[(i % g, k)]);
    let base: Vec<f64> = gains.iter().flat_map(|a| a.base_n.clone()).collect();
    let half_width = |(axle, a): (usize, &AxleGain)| -> Vec<f64> {
        let both = a.sd_n.iter().zip(shared_n(axle));
        both.map(|(own_n, shared_n)| HALF_WIDTH_90 * own_n.hypot(shared_n)).collect()
    };
    let half_width_n = gains.iter().enumerate().flat_map(half_width).collect();
    let expand = leading_directions(&gain, &estimator);
    let project = expand.transpose() * &gain;
    let expected = Mat::from_fn(n, 1, |k, _| estimator.expected_m_s2[k]);
    let shift = &expand * (&project * &expected);
    let offset_n = base.iter().enumerate().map(|(i, b)| b - shift[(i, 0)]).collect();
    Ok(Parts {
        before: estimator.before,
        project,
        expand,
        offset_n,
        half_width_n,
        template_m_s2: estimator.expected_m_s2,
    })
}

/// The prior of the host's forces for the node's windows: the same density of noise over frequency at a higher rate, and nothing
/// concluded from beyond the host's band, which the node's windows hold up to half their rate.
fn node_prior(site: &IdentifiedSite, prior: &Prior) -> Prior {
    let GreensSampling { rate_hz, band_hz, .. } = site.greens.sampling;
    Prior {
        noise_m_s2: prior.noise_m_s2 * (NODE_RATE_HZ / rate_hz).sqrt(),
        beyond: Some(Beyond { from_hz: band_hz[1], noise_m_s2: BEYOND_M_S2 }),
        ..prior.clone()
    }
}

/// Left singular vectors of gain × covariance root, as many as the truncation allows: in that metric a left-out
/// direction is a standard deviation of the forces.
fn leading_directions(gain: &Mat<f64>, estimator: &Estimator) -> Mat<f64> {
    let weighted = gain * estimator.covariance_root();
    let rows = weighted.nrows();
    let Ok(svd) = weighted.thin_svd() else { return Mat::identity(rows, rows) };
    let (u, s) = (svd.U(), svd.S().column_vector());
    let mut left_out = vec![0.0; rows];
    let mut rank = s.nrows();
    while rank > 1 {
        let within = left_out.iter_mut().enumerate().all(|(i, v): (usize, &mut f64)| {
            *v += (u[(i, rank - 1)] * s[rank - 1]).powi(2);
            *v <= TRUNCATION_N * TRUNCATION_N
        });
        if !within {
            break;
        }
        rank -= 1;
    }
    u.subcols(0, rank).to_owned()
}

impl Parts {
    /// Bytes that [`Self::store`] takes.
    fn bytes(&self) -> usize {
        let matrices =
            self.project.nrows() * self.project.ncols() + self.expand.nrows() * self.expand.ncols();
        4 * (matrices + self.offset_n.len() + self.half_width_n.len() + self.template_m_s2.len())
    }

    fn store(&self, payload: &mut Vec<u8>) -> Operator {
        Operator {
            before: self.before as u16,
            project: store_matrix(payload, &self.project),
            expand: store_matrix(payload, &self.expand),
            offset_n: store_column(payload, &self.offset_n),
            half_width_n: store_column(payload, &self.half_width_n),
            template_m_s2: store(payload, 1, self.template_m_s2.len(), self.template_m_s2.iter().copied()),
        }
    }
}

fn store_matrix(payload: &mut Vec<u8>, m: &Mat<f64>) -> Block {
    let rows = (0..m.nrows()).flat_map(|i| (0..m.ncols()).map(move |j| m[(i, j)]));
    store(payload, m.nrows(), m.ncols(), rows)
}

fn store_column(payload: &mut Vec<u8>, values: &[f64]) -> Block {
    store(payload, values.len(), 1, values.iter().copied())
}

fn store(payload: &mut Vec<u8>, rows: usize, cols: usize, values: impl Iterator<Item = f64>) -> Block {
    let start = payload.len();
    for value in values {
        payload.extend((value as f32).to_le_bytes());
    }
    Block { offset: start as u32, rows: rows as u16, cols: cols as u16, crc: block_crc(&payload[start..]) }
}

fn header(site: &IdentifiedSite, kinds: &[GroupKind], grid_m: &[f64]) -> Result<Header, KernelError> {
    let crossing = &site.site.crossing;
    let offsets = &site.pattern.offset_m;
    let mut axle_offset_m = heapless::Vec::new();
    for offset in offsets {
        axle_offset_m
            .push(*offset as f32)
            .map_err(|_| too_many("axles", offsets.len(), axle_offset_m.len()))?;
    }
    let mut groups = heapless::Vec::new();
    for group in site.pattern.groups() {
        let operator = kinds.iter().position(|k| k.groups.contains(&group)).unwrap_or(0) as u8;
        let entry = Group { first_axle: group.first as u8, axles: group.len as u8, operator };
        groups.push(entry).map_err(|_| too_many("axle groups", site.pattern.groups().len(), groups.len()))?;
    }
    Ok(Header {
        format: FORMAT,
        provenance: Provenance {
            site: shortened(&crossing.name),
            model_hash: model_hash(site),
            calibrated_on: heapless::String::new(),
            written_by: shortened(concat!("cpcm ", env!("CARGO_PKG_VERSION"))),
        },
        sensor: Sensor {
            sample_rate_hz: RAW_RATE_HZ as f32,
            decimation: decimate::DECIMATION as u8,
            m_s2_per_code: M_S2_PER_CODE,
            range_m_s2: FULL_SCALE_CODE as f32 * M_S2_PER_CODE,
        },
        direction: site.direction as i8,
        train: Train {
            name: shortened(&crossing.vehicle.kind),
            axle_offset_m,
            static_force_n: site.usual_force_n() as f32,
            groups,
        },
        grid_first_m: grid_m[0] as f32,
        grid_step_m: GRID_STEP_M as f32,
        grid_len: grid_m.len() as u16,
        bins: heapless::Vec::new(),
        payload_len: 0,
    })
}

fn too_many(what: &'static str, found: usize, limit: usize) -> KernelError {
    KernelError::TooMany { what, found, limit }
}

/// As many characters as fit.
fn shortened<const N: usize>(text: &str) -> heapless::String<N> {
    let mut out = heapless::String::new();
    for c in text.chars() {
        if out.push(c).is_err() {
            break;
        }
    }
    out
}

/// CRC-64 of everything the operators depend on: site description, ballast, prior, profile.
fn model_hash(site: &IdentifiedSite) -> u64 {
    let mut text = format!("{:?}{:?}", site.site.crossing, site.ballast.parameters);
    for class in &site.classes {
        text.push_str(&format!("{:?}{:?}", class.prior, class.profile()));
    }
    crc::Crc::<u64>::new(&crc::CRC_64_XZ).checksum(text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 40 g less one are 382.5 m/s².
    #[test]
    fn analytic_recordings_beyond_the_range_of_the_sensor() {
        assert_eq!(beyond_range([600.0, 380.0, 384.0].into_iter()), [384.0, 600.0]);
        assert!(beyond_range([238.0].into_iter()).is_empty());
    }
}
