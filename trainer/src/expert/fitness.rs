//! Whether an expert is fit for a benchmark: plain behaviour cloning of what it does must do nearly as
//! well as the expert. An expert whose gait breaks under the smallest error of an imitator scores high and
//! tells no methods apart.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use palr_gym_core::ActionMode;
use palr_gym_proto::v1::collect_request::Amount;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tokio::sync::mpsc::UnboundedSender;

use crate::client::Client;
use crate::collect::{CollectOptions, Existing, collect};
use crate::error::ClientError;
use crate::evaluate::{EvaluateOptions, evaluate};
use crate::expert::card::{CARD_SEED, Measured};
use crate::expert::run::ONNX_FILE;
use crate::imitate::manifest::FILE as RUN_MANIFEST;
use crate::imitate::settings::Settings;
use crate::imitate::{Event, Imitation};
use crate::policy::PolicySource;
use crate::runs::Run;

/// Where the imitator lives, inside the expert's folder.
pub const FOLDER: &str = "imitation";

/// How the imitator is trained.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FitnessOptions {
    /// Sampled transitions that it learns from.
    pub transitions: u64,
    /// Of the method.
    pub steps: u64,
    /// That it is measured on.
    pub episodes: u32,
    /// Of the recording and of the training.
    pub seed: u64,
}

impl Default for FitnessOptions {
    /// As many transitions as the paper's experiments have.
    fn default() -> Self {
        Self { transitions: 30_000, steps: 20_000, episodes: 100, seed: 0 }
    }
}

/// What an imitator of full observations reached.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Fitness {
    /// Sampled transitions that it learnt from.
    pub transitions: u64,
    /// Of behaviour cloning.
    pub steps: u64,
    /// Of the recording and of the training.
    pub seed: u64,
    /// The imitator's mean action.
    pub imitator: Measured,
    /// Its mean return as a share of the expert's, both of the mean action.
    pub share_of_expert: f64,
    /// Of the expert that was imitated.
    pub onnx_sha256: String,
}

/// Trains and measures an imitator of the expert in `folder`; none if it was stopped before the end,
/// which a later call goes on from.
///
/// # Errors
/// [`ClientError`] of collecting, training and evaluating.
pub async fn fitness(
    client: &Client,
    folder: &Path,
    env: &str,
    (expert, onnx_sha256): (&Measured, &str),
    options: FitnessOptions,
    (git_revision, is_stopped, events): (Option<&str>, Arc<AtomicBool>, UnboundedSender<Event>),
) -> Result<Option<Fitness>, ClientError> {
    let FitnessOptions { transitions, steps, episodes, seed } = options;
    // Another policy, other data: nothing of an earlier expert is taken for this one's.
    let own = folder.join(FOLDER).join(&onnx_sha256[..12.min(onnx_sha256.len())]);
    std::fs::create_dir_all(&own).map_err(|error| ClientError::file(&own, error))?;
    let data = own.join(format!("expert-{transitions}-{seed}.hdf5"));
    let collection = CollectOptions {
        env_id: env.to_owned(),
        policy: PolicySource::File(folder.join(ONNX_FILE)),
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
        "env": env,
        "data": data,
        "training_rows": transitions,
        "held_out": {"rows": 0},
        "algorithm": "bc",
        "steps": steps,
        "seed": seed,
    });
    let run_folder = own.join(format!("bc-{seed}"));
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
    let options = EvaluateOptions {
        env_id: env.to_owned(),
        policy: PolicySource::File(run_folder),
        episodes,
        seed: CARD_SEED,
        action_mode: ActionMode::Deterministic,
        num_envs: None,
        scene_options: None,
    };
    let imitator = Measured::from(&evaluate(client, &options, |_| {}).await?);
    Ok(Some(Fitness {
        transitions,
        steps,
        seed,
        share_of_expert: imitator.return_mean / expert.return_mean,
        imitator,
        onnx_sha256: onnx_sha256.to_owned(),
    }))
}
