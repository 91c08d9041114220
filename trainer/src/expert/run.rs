//! A run: environments, updates, evaluations, in a folder that says everything about it.
//!
//! # A run's folder
//! | file | what |
//! |---|---|
//! | `expert.json` | settings and versions; written first |
//! | `metrics.jsonl`, `evaluations.jsonl`, `tensorboard/` | its curves |
//! | `checkpoint.safetensors` | where it goes on |
//! | `replay.safetensors` | the transitions that it had when it was stopped |
//! | `latest.onnx` | the newest policy that was evaluated |
//! | `policy.onnx`, `policy.safetensors` | the best policy so far |
//! | `card.json` | what is known about it, once it is finished |

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use palr_gym_core::ActionMode;
use serde::{Deserialize, Serialize};
use tokio::runtime::Handle;
use tokio::sync::mpsc::UnboundedSender;

use crate::client::Client;
use crate::error::ClientError;
use crate::evaluate::{EvaluateOptions, evaluate};
use crate::expert::agent::{Agent, Batch, Losses, UpdateNoise};
use crate::expert::checkpoint::{self, Best, Counters, Restored};
use crate::expert::collector::Collector;
use crate::expert::export::ExpertPolicy;
use crate::expert::perturbation::Perturbation;
use crate::expert::records::ExpertMetrics;
use crate::expert::replay::Replay;
use crate::expert::settings::ExpertSettings;
use crate::imitate::manifest::Versions;
use crate::imitate::records::{EVALUATIONS_FILE, EvaluationRecord, METRICS_FILE, Track};
use crate::learning::checkpoint::write_whole;
use crate::learning::noise::Normals;
use crate::learning::streams::{Purpose, stream};
use crate::policy::PolicySource;
use crate::runs::Run;

/// The manifest's name in a run's folder.
pub const MANIFEST_FILE: &str = "expert.json";
/// Where a run goes on.
pub const CHECKPOINT_FILE: &str = "checkpoint.safetensors";
/// The best policy so far.
pub const ONNX_FILE: &str = "policy.onnx";
/// The same.
pub const SAFETENSORS_FILE: &str = "policy.safetensors";
/// Transitions of a run that was stopped: hundreds of megabytes, so not of each checkpoint.
const REPLAY_FILE: &str = "replay.safetensors";
const LATEST_FILE: &str = "latest.onnx";
/// Seed of the first episode of each evaluation.
pub const EVALUATION_SEED: u64 = 10_000;

/// `expert.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ExpertManifest {
    /// Every setting.
    pub settings: ExpertSettings,
    /// Who trained, and where.
    pub versions: Versions,
}

/// What happens during a run, for whoever watches.
#[derive(Debug, Clone)]
pub enum Event {
    /// A resumed run has collected so many of so many transitions before it goes on.
    Refill(u64, u64),
    /// A report of progress.
    Report(ExpertMetrics),
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
    /// Where it stands.
    pub counters: Counters,
    /// Updates.
    pub updates: u64,
}

/// A run that is ready to go; its folder is locked.
pub struct ExpertRun {
    run: Run,
    settings: ExpertSettings,
    restored: Option<Restored>,
    /// Where the restored run's transitions may be.
    replay_file: PathBuf,
}

impl ExpertRun {
    /// Takes `folder`, which must not hold a run, for a new one; it begins from the checkpoint in
    /// the file `from`, if one is named, and its settings then go through `change`.
    ///
    /// # Errors
    /// [`ClientError::RunFolder`], [`ClientError::Train`] for settings and checkpoints.
    pub fn start(
        folder: &Path,
        from: Option<&Path>,
        change: impl FnOnce(Option<ExpertSettings>) -> Result<ExpertSettings, ClientError>,
    ) -> Result<Self, ClientError> {
        if folder.join(MANIFEST_FILE).exists() {
            let message = "holds a run; --resume goes on with it, or name another --out".into();
            return Err(ClientError::RunFolder { path: folder.into(), message });
        }
        let restored = match from {
            Some(path) => Some(
                checkpoint::read(path)?
                    .ok_or_else(|| ClientError::file(path, "there is no such checkpoint"))?,
            ),
            None => None,
        };
        let run = Run::at(folder)?;
        let beside = from.and_then(Path::parent).unwrap_or(folder);
        Self::prepare(run, restored, beside.join(REPLAY_FILE), change)
    }

    /// Goes on with the run in `folder`; its settings go through `change`.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub fn resume(
        folder: &Path,
        change: impl FnOnce(Option<ExpertSettings>) -> Result<ExpertSettings, ClientError>,
    ) -> Result<Self, ClientError> {
        let run = Run::open(folder)?;
        let Some(manifest) = run.read_json::<ExpertManifest>(MANIFEST_FILE)? else {
            let message = format!("holds no run: there is no {MANIFEST_FILE}");
            return Err(ClientError::RunFolder { path: folder.into(), message });
        };
        let restored = checkpoint::read(&run.path(CHECKPOINT_FILE))?;
        let stored = manifest.settings;
        let replay_file = run.path(REPLAY_FILE);
        Self::prepare(run, restored, replay_file, |_| change(Some(stored)))
    }

    fn prepare(
        run: Run,
        restored: Option<Restored>,
        replay_file: PathBuf,
        change: impl FnOnce(Option<ExpertSettings>) -> Result<ExpertSettings, ClientError>,
    ) -> Result<Self, ClientError> {
        let stored = restored.as_ref().map(|restored| restored.settings.clone());
        let settings = change(stored.clone())?;
        settings.validate()?;
        if stored.is_some_and(|stored| !settings.continues(&stored)) {
            let message = "is of a run with other settings: env, seed, critic, hidden, quantiles, \
                batch, discount and the like cannot change on the way"
                .into();
            return Err(ClientError::RunFolder { path: run.folder().into(), message });
        }
        let restored = restored.map(|restored| restored.continued_by(&settings));
        Ok(Self { run, settings, restored, replay_file })
    }

    /// The run's folder.
    #[must_use]
    pub fn folder(&self) -> &Path {
        self.run.folder()
    }

    /// What the run is to do.
    #[must_use]
    pub fn settings(&self) -> &ExpertSettings {
        &self.settings
    }

    /// Trains to the end, or until `is_stopped`. Dropping the receiver of `events` does no harm.
    ///
    /// # Errors
    /// [`ClientError::Train`], [`ClientError::File`], [`ClientError::Status`]. The last checkpoint
    /// is left behind.
    pub async fn train(
        self,
        client: &Client,
        git_revision: Option<&str>,
        is_stopped: Arc<AtomicBool>,
        events: UnboundedSender<Event>,
    ) -> Result<Outcome, ClientError> {
        let server = client.server_info().await?;
        let manifest = ExpertManifest {
            settings: self.settings.clone(),
            versions: Versions {
                palr_gym: env!("CARGO_PKG_VERSION").to_owned(),
                git_revision: git_revision.map(str::to_owned),
                server: server.version,
                mujoco: server.mujoco_version,
            },
        };
        self.run.write_json(MANIFEST_FILE, &manifest)?;
        let client = client.clone();
        let handle = Handle::current();
        let training = tokio::task::spawn_blocking(move || {
            let mut training = Training::open(self, client, handle, events)?;
            training.run(&is_stopped)
        });
        training.await.map_err(|error| ClientError::Panicked {
            what: "the trainer",
            message: error.to_string(),
        })?
    }
}

/// A run under way, on a thread of its own.
struct Training {
    run: Run,
    settings: ExpertSettings,
    client: Client,
    handle: Handle,
    events: UnboundedSender<Event>,
    collector: Collector,
    perturbation: Option<Perturbation>,
    replay: Replay,
    agent: Agent,
    counters: Counters,
    best: Vec<f32>,
    metrics: Track<ExpertMetrics>,
    evaluations: Track<EvaluationRecord>,
    /// Updates that are due, and the part of the next one.
    owed: f64,
    batch: Batch,
    since_report: SinceReport,
    /// When this process began, and what the run had taken before.
    started: Instant,
    wall_time_before_s: f64,
}

#[derive(Default)]
struct SinceReport {
    updates: u64,
    actor_updates: u64,
    sums: Losses,
    returns: Vec<f64>,
}

impl Training {
    fn open(
        expert: ExpertRun,
        client: Client,
        handle: Handle,
        events: UnboundedSender<Event>,
    ) -> Result<Self, ClientError> {
        let ExpertRun { run, settings, restored, replay_file } = expert;
        let resumed = restored.as_ref().map_or(0, |restored| restored.counters.resumed + 1);
        // A resumed run does not see the same resets again.
        let seed = settings.seed.wrapping_add(u64::from(resumed) << 32);
        let open = Collector::open(&client, &settings, seed);
        let collector = handle.block_on(open)?;
        let (observation_size, action_size) =
            (collector.observation_size(), collector.action_size());
        let (agent, counters, best) = match restored {
            Some(restored) => (restored.agent, restored.counters, restored.best),
            None => {
                let agent = Agent::new(&settings, observation_size, action_size);
                (agent, Counters::default(), Vec::new())
            }
        };
        if (agent.observation_size(), agent.action_size()) != (observation_size, action_size) {
            let message = "has a checkpoint for an environment of other sizes".into();
            return Err(ClientError::RunFolder { path: run.folder().into(), message });
        }
        let perturbation = Perturbation::new(&settings, action_size);
        let mut metrics = Track::open(run.folder(), METRICS_FILE, "training", u64::MAX)?;
        let mut evaluations = Track::open(run.folder(), EVALUATIONS_FILE, "evaluation", u64::MAX)?;
        metrics.forget_after(counters.step)?;
        evaluations.forget_after(counters.step)?;
        let mut replay = Replay::new(observation_size, action_size, settings.replay);
        replay.read(&replay_file, counters.step)?;
        let wall_time_before_s = counters.wall_time_s;
        let is_missing = !run.path(ONNX_FILE).exists();
        if is_missing && counters.best.is_some() {
            // A folder that begins from another's checkpoint.
            write_best(&run, &policy(&agent, &settings, &best))?;
        }
        let counters = Counters { resumed, ..counters };
        Ok(Self {
            run,
            settings,
            client,
            handle,
            events,
            collector,
            perturbation,
            replay,
            agent,
            counters,
            best,
            metrics,
            evaluations,
            owed: 0.0,
            batch: Batch::default(),
            since_report: SinceReport::default(),
            started: Instant::now(),
            wall_time_before_s,
        })
    }

    fn run(&mut self, is_stopped: &AtomicBool) -> Result<Outcome, ClientError> {
        let mut refilled = self.replay.len() as u64;
        let refill = match refilled {
            0 => self.counters.kept.min(self.settings.refill),
            _ => 0,
        };
        while refilled < refill {
            if is_stopped.load(Ordering::Relaxed) {
                return Ok(self.outcome());
            }
            refilled += self.round(0)?;
            let _ = self.events.send(Event::Refill(refilled, refill));
        }
        while self.counters.step < self.settings.steps {
            if is_stopped.load(Ordering::Relaxed) {
                self.save()?;
                self.replay.write(&self.run.path(REPLAY_FILE), self.counters.step)?;
                return Ok(self.outcome());
            }
            let is_learning = self.counters.step >= self.settings.learning_starts;
            let updates = if is_learning { self.owed as u64 } else { 0 };
            self.owed -= updates as f64;
            let before = self.counters.step;
            let collected = self.round(updates)?;
            self.counters.step += collected;
            if is_learning {
                self.owed += collected as f64 * self.settings.updates_per_step;
            }
            let now = self.counters.step;
            let crosses = |every| now / every > before / every;
            let ExpertSettings { log_every, evaluate_every, checkpoint_every, .. } = self.settings;
            if crosses(log_every) {
                self.report()?;
            }
            let is_evaluated = crosses(evaluate_every) && is_learning;
            if is_evaluated {
                self.evaluate()?;
            }
            if is_evaluated || crosses(checkpoint_every) {
                self.save()?;
            }
        }
        if self.evaluations.records().last().map(|record| record.step) != Some(self.counters.step) {
            self.evaluate()?;
            self.save()?;
        }
        Ok(self.outcome())
    }

    /// One step of all environments, beside so many updates; returns the transitions collected.
    fn round(&mut self, updates: u64) -> Result<u64, ClientError> {
        let settings = &self.settings;
        let round = self.counters.rounds as u32;
        self.counters.rounds += 1;
        let mut generator = stream(settings.seed, Purpose::Exploration, round);
        let pushes = match &mut self.perturbation {
            Some(some) => some.next(&mut stream(settings.seed, Purpose::Perturbation, round)),
            None => &[],
        };
        let count = settings.num_envs * self.agent.action_size();
        if self.counters.step < settings.learning_starts {
            let actions: Vec<f32> =
                (0..count).map(|_| generator.uniform(-1.0, 1.0) as f32).collect();
            self.collector.send(&actions, pushes)?;
        } else {
            let noise = Normals::new(&mut generator).draw(count, 1.0);
            let actions = self.agent.act(self.collector.observations(), &noise);
            self.collector.send(actions, pushes)?;
        }
        for _ in 0..updates {
            self.update()?;
        }
        let collected = self.handle.block_on(self.collector.receive(&mut self.replay))?;
        self.since_report.returns.extend(collected.returns);
        Ok(collected.transitions)
    }

    fn update(&mut self) -> Result<(), ClientError> {
        let ExpertSettings { seed, batch, .. } = self.settings;
        let number = self.agent.updates as u32;
        self.replay.draw(&mut stream(seed, Purpose::Batch, number), batch, &mut self.batch);
        let mut normals = Normals::new(&mut stream(seed, Purpose::Noise, number));
        let count = batch * self.agent.action_size();
        let noise =
            UpdateNoise { present: normals.draw(count, 1.0), next: normals.draw(count, 1.0) };
        let losses = self.agent.update(&self.batch, &noise)?;
        let since = &mut self.since_report;
        since.updates += 1;
        since.sums.critic += losses.critic;
        since.sums.entropy += losses.entropy;
        since.sums.temperature += losses.temperature;
        if let (Some(actor), Some(value)) = (losses.actor, losses.value) {
            since.actor_updates += 1;
            *since.sums.actor.get_or_insert(0.0) += actor;
            *since.sums.value.get_or_insert(0.0) += value;
        }
        Ok(())
    }

    fn wall_time_s(&self) -> f64 {
        self.wall_time_before_s + self.started.elapsed().as_secs_f64()
    }

    fn report(&mut self) -> Result<(), ClientError> {
        let SinceReport { updates, actor_updates, sums, returns } =
            std::mem::take(&mut self.since_report);
        // Before the first update all sums are 0.
        let count = updates.max(1) as f64;
        let actor_count = actor_updates.max(1) as f64;
        let metrics = ExpertMetrics {
            step: self.counters.step,
            updates: self.agent.updates,
            training_return: (!returns.is_empty())
                .then(|| returns.iter().sum::<f64>() / returns.len() as f64),
            critic_loss: sums.critic / count,
            actor_loss: sums.actor.unwrap_or(0.0) / actor_count,
            value: sums.value.unwrap_or(0.0) / actor_count,
            entropy: sums.entropy / count,
            temperature: sums.temperature / count,
            wall_time_s: self.wall_time_s(),
        };
        self.metrics.put(metrics.clone())?;
        // Nobody may be watching.
        let _ = self.events.send(Event::Report(metrics));
        Ok(())
    }

    fn evaluate(&mut self) -> Result<(), ClientError> {
        let policy = policy(&self.agent, &self.settings, &self.agent.averaged_actor);
        let onnx = policy.to_onnx()?;
        let latest = self.run.path(LATEST_FILE);
        write_whole(&latest, &onnx)?;
        let options = EvaluateOptions {
            env_id: self.settings.env.clone(),
            policy: PolicySource::File(latest),
            episodes: self.settings.episodes,
            seed: EVALUATION_SEED,
            action_mode: ActionMode::Deterministic,
            num_envs: None,
            scene_options: None,
        };
        let evaluation = self.handle.block_on(evaluate(&self.client, &options, |_| {}))?;
        let record = EvaluationRecord::new(self.counters.step, &evaluation);
        let is_best = self.counters.best.is_none_or(|best| record.return_mean > best.return_mean);
        if is_best {
            write_best(&self.run, &policy)?;
            self.best.clone_from(&self.agent.averaged_actor);
            self.counters.best = Some(Best {
                step: record.step,
                return_mean: record.return_mean,
                score_mean: record.score_mean,
            });
        }
        self.evaluations.put(record.clone())?;
        let _ = self.events.send(Event::Evaluation(record));
        Ok(())
    }

    fn save(&mut self) -> Result<(), ClientError> {
        self.counters.kept = self.replay.len() as u64;
        self.counters.wall_time_s = self.wall_time_s();
        let path = self.run.path(CHECKPOINT_FILE);
        checkpoint::write(&path, &self.agent, &self.best, &self.counters, &self.settings)?;
        Ok(())
    }

    fn outcome(&self) -> Outcome {
        Outcome {
            run_folder: self.run.folder().to_path_buf(),
            is_complete: self.counters.step >= self.settings.steps,
            counters: self.counters.clone(),
            updates: self.agent.updates,
        }
    }
}

/// The policy that an agent's actor is with `parameters`.
fn policy<'a>(agent: &Agent, settings: &ExpertSettings, parameters: &'a [f32]) -> ExpertPolicy<'a> {
    ExpertPolicy {
        observation_size: agent.observation_size(),
        hidden: settings.hidden,
        action_size: agent.action_size(),
        parameters,
    }
}

/// Replaces the best policy so far.
fn write_best(run: &Run, policy: &ExpertPolicy<'_>) -> Result<(), ClientError> {
    write_whole(&run.path(ONNX_FILE), &policy.to_onnx()?)?;
    write_whole(&run.path(SAFETENSORS_FILE), &policy.to_safetensors()?)?;
    Ok(())
}
