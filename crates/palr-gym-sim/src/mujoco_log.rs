//! Where MuJoCo's own messages go.
#![allow(unsafe_code, reason = "MuJoCo's log handler is a process-wide global")]

use std::sync::Once;

static ROUTED: Once = Once::new();

/// Sends MuJoCo's warnings and errors to the `log` crate (and so to `tracing`) instead of to the
/// console and a file in the working directory. Call it first thing in `main`.
pub fn route_to_log() {
    ROUTED.call_once(|| {
        // SAFETY: called at the start of the program, before any thread uses MuJoCo.
        unsafe { mujoco_rs::logging::install_logging_hook() };
    });
}

/// Version of the MuJoCo library that is linked, such as "3.17.0".
#[must_use]
pub fn mujoco_version() -> &'static str {
    mujoco_rs::mujoco_version()
}
