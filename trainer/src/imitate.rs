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
//! - [`summary`]: runs found, compared, brought together as curves.
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
pub mod data;
pub mod manifest;
pub mod records;
pub mod settings;
pub mod summary;
pub mod tensorboard;

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use palr_gym_proto::v1;
use serde::Serialize;
use tokio::sync::mpsc::UnboundedSender;

use crate::client::Client;
use crate::error::ClientError;
use crate::imitate::beside::Beside;
use crate::imitate::data::{Prepared, prepare};
use crate::imitate::manifest::Manifest;
use crate::imitate::records::{EvaluationRecord, Metrics, Recorder};
use crate::imitate::settings::Settings;
use crate::learning::train::{CHECKPOINT_FILE, ONNX_FILE, SAFETENSORS_FILE};
use crate::learning::{checkpoint, train};
use crate::runs::Run;

/// The settings of a run, in its folder, as a file for `--config`.
pub const SETTINGS_FILE: &str = "settings.toml";

/// A run that is ready to go: its folder is locked, its data read and checked.
pub struct Imitation {
    run: Run,
    settings: Settings,
    prepared: Prepared,
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
        let prepared = prepare(client, &settings).await?;
        let server = client.server_info().await?;
        let run = Run::create(parent)?;
        Self::begin(run, settings, prepared, &server, git_revision)
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
        let prepared = prepare(client, &settings).await?;
        let server = client.server_info().await?;
        let run = Run::at(folder)?;
        Self::begin(run, settings, prepared, &server, git_revision)
    }

    fn begin(
        run: Run,
        settings: Settings,
        prepared: Prepared,
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
        let mut manifest = Manifest::read(run.folder())?;
        let stored = Settings::from_layers(&[manifest.settings.clone()])?;
        let settings = change(manifest.settings.clone())?;
        stored.check_continued(run.folder(), &settings)?;
        let prepared = prepare(client, &settings).await?;
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
        let Self { run, settings, prepared, is_resumed } = self;
        let folder = run.folder().to_path_buf();
        let recorder = Recorder::open(&folder, is_resumed)?;
        let beside = Beside::start(client.clone(), &settings, &folder, events.clone())?;
        let training = tokio::task::spawn_blocking(move || {
            let mut beside = beside;
            let outcome =
                learn(&run, &settings, &prepared, recorder, &mut beside, &is_stopped, &events);
            (run, outcome, beside)
        });
        let (run, outcome, beside) = training.await.map_err(|error| ClientError::Panicked {
            what: "the trainer",
            message: error.to_string(),
        })?;
        let evaluation = match &outcome {
            // The last evaluations may still be under way; or it was one of them that failed.
            Ok(_) | Err(ClientError::EvaluationStopped { .. }) => beside.finish().await,
            Err(_) => {
                beside.abort();
                Ok(None)
            }
        };
        // Nobody else may write in the folder before that.
        drop(run);
        let mut outcome = match (outcome, evaluation) {
            (Err(ClientError::EvaluationStopped { .. }), Err(cause)) => return Err(cause),
            (outcome, evaluation) => {
                let outcome = outcome?;
                Outcome { evaluation: evaluation?, ..outcome }
            }
        };
        outcome.run_folder = folder;
        Ok(outcome)
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

fn learn(
    run: &Run,
    settings: &Settings,
    prepared: &Prepared,
    mut recorder: Recorder,
    beside: &mut Beside,
    is_stopped: &AtomicBool,
    events: &UnboundedSender<Event>,
) -> Result<Outcome, ClientError> {
    let every = settings.run.evaluation.every;
    let mut last = None;
    let mut failed = None;
    let trained = train(
        &settings.train,
        &prepared.training,
        prepared.held_out.as_ref(),
        run.folder(),
        true,
        is_stopped,
        |progress| {
            let metrics = Metrics::from(progress);
            let before = progress.step.saturating_sub(settings.train.log_every);
            let is_due = every > 0
                && (progress.step / every > before / every || progress.step == progress.steps);
            let result = recorder.metrics(&metrics).and_then(|()| {
                if is_due { beside.submit(progress.step, &progress.policy) } else { Ok(()) }
            });
            // Nobody may be watching.
            let _ = events.send(Event::Report(metrics.clone()));
            last = Some(metrics);
            failed = result.err();
            if failed.is_some() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        },
    )?;
    if let Some(error) = failed {
        return Err(error);
    }
    Ok(Outcome {
        run_folder: run.folder().to_path_buf(),
        is_complete: trained.is_complete,
        step: trained.step,
        policy: trained.is_complete.then(|| run.path(ONNX_FILE)),
        last,
        evaluation: None,
    })
}
