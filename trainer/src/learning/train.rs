//! The training loop.
//!
//! Same build, machine, settings and data ⇒ the same bits, however often the run was killed and
//! resumed and whatever was measured meanwhile: the state is [`State`], and a step's random numbers
//! follow from seed and step.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use crate::learning::algorithms::{Method, StepReport, method};
use crate::learning::checkpoint::{self, write_whole};
use crate::learning::config::{Algorithm, TrainConfig};
use crate::learning::context::Context;
use crate::learning::data::TrainingSet;
use crate::learning::error::TrainError;
use crate::learning::export::TrainedPolicy;
use crate::learning::lockstep::{LockstepRun, train_lockstep};
use crate::learning::metrics::{Measurement, Probe};
use crate::learning::regularizer::{Ahead, SharedWeights, WeightSource};
use crate::learning::state::State;

/// Settings of a run, in its folder.
pub const CONFIG_FILE: &str = "config.json";
/// State of a run, in its folder.
pub const CHECKPOINT_FILE: &str = "checkpoint.safetensors";
/// The finished policy, in the run's folder.
pub const ONNX_FILE: &str = "policy.onnx";
/// The finished policy's parameters, in the run's folder.
pub const SAFETENSORS_FILE: &str = "policy.safetensors";

/// A report of progress. A resumed run repeats the reports after its checkpoint, number for number.
#[derive(Debug, Clone)]
pub struct Progress {
    /// Steps taken.
    pub step: u64,
    /// Steps to take.
    pub steps: u64,
    /// NLL of the step's batch, before the step, in nats.
    pub batch_nll: f64,
    /// HSCIC of the step's regularised rows, before the step; `None` for methods without it.
    pub batch_hscic: Option<f64>,
    /// The method's other terms of the step, by name.
    pub batch_terms: Vec<(&'static str, f64)>,
    /// On rows of the training set.
    pub training: Measurement,
    /// On rows of the held-out set.
    pub held_out: Option<Measurement>,
    /// After the step.
    pub policy: TrainedPolicy,
}

/// What a run left.
#[derive(Debug, Clone)]
pub struct Trained {
    /// The policy.
    pub policy: TrainedPolicy,
    /// Steps taken.
    pub step: u64,
    /// False if the run was stopped; then it can be resumed.
    pub is_complete: bool,
}

/// Trains a policy on `data`; `run_folder` holds the run.
///
/// `on_progress` is called every `log_every` steps and after the last. If it breaks, or once
/// `is_stopped` is true, which is looked at after every step, the run ends there, with a checkpoint.
/// With `resume`, a run goes on from the folder's checkpoint, or starts if there is none yet. A
/// finished run leaves its policy as [`ONNX_FILE`] and [`SAFETENSORS_FILE`]. One process at a time
/// may work in a folder; see [`crate::runs::Run`].
///
/// # Errors
/// Any [`TrainError`]. The folder's last checkpoint is never replaced by numbers that are not
/// finite.
pub fn train(
    config: &TrainConfig,
    data: &TrainingSet,
    held_out: Option<&TrainingSet>,
    run_folder: &Path,
    resume: bool,
    is_stopped: &AtomicBool,
    mut on_progress: impl FnMut(&Progress) -> ControlFlow<()>,
) -> Result<Trained, TrainError> {
    let run = LockstepRun { config, data, held_out, run_folder };
    let trained = train_lockstep(&[run], resume, is_stopped, |_, progress| on_progress(progress))?;
    // One run in, one out.
    trained.into_iter().next().ok_or_else(|| TrainError::Tensor("no run was trained".into()))
}

/// A run under way.
pub(crate) struct Trainer<'a> {
    config: &'a TrainConfig,
    data: &'a TrainingSet,
    method: Box<dyn Method + 'a>,
    weights: Option<WeightSource<'a>>,
    state: State,
    run_folder: PathBuf,
    fingerprint: u32,
    training_probe: Probe,
    held_out_probe: Option<Probe>,
}

impl<'a> Trainer<'a> {
    pub(crate) fn start(
        config: &'a TrainConfig,
        data: &'a TrainingSet,
        held_out: Option<&TrainingSet>,
        run_folder: &Path,
        resume: bool,
        shared_weights: SharedWeights,
    ) -> Result<Self, TrainError> {
        config.validate()?;
        check_sizes(data, held_out)?;
        let context = Context::new(config, data, shared_weights);
        let needs_weights =
            matches!(config.algorithm, Algorithm::Palr | Algorithm::PalrAct | Algorithm::DtPalr);
        let weights = needs_weights.then(|| context.weights.clone());
        let method = method(context);
        let fingerprint = data.fingerprint();
        let path = run_folder.join(CHECKPOINT_FILE);
        let state = start(config, method.start(), &path, fingerprint, resume)?;
        write_config(config, run_folder)?;
        Ok(Self {
            config,
            data,
            method,
            weights,
            state,
            run_folder: run_folder.to_path_buf(),
            fingerprint,
            training_probe: Probe::new(data, config)?,
            held_out_probe: held_out.map(|set| Probe::new(set, config)).transpose()?,
        })
    }

    pub(crate) fn has_next(&self) -> bool {
        self.state.step < self.config.steps
    }

    /// Steps taken.
    pub(crate) fn step(&self) -> u64 {
        self.state.step
    }

    /// M of the step after the next one, if there is one.
    pub(crate) fn ahead(&self) -> Option<Ahead<'a>> {
        let index = self.state.step + 1;
        let weights = self.weights.as_ref().filter(|_| index < self.config.steps)?;
        Ahead::new(weights, index)
    }

    /// Replaces the run's checkpoint.
    pub(crate) fn write_checkpoint(&self) -> Result<(), TrainError> {
        let path = self.run_folder.join(CHECKPOINT_FILE);
        checkpoint::write(&self.state, &path, self.config, self.fingerprint)
    }

    /// A step, or a part of what comes before the first one. Breaks if the run was stopped.
    pub(crate) fn advance(
        &mut self,
        is_stopped: &AtomicBool,
        on_progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
    ) -> Result<ControlFlow<()>, TrainError> {
        let report = self.method.step(&mut self.state)?;
        let mut is_ending = is_stopped.load(Ordering::Relaxed);
        let mut is_due = false;
        if let Some(report) = report {
            self.state.step += 1;
            let step = self.state.step;
            let is_last = step == self.config.steps;
            if is_last || step.is_multiple_of(self.config.log_every) {
                is_ending |= on_progress(&self.progress(report)?).is_break();
            }
            is_due = is_last || step.is_multiple_of(self.config.checkpoint_every);
        }
        if is_due || is_ending {
            self.write_checkpoint()?;
        }
        Ok(if is_ending { ControlFlow::Break(()) } else { ControlFlow::Continue(()) })
    }

    fn progress(&self, report: StepReport) -> Result<Progress, TrainError> {
        let policy = self.policy();
        let measure = |probe: &Probe| probe.measure(policy.architecture, &policy.parameters);
        Ok(Progress {
            step: self.state.step,
            steps: self.config.steps,
            batch_nll: report.nll,
            batch_hscic: report.hscic,
            batch_terms: report.terms,
            training: measure(&self.training_probe)?,
            held_out: self.held_out_probe.as_ref().map(measure).transpose()?,
            policy,
        })
    }

    fn policy(&self) -> TrainedPolicy {
        TrainedPolicy {
            architecture: self.method.architecture(),
            observation_statistics: self.data.observation_statistics().clone(),
            parameters: self.method.acting_parameters(&self.state),
        }
    }

    /// Leaves the finished policy, if it is.
    pub(crate) fn finish(self) -> Result<Trained, TrainError> {
        let policy = self.policy();
        let is_complete = !self.has_next();
        if is_complete {
            write_whole(&self.run_folder.join(ONNX_FILE), &policy.to_onnx()?)?;
            write_whole(&self.run_folder.join(SAFETENSORS_FILE), &policy.to_safetensors()?)?;
        }
        Ok(Trained { policy, step: self.state.step, is_complete })
    }
}

/// The state to go on from.
fn start(
    config: &TrainConfig,
    fresh: State,
    path: &Path,
    fingerprint: u32,
    resume: bool,
) -> Result<State, TrainError> {
    if !resume {
        if path.exists() {
            let message = "there is a run already; resume it, or choose another folder";
            return Err(TrainError::file(path, message));
        }
        return Ok(fresh);
    }
    let state = checkpoint::read(path, config, fingerprint, &fresh)?.unwrap_or(fresh);
    if state.step > config.steps {
        let (got, want) = (state.step, config.steps);
        let message = format!("has {got} steps already; steps is {want}");
        return Err(TrainError::file(path, message));
    }
    Ok(state)
}

fn write_config(config: &TrainConfig, run_folder: &Path) -> Result<(), TrainError> {
    let path = run_folder.join(CONFIG_FILE);
    let mut text =
        serde_json::to_string_pretty(config).map_err(|error| TrainError::file(&path, error))?;
    text.push('\n');
    write_whole(&path, text.as_bytes())
}

fn check_sizes(data: &TrainingSet, held_out: Option<&TrainingSet>) -> Result<(), TrainError> {
    for set in std::iter::once(data).chain(held_out) {
        let sizes = [
            ("an observation", set.observation_size(), data.observation_size()),
            ("an action", set.action_size(), data.action_size()),
        ];
        for (what, got, want) in sizes {
            if got != want {
                return Err(TrainError::Size { what, got, want });
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
