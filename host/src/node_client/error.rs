//! What can go wrong between the tool and a node.

use std::path::PathBuf;

use cpcm_shared::message::Refusal;
use cpcm_shared::package::check::PackageError;

use super::refusal::{explain, explain_package};
use crate::recording::RecordingError;

/// A request or a transfer failed.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The address names no line.
    #[error("“{address}” is no address of a node: {why}")]
    Address {
        /// As given.
        address: String,
        /// What is wrong.
        why: &'static str,
    },
    /// The line cannot be opened, or it broke and stays away.
    #[error(
        "{line}: the line is broken or cannot be opened; check the cable and the name (`cpcm node ports`)"
    )]
    Line {
        /// Address.
        line: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// The node is silent.
    #[error("{line}: no answer to {attempts} requests; is the node powered, and the baud rate right?")]
    NoAnswer {
        /// How often the request was sent.
        attempts: u32,
        /// Address.
        line: String,
    },
    /// The node refuses.
    #[error("the node refuses: {}", explain(.0))]
    Refused(Refusal),
    /// The node answers with something else than asked for.
    #[error("the node's answer does not belong to the request; node and tool may be of different versions")]
    WrongAnswer,
    /// The request does not fit in a frame; a fault of the tool.
    #[error("the request is too long for a frame")]
    RequestTooLong,
    /// The file is no kernel package.
    #[error("no kernel package for this node: {}", explain_package(.0))]
    Package(PackageError),
    /// The package is not as long as its header tells.
    #[error("the kernel package has {found} bytes, its header tells {expected}; the file is damaged")]
    PackageLength {
        /// Length of the file, bytes.
        found: u64,
        /// Prefix, header and payload, bytes.
        expected: u64,
    },
    /// A block of the package is not what its header says.
    #[error(
        "the kernel package is damaged: its kernel for {speed_m_s:.1} m/s fails its checksum; make or copy it again"
    )]
    PackageDamaged {
        /// Speed of the bin, m/s.
        speed_m_s: f32,
    },
    /// The node has restarted again and again during an upload.
    #[error("the node lost the upload {restarts} times (does it restart?)")]
    Restarts {
        /// How often the upload had to begin anew.
        restarts: u32,
    },
    /// A record arrives damaged although every frame was good.
    #[error(
        "record {sequence} is damaged on the node: its checksum is {found:#010x}, the list tells {listed:#010x}"
    )]
    RecordCrc {
        /// Sequence of the record.
        sequence: u32,
        /// CRC-32 in the list.
        listed: u32,
        /// CRC-32 that came.
        found: u32,
    },
    /// A file cannot be read or written.
    #[error("cannot {doing} {}", path.display())]
    File {
        /// `read`, `write`, …
        doing: &'static str,
        /// Which.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The downloaded records cannot be turned into a table.
    #[error(transparent)]
    Records(#[from] super::RecordsError),
    /// The table cannot be written.
    #[error(transparent)]
    Table(#[from] RecordingError),
}
