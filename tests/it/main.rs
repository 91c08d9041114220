//! What must hold across crates and transports.
//!
//! Servers run in this process on sockets of their own; nothing sleeps to wait for something.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test may stop where it stands")]
#![allow(missing_docs, unreachable_pub, reason = "a test's name is its documentation")]

mod architecture;
mod dm_env_rpc;
mod drain;
mod errors;
mod leakage;
mod render;
mod rollouts;
mod same_bits;
mod sessions;
mod snapshot;
mod stream;
mod support;
mod toy;
