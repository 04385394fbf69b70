//! Decoding a package's header and refusing what does not fit this node, with the reason.

use serde::{Deserialize, Serialize};

use heapless::{String, Vec};

use super::{
    Bin, Block, FORMAT, Header, MAGIC, MAX_GRID, MAX_GROUP_AXLES, MAX_HEADER_LEN, MAX_RANK, MAX_WINDOW,
    Operator, PREFIX_LEN, Provenance, Sensor, Train,
};
use crate::checksum::{LEN as CRC_LEN, crc32};
use crate::decimate::DECIMATION;
use crate::sample::{FULL_SCALE_CODE, M_S2_PER_CODE, RAW_RATE_HZ};

/// Sensor constants are the same when they agree to this relative precision: f32 rounding on both sides.
const SAME: f32 = 1e-5;

/// Why a package is refused.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum PackageError {
    /// It does not begin with [`MAGIC`].
    Magic,
    /// The header is longer than the node accepts, or shorter than its CRC; bytes.
    HeaderLength(u32),
    /// Fewer bytes than needed.
    TooShort {
        /// Bytes needed.
        needed: usize,
        /// Bytes given.
        given: usize,
    },
    /// The header's CRC does not match.
    HeaderCrc {
        /// CRC in the package.
        stored: u32,
        /// CRC of the bytes.
        computed: u32,
    },
    /// The header is no postcard of [`Header`], or a list in it is longer than the node can hold.
    Encoding,
    /// Another version of the layout.
    Format(u16),
    /// A direction that is neither 1 nor −1.
    Direction(i8),
    /// A sensor constant is not this node's.
    Sensor {
        /// Which.
        field: SensorField,
        /// In the package.
        package: f32,
        /// On this node.
        node: f32,
    },
    /// A number is not finite or not in its range.
    Number {
        /// Which.
        field: NumberField,
        /// Its value.
        value: f32,
    },
    /// Axle offsets must begin with 0 and ascend; this one does not.
    AxleOrder {
        /// Axle in the train pattern.
        axle: usize,
    },
    /// Fewer than two axles: no speed can be found.
    Axles(usize),
    /// Groups must cover all axles in order, with 1 to [`MAX_GROUP_AXLES`] each; this one does not.
    Group {
        /// Number of the group; the number of groups when the last axles belong to none.
        group: usize,
        /// First axle it should have.
        expected_first: usize,
    },
    /// A force grid of no or too many points.
    Grid(u16),
    /// There are no speed bins.
    NoBins,
    /// Speeds of the bins must ascend; this one does not.
    BinOrder {
        /// Number of the bin.
        bin: usize,
    },
    /// A group uses an operator that a bin does not have.
    NoOperator {
        /// Number of the bin.
        bin: usize,
        /// Number of the operator.
        operator: u8,
    },
    /// A block has another shape than its place demands.
    Shape {
        /// Number of the bin.
        bin: usize,
        /// Which block.
        block: BlockField,
        /// Rows and columns in the header.
        found: (u16, u16),
        /// Rows and columns expected, or the most that are allowed.
        expected: (usize, usize),
    },
    /// A block is not aligned to 4 bytes or reaches beyond the payload.
    Bounds {
        /// Number of the bin.
        bin: usize,
        /// Which block.
        block: BlockField,
        /// Where it begins.
        offset: u32,
        /// Where it ends.
        end: u64,
        /// Length of the payload.
        payload_len: u32,
    },
    /// More samples before the group's time than the window has.
    Before {
        /// Number of the bin.
        bin: usize,
        /// Samples before.
        before: u16,
        /// Length of the window.
        window: u16,
    },
}

/// Sensor constants that are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SensorField {
    /// Raw sampling rate, Hz.
    SampleRate,
    /// Decimation.
    Decimation,
    /// m/s² per code.
    Scale,
    /// Full scale, m/s².
    Range,
}

/// Numbers that are checked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum NumberField {
    /// Offset of an axle, m.
    AxleOffset,
    /// Static wheel force, N.
    StaticForce,
    /// First point of the force grid, m.
    GridFirst,
    /// Step of the force grid, m.
    GridStep,
    /// Speed of a bin, m/s.
    BinSpeed,
}

/// Blocks of an operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum BlockField {
    /// [`Operator::project`].
    Project,
    /// [`Operator::expand`].
    Expand,
    /// [`Operator::offset_n`].
    Offset,
    /// [`Operator::half_width_n`].
    HalfWidth,
    /// [`Operator::template_m_s2`].
    Template,
}

/// Length in bytes of the header that follows a prefix of [`PREFIX_LEN`] bytes.
pub fn header_len(prefix: &[u8]) -> Result<usize, PackageError> {
    let short = PackageError::TooShort { needed: PREFIX_LEN, given: prefix.len() };
    let (magic, rest) = prefix.split_first_chunk::<{ MAGIC.len() }>().ok_or(short)?;
    let length = u32::from_le_bytes(*rest.first_chunk::<4>().ok_or(short)?);
    if *magic != MAGIC {
        return Err(PackageError::Magic);
    }
    match usize::try_from(length) {
        Ok(n) if n > CRC_LEN && n <= MAX_HEADER_LEN => Ok(n),
        _ => Err(PackageError::HeaderLength(length)),
    }
}

/// Postcard and CRC of the header of a package.
fn checked_postcard(package: &[u8]) -> Result<(&[u8], u32), PackageError> {
    let needed = PREFIX_LEN + header_len(package)?;
    let short = PackageError::TooShort { needed, given: package.len() };
    let bytes = package.get(PREFIX_LEN..needed).ok_or(short)?;
    let (postcard, stored) = bytes.split_last_chunk::<CRC_LEN>().ok_or(short)?;
    let (stored, computed) = (u32::from_le_bytes(*stored), crc32(postcard));
    if stored != computed {
        return Err(PackageError::HeaderCrc { stored, computed });
    }
    Ok((postcard, stored))
}

impl Header {
    /// Decodes and checks the header of a package, given at least its first `PREFIX_LEN + header_len` bytes.
    /// Also returns the header's CRC, by which the package is known in records.
    pub fn decode(package: &[u8]) -> Result<(Self, u32), PackageError> {
        let mut header = Self::empty();
        let crc = header.decode_into(package)?;
        Ok((header, crc))
    }

    /// A header to decode into.
    pub const fn empty() -> Self {
        let provenance = Provenance {
            site: String::new(),
            model_hash: 0,
            calibrated_on: String::new(),
            written_by: String::new(),
        };
        let sensor = Sensor { sample_rate_hz: 0.0, decimation: 0, m_s2_per_code: 0.0, range_m_s2: 0.0 };
        let train =
            Train { name: String::new(), axle_offset_m: Vec::new(), static_force_n: 0.0, groups: Vec::new() };
        Header {
            format: 0,
            provenance,
            sensor,
            direction: 0,
            train,
            grid_first_m: 0.0,
            grid_step_m: 0.0,
            grid_len: 0,
            bins: Vec::new(),
            payload_len: 0,
        }
    }

    /// Like [`decode`](Self::decode), into memory that is there. Bin by bin: as one value, with what serde keeps on
    /// the way, it takes 60 kB of stack on the MCU. After an error, what is there is not to be used.
    pub fn decode_into(&mut self, package: &[u8]) -> Result<u32, PackageError> {
        let (postcard, crc) = checked_postcard(package)?;
        // Before anything that another version may have changed.
        match postcard::take_from_bytes::<u16>(postcard) {
            Ok((FORMAT, _)) => {}
            Ok((other, _)) => return Err(PackageError::Format(other)),
            Err(_) => return Err(PackageError::Encoding),
        }
        self.fill(postcard).map_err(|_| PackageError::Encoding)?;
        self.check()?;
        Ok(crc)
    }

    fn fill(&mut self, postcard: &[u8]) -> postcard::Result<()> {
        type Head = (u16, Provenance, Sensor, i8, Train, f32, f32, u16);
        let (head, rest) = postcard::take_from_bytes::<Head>(postcard)?;
        (self.format, self.provenance, self.sensor, self.direction, self.train, ..) = head;
        (.., self.grid_first_m, self.grid_step_m, self.grid_len) = head;
        let (count, mut rest) = postcard::take_from_bytes::<u32>(rest)?;
        self.bins.clear();
        for _ in 0..count {
            let (bin, after) = postcard::take_from_bytes::<Bin>(rest)?;
            self.bins.push(bin).map_err(|_| postcard::Error::SerializeBufferFull)?;
            rest = after;
        }
        (self.payload_len, _) = postcard::take_from_bytes::<u32>(rest)?;
        Ok(())
    }

    /// Writes prefix, header and CRC; returns how many bytes they take. `HeaderLength` when `out` is too small.
    pub fn encode(&self, out: &mut [u8]) -> Result<usize, PackageError> {
        let too_long = PackageError::HeaderLength(out.len() as u32);
        let (prefix, body) = out.split_at_mut_checked(PREFIX_LEN).ok_or(too_long)?;
        let used = postcard::to_slice(self, body).map_err(|_| too_long)?.len();
        let (postcard, rest) = body.split_at_mut_checked(used).ok_or(too_long)?;
        let crc = crc32(postcard).to_le_bytes();
        *rest.first_chunk_mut::<CRC_LEN>().ok_or(too_long)? = crc;
        let (magic, length) = prefix.split_at_mut(MAGIC.len());
        magic.copy_from_slice(&MAGIC);
        length.copy_from_slice(&((used + CRC_LEN) as u32).to_le_bytes());
        Ok(PREFIX_LEN + used + CRC_LEN)
    }

    /// Checks everything that the node relies on.
    pub fn check(&self) -> Result<(), PackageError> {
        if self.format != FORMAT {
            return Err(PackageError::Format(self.format));
        }
        if self.direction.unsigned_abs() != 1 {
            return Err(PackageError::Direction(self.direction));
        }
        self.check_sensor()?;
        self.check_train()?;
        self.check_groups()?;
        self.check_grid()?;
        self.check_bins()
    }

    fn check_sensor(&self) -> Result<(), PackageError> {
        let sensor = &self.sensor;
        let range = FULL_SCALE_CODE as f32 * M_S2_PER_CODE;
        let constants = [
            (SensorField::SampleRate, sensor.sample_rate_hz, RAW_RATE_HZ as f32),
            (SensorField::Decimation, f32::from(sensor.decimation), DECIMATION as f32),
            (SensorField::Scale, sensor.m_s2_per_code, M_S2_PER_CODE),
            (SensorField::Range, sensor.range_m_s2, range),
        ];
        for (field, package, node) in constants {
            let same = (package - node).abs() <= SAME * node; // false for NaN
            if !same {
                return Err(PackageError::Sensor { field, package, node });
            }
        }
        Ok(())
    }

    fn check_train(&self) -> Result<(), PackageError> {
        let offsets = &self.train.axle_offset_m;
        if offsets.len() < 2 {
            return Err(PackageError::Axles(offsets.len()));
        }
        let mut previous = None;
        for (axle, &value) in offsets.iter().enumerate() {
            finite(NumberField::AxleOffset, value)?;
            if previous.map_or(value == 0.0, |before| value > before) {
                previous = Some(value);
            } else {
                return Err(PackageError::AxleOrder { axle });
            }
        }
        positive(NumberField::StaticForce, self.train.static_force_n)
    }

    fn check_groups(&self) -> Result<(), PackageError> {
        let mut expected_first = 0;
        let axles = self.train.axle_offset_m.len();
        for (number, group) in self.train.groups.iter().enumerate() {
            let count = usize::from(group.axles);
            let fits = usize::from(group.first_axle) == expected_first
                && (1..=MAX_GROUP_AXLES).contains(&count)
                && expected_first + count <= axles;
            if !fits {
                return Err(PackageError::Group { group: number, expected_first });
            }
            expected_first += count;
        }
        if expected_first == axles {
            Ok(())
        } else {
            Err(PackageError::Group { group: self.train.groups.len(), expected_first })
        }
    }

    fn check_grid(&self) -> Result<(), PackageError> {
        finite(NumberField::GridFirst, self.grid_first_m)?;
        positive(NumberField::GridStep, self.grid_step_m)?;
        if (1..=MAX_GRID).contains(&usize::from(self.grid_len)) {
            Ok(())
        } else {
            Err(PackageError::Grid(self.grid_len))
        }
    }

    fn check_bins(&self) -> Result<(), PackageError> {
        if self.bins.is_empty() {
            return Err(PackageError::NoBins);
        }
        let mut slower = 0.0;
        for (number, bin) in self.bins.iter().enumerate() {
            positive(NumberField::BinSpeed, bin.speed_m_s)?;
            if bin.speed_m_s <= slower {
                return Err(PackageError::BinOrder { bin: number });
            }
            slower = bin.speed_m_s;
            for operator in &bin.operators {
                self.check_operator(number, operator)?;
            }
            for group in &self.train.groups {
                let missing = PackageError::NoOperator { bin: number, operator: group.operator };
                let operator = bin.operators.get(usize::from(group.operator)).ok_or(missing)?;
                let rows = usize::from(group.axles) * usize::from(self.grid_len);
                let rank = usize::from(operator.expand.cols);
                shape(number, BlockField::Expand, operator.expand, (rows, rank))?;
            }
        }
        Ok(())
    }

    fn check_operator(&self, bin: usize, operator: &Operator) -> Result<(), PackageError> {
        let Operator { before, project, expand, offset_n, half_width_n, template_m_s2 } = *operator;
        let rank = usize::from(project.rows);
        let window = usize::from(project.cols);
        let forces = usize::from(expand.rows);
        if !(1..=MAX_RANK).contains(&rank) || !(1..=MAX_WINDOW).contains(&window) {
            let found = (project.rows, project.cols);
            let expected = (MAX_RANK, MAX_WINDOW);
            return Err(PackageError::Shape { bin, block: BlockField::Project, found, expected });
        }
        shape(bin, BlockField::Expand, expand, (forces, rank))?;
        shape(bin, BlockField::Offset, offset_n, (forces, 1))?;
        shape(bin, BlockField::HalfWidth, half_width_n, (forces, 1))?;
        shape(bin, BlockField::Template, template_m_s2, (1, window))?;
        if before >= project.cols {
            return Err(PackageError::Before { bin, before, window: project.cols });
        }
        let blocks = [
            (BlockField::Project, project),
            (BlockField::Expand, expand),
            (BlockField::Offset, offset_n),
            (BlockField::HalfWidth, half_width_n),
            (BlockField::Template, template_m_s2),
        ];
        blocks.into_iter().try_for_each(|(field, block)| self.check_bounds(bin, field, block))
    }

    fn check_bounds(&self, bin: usize, block: BlockField, place: Block) -> Result<(), PackageError> {
        let Block { offset, rows, cols, .. } = place;
        let end = u64::from(offset) + 4 * u64::from(rows) * u64::from(cols);
        if offset.is_multiple_of(4) && end <= u64::from(self.payload_len) {
            Ok(())
        } else {
            Err(PackageError::Bounds { bin, block, offset, end, payload_len: self.payload_len })
        }
    }
}

fn shape(bin: usize, block: BlockField, found: Block, expected: (usize, usize)) -> Result<(), PackageError> {
    let found = (found.rows, found.cols);
    if (usize::from(found.0), usize::from(found.1)) == expected {
        Ok(())
    } else {
        Err(PackageError::Shape { bin, block, found, expected })
    }
}

fn finite(field: NumberField, value: f32) -> Result<(), PackageError> {
    if value.is_finite() { Ok(()) } else { Err(PackageError::Number { field, value }) }
}

fn positive(field: NumberField, value: f32) -> Result<(), PackageError> {
    if value.is_finite() && value > 0.0 { Ok(()) } else { Err(PackageError::Number { field, value }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::package::{Bin, Group, Provenance, Sensor, Train};
    use heapless::{String, Vec};
    use proptest::prelude::*;
    extern crate std;

    fn block(offset: u32, rows: u16, cols: u16) -> Block {
        Block { offset, rows, cols, crc: 0 }
    }

    fn operator() -> Operator {
        Operator {
            before: 3,
            project: block(0, 2, 10),
            expand: block(80, 6, 2),
            offset_n: block(128, 6, 1),
            half_width_n: block(128, 6, 1),
            template_m_s2: block(152, 1, 10),
        }
    }

    /// One bogie, three points of the grid, two bins.
    fn header() -> Header {
        let bin = |speed_m_s| Bin { speed_m_s, operators: Vec::from_slice(&[operator()]).unwrap() };
        Header {
            format: FORMAT,
            provenance: Provenance {
                site: String::new(),
                model_hash: 1,
                calibrated_on: String::new(),
                written_by: String::new(),
            },
            sensor: Sensor {
                sample_rate_hz: 4000.0,
                decimation: 4,
                m_s2_per_code: 7.661_445e-4,
                range_m_s2: 392.266,
            },
            direction: 1,
            train: Train {
                name: String::new(),
                axle_offset_m: Vec::from_slice(&[0.0, 2.9]).unwrap(),
                static_force_n: 76_000.0,
                groups: Vec::from_slice(&[Group { first_axle: 0, axles: 2, operator: 0 }]).unwrap(),
            },
            grid_first_m: -0.9,
            grid_step_m: 0.01,
            grid_len: 3,
            bins: Vec::from_slice(&[bin(40.0), bin(41.0)]).unwrap(),
            payload_len: 192,
        }
    }

    fn encoded(header: &Header) -> std::vec::Vec<u8> {
        let mut bytes = std::vec![0; MAX_HEADER_LEN];
        let used = header.encode(&mut bytes).unwrap();
        bytes.truncate(used);
        bytes
    }

    #[test]
    fn property_round_trip() {
        let header = header();
        let (decoded, id) = Header::decode(&encoded(&header)).unwrap();
        assert_eq!(decoded, header);
        assert_ne!(id, 0);
    }

    #[test]
    fn property_each_defect_is_named() {
        use PackageError as E;
        type Case = (fn(&mut Header), fn(&PackageError) -> bool);
        let mut cases: std::vec::Vec<Case> = std::vec::Vec::new();
        cases.push((|h| h.format = 9, |e| *e == E::Format(9)));
        cases.push((|h| h.direction = 0, |e| *e == E::Direction(0)));
        cases.push((
            |h| h.sensor.sample_rate_hz = 2000.0,
            |e| matches!(e, E::Sensor { field: SensorField::SampleRate, .. }),
        ));
        cases.push((
            |h| h.sensor.m_s2_per_code = f32::NAN,
            |e| matches!(e, E::Sensor { field: SensorField::Scale, .. }),
        ));
        cases.push((|h| h.train.axle_offset_m[1] = 0.0, |e| *e == E::AxleOrder { axle: 1 }));
        cases.push((|h| h.train.axle_offset_m.truncate(1), |e| *e == E::Axles(1)));
        cases.push((|h| h.train.static_force_n = f32::INFINITY, |e| matches!(e, E::Number { .. })));
        cases.push((|h| h.train.groups[0].axles = 1, |e| *e == E::Group { group: 1, expected_first: 1 }));
        cases.push((|h| h.train.groups[0].axles = 3, |e| *e == E::Group { group: 0, expected_first: 0 }));
        cases.push((|h| h.train.groups[0].operator = 1, |e| *e == E::NoOperator { bin: 0, operator: 1 }));
        cases.push((|h| h.grid_len = 0, |e| *e == E::Grid(0)));
        cases.push((|h| h.grid_step_m = 0.0, |e| matches!(e, E::Number { .. })));
        cases.push((
            |h| h.grid_len = 4,
            |e| matches!(e, E::Shape { block: BlockField::Expand, expected: (8, 2), .. }),
        ));
        cases.push((|h| h.bins.clear(), |e| *e == E::NoBins));
        cases.push((|h| h.bins[1].speed_m_s = 40.0, |e| *e == E::BinOrder { bin: 1 }));
        cases.push((
            |h| h.bins[1].operators[0].before = 10,
            |e| *e == E::Before { bin: 1, before: 10, window: 10 },
        ));
        cases.push((
            |h| h.bins[0].operators[0].project.cols = 2000,
            |e| matches!(e, E::Shape { block: BlockField::Project, .. }),
        ));
        cases.push((
            |h| h.bins[0].operators[0].template_m_s2.offset = u32::MAX - 3,
            |e| matches!(e, E::Bounds { block: BlockField::Template, .. }),
        ));
        cases.push((|h| h.payload_len = 191, |e| matches!(e, E::Bounds { end: 192, payload_len: 191, .. })));
        for (number, (spoil, expected)) in cases.into_iter().enumerate() {
            let mut header = header();
            spoil(&mut header);
            let error = Header::decode(&encoded(&header)).unwrap_err();
            assert!(expected(&error), "case {number}: {error:?}");
        }
    }

    #[test]
    fn property_damaged_bytes_are_refused() {
        let bytes = encoded(&header());
        for k in 0..bytes.len() {
            let mut bytes = bytes.clone();
            bytes[k] ^= 0x10;
            assert!(Header::decode(&bytes).is_err(), "byte {k}");
        }
        for len in 0..bytes.len() {
            assert!(Header::decode(&bytes[..len]).is_err(), "length {len}");
        }
    }

    proptest! {
        #[test]
        fn property_arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..600)) {
            let _ = Header::decode(&bytes);
            // The same as postcard behind a valid prefix and CRC.
            let mut package = MAGIC.to_vec();
            package.extend((bytes.len() as u32 + 4).to_le_bytes());
            package.extend(&bytes);
            package.extend(crc32(&bytes).to_le_bytes());
            let _ = Header::decode(&package);
        }

        #[test]
        fn property_arbitrary_changes_never_panic(at in 0_usize..400, value in any::<u8>()) {
            let mut bytes = encoded(&header());
            let end = bytes.len() - CRC_LEN;
            if (PREFIX_LEN..end).contains(&at) {
                bytes[at] = value;
            }
            let crc = crc32(&bytes[PREFIX_LEN..end]).to_le_bytes();
            bytes[end..].copy_from_slice(&crc);
            let _ = Header::decode(&bytes);
        }
    }
}
