//! Everything the node decides or says.
#![no_std]
#![forbid(unsafe_code)]

pub mod package;
pub mod record;
