//! Where MuJoCo's own messages go.

use crate::guard;

/// Sends MuJoCo's warnings and errors to `tracing` instead of to the console and a file in the
/// working directory. Compiling a scene does it too; call it first thing in `main` to be early.
pub fn route_to_log() {
    guard::install();
}

/// Version of the MuJoCo library that is linked, such as "3.17.0".
#[must_use]
pub fn mujoco_version() -> &'static str {
    mujoco_rs::mujoco_version()
}
