//! How an upload goes.

use serde::{Deserialize, Serialize};

use crate::package::check::PackageError;

/// How far an upload is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Progress {
    /// Bytes stored, without gap from the beginning.
    pub received: u32,
    /// Length of the whole package, bytes.
    pub length: u32,
    /// CRC-32 of the whole package, as announced.
    pub crc: u32,
}

/// Why an upload or a read is refused; the package in force stays.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Refusal {
    /// The package is longer than a bank.
    TooLong {
        /// Announced, bytes.
        length: u32,
        /// Length of a bank, bytes.
        max: u32,
    },
    /// No package is in force.
    NoPackage,
    /// No upload has begun, or it was given up, or the node has restarted since.
    NotBegun,
    /// The chunk does not follow what was received.
    Gap {
        /// Offset of the chunk, bytes.
        offset: u32,
        /// Offset that was expected, bytes.
        received: u32,
    },
    /// The chunk reaches beyond the announced length.
    Overrun {
        /// End of the chunk, bytes.
        end: u32,
        /// Announced length, bytes.
        length: u32,
    },
    /// Commit before everything was received.
    Incomplete {
        /// Received, bytes.
        received: u32,
        /// Announced length, bytes.
        length: u32,
    },
    /// What is in flash is not what was announced.
    Crc {
        /// CRC-32 announced.
        announced: u32,
        /// CRC-32 of what is in flash.
        found: u32,
    },
    /// The header is not one that this node can use.
    Header(PackageError),
    /// Prefix, header and payload together are not as long as the package.
    Length {
        /// Of the package, bytes.
        package: u32,
        /// Of its parts as the header tells, bytes.
        parts: u64,
    },
    /// The flash failed at this offset from the start of the bank.
    Flash {
        /// Bytes.
        offset: u32,
    },
}
