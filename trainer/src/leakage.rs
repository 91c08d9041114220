//! Leakage of a policy on recorded demonstrations, estimated by the server.

use std::path::PathBuf;

use bytes::Bytes;
use ndarray::Array2;
use palr_gym_core::{ActionMode, Fidelity, Mask};
use palr_gym_data::{RecordedFile, Samples, Selection, View};
use palr_gym_proto::v1;
use palr_gym_proto::v1::estimate_leakage_request::Subject;
use serde::{Deserialize, Serialize};

use crate::client::Client;
use crate::error::ClientError;
use crate::evaluate::wire_action_mode;
use crate::policy::PolicySource;

/// What to estimate.
#[derive(Debug, Clone)]
pub struct LeakageOptions {
    /// Such as `hopper-w2`: how the policy sees the recorded full observations.
    pub env_id: String,
    /// Whose actions may leak.
    pub policy: PolicySource,
    /// A D4RL file with full observations.
    pub data: PathBuf,
    /// Which rows of it.
    pub selection: Selection,
    /// Deterministic or sampled actions; the paper samples.
    pub action_mode: ActionMode,
    /// λ of the ridge regression; the server's default if unset.
    pub ridge: Option<f64>,
    /// σ² of the kernels; the server's default if unset.
    pub bandwidth_sq: Option<f64>,
    /// Of sampled actions and of the bootstrap.
    pub seed: u64,
}

/// An estimate, as it goes into result files.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Leakage {
    /// Canonical id.
    pub env_id: String,
    /// Whose actions.
    pub policy: String,
    /// `deterministic` or `sampled`.
    pub action_mode: String,
    /// The data set.
    pub data: PathBuf,
    /// Rows of it that were used.
    pub samples: usize,
    /// Episodes that they come from.
    pub episodes: usize,
    /// HSCIC(policy's action; expert's past action | expert's action).
    pub hscic: f64,
    /// Its 95 % block-bootstrap interval, with the embedding held fixed.
    pub hscic_interval: (f64, f64),
    /// True if whole episodes were resampled.
    pub is_by_episode: bool,
    /// Of sampled actions and of the bootstrap.
    pub seed: u64,
}

/// Estimates on the server.
///
/// # Errors
/// [`ClientError::Data`] for a data set that does not fit, [`ClientError::Status`].
pub async fn estimate(client: &Client, options: &LeakageOptions) -> Result<Leakage, ClientError> {
    let spec = client.spec(&options.env_id).await?;
    let view = view(client, &spec).await?;
    let file = RecordedFile::open(&options.data)?;
    let samples = Samples::select(&file, &view, options.selection)?;
    let lengths = &samples.episode_lengths;
    let request = v1::EstimateLeakageRequest {
        subject: Some(Subject::Policy(v1::PolicyOnObservations {
            policy: Some(options.policy.load()?),
            env_id: spec.env_id.clone(),
            observations: Some(tensor(&samples.observations)),
            action_mode: wire_action_mode(options.action_mode).into(),
        })),
        past_actions: Some(tensor(&samples.past_actions)),
        given_actions: Some(tensor(&samples.actions)),
        ridge: options.ridge,
        bandwidth_sq: options.bandwidth_sq,
        episode_lengths: lengths.iter().map(|&length| length as u32).collect(),
        resamples: None,
        seed: options.seed,
    };
    let mut service = client.leakages();
    let answer = client.within(service.estimate_leakage(request)).await?.into_inner();
    Ok(Leakage {
        env_id: spec.env_id,
        policy: options.policy.label(),
        action_mode: options.action_mode.name().to_owned(),
        data: options.data.clone(),
        samples: samples.rows(),
        episodes: lengths.len(),
        hscic: answer.hscic,
        hscic_interval: (answer.hscic_low, answer.hscic_high),
        is_by_episode: answer.is_by_episode,
        seed: options.seed,
    })
}

/// How an environment shows the full observations of its task.
pub(crate) async fn view(client: &Client, spec: &v1::EnvironmentSpec) -> Result<View, ClientError> {
    let tasks = client.tasks().await?;
    let task = tasks.into_iter().find(|task| task.name == spec.task).ok_or_else(|| {
        ClientError::Protocol(format!("the server does not list its task {}", spec.task))
    })?;
    let (recorded_as, size, mask_indices) = match (spec.observation_kind(), &spec.feature_extractor)
    {
        (v1::ObservationKind::Features, Some(extractor)) => {
            let size = extractor.size as usize;
            (Mask::Paper, size, (0..size).collect())
        }
        (v1::ObservationKind::Pixels, _) => {
            return Err(ClientError::Pixels { env_id: spec.env_id.clone() });
        }
        _ => {
            let indices = spec.mask_indices.iter().map(|&index| index as usize).collect();
            (Mask::Full, task.full_observation_size as usize, indices)
        }
    };
    Ok(View {
        task: task.name,
        recorded_as,
        full_observation_size: size,
        action_size: task.action_size as usize,
        mask_indices,
        frame_stack: spec.frame_stack as usize,
        fidelity: match spec.fidelity() {
            v1::Fidelity::Gym5 => Fidelity::Gym5,
            v1::Fidelity::Gym4 | v1::Fidelity::Unspecified => Fidelity::Gym4,
        },
    })
}

fn tensor(array: &Array2<f32>) -> v1::Tensor {
    let values: Vec<f32> = array.iter().copied().collect();
    v1::Tensor {
        dtype: v1::DataType::Float32.into(),
        shape: array.shape().iter().map(|&size| size as i64).collect(),
        data: Bytes::copy_from_slice(bytemuck::cast_slice(&values)),
    }
}
