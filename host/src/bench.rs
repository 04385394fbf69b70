//! Speed and memory beside the programs that a user would take instead, on the same work.
//!
//! Each job exists twice: as a script ([`peers`]) and as a function of this program ([`job`]). Both run as child processes,
//! one after the other in turn, so that the same load of the machine is on both; CPU time and peak memory are what the
//! operating system counted for the child ([`child`]). A time says little about another machine; the ratio does.

pub mod child;
pub mod growth;
pub mod job;
pub mod peers;
pub mod table;

pub use child::Usage;
pub use job::Job;
pub use table::{Outcome, Row};
