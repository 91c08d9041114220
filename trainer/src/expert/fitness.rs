//! Whether an expert is fit for a benchmark: plain behaviour cloning of what it does must do nearly as
//! well as the expert. An expert whose gait breaks under the smallest error of an imitator scores high and
//! tells no methods apart. One imitator tells little: of a brittle expert, two that differ only in their
//! seeds can be fifteen points of a hundred apart.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use palr_gym_core::ActionMode;
use palr_gym_core::score::{mean, standard_error};
use palr_gym_proto::v1::collect_request::Amount;
use palr_gym_proto::v1::policy::Policy;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tokio::sync::mpsc::UnboundedSender;

use crate::client::Client;
use crate::collect::{CollectOptions, Existing, collect};
use crate::error::ClientError;
use crate::evaluate::{EvaluateOptions, evaluate};
use crate::expert::card::{CARD_SEED, Measured, sha256};
use crate::imitate::manifest::FILE as RUN_MANIFEST;
use crate::imitate::settings::Settings;
use crate::imitate::{Event, Imitation};
use crate::policy::PolicySource;
use crate::runs::Run;

/// Where the imitators of a run's expert live, inside the expert's folder.
pub const FOLDER: &str = "imitation";

/// Who is imitated.
#[derive(Debug, Clone)]
pub struct Imitated {
    /// Environment id.
    pub env: String,
    /// What plays it.
    pub policy: PolicySource,
    /// Of its ONNX file; empty for a controller in the server's own code.
    pub onnx_sha256: String,
    /// Its mean action.
    pub reached: Measured,
}

/// How imitators are trained.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FitnessOptions {
    /// Sampled transitions that each learns from.
    pub transitions: u64,
    /// Of the method.
    pub steps: u64,
    /// That each is measured on.
    pub episodes: u32,
}

impl FitnessOptions {
    /// As many transitions as the paper's experiments have.
    pub const TRANSITIONS: u64 = 30_000;
    /// Steps that are enough for most experts.
    pub const STEPS: u64 = 20_000;
}

/// What imitators of full observations reached.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Fitness {
    /// Sampled transitions that each learnt from.
    pub transitions: u64,
    /// Of behaviour cloning.
    pub steps: u64,
    /// One or more.
    #[serde(default)]
    pub imitators: Vec<Imitator>,
    /// Their mean return as a share of the expert's, both of the mean action.
    pub share_of_expert: f64,
    /// Of that share, over the imitators; none of a single one's.
    #[serde(default)]
    pub share_standard_error: Option<f64>,
    /// Of the expert that was imitated.
    pub onnx_sha256: String,
}

/// What one of them reached.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Imitator {
    /// Of the recording and of the training.
    pub seed: u64,
    /// Its mean action.
    pub reached: Measured,
    /// Its mean return as a share of the expert's.
    pub share_of_expert: f64,
}

impl Imitated {
    /// Measures `policy` in `env`.
    ///
    /// # Errors
    /// [`ClientError::File`], [`ClientError::RunFolder`], [`ClientError::Status`].
    pub async fn measure(
        client: &Client,
        env: &str,
        policy: PolicySource,
        episodes: u32,
    ) -> Result<Self, ClientError> {
        let onnx_sha256 = match policy.load()?.policy {
            Some(Policy::Onnx(bytes)) => sha256(&bytes),
            _ => {
                let spec = client.spec(env).await?;
                let tasks = client.tasks().await?;
                let task = tasks.into_iter().find(|task| task.name == spec.task);
                task.and_then(|task| task.expert).map(|expert| expert.sha256).unwrap_or_default()
            }
        };
        let options = deterministic(env, policy.clone(), episodes);
        let reached = Measured::from(&evaluate(client, &options, |_| {}).await?);
        Ok(Self { env: env.to_owned(), policy, onnx_sha256, reached })
    }
}

impl Fitness {
    /// What `imitators` of `imitated`, at least one, reached together.
    #[must_use]
    pub fn of(imitated: &Imitated, options: FitnessOptions, imitators: Vec<Imitator>) -> Self {
        let shares: Vec<f64> = imitators.iter().map(|imitator| imitator.share_of_expert).collect();
        Self {
            transitions: options.transitions,
            steps: options.steps,
            share_of_expert: mean(&shares),
            share_standard_error: (shares.len() > 1).then(|| standard_error(&shares)),
            imitators,
            onnx_sha256: imitated.onnx_sha256.clone(),
        }
    }
}

/// Records `imitated` with `seed`, trains an imitator with it and measures that, all in `folder`; none if
/// it was stopped before the end, which a later call goes on from.
///
/// # Errors
/// [`ClientError`] of collecting, training and evaluating.
pub async fn imitator(
    client: &Client,
    imitated: &Imitated,
    folder: &Path,
    (options, seed): (FitnessOptions, u64),
    (git_revision, is_stopped, events): (Option<&str>, Arc<AtomicBool>, UnboundedSender<Event>),
) -> Result<Option<Imitator>, ClientError> {
    let FitnessOptions { transitions, steps, episodes } = options;
    // Another policy, other data: nothing of an earlier expert is taken for this one's.
    let digest = &imitated.onnx_sha256;
    let own = folder.join(&digest[..12.min(digest.len())]);
    std::fs::create_dir_all(&own).map_err(|error| ClientError::file(&own, error))?;
    let data = own.join(format!("expert-{transitions}-{seed}.hdf5"));
    let collection = CollectOptions {
        env_id: imitated.env.clone(),
        policy: imitated.policy.clone(),
        amount: Amount::Transitions(transitions),
        seed,
        action_mode: ActionMode::Sampled,
        num_envs: None,
        scene_options: None,
        out: data.clone(),
        existing: Existing::Resume,
    };
    collect(client, &collection, |_| {}).await?;
    let layer = json!({
        "env": imitated.env,
        "data": data,
        "training_rows": transitions,
        "held_out": {"rows": 0},
        "algorithm": "bc",
        "steps": steps,
        "seed": seed,
    });
    // Another amount of data or of training: another imitator, not this one gone on with.
    let run_folder = own.join(format!("bc-{transitions}-{steps}-{seed}"));
    let imitation = if run_folder.join(RUN_MANIFEST).exists() {
        let change = |stored: Value| Settings::from_layers(&[stored, layer]);
        Imitation::resume(client, Run::open(&run_folder)?, change).await?
    } else {
        let settings = Settings::from_layers(&[layer])?;
        Imitation::start_in(client, &run_folder, settings, git_revision).await?
    };
    let outcome = imitation.run(client, is_stopped, events).await?;
    if !outcome.is_complete {
        return Ok(None);
    }
    let options = deterministic(&imitated.env, PolicySource::File(run_folder), episodes);
    let reached = Measured::from(&evaluate(client, &options, |_| {}).await?);
    let share_of_expert = reached.return_mean / imitated.reached.return_mean;
    Ok(Some(Imitator { seed, reached, share_of_expert }))
}

/// Episodes of the mean action that chose nothing.
fn deterministic(env: &str, policy: PolicySource, episodes: u32) -> EvaluateOptions {
    EvaluateOptions {
        env_id: env.to_owned(),
        policy,
        episodes,
        seed: CARD_SEED,
        action_mode: ActionMode::Deterministic,
        num_envs: None,
        scene_options: None,
    }
}
