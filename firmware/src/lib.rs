//! The node.
#![no_std]
