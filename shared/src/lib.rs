//! Everything the node decides or says.
//!
//! In data order: [`sample`] codes are filtered and decimated ([`decimate`]), a train is noticed ([`detect`]) and
//! recorded ([`passage`]), all by [`sampler`]; its speed and axles are found ([`timing`]), the windows around the
//! axle groups are cut out ([`resample`], [`window`]), the operators of the kernel [`package`] are applied
//! ([`operator`]) and the force [`peaks`] are picked, all by [`evaluate`]; what remains is a [`record`].
//!
//! Around that: the sensor ([`adxl357`]); what is kept in flash ([`storage`]: [`journal`] of records, kernel [`bank`],
//! [`clock`]), with a [`limit`] to its waits; and the link to the field tool ([`frame`], [`message`], [`server`]).
//!
//! The arithmetic is plain f32 in a fixed order, so the same samples give the same bits on the PC and on the MCU.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod acquire;
pub mod adxl357;
pub mod bank;
pub mod checksum;
pub mod clock;
pub mod decimate;
pub mod detect;
pub mod evaluate;
pub mod frame;
pub mod image;
pub mod journal;
pub mod kaiser;
pub mod limit;
pub mod message;
#[cfg(test)]
mod nor_mock;
pub mod operator;
pub mod pace;
pub mod package;
pub mod passage;
pub mod peaks;
pub mod record;
pub mod resample;
pub mod sample;
pub mod sampler;
pub mod server;
pub mod slots;
pub mod storage;
pub mod timing;
pub mod window;
