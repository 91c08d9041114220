//! The training loop.
//!
//! Same build, machine, settings and data ⇒ the same bits, however often the run was killed and
//! resumed and whatever was measured meanwhile: the state is that of [`Checkpoint`], and a step's
//! random numbers follow from seed and step.

use std::ops::ControlFlow;
use std::path::Path;

use burn::tensor::Device;

use crate::learning::algorithms::palr::Regularizer;
use crate::learning::algorithms::{Loss, bc, palr};
use crate::learning::checkpoint::{Checkpoint, write_whole};
use crate::learning::config::{Algorithm, TrainConfig, WeightsMode};
use crate::learning::data::TrainingSet;
use crate::learning::error::TrainError;
use crate::learning::export::TrainedPolicy;
use crate::learning::metrics::{Measurement, Probe, kernels};
use crate::learning::policy_net::{PolicyNet, PolicyShape};
use crate::learning::streams::{Purpose, draw_rows, stream};
use crate::learning::weights::{PackedWeights, WeightMatrix};

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
    /// HSCIC of the step's regularised rows, before the step; `None` for behaviour cloning.
    pub batch_hscic: Option<f64>,
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
    /// False if `on_progress` stopped the run; then it can be resumed.
    pub is_complete: bool,
}

/// Trains a policy on `data`; `run_folder` holds the run.
///
/// `on_progress` is called every `log_every` steps and after the last; if it breaks, the run ends
/// there, with a checkpoint. With `resume`, a run goes on from the folder's checkpoint, or starts
/// if there is none yet. A finished run leaves its policy as [`ONNX_FILE`] and
/// [`SAFETENSORS_FILE`]. One process at a time may work in a folder; see [`crate::runs::Run`].
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
    mut on_progress: impl FnMut(&Progress) -> ControlFlow<()>,
) -> Result<Trained, TrainError> {
    config.validate()?;
    check_sizes(data, held_out)?;
    let path = run_folder.join(CHECKPOINT_FILE);
    let fingerprint = data.fingerprint();
    let mut learner = Learner::new(config, data);
    let mut state = start(&learner, &path, fingerprint, resume)?;
    write_config(config, run_folder)?;
    let training_probe = Probe::new(data, config)?;
    let held_out_probe = held_out.map(|set| Probe::new(set, config)).transpose()?;

    let mut is_stopped = false;
    while state.adam.step < config.steps && !is_stopped {
        let loss = learner.step(&mut state)?;
        let step = state.adam.step;
        let is_last = step == config.steps;
        if is_last || step.is_multiple_of(config.log_every) {
            let measure = |probe: &Probe| probe.measure(learner.shape, &state.parameters);
            let progress = Progress {
                step,
                steps: config.steps,
                batch_nll: loss.nll,
                batch_hscic: loss.hscic,
                training: measure(&training_probe)?,
                held_out: held_out_probe.as_ref().map(measure).transpose()?,
                policy: learner.policy(&state),
            };
            is_stopped = on_progress(&progress).is_break();
        }
        if is_last || is_stopped || step.is_multiple_of(config.checkpoint_every) {
            if !state.parameters.iter().all(|parameter| parameter.is_finite()) {
                return Err(TrainError::Diverged { step, value: f64::NAN });
            }
            state.write(&path, config, fingerprint)?;
        }
    }

    let policy = learner.policy(&state);
    let is_complete = state.adam.step == config.steps;
    if is_complete {
        write_whole(&run_folder.join(ONNX_FILE), &policy.to_onnx()?)?;
        write_whole(&run_folder.join(SAFETENSORS_FILE), &policy.to_safetensors()?)?;
    }
    Ok(Trained { policy, step: state.adam.step, is_complete })
}

/// The state to go on from.
fn start(
    learner: &Learner<'_>,
    path: &Path,
    fingerprint: u32,
    resume: bool,
) -> Result<Checkpoint, TrainError> {
    let (config, shape) = (learner.config, learner.shape);
    if !resume {
        if path.exists() {
            let message = "there is a run already; resume it, or choose another folder";
            return Err(TrainError::file(path, message));
        }
        return Ok(Checkpoint::new(shape.initial_parameters(config.seed)));
    }
    let read = Checkpoint::read(path, config, fingerprint, shape.parameter_count())?;
    let state = read.unwrap_or_else(|| Checkpoint::new(shape.initial_parameters(config.seed)));
    if state.adam.step > config.steps {
        let (got, want) = (state.adam.step, config.steps);
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

/// Takes steps; what it caches follows from settings and data.
pub struct Learner<'a> {
    config: &'a TrainConfig,
    data: &'a TrainingSet,
    shape: PolicyShape,
    device: Device,
    /// M of the pool's batches, each computed when it is first needed.
    pool: Vec<Option<PackedWeights>>,
}

impl<'a> Learner<'a> {
    /// For a run of `config` on `data`.
    #[must_use]
    pub fn new(config: &'a TrainConfig, data: &'a TrainingSet) -> Self {
        let shape = PolicyShape {
            observation_size: data.observation_size(),
            action_size: data.action_size(),
        };
        let has_pool =
            config.algorithm == Algorithm::Palr && config.palr.weights == WeightsMode::Pool;
        let pool = vec![None; if has_pool { config.palr.pool_size } else { 0 }];
        Self { config, data, shape, device: Device::flex().autodiff(), pool }
    }

    /// Takes the step after `state`; the loss is that before it.
    ///
    /// # Errors
    /// [`TrainError::Diverged`], [`TrainError::Singular`] or [`TrainError::Tensor`].
    pub fn step(&mut self, state: &mut Checkpoint) -> Result<Loss, TrainError> {
        let policy = PolicyNet::new(self.shape, &state.parameters, &self.device)?;
        let loss = self.loss(&policy, state.adam.step)?;
        if !loss.nll.is_finite() {
            return Err(TrainError::Diverged { step: state.adam.step + 1, value: loss.nll });
        }
        let gradient = policy.gradient(&loss.tensor)?;
        state.adam.update(&mut state.parameters, &gradient, self.config.learning_rate);
        Ok(loss)
    }

    fn policy(&self, state: &Checkpoint) -> TrainedPolicy {
        TrainedPolicy {
            shape: self.shape,
            observation_statistics: self.data.observation_statistics().clone(),
            parameters: state.parameters.clone(),
        }
    }

    /// `index`: of the step, from 0.
    fn loss(&mut self, policy: &PolicyNet, index: u64) -> Result<Loss, TrainError> {
        let rows = self.rows(Purpose::Batch, index);
        let batch = self.data.batch(&rows);
        match self.config.algorithm {
            Algorithm::Bc => return bc::loss(policy, &batch, &self.device),
            Algorithm::Palr => {}
            other => {
                let message = format!("algorithm {} cannot be trained yet", other.name());
                return Err(TrainError::Setting { message });
            }
        }
        let pool_batch;
        let (weights, observations) = match self.config.palr.weights {
            WeightsMode::Exact => (self.weights(&rows)?, None),
            WeightsMode::Pool => {
                let entry = index % self.pool.len() as u64;
                let rows = self.rows(Purpose::PoolBatch, entry);
                pool_batch = self.data.batch(&rows);
                let weights = self.pooled_weights(entry as usize, &rows)?;
                (weights, Some(pool_batch.observations.as_slice()))
            }
        };
        let regularizer = Regularizer {
            weights: &weights,
            observations,
            alpha: self.config.palr.alpha,
            bandwidth_sq: self.config.palr.bandwidth_sq,
        };
        palr::loss(policy, &batch, regularizer, &self.device)
    }

    fn rows(&self, purpose: Purpose, index: u64) -> Vec<usize> {
        // Validation holds steps and pool below 2³².
        let mut generator = stream(self.config.batch_seed(), purpose, index as u32);
        draw_rows(&mut generator, self.data.len(), self.config.batch)
    }

    fn weights(&self, rows: &[usize]) -> Result<WeightMatrix, TrainError> {
        let (past, given) = self.data.hscic_actions(rows, self.config.palr.standardize_actions);
        WeightMatrix::new(&past, &given, self.data.action_size(), kernels(self.config))
    }

    /// Through half precision also when it was just computed: a resumed run would see it so.
    fn pooled_weights(&mut self, entry: usize, rows: &[usize]) -> Result<WeightMatrix, TrainError> {
        if let Some(packed) = &self.pool[entry] {
            return Ok(packed.unpack());
        }
        let packed = self.weights(rows)?.pack();
        let weights = packed.unpack();
        self.pool[entry] = Some(packed);
        Ok(weights)
    }
}

#[cfg(test)]
mod tests;
