//! What is known about a trained expert, measured and written down: its model card.

use std::path::Path;

use palr_gym_core::ActionMode;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::client::Client;
use crate::error::ClientError;
use crate::evaluate::{EvaluateOptions, Evaluation, evaluate};
use crate::expert::checkpoint;
use crate::expert::fitness::Fitness;
use crate::expert::run::{
    CHECKPOINT_FILE, ExpertManifest, MANIFEST_FILE, ONNX_FILE, SAFETENSORS_FILE,
};
use crate::expert::settings::{Change, ExpertSettings};
use crate::imitate::manifest::Versions;
use crate::imitate::records::{EVALUATIONS_FILE, EvaluationRecord, read_lines};
use crate::policy::PolicySource;

/// The card's name in a run's folder.
pub const CARD_FILE: &str = "card.json";
/// Seed of the first episode of what a card states: none of those that chose the policy.
pub const CARD_SEED: u64 = 20_000;

/// A model card.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Card {
    /// Environment id.
    pub env: String,
    /// What began the run.
    pub command: String,
    /// Settings that were changed on the way, each by going on with the run and `--set NAME=VALUE`.
    #[serde(default)]
    pub changes: Vec<Change>,
    /// Every setting at last, the seed among them.
    pub settings: ExpertSettings,
    /// Programs that had a part in it.
    pub versions: Versions,
    /// Transitions after which this policy was kept.
    pub step: u64,
    /// Transitions of the run so far.
    pub steps: u64,
    /// Updates of the run so far.
    pub updates: u64,
    /// Seconds of the run so far.
    pub wall_time_s: f64,
    /// Times that the run was resumed.
    pub resumed: u32,
    /// With the mean action.
    pub deterministic: Measured,
    /// With sampled actions.
    pub sampled: Measured,
    /// Transitions, and the mean return of the mean action over a few episodes.
    pub curve: Vec<(u64, f64)>,
    /// Of `policy.onnx`.
    pub onnx: FileIdentity,
    /// Of `policy.safetensors`.
    pub safetensors: FileIdentity,
    /// What plain behaviour cloning of it reached; none if that was not tried.
    #[serde(default)]
    pub fitness: Option<Fitness>,
}

/// Returns over episodes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// Mean undiscounted return.
    pub return_mean: f64,
    /// Its standard error.
    pub return_standard_error: Option<f64>,
    /// Lowest return.
    pub return_min: f64,
    /// Mean normalised score.
    pub score_mean: f64,
    /// Mean length.
    pub length_mean: f64,
    /// Episodes.
    pub episodes: usize,
    /// Seed of the first.
    pub seed: u64,
}

/// Which file is meant.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileIdentity {
    /// Length.
    pub bytes: usize,
    /// 64 hexadecimal digits.
    pub sha256: String,
}

impl From<&Evaluation> for Measured {
    fn from(evaluation: &Evaluation) -> Self {
        let returns = evaluation.episodes.iter().map(|episode| episode.episode_return);
        Self {
            return_mean: evaluation.return_mean,
            return_standard_error: evaluation.return_standard_error,
            return_min: returns.fold(f64::INFINITY, f64::min),
            score_mean: evaluation.score_mean,
            length_mean: evaluation.length_mean,
            episodes: evaluation.episodes.len(),
            seed: evaluation.seed,
        }
    }
}

/// Measures the best policy of the run in `folder` over `episodes` episodes each way.
///
/// # Errors
/// [`ClientError::RunFolder`] if there is no policy yet, [`ClientError::Status`].
pub async fn measure(client: &Client, folder: &Path, episodes: u32) -> Result<Card, ClientError> {
    let missing = |what: &str| ClientError::RunFolder {
        path: folder.into(),
        message: format!("holds no {what}; train until the first evaluation"),
    };
    let read = |name: &str| {
        std::fs::read(folder.join(name)).map_err(|error| match error.kind() {
            std::io::ErrorKind::NotFound => missing(name),
            _ => ClientError::file(folder.join(name), error),
        })
    };
    let manifest = read(MANIFEST_FILE)?;
    let ExpertManifest { settings, versions } = serde_json::from_slice(&manifest)
        .map_err(|error| ClientError::file(folder.join(MANIFEST_FILE), error))?;
    let identity = |name: &str| {
        let bytes = read(name)?;
        Ok::<_, ClientError>(FileIdentity { bytes: bytes.len(), sha256: sha256(&bytes) })
    };
    let (onnx, safetensors) = (identity(ONNX_FILE)?, identity(SAFETENSORS_FILE)?);
    let restored = checkpoint::read(&folder.join(CHECKPOINT_FILE))?;
    let restored = restored.ok_or_else(|| missing(CHECKPOINT_FILE))?;
    let best = restored.counters.best.ok_or_else(|| missing("evaluated policy"))?;
    let earlier = std::fs::read(folder.join(CARD_FILE)).ok();
    let earlier = earlier.and_then(|bytes| serde_json::from_slice::<Card>(&bytes).ok());
    let fitness =
        earlier.and_then(|card| card.fitness).filter(|fitness| fitness.onnx_sha256 == onnx.sha256);
    let curve = read_lines::<EvaluationRecord>(&folder.join(EVALUATIONS_FILE))?;
    let mut measured = Vec::new();
    for action_mode in [ActionMode::Deterministic, ActionMode::Sampled] {
        let options = EvaluateOptions {
            env_id: settings.env.clone(),
            policy: PolicySource::File(folder.join(ONNX_FILE)),
            episodes,
            seed: CARD_SEED,
            action_mode,
            num_envs: None,
            scene_options: None,
        };
        measured.push(Measured::from(&evaluate(client, &options, |_| {}).await?));
    }
    let [deterministic, sampled] = <[Measured; 2]>::try_from(measured)
        .map_err(|_| ClientError::Protocol("an evaluation is missing".into()))?;
    Ok(Card {
        env: settings.env.clone(),
        command: command(&settings.before(&restored.counters.changes)?),
        changes: restored.counters.changes,
        settings,
        versions,
        step: best.step,
        steps: restored.counters.step,
        updates: restored.agent.updates,
        wall_time_s: restored.counters.wall_time_s,
        resumed: restored.counters.resumed,
        deterministic,
        sampled,
        curve: curve.iter().map(|record| (record.step, record.return_mean)).collect(),
        onnx,
        safetensors,
        fitness,
    })
}

/// SHA-256 of `bytes`, 64 hexadecimal digits.
pub(crate) fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The command line that says what differs from the task's defaults.
fn command(settings: &ExpertSettings) -> String {
    let json = |settings: &ExpertSettings| serde_json::to_value(settings).unwrap_or_default();
    let (own, defaults) = (json(settings), json(&ExpertSettings::for_task(&settings.env)));
    let mut command = format!("palr-gym expert train --env {}", settings.env);
    for (name, value) in own.as_object().into_iter().flatten() {
        if defaults.get(name) != Some(value) {
            // A shell would take an array for a pattern.
            let quote = if value.is_array() { "'" } else { "" };
            let value = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
            command.push_str(&format!(" --set {quote}{name}={value}{quote}"));
        }
    }
    command
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_can_be_given_to_a_shell() {
        let settings = ExpertSettings {
            reward_cap: Some(4.5),
            healthy_z_range: Some([0.4, 0.95]),
            ..ExpertSettings::for_task("ant")
        };
        let want = "palr-gym expert train --env ant --set reward_cap=4.5 \
                    --set 'healthy_z_range=[0.4,0.95]'";
        assert_eq!(command(&settings), want);
        assert_eq!(command(&ExpertSettings::for_task("ant")), "palr-gym expert train --env ant");
    }
}
