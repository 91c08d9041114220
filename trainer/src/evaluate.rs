//! Evaluation on the server.

use palr_gym_core::ActionMode;
use palr_gym_proto::v1;
use palr_gym_proto::v1::evaluate_response::Response;
use serde::{Deserialize, Serialize};

use crate::client::Client;
use crate::error::ClientError;
use crate::policy::PolicySource;

/// What to evaluate.
#[derive(Debug, Clone)]
pub struct EvaluateOptions {
    /// Such as `hopper-w2`.
    pub env_id: String,
    /// Who plays.
    pub policy: PolicySource,
    /// How many episodes.
    pub episodes: u32,
    /// Episode i is reset with seed + i.
    pub seed: u64,
    /// Deterministic or sampled actions.
    pub action_mode: ActionMode,
    /// Environments side by side; the server chooses if unset.
    pub num_envs: Option<u32>,
    /// Of a driving task; the defaults if unset.
    pub scene_options: Option<v1::SceneOptions>,
}

/// One finished episode.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Episode {
    /// Counted from 0.
    pub index: u32,
    /// The environment's seed.
    pub seed: u64,
    /// Undiscounted.
    pub episode_return: f64,
    /// After D4RL.
    pub normalized_score: f64,
    /// Steps.
    pub length: u32,
    /// The task ended it.
    pub terminated: bool,
    /// The time limit ended it.
    pub truncated: bool,
}

/// A whole evaluation, as it goes into result files.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Canonical id.
    pub env_id: String,
    /// Who played.
    pub policy: String,
    /// `deterministic` or `sampled`.
    pub action_mode: String,
    /// Seed of the first episode.
    pub seed: u64,
    /// Environments side by side.
    pub num_envs: u32,
    /// Mean return.
    pub return_mean: f64,
    /// Standard error of the mean return; null for a single episode.
    pub return_standard_error: Option<f64>,
    /// Mean normalised score.
    pub score_mean: f64,
    /// Standard error of the mean score; null for a single episode.
    pub score_standard_error: Option<f64>,
    /// Interquartile mean of the scores.
    pub score_interquartile_mean: f64,
    /// Its 95 % bootstrap interval.
    pub score_interquartile_mean_interval: (f64, f64),
    /// Mean length.
    pub length_mean: f64,
    /// Environment steps.
    pub steps: u64,
    /// Seconds of wall-clock time.
    pub wall_time_s: f64,
    /// In the order of their indices.
    pub episodes: Vec<Episode>,
}

impl Evaluation {
    /// Environment steps in a second of wall-clock time.
    #[must_use]
    pub fn steps_per_s(&self) -> f64 {
        self.steps as f64 / self.wall_time_s
    }
}

/// Evaluates on the server and hands each episode to `on_episode` as it ends.
///
/// # Errors
/// [`ClientError::Status`], or [`ClientError::File`] for a policy that cannot be read.
pub async fn evaluate(
    client: &Client,
    options: &EvaluateOptions,
    mut on_episode: impl FnMut(&Episode),
) -> Result<Evaluation, ClientError> {
    let env_id = client.spec(&options.env_id).await?.env_id;
    let request = v1::EvaluateRequest {
        env_id: options.env_id.clone(),
        policy: Some(options.policy.load()?),
        episodes: Some(options.episodes),
        seed: options.seed,
        action_mode: wire_action_mode(options.action_mode).into(),
        num_envs: options.num_envs,
        scene_options: options.scene_options,
    };
    let mut service = client.evaluations();
    let mut stream = client.within(service.evaluate(request)).await?.into_inner();
    let mut episodes = Vec::new();
    while let Some(message) = client.within(stream.message()).await? {
        match message.response {
            Some(Response::Episode(episode)) => {
                let episode = Episode {
                    index: episode.index,
                    seed: episode.seed,
                    episode_return: episode.episode_return,
                    normalized_score: episode.normalized_score,
                    length: episode.length,
                    terminated: episode.terminated,
                    truncated: episode.truncated,
                };
                on_episode(&episode);
                episodes.push(episode);
            }
            Some(Response::Summary(summary)) => {
                episodes.sort_by_key(|episode| episode.index);
                return Ok(summarize(env_id, options, &summary, episodes));
            }
            None => {}
        }
    }
    Err(ClientError::Protocol("the evaluation ended without a summary".into()))
}

fn summarize(
    env_id: String,
    options: &EvaluateOptions,
    summary: &v1::EvaluationSummary,
    episodes: Vec<Episode>,
) -> Evaluation {
    let known = |value: f64| value.is_finite().then_some(value);
    Evaluation {
        env_id,
        policy: options.policy.label(),
        action_mode: options.action_mode.name().to_owned(),
        seed: options.seed,
        num_envs: summary.num_envs,
        return_mean: summary.return_mean,
        return_standard_error: known(summary.return_standard_error),
        score_mean: summary.score_mean,
        score_standard_error: known(summary.score_standard_error),
        score_interquartile_mean: summary.score_interquartile_mean,
        score_interquartile_mean_interval: (
            summary.score_interquartile_mean_low,
            summary.score_interquartile_mean_high,
        ),
        length_mean: summary.length_mean,
        steps: summary.steps,
        wall_time_s: summary.wall_time_s,
        episodes,
    }
}

pub(crate) fn wire_action_mode(action_mode: ActionMode) -> v1::ActionMode {
    match action_mode {
        ActionMode::Deterministic => v1::ActionMode::Deterministic,
        ActionMode::Sampled => v1::ActionMode::Sampled,
    }
}
