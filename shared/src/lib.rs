//! Everything the node decides or says.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod adxl357;
pub mod bank;
pub mod checksum;
pub mod clock;
pub mod fit;
pub mod frame;
pub mod journal;
pub mod message;
#[cfg(test)]
mod nor_mock;
pub mod package;
pub mod record;
pub mod server;
pub mod slots;
pub mod storage;
