//! Runs of imitation learning: from recorded demonstrations to an evaluated policy, in a folder
//! that says everything about it.
//!
//! This is what stands between the service and [`learning`](crate::learning), which knows arrays
//! only.
//!
//! # Layout
//! - [`settings`]: what a run is to do, in layers: defaults, file, command line.
//! - [`data`]: the rows that a run trains on.
//! - [`manifest`]: `run.json`, what a folder says of itself.
//! - [`records`]: `metrics.jsonl`, `evaluations.jsonl`.
//! - [`tensorboard`]: the same numbers for TensorBoard.
//! - [`choice`]: α, chosen by held-out data.
//! - [`summary`]: runs found, compared, brought together as curves.
//! - [`together`]: the runs of a process, in lockstep.
//! - [`beside`]: evaluation on the server while training goes on.
//!
//! # A run's folder
//! | file | what |
//! |---|---|
//! | `run.json` | the manifest; written first |
//! | `settings.toml` | the settings; `palr-gym train --config` takes it |
//! | `config.json` | the part of the settings that the learner sees |
//! | `metrics.jsonl`, `evaluations.jsonl` | a line each report, a line each evaluation |
//! | `tensorboard/` | both, as event files |
//! | `pending/` | policies whose evaluation is not finished |
//! | `checkpoint.safetensors` | where `--resume` goes on |
//! | `policy.onnx`, `policy.safetensors` | the finished policy |

pub mod beside;
pub mod choice;
pub mod data;
pub mod manifest;
pub mod records;
pub mod settings;
pub mod summary;
pub mod tensorboard;
pub mod together;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use palr_gym_proto::v1;
use serde::Serialize;
use tokio::sync::mpsc::UnboundedSender;

use crate::client::Client;
use crate::error::ClientError;
use crate::imitate::data::{Prepared, Shelf, prepare};
use crate::imitate::manifest::Manifest;
use crate::imitate::records::{EvaluationRecord, Metrics};
use crate::imitate::settings::Settings;
use crate::imitate::together::run_together;
use crate::learning::checkpoint;
use crate::learning::train::{CHECKPOINT_FILE, ONNX_FILE, SAFETENSORS_FILE};
use crate::runs::Run;

/// The settings of a run, in its folder, as a file for `--config`.
pub const SETTINGS_FILE: &str = "settings.toml";

/// A run that is ready to go: its folder is locked, its data read and checked.
pub struct Imitation {
    run: Run,
    settings: Settings,
    prepared: Arc<Prepared>,
    is_resumed: bool,
}

/// What happens during a run, for whoever watches.
#[derive(Debug, Clone)]
pub enum Event {
    /// A report of progress.
    Report(Metrics),
    /// An evaluation ended.
    Evaluation(EvaluationRecord),
}

/// What a run came to.
#[derive(Debug, Clone, Serialize)]
pub struct Outcome {
    /// Its folder.
    pub run_folder: PathBuf,
    /// False if it was interrupted; then it can be resumed.
    pub is_complete: bool,
    /// Steps taken.
    pub step: u64,
    /// There once the run is complete.
    pub policy: Option<PathBuf>,
    /// The newest report; none if a finished run was resumed.
    pub last: Option<Metrics>,
    /// The newest evaluation.
    pub evaluation: Option<EvaluationRecord>,
}

impl Imitation {
    /// Reads the data that `settings` name, then makes a folder in `parent`. `git_revision` is
    /// recorded.
    ///
    /// # Errors
    /// Settings and data that do not fit: nothing was made then. [`ClientError::File`].
    pub async fn start(
        client: &Client,
        parent: &Path,
        settings: Settings,
        git_revision: Option<&str>,
    ) -> Result<Self, ClientError> {
        let runs = Self::start_all(client, parent, vec![settings], git_revision).await?;
        runs.into_iter().next().ok_or_else(|| ClientError::file(parent, "no run was started"))
    }

    /// As [`Self::start`], for each of `settings`, in their order. Runs that see the same rows share
    /// them.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub async fn start_all(
        client: &Client,
        parent: &Path,
        settings: Vec<Settings>,
        git_revision: Option<&str>,
    ) -> Result<Vec<Self>, ClientError> {
        let mut shelf = Shelf::default();
        let mut prepared = Vec::with_capacity(settings.len());
        for settings in &settings {
            prepared.push(shelf.get(client, settings).await?);
        }
        let server = client.server_info().await?;
        let begin = |(settings, prepared)| {
            Self::begin(Run::create(parent)?, settings, prepared, &server, git_revision)
        };
        settings.into_iter().zip(prepared).map(begin).collect()
    }

    /// As [`Self::start`], in a folder that the caller owns; it must not hold a run.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub async fn start_in(
        client: &Client,
        folder: &Path,
        settings: Settings,
        git_revision: Option<&str>,
    ) -> Result<Self, ClientError> {
        let prepared = Arc::new(prepare(client, &settings).await?);
        let server = client.server_info().await?;
        let run = Run::at(folder)?;
        Self::begin(run, settings, prepared, &server, git_revision)
    }

    fn begin(
        run: Run,
        settings: Settings,
        prepared: Arc<Prepared>,
        server: &v1::GetServerInfoResponse,
        git_revision: Option<&str>,
    ) -> Result<Self, ClientError> {
        let manifest = Manifest::new(&settings, &prepared, server, git_revision);
        run.write_json(manifest::FILE, &manifest)?;
        write_settings(&run, &settings)?;
        Ok(Self { run, settings, prepared, is_resumed: false })
    }

    /// Goes on with the run in `run`'s folder. `change` may replace settings that do not decide
    /// the bits of a step, such as `steps`.
    ///
    /// # Errors
    /// [`ClientError::File`] if it is no run, is of another version, or its data are others now.
    pub async fn resume(
        client: &Client,
        run: Run,
        change: impl FnOnce(serde_json::Value) -> Result<Settings, ClientError>,
    ) -> Result<Self, ClientError> {
        Self::resume_sharing(client, run, &mut Shelf::default(), change).await
    }

    /// As [`Self::resume`]; rows that are on the `shelf` are not read again.
    ///
    /// # Errors
    /// As [`Self::resume`].
    pub async fn resume_sharing(
        client: &Client,
        run: Run,
        shelf: &mut Shelf,
        change: impl FnOnce(serde_json::Value) -> Result<Settings, ClientError>,
    ) -> Result<Self, ClientError> {
        let mut manifest = Manifest::read(run.folder())?;
        let stored = Settings::from_layers(&[manifest.settings.clone()])?;
        let settings = change(manifest.settings.clone())?;
        stored.check_continued(run.folder(), &settings)?;
        let prepared = shelf.get(client, &settings).await?;
        manifest.check_data(run.folder(), &prepared)?;
        let steps = settings.train.steps;
        match recorded_steps(run.folder())? {
            Some(taken) if taken > steps => {
                let message = format!("has {taken} steps already; steps is {steps}");
                return Err(ClientError::RunFolder { path: run.folder().into(), message });
            }
            // What the shorter run left is not what this one will leave.
            taken if taken.is_none_or(|taken| taken < steps) => remove_policy(&run)?,
            _ => {}
        }
        manifest.settings = settings.to_json();
        run.write_json(manifest::FILE, &manifest)?;
        write_settings(&run, &settings)?;
        Ok(Self { run, settings, prepared, is_resumed: true })
    }

    /// The run's folder.
    #[must_use]
    pub fn folder(&self) -> &Path {
        self.run.folder()
    }

    /// What the run is to do.
    #[must_use]
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Trains to the end, or until `is_stopped`; evaluates beside it. Dropping the receiver of
    /// `events` does no harm.
    ///
    /// # Errors
    /// [`ClientError::Train`], [`ClientError::File`], or what an evaluation failed with. Except
    /// for a failing disk, a checkpoint is left behind.
    pub async fn run(
        self,
        client: &Client,
        is_stopped: Arc<AtomicBool>,
        events: UnboundedSender<Event>,
    ) -> Result<Outcome, ClientError> {
        let outcomes = run_together(vec![self], client, is_stopped, vec![events]).await?;
        // One run in, one out.
        outcomes.into_iter().next().ok_or(ClientError::Panicked {
            what: "the trainer",
            message: "it trained no run".to_owned(),
        })
    }
}

/// Steps of the checkpoint in `folder`, if there is one.
fn recorded_steps(folder: &Path) -> Result<Option<u64>, ClientError> {
    Ok(checkpoint::steps_taken(&folder.join(CHECKPOINT_FILE))?)
}

fn remove_policy(run: &Run) -> Result<(), ClientError> {
    for name in [ONNX_FILE, SAFETENSORS_FILE] {
        let path = run.path(name);
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(ClientError::file(path, error));
            }
            _ => {}
        }
    }
    Ok(())
}

fn write_settings(run: &Run, settings: &Settings) -> Result<(), ClientError> {
    let path = run.path(SETTINGS_FILE);
    std::fs::write(&path, settings.to_toml()?).map_err(|error| ClientError::file(path, error))
}
