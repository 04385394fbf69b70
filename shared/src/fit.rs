//! Does a kernel package fit this node?

use heapless::String;
use serde::{Deserialize, Serialize};

use crate::checksum;
use crate::package::{
    Block, FORMAT, Header, MAGIC, MAX_GRID, MAX_GROUP_AXLES, MAX_HEADER_LEN, MAX_RANK, MAX_WINDOW, Operator,
    PREFIX_LEN,
};

/// What a package must have been computed for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expected {
    /// Raw sampling rate, Hz.
    pub sample_rate_hz: f32,
    /// Decimation from the raw to the window rate.
    pub decimation: u8,
    /// Acceleration of one sensor code, m/s².
    pub m_s2_per_code: f32,
}

/// Why a package does not fit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Misfit {
    /// The first bytes are not those of a package.
    Magic([u8; 8]),
    /// Another layout version.
    Format {
        /// In the package.
        found: u16,
        /// Of this node.
        supported: u16,
    },
    /// The header is longer than the node can hold.
    HeaderLength {
        /// Announced, bytes.
        found: u32,
        /// Longest, bytes.
        max: u32,
    },
    /// The header's checksum is wrong.
    HeaderCrc,
    /// The header does not decode: too many axles, groups, bins or operators, or damaged.
    Undecodable,
    /// The lengths do not add up.
    Length {
        /// Of the whole package, bytes.
        package: u32,
        /// Prefix, header and payload as the header tells, bytes.
        parts: u32,
    },
    /// Another sampling rate.
    SampleRate {
        /// Of the package, Hz.
        found_hz: f32,
        /// Of this node, Hz.
        expected_hz: f32,
    },
    /// Another decimation.
    Decimation {
        /// Of the package.
        found: u8,
        /// Of this node.
        expected: u8,
    },
    /// Another sensor or range.
    Scale {
        /// Of the package, m/s² per code.
        found: f32,
        /// Of this node, m/s² per code.
        expected: f32,
    },
    /// A dimension is zero or too large, or the matrices of an operator do not go together.
    Operator {
        /// Speed bin.
        bin: u8,
        /// Operator in the bin.
        operator: u8,
    },
    /// A matrix reaches beyond the payload.
    Block {
        /// Speed bin.
        bin: u8,
        /// Operator in the bin.
        operator: u8,
        /// End of the matrix, bytes from the start of the payload.
        end: u64,
        /// Length of the payload, bytes.
        payload: u32,
    },
    /// A group has no axle, too many or some beyond the train, or no operator serves it.
    Group {
        /// Index of the group.
        group: u8,
    },
}

/// What the header tells of a package that fits.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// CRC-32 of the header: the kernel id of records.
    pub id: u32,
    /// Site name.
    pub site: String<48>,
    /// Name of the train type.
    pub train: String<16>,
}

/// Length of the header that follows `prefix`, bytes, its checksum included.
pub fn header_length(prefix: &[u8; PREFIX_LEN]) -> Result<usize, Misfit> {
    let [m0, m1, m2, m3, m4, m5, m6, m7, length @ ..] = *prefix;
    let magic = [m0, m1, m2, m3, m4, m5, m6, m7];
    if magic != MAGIC {
        return Err(Misfit::Magic(magic));
    }
    let found = u32::from_le_bytes(length);
    match usize::try_from(found) {
        Ok(length) if length <= MAX_HEADER_LEN => Ok(length),
        _ => Err(Misfit::HeaderLength { found, max: MAX_HEADER_LEN as u32 }),
    }
}

/// Decodes the bytes that follow the prefix (postcard and checksum).
pub fn decode(bytes: &[u8]) -> Result<(u32, Header), Misfit> {
    let content = checksum::verified(bytes).ok_or(Misfit::HeaderCrc)?;
    // The layout version is the first field, so that it can be told apart before anything else may fail.
    let (found, _) = postcard::take_from_bytes::<u16>(content).map_err(|_| Misfit::Undecodable)?;
    if found != FORMAT {
        return Err(Misfit::Format { found, supported: FORMAT });
    }
    match postcard::take_from_bytes::<Header>(content) {
        Ok((header, [])) => Ok((checksum::crc32(content), header)),
        _ => Err(Misfit::Undecodable),
    }
}

/// Checks a header (postcard and checksum) of a package of `package` bytes in all.
pub fn check(bytes: &[u8], package: u32, expected: &Expected) -> Result<Found, Misfit> {
    let (id, header) = decode(bytes)?;
    let parts = (PREFIX_LEN as u64 + bytes.len() as u64).saturating_add(u64::from(header.payload_len));
    if parts != u64::from(package) {
        return Err(Misfit::Length { package, parts: parts.try_into().unwrap_or(u32::MAX) });
    }
    check_sensor(&header, expected)?;
    check_groups(&header)?;
    for (bin, operator, op) in operators(&header) {
        check_operator(&header, bin, operator, op)?;
    }
    Ok(Found { id, site: header.provenance.site, train: header.train.name })
}

fn check_sensor(header: &Header, expected: &Expected) -> Result<(), Misfit> {
    let sensor = &header.sensor;
    // Written so that NaN does not pass.
    let same = |a: f32, b: f32| (a - b).abs() <= 1e-4 * b;
    if !same(sensor.sample_rate_hz, expected.sample_rate_hz) {
        let (found_hz, expected_hz) = (sensor.sample_rate_hz, expected.sample_rate_hz);
        return Err(Misfit::SampleRate { found_hz, expected_hz });
    }
    if sensor.decimation != expected.decimation {
        return Err(Misfit::Decimation { found: sensor.decimation, expected: expected.decimation });
    }
    if !same(sensor.m_s2_per_code, expected.m_s2_per_code) {
        return Err(Misfit::Scale { found: sensor.m_s2_per_code, expected: expected.m_s2_per_code });
    }
    Ok(())
}

fn check_groups(header: &Header) -> Result<(), Misfit> {
    let train = &header.train;
    for (group, g) in (0..).zip(&train.groups) {
        let axles = usize::from(g.axles);
        let in_train = usize::from(g.first_axle) + axles <= train.axle_offset_m.len();
        let served = header.bins.iter().all(|bin| usize::from(g.operator) < bin.operators.len());
        if axles == 0 || axles > MAX_GROUP_AXLES || !in_train || !served {
            return Err(Misfit::Group { group });
        }
    }
    Ok(())
}

fn operators(header: &Header) -> impl Iterator<Item = (u8, u8, &Operator)> {
    (0..)
        .zip(&header.bins)
        .flat_map(|(bin, b)| (0..).zip(&b.operators).map(move |(operator, op)| (bin, operator, op)))
}

fn check_operator(header: &Header, bin: u8, operator: u8, op: &Operator) -> Result<(), Misfit> {
    let grid = usize::from(header.grid_len);
    let (rank, window) = (usize::from(op.project.rows), usize::from(op.project.cols));
    let forces = usize::from(op.expand.rows);
    let size = |block: &Block| (usize::from(block.rows), usize::from(block.cols));
    let good = (1..=MAX_RANK).contains(&rank)
        && (1..=MAX_WINDOW).contains(&window)
        && (1..=MAX_GRID).contains(&grid)
        && (1..=MAX_GROUP_AXLES * grid).contains(&forces)
        && forces.is_multiple_of(grid)
        && usize::from(op.before) <= window
        && size(&op.expand) == (forces, rank)
        && size(&op.offset_n) == (forces, 1)
        && size(&op.half_width_n) == (forces, 1)
        && size(&op.template_m_s2) == (1, window);
    if !good {
        return Err(Misfit::Operator { bin, operator });
    }
    for block in [op.project, op.expand, op.offset_n, op.half_width_n, op.template_m_s2] {
        let end = u64::from(block.offset) + 4 * u64::from(block.rows) * u64::from(block.cols);
        if end > u64::from(header.payload_len) {
            return Err(Misfit::Block { bin, operator, end, payload: header.payload_len });
        }
    }
    Ok(())
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::package::{Bin, Group, Provenance, Sensor, Train};
    use heapless::Vec;
    use std::vec::Vec as StdVec;

    pub(crate) const EXPECTED: Expected =
        Expected { sample_rate_hz: 4000.0, decimation: 4, m_s2_per_code: 7.66e-4 };

    /// A small header: one bin, one operator, two axles; `payload` bytes of matrices.
    pub(crate) fn header(site: &str) -> Header {
        let block = |offset, rows, cols| Block { offset, rows, cols, crc: 0 };
        let operator = Operator {
            before: 2,
            project: block(0, 2, 8),
            expand: block(64, 6, 2),
            offset_n: block(112, 6, 1),
            half_width_n: block(136, 6, 1),
            template_m_s2: block(160, 1, 8),
        };
        Header {
            format: FORMAT,
            provenance: Provenance {
                site: site.try_into().unwrap(),
                model_hash: 7,
                calibrated_on: String::new(),
                written_by: "test".try_into().unwrap(),
            },
            sensor: Sensor {
                sample_rate_hz: 4000.0,
                decimation: 4,
                m_s2_per_code: 7.66e-4,
                range_m_s2: 392.0,
            },
            direction: 1,
            train: Train {
                name: "X2".try_into().unwrap(),
                axle_offset_m: Vec::from_slice(&[0.0, 2.9]).unwrap(),
                static_force_n: 76_000.0,
                groups: Vec::from_slice(&[Group { first_axle: 0, axles: 2, operator: 0 }]).unwrap(),
            },
            grid_first_m: -0.9,
            grid_step_m: 0.01,
            grid_len: 3,
            bins: Vec::from_slice(&[Bin {
                speed_m_s: 40.0,
                operators: Vec::from_slice(&[operator]).unwrap(),
            }])
            .unwrap(),
            payload_len: 192,
        }
    }

    /// The file of `header` with a payload that counts.
    pub(crate) fn package(header: &Header) -> StdVec<u8> {
        let mut encoded = [0; MAX_HEADER_LEN];
        let length = postcard::to_slice(header, &mut encoded).unwrap().len();
        let mut file = MAGIC.to_vec();
        file.extend((length as u32 + 4).to_le_bytes());
        file.extend(&encoded[..length]);
        file.extend(checksum::crc32(&encoded[..length]).to_le_bytes());
        file.extend((0..header.payload_len).map(|k| k as u8));
        file
    }

    fn checked(header: &Header) -> Result<Found, Misfit> {
        let file = package(header);
        let length = header_length(file.first_chunk().unwrap())?;
        check(&file[PREFIX_LEN..PREFIX_LEN + length], file.len() as u32, &EXPECTED)
    }

    #[test]
    fn property_good_header_is_found_with_its_id() {
        let found = checked(&header("GN 648")).unwrap();
        assert_eq!((found.site.as_str(), found.train.as_str()), ("GN 648", "X2"));
        assert_ne!(found.id, checked(&header("GN 649")).unwrap().id);
    }

    #[test]
    fn property_each_misfit_is_named() {
        let refused = |change: fn(&mut Header)| {
            let mut header = header("x");
            change(&mut header);
            checked(&header).unwrap_err()
        };
        assert_eq!(refused(|h| h.format = 2), Misfit::Format { found: 2, supported: 1 });
        assert_eq!(refused(|h| h.sensor.decimation = 2), Misfit::Decimation { found: 2, expected: 4 });
        let rate = Misfit::SampleRate { found_hz: 2000.0, expected_hz: 4000.0 };
        assert_eq!(refused(|h| h.sensor.sample_rate_hz = 2000.0), rate);
        assert!(matches!(refused(|h| h.sensor.m_s2_per_code = f32::NAN), Misfit::Scale { .. }));
        assert_eq!(refused(|h| h.train.groups[0].axles = 3), Misfit::Group { group: 0 });
        assert_eq!(refused(|h| h.train.groups[0].operator = 1), Misfit::Group { group: 0 });
        let operator = Misfit::Operator { bin: 0, operator: 0 };
        assert_eq!(refused(|h| h.grid_len = 0), operator);
        assert_eq!(refused(|h| h.bins[0].operators[0].expand.cols = 3), operator);
        assert_eq!(refused(|h| h.bins[0].operators[0].before = 9), operator);
        let block = Misfit::Block { bin: 0, operator: 0, end: 192, payload: 188 };
        assert_eq!(refused(|h| h.payload_len = 188), block);
    }

    #[test]
    fn property_every_bit_flip_of_prefix_and_header_is_refused() {
        let file = package(&header("GN 648"));
        let end = PREFIX_LEN + header_length(file.first_chunk().unwrap()).unwrap();
        for bit in 0..8 * end {
            let mut bad = file.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            let found = header_length(bad.first_chunk().unwrap()).and_then(|length| {
                check(bad.get(PREFIX_LEN..PREFIX_LEN + length).unwrap_or(&[]), bad.len() as u32, &EXPECTED)
            });
            assert!(found.is_err(), "bit {bit}");
        }
    }

    proptest::proptest! {
        #[test]
        fn property_arbitrary_bytes_never_panic(bytes in proptest::collection::vec(0u8.., 0..600)) {
            let mut sealed = bytes.clone();
            sealed.extend(checksum::crc32(&bytes).to_le_bytes());
            let _ = check(&sealed, 1000, &EXPECTED);
        }
    }
}
