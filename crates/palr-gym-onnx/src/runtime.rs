//! ONNX Runtime, loaded when the first model needs it.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use ort::environment::Environment;

use crate::error::OnnxError;

const LIBRARY: &str = "libonnxruntime.so";

static ENVIRONMENT: OnceLock<Result<Environment, OnnxError>> = OnceLock::new();

/// The process's one environment.
///
/// The library is looked for at `$PALR_GYM_ONNXRUNTIME`; beside the executable, in `../lib` from
/// it; where set-up put it when this was built; and at last wherever the system's loader looks.
///
/// # Errors
/// [`OnnxError::RuntimeMissing`] with every path that was tried. It does not try again.
pub fn environment() -> Result<&'static Environment, OnnxError> {
    ENVIRONMENT.get_or_init(load).as_ref().map_err(Clone::clone)
}

fn load() -> Result<Environment, OnnxError> {
    let candidates = match std::env::var_os("PALR_GYM_ONNXRUNTIME") {
        Some(path) => vec![PathBuf::from(path)],
        None => candidates(),
    };
    let tried =
        || candidates.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ");
    let fail = |message: String| OnnxError::RuntimeMissing { tried: tried(), message };
    // A bare name is left to the system's loader; anything else must exist.
    let found =
        candidates.iter().find(|path| path.parent() == Some(Path::new("")) || path.exists());
    let Some(path) = found else {
        return Err(fail("no such file".into()));
    };
    ort::init_from(path)
        .map_err(|error| fail(error.to_string()))?
        .with_name("palr-gym")
        .with_telemetry(false)
        .build()
        .map_err(|error| fail(error.to_string()))
}

fn candidates() -> Vec<PathBuf> {
    let mut candidates = Vec::new();
    let executable = std::env::current_exe().ok();
    if let Some(folder) = executable.as_deref().and_then(Path::parent) {
        candidates.push(folder.join(LIBRARY));
        candidates.push(folder.join("../lib").join(LIBRARY));
    }
    let built_with = env!("PALR_GYM_NATIVE_DIR");
    if !built_with.is_empty() {
        candidates.push(Path::new(built_with).join(LIBRARY));
    }
    candidates.push(PathBuf::from(LIBRARY));
    candidates
}
