//! What strangers may send: fuzz targets as plain functions, and the inputs they start from.
//!
//! Run by `tests/million.rs` with a generator of our own, and by cargo-fuzz with libFuzzer: see
//! README.md.
#![allow(clippy::expect_used, clippy::panic, reason = "that is how a target says what it found")]

pub mod mutate;
pub mod targets;
