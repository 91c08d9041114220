//! Evaluation on the server while training goes on.
//!
//! A policy that waits for its evaluation lies in the run's folder, so that a kill loses none: the
//! resumed run evaluates what is still there.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use palr_gym_core::ActionMode;
use tokio::sync::Semaphore;
use tokio::sync::mpsc::{Receiver, Sender, UnboundedSender, channel};
use tokio::task::JoinHandle;
use tokio::time::sleep;

use crate::client::Client;
use crate::error::ClientError;
use crate::evaluate::{EvaluateOptions, evaluate};
use crate::imitate::Event;
use crate::imitate::records::{EvaluationRecord, EvaluationRecorder};
use crate::imitate::settings::Settings;
use crate::learning::TrainedPolicy;
use crate::learning::checkpoint::write_whole;
use crate::policy::PolicySource;

const PENDING: &str = "pending";
/// Policies that may wait; then training waits for the server.
const QUEUE: usize = 4;
/// Until a server that is busy with others' evaluations is asked again.
const BUSY: Duration = Duration::from_secs(1);
/// The server's reason for that.
const BUSY_REASON: &str = "TOO_MANY_ROLLOUTS";

/// How many evaluations of runs that train together are under way at once: more would only share
/// the same processors, and a server allows few.
#[derive(Debug, Clone)]
pub struct Turns(Arc<Semaphore>);

impl Default for Turns {
    fn default() -> Self {
        const AT_ONCE: usize = 2;
        Self(Arc::new(Semaphore::new(AT_ONCE)))
    }
}

/// The evaluations of a run.
pub struct Beside {
    pending: PathBuf,
    queue: Sender<u64>,
    worker: JoinHandle<Result<Option<EvaluationRecord>, ClientError>>,
}

impl Beside {
    /// Starts with what an earlier process left unevaluated in `folder`.
    ///
    /// # Errors
    /// [`ClientError::File`].
    pub fn start(
        client: Client,
        settings: &Settings,
        folder: &Path,
        turns: Turns,
        events: UnboundedSender<Event>,
    ) -> Result<Self, ClientError> {
        let pending = folder.join(PENDING);
        let recorder = EvaluationRecorder::open(folder)?;
        let left = left_over(&pending)?;
        let (queue, jobs) = channel(QUEUE);
        let evaluation = &settings.run.evaluation;
        let options = EvaluateOptions {
            env_id: settings.run.env.clone(),
            policy: PolicySource::Random,
            episodes: evaluation.episodes,
            seed: evaluation.seed,
            action_mode: ActionMode::Deterministic,
            num_envs: None,
            scene_options: None,
        };
        let worker = Worker { client, options, recorder, turns, events, pending: pending.clone() };
        let worker = tokio::spawn(worker.work(left, jobs));
        Ok(Self { pending, queue, worker })
    }

    /// Queues the evaluation of a policy. Blocks while the server is far behind.
    ///
    /// # Errors
    /// [`ClientError::File`], [`ClientError::Train`]; [`ClientError::EvaluationStopped`] if an
    /// earlier evaluation failed: [`Self::finish`] says of what.
    pub fn submit(&mut self, step: u64, policy: &TrainedPolicy) -> Result<(), ClientError> {
        let model = policy.to_onnx()?;
        fs::create_dir_all(&self.pending)
            .map_err(|error| ClientError::file(&self.pending, error))?;
        write_whole(&pending_file(&self.pending, step), &model)?;
        self.queue.blocking_send(step).map_err(|_| ClientError::EvaluationStopped { step })
    }

    /// Gives up what is under way; a resumed run does it again.
    pub fn abort(self) {
        self.worker.abort();
    }

    /// Waits for the evaluations under way and says what the newest came to.
    ///
    /// # Errors
    /// What an evaluation failed with.
    pub async fn finish(self) -> Result<Option<EvaluationRecord>, ClientError> {
        drop(self.queue);
        self.worker.await.map_err(|error| ClientError::Panicked {
            what: "the evaluation",
            message: error.to_string(),
        })?
    }
}

struct Worker {
    client: Client,
    options: EvaluateOptions,
    recorder: EvaluationRecorder,
    turns: Turns,
    events: UnboundedSender<Event>,
    pending: PathBuf,
}

impl Worker {
    async fn work(
        mut self,
        left: Vec<u64>,
        mut jobs: Receiver<u64>,
    ) -> Result<Option<EvaluationRecord>, ClientError> {
        for step in left {
            self.evaluate(step).await?;
        }
        while let Some(step) = jobs.recv().await {
            self.evaluate(step).await?;
        }
        // Only an empty folder goes.
        let _ = fs::remove_dir(&self.pending);
        Ok(self.recorder.last().cloned())
    }

    async fn evaluate(&mut self, step: u64) -> Result<(), ClientError> {
        let path = pending_file(&self.pending, step);
        // A resumed run comes through the same steps again, with the same policies.
        if !self.recorder.has(step) {
            let options = EvaluateOptions {
                policy: PolicySource::File(path.clone()),
                ..self.options.clone()
            };
            let evaluation = {
                // It is never closed.
                let _turn = self.turns.0.acquire().await.ok();
                loop {
                    match evaluate(&self.client, &options, |_| ()).await {
                        Err(ClientError::Status { reason, .. })
                            if reason.as_deref() == Some(BUSY_REASON) =>
                        {
                            sleep(BUSY).await;
                        }
                        evaluation => break evaluation?,
                    }
                }
            };
            let record = EvaluationRecord::new(step, &evaluation);
            self.recorder.put(record.clone())?;
            // Nobody may be watching.
            let _ = self.events.send(Event::Evaluation(record));
        }
        match fs::remove_file(&path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(ClientError::file(path, error))
            }
            _ => Ok(()),
        }
    }
}

fn pending_file(pending: &Path, step: u64) -> PathBuf {
    pending.join(format!("{step:010}.onnx"))
}

/// Steps of the policies in `pending`, ascending.
fn left_over(pending: &Path) -> Result<Vec<u64>, ClientError> {
    let entries = match fs::read_dir(pending) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(ClientError::file(pending, error)),
    };
    let mut steps: Vec<u64> = entries
        .filter_map(Result::ok)
        .filter_map(|entry| entry.file_name().to_str()?.strip_suffix(".onnx")?.parse().ok())
        .collect();
    steps.sort_unstable();
    Ok(steps)
}
