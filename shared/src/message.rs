//! What the field tool and the node say to each other: the message table.
//!
//! Each frame (see [`crate::frame`]) carries one [`Envelope`] in postcard: the tool sends a [`Request`], the node
//! answers with one [`Reply`] of the same `id`. The node never speaks unasked.
//!
//! | request | answer | |
//! |---|---|---|
//! | `Info` | `Info` | who the node is, what it holds, what it has lost |
//! | `SetClock` | `ClockSet` | binds host time to the sample count; tells offset and drift |
//! | `List` | `List` | records from a sequence on, up to [`MAX_LISTED`] |
//! | `Read` | `Record` | a piece of one encoded record |
//! | `UploadBegin` | `Upload` | begins an upload, or goes on with the same one |
//! | `UploadChunk` | `Upload` | the next piece of the package |
//! | `UploadStatus` | `Upload` | how far the upload is |
//! | `UploadCommit` | `Committed` | checks the package and puts it in force |
//! | `UploadAbort` | `Aborted` | gives the upload up |
//! | `Watch` | `Live` | what the sensor sees now |
//! | any | `Refused` | why not |
//!
//! Every request may be repeated when its answer was lost: the second time has no other effect than the first.
//!
//! Compatibility: variants and trailing fields of enums are only appended, never reordered or removed; a change that
//! cannot be expressed so raises [`PROTOCOL_VERSION`]. `Info`, `Refused` and the first two fields of the envelope
//! never change.

use heapless::{String, Vec};
use serde::{Deserialize, Serialize};

use crate::bank;
use crate::clock;
use crate::journal::Extent;

/// Version of this table.
pub const PROTOCOL_VERSION: u8 = 1;
/// Most bytes of a record or package in one message.
pub const MAX_CHUNK: usize = 1024;
/// Most records in one list.
pub const MAX_LISTED: usize = 24;

/// One message.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Envelope<T> {
    /// [`PROTOCOL_VERSION`] of the sender.
    pub version: u8,
    /// Chosen by the tool, repeated by the node, so that a late answer is not taken for another.
    pub id: u16,
    /// The message.
    pub body: T,
}

/// The tool asks.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Request<'a> {
    /// Who are you?
    Info,
    /// It is now this time.
    SetClock {
        /// µs since 1970-01-01 UTC.
        unix_us: u64,
    },
    /// Which records do you have?
    List {
        /// First sequence of interest.
        first: u32,
    },
    /// Give me a piece of a record.
    Read {
        /// Sequence of the record.
        sequence: u32,
        /// First byte.
        offset: u32,
        /// Number of bytes; the node may give fewer.
        length: u16,
    },
    /// A kernel package is coming.
    UploadBegin {
        /// Length of the package, bytes.
        length: u32,
        /// CRC-32 of the whole package.
        crc: u32,
    },
    /// The next piece of it.
    UploadChunk {
        /// First byte.
        offset: u32,
        /// Up to [`MAX_CHUNK`] bytes.
        #[serde(borrow)]
        bytes: &'a [u8],
    },
    /// How far is the upload?
    UploadStatus,
    /// Put the package in force.
    UploadCommit {
        /// CRC-32 of the whole package, as announced.
        crc: u32,
    },
    /// Give the upload up.
    UploadAbort,
    /// What do you see?
    Watch,
}

/// The node answers.
#[allow(clippy::large_enum_variant, reason = "one reply at a time, and no heap to put the list on")]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Reply<'a> {
    /// To any request.
    Refused(Refusal),
    /// To `Info`.
    Info(Info),
    /// To `SetClock`.
    ClockSet(clock::Set),
    /// To `List`.
    List(Listing),
    /// To `Read`.
    Record {
        /// Sequence of the record.
        sequence: u32,
        /// First byte of this piece.
        offset: u32,
        /// Length of the whole encoded record, bytes.
        total: u32,
        /// The piece.
        #[serde(borrow)]
        bytes: &'a [u8],
    },
    /// To `UploadBegin`, `UploadChunk` and `UploadStatus`.
    Upload(bank::Progress),
    /// To `UploadCommit`.
    Committed {
        /// Id of the package now in force.
        kernel_id: u32,
    },
    /// To `UploadAbort`.
    Aborted,
    /// To `Watch`.
    Live(Live),
}

/// Why a request is refused.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Refusal {
    /// The tool speaks another version.
    Version {
        /// Version of the node.
        node: u8,
        /// Version of the request.
        tool: u8,
    },
    /// The request does not decode: unknown to this firmware, or damaged before it was framed.
    Unknown,
    /// The record is not in the journal.
    NoRecord {
        /// Sequence asked for.
        sequence: u32,
        /// What there is.
        extent: Option<Extent>,
    },
    /// The offset is beyond the record.
    Offset {
        /// Asked for, bytes.
        offset: u32,
        /// Length of the record, bytes.
        total: u32,
    },
    /// About the kernel package.
    Package(bank::Refusal),
    /// The node has not read its flash yet, or has no sample yet to set the clock by; ask again.
    Starting,
    /// The answer does not fit in a frame; a fault of the firmware.
    TooLong,
}

/// Who the node is, what it holds and what it has lost.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Info {
    /// [`PROTOCOL_VERSION`] of the node.
    pub protocol: u8,
    /// Serial number.
    pub serial: u64,
    /// Firmware version.
    pub firmware: String<16>,
    /// Board the firmware was built for.
    pub board: String<16>,
    /// The kernel package in force.
    pub kernel: Option<Kernel>,
    /// Longest kernel package, bytes.
    pub kernel_capacity: u32,
    /// Records in the journal.
    pub records: Option<Extent>,
    /// Since start-up.
    pub counters: Counters,
    /// Clock.
    pub clock: clock::State,
}

/// A kernel package.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Kernel {
    /// CRC-32 of its header.
    pub id: u32,
    /// CRC-32 of the whole package.
    pub crc: u32,
    /// Length, bytes.
    pub length: u32,
    /// Site name.
    pub site: String<48>,
    /// Name of the train type.
    pub train: String<16>,
}

/// What has happened since start-up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counters {
    /// Raw samples, the lost ones included.
    pub samples: u64,
    /// Raw samples lost (FIFO overrun).
    pub lost_samples: u64,
    /// Passages detected.
    pub passages: u32,
    /// Passages that were not recorded or whose record was not stored.
    pub lost_passages: u32,
    /// Failures of the sensor's bus.
    pub sensor_errors: u32,
    /// Failures of the flash.
    pub storage_errors: u32,
    /// Frames dropped as damaged.
    pub link_errors: u32,
    /// Most samples found in the sensor's FIFO at one visit; it holds 32, and at 8 it calls.
    pub fifo_deepest: u16,
}

/// A part of the list of records.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Listing {
    /// In order of sequence.
    pub entries: Vec<Entry, MAX_LISTED>,
    /// Where to go on; `None` at the end.
    pub next: Option<u32>,
}

/// One record of the list.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// Sequence.
    pub sequence: u32,
    /// Length encoded, bytes.
    pub length: u16,
    /// CRC-32 of the encoded record, with which it ends.
    pub crc: u32,
    /// See [`crate::record::Record`].
    pub first_axle_sample: u64,
    /// See [`crate::record::Record`].
    pub flags: u16,
    /// Train speed, m/s.
    pub speed_m_s: f32,
    /// Number of wheelsets.
    pub wheelsets: u8,
}

/// What the node is doing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Activity {
    /// No sample has come yet.
    #[default]
    Starting,
    /// No train.
    Quiet,
    /// A train passes.
    Passage,
    /// A passage is being evaluated.
    Evaluating,
    /// No more samples will come and every passage has been evaluated (simulated sensor).
    Ended,
}

/// What the sensor sees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Live {
    /// Raw samples since start-up.
    pub sample: u64,
    /// What the node is doing.
    pub activity: Activity,
    /// Mean of the last full second, m/s² (gravity and bias).
    pub mean_m_s2: f32,
    /// RMS about the mean of the last full second, m/s².
    pub rms_m_s2: f32,
    /// Largest deviation from the mean in the last full second, m/s².
    pub peak_m_s2: f32,
    /// Sequence of the newest record.
    pub last_sequence: Option<u32>,
    /// As in [`Info`].
    pub counters: Counters,
}
