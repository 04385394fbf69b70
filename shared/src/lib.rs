//! Everything the node decides or says.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod adxl357;
pub mod checksum;
pub mod frame;
pub mod package;
pub mod record;
