//! The settings that a method starts with on a task, from the files in `trainer/configs/`.

use palr_gym_core::{EnvId, Mask};
use serde::Deserialize;
use serde_json::{Map, Value};

use super::{Algorithm, TrainConfig};
use crate::learning::error::TrainError;

/// A file of `trainer/configs/`.
#[derive(Deserialize)]
struct MethodFile {
    /// Whatever the task.
    default: Map<String, Value>,
    /// By `TASK-wN`: what differs there.
    #[serde(default)]
    settings: Map<String, Value>,
}

/// The text of a method's file.
fn text(algorithm: Algorithm) -> &'static str {
    match algorithm {
        Algorithm::Bc => include_str!("../../../configs/bc.toml"),
        Algorithm::Kf => include_str!("../../../configs/kf.toml"),
        Algorithm::Primenet => include_str!("../../../configs/primenet.toml"),
        Algorithm::Rap => include_str!("../../../configs/rap.toml"),
        Algorithm::Fca => include_str!("../../../configs/fca.toml"),
        Algorithm::Mine => include_str!("../../../configs/mine.toml"),
        Algorithm::Palr => include_str!("../../../configs/palr.toml"),
        Algorithm::PalrAct => include_str!("../../../configs/palr_act.toml"),
        Algorithm::Vib => include_str!("../../../configs/vib.toml"),
        Algorithm::Dt => include_str!("../../../configs/dt.toml"),
        Algorithm::DtPalr => include_str!("../../../configs/dt_palr.toml"),
    }
}

/// The settings of `algorithm` for the environment `env_id`, such as `hopper-w2`.
///
/// They are those of the paper's Tables 7 and 8 where it has any for the task with this stack; for
/// another task, mask or stack they are the method's general ones. An id that cannot be read is
/// another task's.
///
/// # Errors
/// [`TrainError::Setting`] or [`TrainError::UnknownSetting`] if the method's file is wrong, which a
/// test holds off.
pub fn defaults(algorithm: Algorithm, env_id: &str) -> Result<TrainConfig, TrainError> {
    let wrong = |message: String| TrainError::Setting {
        message: format!("configs/{}.toml: {message}", algorithm.name()),
    };
    let file: MethodFile =
        toml::from_str(text(algorithm)).map_err(|error| wrong(error.to_string()))?;
    let mut layer = Value::Object(file.default);
    if let Some(settings) = key(env_id).and_then(|key| file.settings.get(&key)) {
        merge(&mut layer, settings);
    }
    merge(&mut layer, &serde_json::json!({ "algorithm": algorithm }));
    TrainConfig::from_json(layer)
}

/// `TASK-wN` of an environment of the paper's kind.
fn key(env_id: &str) -> Option<String> {
    let id: EnvId = env_id.parse().ok()?;
    (id.mask == Mask::Paper).then(|| format!("{}-w{}", id.task, id.frame_stack))
}

/// Puts `upper` over `lower`, key by key.
fn merge(lower: &mut Value, upper: &Value) {
    match (lower, upper) {
        (Value::Object(lower), Value::Object(upper)) => {
            for (key, value) in upper {
                merge(lower.entry(key.clone()).or_insert(Value::Null), value);
            }
        }
        (lower, upper) => *lower = upper.clone(),
    }
}

#[cfg(test)]
mod tests;
