//! The runs that one command line asks for: a run of each combination.

use palr_gym_core::EnvId;
use palr_gym_trainer::ClientError;
use palr_gym_trainer::imitate::settings::{Settings, algorithm, merge, nest};
use palr_gym_trainer::learning::{Algorithm, TrainError};
use serde_json::{Value, json};

use crate::cli::TrainArguments;

/// Layers of settings in three parts, each over the one before.
pub(super) struct Layers {
    /// Files and flags.
    pub(super) below: Vec<Value>,
    /// What `--set` says: over everything else.
    pub(super) above: Vec<Value>,
}

impl Layers {
    /// What the uppermost layer that names `key` says.
    pub(super) fn text(&self, key: &str) -> Option<&str> {
        self.all().rev().find_map(|layer| layer.get(key)?.as_str())
    }

    pub(super) fn all(&self) -> impl DoubleEndedIterator<Item = &Value> {
        self.below.iter().chain(&self.above)
    }

    fn algorithm(&self) -> Result<Algorithm, ClientError> {
        let named = self.all().rev().find(|layer| layer.get("algorithm").is_some());
        algorithm(named.unwrap_or(&Value::Null))
    }
}

/// The settings of each run, seeds innermost.
pub(super) fn settings(
    arguments: &TrainArguments,
    layers: &Layers,
) -> Result<Vec<Settings>, ClientError> {
    let none = || vec![Value::Object(serde_json::Map::new())];
    let stacks = match (arguments.frame_stack.as_slice(), layers.text("env")) {
        (stacks, Some(env)) if !stacks.is_empty() => {
            stacks.iter().map(|&stack| json!({"env": with_stack(env, stack)})).collect()
        }
        _ => none(),
    };
    let alphas = match &arguments.alpha {
        Some(alphas) => {
            let alphas = alphas.values.iter();
            alphas.map(|&alpha| alpha_layer(layers, alpha)).collect::<Result<_, _>>()?
        }
        None => none(),
    };
    let seeds = match &arguments.seeds {
        Some(seeds) => {
            // One stream of batches for all, unless somebody says which.
            let first = seeds.0.first();
            seeds.0.iter().map(|&seed| json!({"seed": seed, "batch_seed": first})).collect()
        }
        None => none(),
    };
    let batch_seed = layers.all().rev().find_map(|layer| layer.get("batch_seed"));
    let mut runs = Vec::new();
    for stack in &stacks {
        for alpha in &alphas {
            for seed in &seeds {
                let mut between = seed.clone();
                merge(&mut between, alpha);
                merge(&mut between, stack);
                if let Some(batch_seed) = batch_seed {
                    merge(&mut between, &json!({"batch_seed": batch_seed}));
                }
                let layers = layers.below.iter().chain([&between]).chain(&layers.above);
                runs.push(Settings::from_layers(&layers.cloned().collect::<Vec<_>>())?);
            }
        }
    }
    // A run alone has its batches from its seed; `null` would be another set of settings.
    Ok(runs)
}

/// α is a setting of its own in each method.
pub(super) fn alpha_layer(layers: &Layers, alpha: f64) -> Result<Value, ClientError> {
    let algorithm = layers.algorithm()?;
    let Some(setting) = algorithm.alpha_setting() else {
        let message = format!("{} has no α; leave --alpha away", algorithm.name());
        return Err(TrainError::Setting { message }.into());
    };
    Ok(nest(setting, alpha.into()))
}

/// `env` with another stack, as somebody would write it: `hopper` becomes `hopper-w2`, with the
/// paper's mask.
fn with_stack(env: &str, stack: usize) -> String {
    let Ok(id) = env.parse::<EnvId>() else {
        // It is refused later, with the nearest one that exists.
        return env.to_owned();
    };
    let stripped = env.strip_suffix("-v0").unwrap_or(env);
    match stripped.rsplit_once("-w") {
        Some((rest, digits)) if digits.parse() == Ok(id.frame_stack) => format!("{rest}-w{stack}"),
        _ => format!("{stripped}-w{stack}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stack_takes_the_place_of_the_environments() {
        for (env, want) in [
            ("hopper-w2", "hopper-w4"),
            ("hopper-w2-v0", "hopper-w4"),
            ("hopper", "hopper-w4"),
            ("ant-strict-gym5-w3", "ant-strict-gym5-w4"),
            ("a--b", "a--b"),
        ] {
            assert_eq!(with_stack(env, 4), want);
        }
    }
}
