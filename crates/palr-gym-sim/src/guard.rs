//! MuJoCo's steps behind a guard: an error of MuJoCo comes back as a value.
//!
//! The other half is `guard.c`, because only C may jump over C.
#![allow(unsafe_code, reason = "calls into MuJoCo and guard.c")]

use std::ffi::{CStr, c_char, c_int, c_uchar};
use std::sync::{Arc, Once};

use mujoco_rs::mujoco_c::{
    mjData, mjModel, mjrContext, mjvCamera, mjvOption, mjvPerturb, mjvScene,
};
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
    fn palr_gym_guard_try_data(model: *const mjModel) -> c_int;
    fn palr_gym_guard_step(model: *const mjModel, data: *mut mjData, steps: c_int) -> c_int;
    fn palr_gym_guard_forward(model: *const mjModel, data: *mut mjData) -> c_int;
    fn palr_gym_guard_contact_forces(model: *const mjModel, data: *mut mjData) -> c_int;
    fn palr_gym_guard_make_context(model: *const mjModel, context: *mut mjrContext) -> c_int;
    fn palr_gym_guard_resize(width: c_int, height: c_int, context: *mut mjrContext) -> c_int;
    fn palr_gym_guard_update_scene(
        model: *const mjModel,
        data: *mut mjData,
        option: *const mjvOption,
        perturb: *const mjvPerturb,
        camera: *mut mjvCamera,
        scene: *mut mjvScene,
    ) -> c_int;
    fn palr_gym_guard_draw(
        scene: *mut mjvScene,
        context: *mut mjrContext,
        width: c_int,
        height: c_int,
        rgb: *mut c_uchar,
    ) -> c_int;
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

/// `mj_makeData`, which takes no refusal of memory for an answer: whether there is enough is tried in
/// a guard first, because `MjData` itself can only be made outside of one.
pub(crate) fn make_data(model: &Arc<MjModel>) -> Result<MjData<Arc<MjModel>>, EngineError> {
    // SAFETY: the pointer comes from a live reference.
    check(unsafe { palr_gym_guard_try_data(model.ffi()) })?;
    MjData::try_new(Arc::clone(model)).map_err(|error| EngineError { message: error.to_string() })
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
    check(call(model, data))
}

fn check(code: c_int) -> Result<(), EngineError> {
    if code == 0 {
        return Ok(());
    }
    // SAFETY: a terminated text in this thread's own memory, which nothing writes meanwhile.
    let message = unsafe { CStr::from_ptr(palr_gym_guard_last_error()) };
    Err(EngineError { message: message.to_string_lossy().into_owned() })
}

/// `mjr_makeContext`, on a thread with a current OpenGL context.
pub(crate) fn make_context(model: &MjModel, context: &mut mjrContext) -> Result<(), EngineError> {
    // SAFETY: both pointers come from live references; the context holds MuJoCo's defaults.
    check(unsafe { palr_gym_guard_make_context(model.ffi(), context) })
}

/// `mjr_resizeOffscreen`.
pub(crate) fn resize(
    context: &mut mjrContext,
    width: usize,
    height: usize,
) -> Result<(), EngineError> {
    // SAFETY: a context that `make_context` made on this thread.
    check(unsafe { palr_gym_guard_resize(width as c_int, height as c_int, context) })
}

/// What follows from positions for the eye, and `mjv_updateScene`.
pub(crate) fn update_scene(
    data: &mut MjData<Arc<MjModel>>,
    option: &mjvOption,
    perturb: &mjvPerturb,
    camera: &mut mjvCamera,
    scene: &mut mjvScene,
) -> Result<(), EngineError> {
    guarded(data, |model, data| {
        // SAFETY: all pointers come from live references; the scene was made for this model.
        unsafe { palr_gym_guard_update_scene(model, data, option, perturb, camera, scene) }
    })
}

/// `mjr_render` and `mjr_readPixels`: fills `rgb`, `[height, width, 3]`, from below.
pub(crate) fn draw(
    scene: &mut mjvScene,
    context: &mut mjrContext,
    (width, height): (usize, usize),
    rgb: &mut [u8],
) -> Result<(), EngineError> {
    if rgb.len() != width * height * 3 {
        return Err(EngineError { message: "no room for the picture".into() });
    }
    let pixels = rgb.as_mut_ptr();
    // SAFETY: a context of this thread with a framebuffer of that size, and room for its pixels.
    check(unsafe { palr_gym_guard_draw(scene, context, width as c_int, height as c_int, pixels) })
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_memory_is_an_error() {
        install();
        let mut model = MjModel::from_xml_string("<mujoco/>").unwrap();
        // SAFETY: only the size of what is still to be allocated changes: more than there is.
        unsafe { model.ffi_mut() }.narena = 1 << 50;
        let error = make_data(&Arc::new(model)).map(|_| ()).unwrap_err();
        assert!(error.message.contains("allocate"), "{error}");
    }
}
