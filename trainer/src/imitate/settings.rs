//! What a run is to do, put together from layers.
//!
//! A setting has one name everywhere: in a TOML file, after `--set`, in `run.json`. Settings of
//! the data and of the evaluation stand beside those of the learner
//! ([`TrainConfig`]); a later layer wins, key by key.

use std::path::{Path, PathBuf};

use palr_gym_data::{HeldOut, Selection};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::error::ClientError;
use crate::learning::config::from_json;
use crate::learning::{self, Algorithm, TrainConfig, TrainError};

/// Which rows are held out.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HeldOutSettings {
    /// How many; 0 for none.
    pub rows: usize,
    /// Least number of episodes to spread them over. Consecutive rows depend on each other.
    pub min_episodes: usize,
    /// Consecutive rows from this one on instead, as the paper does (900000).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start: Option<usize>,
}

impl Default for HeldOutSettings {
    fn default() -> Self {
        Self { rows: 2000, min_episodes: 20, start: None }
    }
}

/// How the policy is evaluated on the server while it trains.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EvaluationSettings {
    /// Steps between two evaluations, taken with the first report at or after; 0 for none. The
    /// finished policy is evaluated too.
    pub every: u64,
    /// Episodes of an evaluation.
    pub episodes: u32,
    /// Episode i is reset with seed + i; the same in every evaluation of a run.
    pub seed: u64,
}

impl Default for EvaluationSettings {
    fn default() -> Self {
        Self { every: 10_000, episodes: 20, seed: 0 }
    }
}

/// Settings of a run besides the learner's.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RunSettings {
    /// Environment as which the policy sees the data, such as `hopper-w2`.
    pub env: String,
    /// A D4RL file with full observations.
    pub data: PathBuf,
    /// Rows at its beginning to train on.
    pub training_rows: usize,
    /// Rows to report on that are not trained on.
    pub held_out: HeldOutSettings,
    /// Evaluation beside training.
    pub evaluation: EvaluationSettings,
}

impl Default for RunSettings {
    /// The paper's 30 000 rows.
    fn default() -> Self {
        Self {
            env: String::new(),
            data: PathBuf::new(),
            training_rows: 30_000,
            held_out: HeldOutSettings::default(),
            evaluation: EvaluationSettings::default(),
        }
    }
}

impl RunSettings {
    /// Which rows are held out, if any.
    #[must_use]
    pub fn held_out_selection(&self) -> Option<Selection> {
        let HeldOutSettings { rows, min_episodes, start } = self.held_out;
        let held_out = match start {
            Some(start) => HeldOut::slice(start, rows),
            None => HeldOut::spread(rows, min_episodes),
        };
        (rows > 0).then(|| held_out.after(self.training_rows))
    }
}

/// Everything that is set of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Data and evaluation.
    pub run: RunSettings,
    /// The learner.
    pub train: TrainConfig,
}

impl Settings {
    /// Lays `layers` over the defaults, the last on top. Each is an object as [`Self::to_json`]
    /// makes it, with any part of its keys.
    ///
    /// # Errors
    /// [`ClientError::Train`]: a key that does not exist, with the nearest one that does; a value
    /// that no run can have. A missing `env` or `data`.
    pub fn from_layers(layers: &[Value]) -> Result<Self, ClientError> {
        let mut named = Value::Object(Map::new());
        for layer in layers {
            refuse_unknown(layer)?;
            merge(&mut named, layer);
        }
        let mut all = defaults(&named)?;
        merge(&mut all, &named);
        let mut train = into_object(all);
        let mut run = Map::new();
        for key in into_object(to_value(&RunSettings::default())).keys() {
            if let Some(value) = train.remove(key) {
                run.insert(key.clone(), value);
            }
        }
        let run = from_json::<RunSettings>(Value::Object(run))?;
        let train = TrainConfig::from_json(Value::Object(train))?;
        let settings = Self { run, train };
        settings.validate()?;
        Ok(settings)
    }

    fn validate(&self) -> Result<(), ClientError> {
        let run = &self.run;
        let wrong = |message: &str| Err(setting(message));
        if run.env.is_empty() {
            return wrong("env is not set; expected an environment such as hopper-w2");
        }
        if run.data.as_os_str().is_empty() {
            return wrong("data is not set; expected the path of a D4RL HDF5 file");
        }
        if run.training_rows == 0 {
            return wrong("training_rows is 0; expected at least 1");
        }
        if run.held_out.rows == 1 {
            return wrong("held_out.rows is 1; expected 0 for none, or at least 2");
        }
        if run.evaluation.episodes == 0 {
            return wrong("evaluation.episodes is 0; expected at least 1");
        }
        Ok(())
    }

    /// Refuses to go on with `changed` settings that would make another run.
    ///
    /// # Errors
    /// [`ClientError::RunFolder`].
    pub fn check_continued(&self, folder: &Path, changed: &Self) -> Result<(), ClientError> {
        let mut run = changed.run.clone();
        run.evaluation = self.run.evaluation.clone();
        if run == self.run && changed.train.continues(&self.train) {
            return Ok(());
        }
        let message = "holds a run with other settings; those that may change on resuming are \
            steps, log_every, checkpoint_every, metric_rows and those of the evaluation";
        Err(ClientError::RunFolder { path: folder.into(), message: message.to_owned() })
    }

    /// One object with every setting.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let mut all = into_object(to_value(&self.run));
        all.extend(into_object(to_value(&self.train)));
        Value::Object(all)
    }

    /// The same as TOML, as a file for a layer.
    ///
    /// # Errors
    /// None in practice.
    pub fn to_toml(&self) -> Result<String, ClientError> {
        let mut all = self.to_json();
        drop_nulls(&mut all);
        toml::to_string(&all).map_err(setting)
    }
}

/// A layer from the text of a TOML file.
///
/// # Errors
/// [`ClientError::Train`] with line and column.
pub fn layer_from_toml(text: &str) -> Result<Value, ClientError> {
    toml::from_str(text).map_err(|error| setting(error.to_string().trim_end()))
}

/// A layer from `KEY=VALUE`. The key may have dots; the value is TOML's, or a plain text.
///
/// # Errors
/// [`ClientError::Train`] without a `=`.
pub fn layer_from_assignment(text: &str) -> Result<Value, ClientError> {
    let Some((key, value)) = text.split_once('=') else {
        return Err(setting(format!("{text:?} sets nothing; expected KEY=VALUE")));
    };
    let (key, value) = (key.trim(), value.trim());
    let parsed = toml::from_str::<Map<String, Value>>(&format!("value = {value}"));
    let value = match parsed.ok().and_then(|mut table| table.remove("value")) {
        Some(value) => value,
        None => Value::String(value.to_owned()),
    };
    Ok(nest(key, value))
}

/// `{"a": {"b": value}}` of the key `a.b`.
#[must_use]
pub fn nest(key: &str, value: Value) -> Value {
    key.rsplit('.').fold(value, |inner, name| {
        let mut object = Map::new();
        object.insert(name.to_owned(), inner);
        Value::Object(object)
    })
}

/// Puts `upper` over `lower`, key by key.
pub fn merge(lower: &mut Value, upper: &Value) {
    match (lower, upper) {
        (Value::Object(lower), Value::Object(upper)) => {
            for (key, value) in upper {
                match lower.get_mut(key) {
                    Some(inner) => merge(inner, value),
                    None => {
                        lower.insert(key.clone(), value.clone());
                    }
                }
            }
        }
        (lower, upper) => *lower = upper.clone(),
    }
}

/// Those of the named algorithm for the named environment.
fn defaults(named: &Value) -> Result<Value, ClientError> {
    let env_id = named.get("env").and_then(Value::as_str).unwrap_or_default();
    let train = learning::config::defaults(algorithm(named)?, env_id)?;
    Ok(Settings { run: RunSettings::default(), train }.to_json())
}

/// The algorithm that `layer` names, or the default.
///
/// # Errors
/// [`ClientError::Train`] for one that does not exist, with the nearest one that does.
pub fn algorithm(layer: &Value) -> Result<Algorithm, ClientError> {
    let Some(named) = layer.get("algorithm") else { return Ok(TrainConfig::default().algorithm) };
    let names = Algorithm::ALL.map(Algorithm::name);
    let text = named.as_str().unwrap_or_default();
    Algorithm::ALL.into_iter().find(|algorithm| algorithm.name() == text).ok_or_else(|| {
        let nearest = palr_gym_core::nearest::nearest(text, names);
        let nearest = nearest.map(|name| format!("; did you mean {name:?}?")).unwrap_or_default();
        setting(format!("there is no algorithm {named}{nearest} (there are {})", names.join(", ")))
    })
}

/// Refuses a layer with a key that does not exist.
///
/// # Errors
/// [`ClientError::Train`] with the nearest key that does.
pub fn refuse_unknown(layer: &Value) -> Result<(), ClientError> {
    if !layer.is_object() {
        return Err(setting(format!("{layer} is no table of settings")));
    }
    let mut run = RunSettings::default();
    run.held_out.start = Some(0);
    let known = Settings { run, train: TrainConfig::default() }.to_json();
    Ok(crate::learning::config::refuse_unknown(layer, &known, "")?)
}

fn setting(message: impl std::fmt::Display) -> ClientError {
    TrainError::Setting { message: message.to_string() }.into()
}

fn to_value(value: &impl Serialize) -> Value {
    // Plain structs of plain values cannot fail.
    serde_json::to_value(value).unwrap_or_default()
}

fn into_object(value: Value) -> Map<String, Value> {
    match value {
        Value::Object(object) => object,
        _ => Map::new(),
    }
}

/// TOML has no null: what is not set is not there.
fn drop_nulls(value: &mut Value) {
    if let Value::Object(object) = value {
        object.retain(|_, inner| !inner.is_null());
        object.values_mut().for_each(drop_nulls);
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::learning::WeightsMode;

    fn named() -> Value {
        json!({"env": "hopper-w2", "data": "a.hdf5"})
    }

    #[test]
    fn later_layers_win_key_by_key_and_what_nobody_names_keeps_its_default() {
        let file = layer_from_toml(
            "algorithm = \"bc\"\nsteps = 50\n[palr]\nalpha = 3\npool_size = 7\n[held_out]\nrows = 0",
        )
        .unwrap();
        let set = layer_from_assignment("palr.alpha = 0.5").unwrap();
        let settings = Settings::from_layers(&[named(), file, set]).unwrap();
        assert_eq!((settings.train.algorithm, settings.train.steps), (Algorithm::Bc, 50));
        assert_eq!((settings.train.palr.alpha, settings.train.palr.pool_size), (0.5, 7));
        assert_eq!((settings.run.held_out.rows, settings.run.held_out.min_episodes), (0, 20));
        assert_eq!(settings.run.held_out_selection(), None);
        assert_eq!(settings.train.batch, 1024);
    }

    #[test]
    fn settings_survive_json_and_toml() {
        let more = json!({"batch_seed": 4, "palr": {"weights": "pool"}, "learning_rate": 0.1});
        let settings = Settings::from_layers(&[named(), more]).unwrap();
        assert_eq!(settings.train.palr.weights, WeightsMode::Pool);
        assert_eq!(Settings::from_layers(&[settings.to_json()]).unwrap(), settings);
        let toml = layer_from_toml(&settings.to_toml().unwrap()).unwrap();
        assert_eq!(Settings::from_layers(&[toml]).unwrap(), settings);
    }

    #[test]
    fn defaults_are_those_of_the_method_and_the_task() {
        let alpha = |env: &str| {
            Settings::from_layers(&[named(), json!({"env": env})]).unwrap().train.palr.alpha
        };
        assert_eq!((alpha("hopper-w2"), alpha("walker2d-w2")), (10.0, 100.0));
    }

    #[test]
    fn assignments_are_toml_values_or_plain_texts() {
        assert_eq!(layer_from_assignment("a.b=1").unwrap(), json!({"a": {"b": 1}}));
        assert_eq!(layer_from_assignment("a=true").unwrap(), json!({"a": true}));
        assert_eq!(layer_from_assignment("env=hopper-w2").unwrap(), json!({"env": "hopper-w2"}));
        assert_eq!(layer_from_assignment("data=x=y.h5").unwrap(), json!({"data": "x=y.h5"}));
        let error = layer_from_assignment("steps 5").unwrap_err().to_string();
        assert_eq!(error, "\"steps 5\" sets nothing; expected KEY=VALUE");
    }

    #[test]
    fn wrong_layers_are_refused_with_the_nearest_key_or_what_was_wanted() {
        let cases = [
            (json!({"trainig_rows": 5}), "did you mean `training_rows`?"),
            (json!({"held_out": {"row": 5}}), "did you mean `held_out.rows`?"),
            (json!({"palr": {"aplha": 5}}), "did you mean `palr.alpha`?"),
            (json!({"evaluation": {"episodes": 0}}), "evaluation.episodes is 0"),
            (json!({"training_rows": 0}), "training_rows is 0; expected at least 1"),
            (json!({"held_out": {"rows": 1}}), "held_out.rows is 1"),
            (json!({"training_rows": -4}), "training_rows: invalid value: integer `-4`"),
            (json!({"env": ""}), "env is not set"),
            (json!({"palr": {"alpha": -1.0}}), "palr.alpha is -1; expected at least 0"),
            (json!({"algorithm": "plar"}), "did you mean \"palr\"? (there are bc, "),
            (json!({"algorithm": 3}), "there is no algorithm 3"),
            (json!(3), "3 is no table of settings"),
        ];
        for (layer, want) in cases {
            let got = Settings::from_layers(&[named(), layer]).unwrap_err().to_string();
            assert!(got.contains(want), "{got}");
        }
        let error = layer_from_toml("steps = ").unwrap_err().to_string();
        assert!(error.contains("line 1"), "{error}");
    }
}
