//! Refusals in words: what, and what to do.

use cpcm_shared::bank;
use cpcm_shared::message::Refusal;
use cpcm_shared::package::FORMAT;
use cpcm_shared::package::check::PackageError;

/// What a refusal means to the person at the tool.
pub fn explain(refusal: &Refusal) -> String {
    match refusal {
        Refusal::Version { node, tool } => {
            format!("it speaks protocol {node}, this program {tool}; update the older of the two")
        }
        Refusal::Unknown => "its firmware does not know this request; update the firmware".into(),
        Refusal::NoRecord { sequence, extent: Some(extent) } => format!(
            "record {sequence} is not in its journal, which holds {} records from {} to {}",
            extent.count, extent.first, extent.last
        ),
        Refusal::NoRecord { sequence, extent: None } => {
            format!("record {sequence} is not in its journal, which is empty")
        }
        Refusal::Offset { offset, total } => format!("byte {offset} is beyond the record's {total} bytes"),
        Refusal::Package(refusal) => format!("{}; the package in force stays", package(refusal)),
        Refusal::Starting => "it is still reading its flash, or its sensor gives no samples; try again in some seconds, and see the \
             sensor errors of `cpcm node info`".into(),
        Refusal::TooLong => "its answer does not fit in a frame; report this".into(),
    }
}

/// What is wrong with a file that is to be a kernel package, and what to do.
pub fn explain_package(error: &PackageError) -> String {
    let what = match error {
        PackageError::Magic => "it is another kind of file, or an empty one".into(),
        PackageError::HeaderLength(bytes) => format!("its header is said to have {bytes} bytes"),
        PackageError::TooShort { needed, given } => {
            format!("it has {given} bytes, {needed} at least are needed")
        }
        PackageError::HeaderCrc { stored, computed } => {
            format!("its header has checksum {computed:#010x} instead of {stored:#010x}, it is damaged")
        }
        PackageError::Encoding => "its header does not decode".into(),
        PackageError::Format(found) => format!("its layout is {found}, this program knows {FORMAT}"),
        other => format!("{other:?}"),
    };
    format!("{what}; make it with `cpcm kernel`")
}

fn package(refusal: &bank::Refusal) -> String {
    use bank::Refusal::*;
    match refusal {
        TooLong { length, max } => format!("the package has {length} bytes, there is room for {max}"),
        NoPackage => "no package is in force".into(),
        NotBegun => "no upload is going on".into(),
        Gap { offset, received } => format!("byte {offset} does not follow the {received} received"),
        Overrun { end, length } => format!("byte {end} is beyond the announced {length}"),
        Incomplete { received, length } => format!("only {received} of {length} bytes have arrived"),
        Crc { announced, found } => {
            format!(
                "the package in its flash has checksum {found:#010x} instead of {announced:#010x}; upload again"
            )
        }
        Header(error) => format!("the package does not fit this node: {}", explain_package(error)),
        Length { package, parts } => {
            format!("the package has {package} bytes, its header tells {parts}; the file is damaged")
        }
        Flash { offset } => format!("its flash fails at byte {offset} of the bank"),
    }
}
