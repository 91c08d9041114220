//! MuJoCo's steps behind a guard: an error of MuJoCo comes back as a value.
//!
//! The other half is `guard.c`, because only C may jump over C.
#![allow(unsafe_code, reason = "calls into MuJoCo and guard.c")]

use std::ffi::{CStr, c_char, c_int};
use std::sync::{Arc, Once};

use mujoco_rs::mujoco_c::{mjData, mjModel};
use mujoco_rs::prelude::{MjData, MjModel};

/// MuJoCo reported an error in the middle of a computation. The simulation's data is half done and
/// must be thrown away.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("MuJoCo failed: {message}")]
pub struct EngineError {
    /// What MuJoCo said.
    pub message: String,
}

unsafe extern "C" {
    fn palr_gym_guard_install();
    fn palr_gym_guard_last_error() -> *const c_char;
    fn palr_gym_guard_step(model: *const mjModel, data: *mut mjData, steps: c_int) -> c_int;
    fn palr_gym_guard_forward(model: *const mjModel, data: *mut mjData) -> c_int;
    fn palr_gym_guard_contact_forces(model: *const mjModel, data: *mut mjData) -> c_int;
}

static INSTALLED: Once = Once::new();

/// Routes MuJoCo's messages to `tracing` and its errors to the guards. Comes before the first model;
/// may be repeated.
pub(crate) fn install() {
    INSTALLED.call_once(|| {
        // SAFETY: MuJoCo's handler is a plain global. No model exists yet, so no thread is inside
        // of MuJoCo, and `call_once` keeps others out.
        unsafe { palr_gym_guard_install() };
    });
}

/// `mj_step`, `steps` times.
pub(crate) fn step(data: &mut MjData<Arc<MjModel>>, steps: u32) -> Result<(), EngineError> {
    guarded(data, |model, data| {
        // SAFETY: both pointers come from live references, and the model is the data's own.
        unsafe { palr_gym_guard_step(model, data, steps as c_int) }
    })
}

/// `mj_forward`.
pub(crate) fn forward(data: &mut MjData<Arc<MjModel>>) -> Result<(), EngineError> {
    guarded(data, |model, data| {
        // SAFETY: both pointers come from live references, and the model is the data's own.
        unsafe { palr_gym_guard_forward(model, data) }
    })
}

/// `mj_rnePostConstraint`.
pub(crate) fn contact_forces(data: &mut MjData<Arc<MjModel>>) -> Result<(), EngineError> {
    guarded(data, |model, data| {
        // SAFETY: both pointers come from live references, and the model is the data's own.
        unsafe { palr_gym_guard_contact_forces(model, data) }
    })
}

fn guarded(
    data: &mut MjData<Arc<MjModel>>,
    call: impl FnOnce(*const mjModel, *mut mjData) -> c_int,
) -> Result<(), EngineError> {
    let model: *const mjModel = data.model().ffi();
    // SAFETY: MuJoCo itself is what changes the struct; nothing else touches it meanwhile.
    let data: *mut mjData = unsafe { data.ffi_mut() };
    if call(model, data) == 0 {
        return Ok(());
    }
    // SAFETY: a terminated text in this thread's own memory, which nothing writes meanwhile.
    let message = unsafe { CStr::from_ptr(palr_gym_guard_last_error()) };
    Err(EngineError { message: message.to_string_lossy().into_owned() })
}

/// Called by `guard.c` for every message but errors that a guard catches.
///
/// # Safety
/// `func` and `body` are null or terminated texts, `subject` is a terminated text.
#[unsafe(no_mangle)]
unsafe extern "C" fn palr_gym_log(
    level: c_int,
    func: *const c_char,
    subject: *const c_char,
    body: *const c_char,
) {
    let text = |text: *const c_char| {
        if text.is_null() {
            return String::new();
        }
        // SAFETY: the caller's promise.
        unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned()
    };
    let (func, subject, body) = (text(func), text(subject), text(body));
    match level {
        0 => tracing::debug!(target: "mujoco", func, body, "{subject}"),
        1 => tracing::info!(target: "mujoco", func, body, "{subject}"),
        2 => tracing::warn!(target: "mujoco", func, body, "{subject}"),
        _ => tracing::error!(target: "mujoco", func, body, "{subject}"),
    }
}
