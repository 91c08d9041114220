//! The rows that a run trains on, read from a data file.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::sync::Arc;

use palr_gym_data::{RecordedFile, Recording, Samples, Selection, View};
use palr_gym_proto::v1;
use safetensors::tensor::{Dtype, TensorView, serialize};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::client::Client;
use crate::error::ClientError;
use crate::imitate::settings::{EvaluationSettings, RunSettings, Settings};
use crate::leakage::view;
use crate::learning::config::StatisticsRows;
use crate::learning::data::{RowArrays, Standardization};
use crate::learning::{TrainError, TrainingSet};

/// Which data a run saw.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DataIdentity {
    /// Of the whole file, in lower-case hexadecimal digits.
    pub sha256: String,
    /// Rows in the file.
    pub transitions: usize,
    /// What the file says that it holds, if it does.
    pub env_id: Option<String>,
}

/// Rows as a method trains on them.
#[derive(Debug)]
pub struct Prepared {
    /// For the loss.
    pub training: TrainingSet,
    /// For reports of progress.
    pub held_out: Option<TrainingSet>,
    /// Where they are from.
    pub identity: DataIdentity,
    /// Canonical id of the environment.
    pub env_id: String,
}

/// Reads the rows that `settings` name.
///
/// # Errors
/// [`ClientError::Data`] for a file that does not fit, [`ClientError::Train`] for rows that cannot
/// be trained on, [`ClientError::Status`].
pub async fn prepare(client: &Client, settings: &Settings) -> Result<Prepared, ClientError> {
    let Settings { run: settings, train } = settings;
    let spec = client.spec(&settings.env).await?;
    let view = view(client, &spec).await?;
    check_extractor(&settings.data, &spec)?;
    let file = RecordedFile::open(&settings.data)?;
    let rows = Rows::select(&file, &view, Selection::first(settings.training_rows))?;
    let statistics = match train.statistics {
        StatisticsRows::Training => {
            Standardization::of(&rows.observations, view.observation_size())?
        }
        StatisticsRows::All => Standardization::of_blocks(
            view.observation_size(),
            |visit| -> Result<(), ClientError> {
                Ok(Samples::for_each_block_of_observations(&file, &view, visit)?)
            },
        )?,
    };
    let training = TrainingSet::with_statistics(
        &rows.observations,
        statistics,
        rows.actions,
        rows.past_actions,
        view.action_size,
    )?
    .with_frame_stack(view.frame_stack)?
    .with_episodes(&rows.episode_lengths)?;
    training.check_actions_vary()?;
    let held_out = match settings.held_out_selection() {
        Some(selection) => {
            let rows = Rows::select(&file, &view, selection)?;
            Some(training.like(&rows.observations, rows.actions, rows.past_actions)?)
        }
        None => None,
    };
    let identity = DataIdentity {
        sha256: sha256(&settings.data)?,
        transitions: file.outline().transitions(),
        env_id: file.outline().env_id.clone(),
    };
    Ok(Prepared { training, held_out, identity, env_id: spec.env_id })
}

/// Refuses features of another extractor than the server's, as far as the file says whose they are.
fn check_extractor(path: &Path, spec: &v1::EnvironmentSpec) -> Result<(), ClientError> {
    #[derive(Deserialize)]
    struct Recorded {
        #[serde(default)]
        extractor_sha256: String,
    }
    let Some(extractor) = &spec.feature_extractor else { return Ok(()) };
    // What has no such summary is another layout, or is refused by whoever reads the rows.
    let summary = palr_gym_data::d4rl::summarize(path).ok();
    let request = summary.and_then(|summary| summary.request);
    let recorded = request.and_then(|text| serde_json::from_str::<Recorded>(&text).ok());
    match recorded {
        Some(Recorded { extractor_sha256 })
            if !extractor_sha256.is_empty() && extractor_sha256 != extractor.sha256 =>
        {
            let got = extractor_sha256;
            let (env_id, want) = (spec.env_id.clone(), extractor.sha256.clone());
            Err(ClientError::Extractor { path: path.to_path_buf(), env_id, got, want })
        }
        _ => Ok(()),
    }
}

impl Prepared {
    /// The rows as a method is given them, for whoever wants to train elsewhere. Float32 tensors:
    /// `training.observations` `[n, w·d]` (masked, stacked, standardised), `training.actions` and
    /// `training.past_actions` `[n, A]`, the same of `held_out.` if there are such rows, and
    /// `observation_mean` and `observation_std` `[w·d]`. The metadata tell `env_id`, `data_sha256` and
    /// `transitions`.
    ///
    /// # Errors
    /// [`ClientError::Train`], which no rows cause.
    pub fn to_safetensors(&self) -> Result<Vec<u8>, ClientError> {
        let statistics = self.training.observation_statistics();
        let mut tensors = vec![
            ("observation_mean".to_owned(), 0, statistics.mean.as_slice()),
            ("observation_std".to_owned(), 0, statistics.std.as_slice()),
        ];
        let sets = [("training", Some(&self.training)), ("held_out", self.held_out.as_ref())];
        for (name, set) in sets.into_iter().filter_map(|(name, set)| Some((name, set?))) {
            let RowArrays { observations, actions, past_actions } = set.arrays();
            tensors.extend([
                (format!("{name}.observations"), set.observation_size(), observations),
                (format!("{name}.actions"), set.action_size(), actions),
                (format!("{name}.past_actions"), set.action_size(), past_actions),
            ]);
        }
        let failed = |error: safetensors::SafeTensorError| {
            ClientError::from(TrainError::Tensor(error.to_string()))
        };
        let views: Result<Vec<_>, _> = tensors.into_iter().map(tensor).collect();
        let about = HashMap::from([
            ("env_id".to_owned(), self.env_id.clone()),
            ("data_sha256".to_owned(), self.identity.sha256.clone()),
            ("transitions".to_owned(), self.identity.transitions.to_string()),
        ]);
        serialize(views.map_err(failed)?, Some(about)).map_err(failed)
    }
}

/// A tensor of rows of `width` entries; of width 0, a list.
fn tensor(
    (name, width, values): (String, usize, &[f32]),
) -> Result<(String, TensorView<'_>), safetensors::SafeTensorError> {
    let dims = match width {
        0 => vec![values.len()],
        width => vec![values.len() / width, width],
    };
    Ok((name, TensorView::new(Dtype::F32, dims, bytemuck::cast_slice(values))?))
}

/// Rows that runs of a process share: what sees the same is in memory once.
#[derive(Debug, Default)]
pub struct Shelf(Vec<(RunSettings, StatisticsRows, Arc<Prepared>)>);

impl Shelf {
    /// The rows that `settings` name, read at the first time.
    ///
    /// # Errors
    /// As [`prepare`].
    pub async fn get(
        &mut self,
        client: &Client,
        settings: &Settings,
    ) -> Result<Arc<Prepared>, ClientError> {
        // How policies are evaluated says nothing of the rows.
        let run = RunSettings { evaluation: EvaluationSettings::default(), ..settings.run.clone() };
        let statistics = settings.train.statistics;
        let found = self.0.iter().find(|entry| entry.0 == run && entry.1 == statistics);
        if let Some((.., prepared)) = found {
            return Ok(Arc::clone(prepared));
        }
        let prepared = Arc::new(prepare(client, settings).await?);
        self.0.push((run, statistics, Arc::clone(&prepared)));
        Ok(prepared)
    }
}

/// Samples, flat.
struct Rows {
    observations: Vec<f32>,
    actions: Vec<f32>,
    past_actions: Vec<f32>,
    episode_lengths: Vec<usize>,
}

impl Rows {
    fn select(file: &RecordedFile, view: &View, selection: Selection) -> Result<Self, ClientError> {
        let samples = Samples::select(file, view, selection)?;
        Ok(Self {
            observations: samples.observations.iter().copied().collect(),
            actions: samples.actions.iter().copied().collect(),
            past_actions: samples.past_actions.iter().copied().collect(),
            episode_lengths: samples.episode_lengths,
        })
    }
}

/// Of a file's bytes, which may be more than fit into memory; of a folder in Minari's layout, those
/// of its one HDF5 file. In lower-case hexadecimal digits.
///
/// # Errors
/// [`ClientError::File`].
pub fn sha256(path: &Path) -> Result<String, ClientError> {
    let path = &palr_gym_data::minari::main_file(path);
    let failed = |error| ClientError::file(path, error);
    let mut hasher = Sha256::new();
    let mut file = BufReader::with_capacity(1 << 20, File::open(path).map_err(failed)?);
    loop {
        let bytes = file.fill_buf().map_err(failed)?;
        if bytes.is_empty() {
            break;
        }
        hasher.update(bytes);
        let count = bytes.len();
        file.consume(count);
    }
    Ok(hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
}
