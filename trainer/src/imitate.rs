//! A policy from a data file: what stands between recorded demonstrations and
//! [`learning`](crate::learning).

use std::ops::ControlFlow;
use std::path::PathBuf;

use palr_gym_data::{Demonstrations, Samples, Selection, View};
use serde::{Deserialize, Serialize};

use crate::client::Client;
use crate::error::ClientError;
use crate::leakage::view;
use crate::learning::{Progress, TrainConfig, Trained, TrainingSet, train};
use crate::runs::Run;

/// What was trained on; fixed when a run's folder is made.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DataConfig {
    /// Canonical id: how the policy sees the recorded full observations.
    pub env_id: String,
    /// A D4RL file with full observations.
    pub data: PathBuf,
    /// Rows at its beginning to train on.
    pub training_rows: usize,
    /// Rows after them to hold out; 0 for none.
    pub held_out_rows: usize,
    /// Least number of episodes to spread the held-out rows over.
    pub held_out_episodes: usize,
}

/// Rows as a method trains on them.
#[derive(Debug)]
pub struct Prepared {
    /// For the loss.
    pub training: TrainingSet,
    /// For reports of progress.
    pub held_out: Option<TrainingSet>,
}

/// Reads the rows that `config` names.
///
/// # Errors
/// [`ClientError::Data`] for a file that does not fit, [`ClientError::Train`] for rows that cannot
/// be trained on, [`ClientError::Status`].
pub async fn prepare(client: &Client, config: &DataConfig) -> Result<Prepared, ClientError> {
    let spec = client.spec(&config.env_id).await?;
    let view = view(client, &spec).await?;
    let demonstrations = Demonstrations::read(&config.data)?;
    let rows = Rows::select(&demonstrations, &view, Selection::first(config.training_rows))?;
    let training = TrainingSet::new(
        &rows.observations,
        view.observation_size(),
        rows.actions,
        rows.past_actions,
        view.action_size,
    )?;
    let held_out = if config.held_out_rows == 0 {
        None
    } else {
        let spread = palr_gym_data::HeldOut::spread(config.held_out_rows, config.held_out_episodes);
        let rows = Rows::select(&demonstrations, &view, spread.after(config.training_rows))?;
        Some(training.like(&rows.observations, rows.actions, rows.past_actions)?)
    };
    Ok(Prepared { training, held_out })
}

/// Samples, flat.
struct Rows {
    observations: Vec<f32>,
    actions: Vec<f32>,
    past_actions: Vec<f32>,
}

impl Rows {
    fn select(
        demonstrations: &Demonstrations,
        view: &View,
        selection: Selection,
    ) -> Result<Self, ClientError> {
        let samples = Samples::select(demonstrations, view, selection)?;
        Ok(Self {
            observations: samples.observations.iter().copied().collect(),
            actions: samples.actions.iter().copied().collect(),
            past_actions: samples.past_actions.iter().copied().collect(),
        })
    }
}

/// Trains in `run`'s folder. It takes long: call it where blocking is allowed.
///
/// # Errors
/// [`ClientError::Train`].
pub fn imitate(
    run: &Run,
    config: &TrainConfig,
    prepared: &Prepared,
    resume: bool,
    on_progress: impl FnMut(&Progress) -> ControlFlow<()>,
) -> Result<Trained, ClientError> {
    let held_out = prepared.held_out.as_ref();
    Ok(train(config, &prepared.training, held_out, run.folder(), resume, on_progress)?)
}
