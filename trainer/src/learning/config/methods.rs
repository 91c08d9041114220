//! Settings of each method, a table each.
//!
//! Where the paper, its public code and a method's own code differ, the default follows the paper's
//! Tables 7 and 8, then the paper's code; each alternative has a name here.

use serde::{Deserialize, Serialize};

use super::{check, positive};
use crate::learning::error::TrainError;

/// Where the regulariser's weight matrix M of a step comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WeightsMode {
    /// From the step's own batch, computed anew each step.
    Exact,
    /// From one of `pool_size` batches drawn once; the likelihood stays on fresh batches.
    Pool,
}

/// `[palr]`: the regulariser of PALR, PALR-ACT and DT-PALR, and the kernels of every logged HSCIC.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PalrConfig {
    /// α, the weight of HSCIC in the loss.
    pub alpha: f64,
    /// λ of the ridge regression; enters the kernel matrix as n·λ.
    pub ridge: f64,
    /// σ² of all three kernels, `exp(-d² / σ²)`.
    pub bandwidth_sq: f64,
    /// True: both actions are standardised inside HSCIC (the reference code); false: raw (the
    /// paper's text).
    pub standardize_actions: bool,
    /// Where M comes from.
    pub weights: WeightsMode,
    /// Batches in the pool. Each holds n(n+1) bytes: 1 MiB at a batch of 1024.
    pub pool_size: usize,
}

impl Default for PalrConfig {
    /// α of the paper's Table 8 for most tasks (walker2d: 100), λ and σ² of the reference.
    fn default() -> Self {
        Self {
            alpha: 10.0,
            ridge: 1e-5,
            bandwidth_sq: 1.0,
            standardize_actions: true,
            weights: WeightsMode::Exact,
            pool_size: 512,
        }
    }
}

impl PalrConfig {
    pub(super) fn validate(&self) -> Result<(), TrainError> {
        not_negative("palr.alpha", self.alpha)?;
        positive("palr.ridge", self.ridge)?;
        positive("palr.bandwidth_sq", self.bandwidth_sq)?;
        let got = self.pool_size;
        check(got >= 1, "palr.pool_size", got, "at least 1")?;
        check(u32::try_from(got).is_ok(), "palr.pool_size", got, "below 2^32")
    }
}

/// Which action PALR-ACT regularises.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ActionSource {
    /// tanh(mean + std ε), differentiated through mean and std (the paper's text).
    Sampled,
    /// tanh(mean).
    Mean,
}

/// `[palr_act]`: besides `[palr]`, which holds the regulariser.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PalrActConfig {
    /// Which action.
    pub action: ActionSource,
}

impl Default for PalrActConfig {
    fn default() -> Self {
        Self { action: ActionSource::Sampled }
    }
}

/// How KF turns the errors of action prediction into weights of samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum KfWeighting {
    /// Softmax over the batch.
    Softmax,
    /// `step_weight` above a threshold, 1 below it.
    Step,
}

/// What the temperature does inside of KF's softmax.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum KfTemperature {
    /// softmax(temperature · error), as the KF paper writes it. Table 8's values make sense so.
    Multiplies,
    /// softmax(error / temperature), as the KF code computes it.
    Divides,
}

/// When KF's action predictor is trained.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum KfSchedule {
    /// Beside the policy: each step weighs with the predictor so far, then updates it.
    Joint,
    /// First, for `predictor_steps` steps; then every sample's error is fixed (the KF code).
    TwoStage,
}

/// `[kf]`: keyframe-focused imitation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KfConfig {
    /// Widths of the action predictor's hidden layers.
    pub hidden_sizes: [usize; 2],
    /// Its Adam's step size.
    pub learning_rate: f64,
    /// Its updates in each step of the policy.
    pub inner_updates: u32,
    /// Past actions that it sees: a[t-1], …, a[t-k].
    pub past_actions: usize,
    /// How errors become weights.
    pub weighting: KfWeighting,
    /// Of the softmax.
    pub temperature: f64,
    /// What it does.
    pub temperature_use: KfTemperature,
    /// Of the step: the share of the training rows, those with the largest errors, that are
    /// keyframes.
    pub step_share: f64,
    /// Of the step: weight of a keyframe.
    pub step_weight: f64,
    /// When the predictor is trained.
    pub schedule: KfSchedule,
    /// Steps of the first of two stages.
    pub predictor_steps: u64,
}

impl Default for KfConfig {
    fn default() -> Self {
        Self {
            hidden_sizes: [128, 128],
            learning_rate: 3e-4,
            inner_updates: 1,
            past_actions: 1,
            weighting: KfWeighting::Softmax,
            temperature: 0.01,
            temperature_use: KfTemperature::Multiplies,
            step_share: 0.1,
            step_weight: 5.0,
            schedule: KfSchedule::Joint,
            predictor_steps: 10_000,
        }
    }
}

impl KfConfig {
    pub(super) fn validate(&self) -> Result<(), TrainError> {
        for got in self.hidden_sizes {
            width("kf.hidden_sizes", got)?;
        }
        positive("kf.learning_rate", self.learning_rate)?;
        updates("kf.inner_updates", self.inner_updates)?;
        check(self.past_actions >= 1, "kf.past_actions", self.past_actions, "at least 1")?;
        positive("kf.temperature", self.temperature)?;
        let is_share = self.step_share > 0.0 && self.step_share < 1.0;
        check(is_share, "kf.step_share", self.step_share, "a share between 0 and 1")?;
        positive("kf.step_weight", self.step_weight)?;
        let got = self.predictor_steps;
        check(got >= 1, "kf.predictor_steps", got, "at least 1")?;
        check(u32::try_from(got).is_ok(), "kf.predictor_steps", got, "below 2^32")
    }
}

/// Where the prime network's action joins PrimeNet's policy.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PrimeJunction {
    /// Beside the observations.
    Input,
    /// Beside the representation φ.
    Representation,
    /// Beside the last hidden layer, before the heads (the public code joins at the last layer).
    Hidden,
}

/// `[primenet]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PrimenetConfig {
    /// Step size of the prime network's Adam.
    pub learning_rate: f64,
    /// Where its action joins.
    pub junction: PrimeJunction,
    /// True: the policy's likelihood does not reach the prime network.
    pub detach: bool,
}

impl Default for PrimenetConfig {
    fn default() -> Self {
        Self { learning_rate: 3e-4, junction: PrimeJunction::Representation, detach: false }
    }
}

impl PrimenetConfig {
    pub(super) fn validate(&self) -> Result<(), TrainError> {
        positive("primenet.learning_rate", self.learning_rate)
    }
}

/// `[rap]`: residual action prediction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RapConfig {
    /// Width of the residual head's hidden layer (the released training script passes 128; the
    /// paper's Table 7 says 300).
    pub residual_size: usize,
    /// Step size of the memory stream's and the residual head's Adams.
    pub learning_rate: f64,
    /// Their updates in each step of the policy.
    pub inner_updates: u32,
}

impl Default for RapConfig {
    fn default() -> Self {
        Self { residual_size: 300, learning_rate: 3e-4, inner_updates: 1 }
    }
}

impl RapConfig {
    pub(super) fn validate(&self) -> Result<(), TrainError> {
        width("rap.residual_size", self.residual_size)?;
        positive("rap.learning_rate", self.learning_rate)?;
        updates("rap.inner_updates", self.inner_updates)
    }
}

/// `[fca]`: fighting copycat agents.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FcaConfig {
    /// α, the weight of the adversary's error.
    pub alpha: f64,
    /// Weight of ½φ², summed over the batch and φ.
    pub bottleneck: f64,
    /// Width of the adversary's hidden layer (the released training script passes 128; the paper's
    /// Table 7 says 300).
    pub hidden_size: usize,
    /// Step size of the adversary's Adam.
    pub learning_rate: f64,
    /// Its updates in each step of the policy, each on a batch of its own.
    pub inner_updates: u32,
    /// True: the layer after φ keeps its initial parameters, as in the released code, whose
    /// optimiser leaves it out.
    pub freeze_hidden: bool,
}

impl Default for FcaConfig {
    fn default() -> Self {
        Self {
            alpha: 0.1,
            bottleneck: 0.01,
            hidden_size: 300,
            learning_rate: 1e-4,
            inner_updates: 5,
            freeze_hidden: false,
        }
    }
}

impl FcaConfig {
    pub(super) fn validate(&self) -> Result<(), TrainError> {
        not_negative("fca.alpha", self.alpha)?;
        not_negative("fca.bottleneck", self.bottleneck)?;
        width("fca.hidden_size", self.hidden_size)?;
        positive("fca.learning_rate", self.learning_rate)?;
        updates("fca.inner_updates", self.inner_updates)
    }
}

/// `[mine]`: the likelihood, and a neural estimate of mutual information.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MineConfig {
    /// α, the weight of the estimate.
    pub alpha: f64,
    /// Widths of the estimator's hidden layers.
    pub hidden_sizes: [usize; 2],
    /// Step size of the estimator's Adam.
    pub learning_rate: f64,
    /// Its updates in each step of the policy, each on a batch of its own.
    pub inner_updates: u32,
    /// Standard deviation of the noise on the estimator's input.
    pub input_noise: f64,
    /// Standard deviation of the noise on its hidden layers.
    pub hidden_noise: f64,
    /// Decay of the moving average that corrects the estimator's gradient (0.994 in MINE's public
    /// code; the paper's code never gets to its own). Unset: the plain, biased gradient.
    pub ema_decay: Option<f64>,
    /// As [`FcaConfig::freeze_hidden`].
    pub freeze_hidden: bool,
}

impl Default for MineConfig {
    fn default() -> Self {
        Self {
            alpha: 1.0,
            hidden_sizes: [100, 100],
            learning_rate: 1e-4,
            inner_updates: 5,
            input_noise: 0.3,
            hidden_noise: 0.5,
            ema_decay: None,
            freeze_hidden: false,
        }
    }
}

impl MineConfig {
    pub(super) fn validate(&self) -> Result<(), TrainError> {
        not_negative("mine.alpha", self.alpha)?;
        for got in self.hidden_sizes {
            width("mine.hidden_sizes", got)?;
        }
        positive("mine.learning_rate", self.learning_rate)?;
        updates("mine.inner_updates", self.inner_updates)?;
        not_negative("mine.input_noise", self.input_noise)?;
        not_negative("mine.hidden_noise", self.hidden_noise)?;
        match self.ema_decay {
            Some(got) => check((0.0..1.0).contains(&got), "mine.ema_decay", got, "0 to below 1"),
            None => Ok(()),
        }
    }
}

/// `[vib]`: the variational information bottleneck.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VibConfig {
    /// β, the weight of the divergence from the standard normal (1e-3 and 1e-5 in the paper).
    pub beta: f64,
    /// Samples of the bottleneck that the finished policy averages over (12 in VIB's public
    /// code), drawn once; 0: the bottleneck's mean.
    pub policy_samples: usize,
}

impl Default for VibConfig {
    fn default() -> Self {
        Self { beta: 1e-3, policy_samples: 0 }
    }
}

impl VibConfig {
    pub(super) fn validate(&self) -> Result<(), TrainError> {
        not_negative("vib.beta", self.beta)?;
        let got = self.policy_samples;
        check(got <= 1000, "vib.policy_samples", got, "at most 1000")
    }
}

fn not_negative(name: &str, got: f64) -> Result<(), TrainError> {
    check(got.is_finite() && got >= 0.0, name, got, "at least 0")
}

fn width(name: &str, got: usize) -> Result<(), TrainError> {
    check((1..=4096).contains(&got), name, got, "1 to 4096")
}

fn updates(name: &str, got: u32) -> Result<(), TrainError> {
    // The number of an update is part of a generator's stream.
    check((1..=1000).contains(&got), name, got, "1 to 1000")
}

/// `[dt]`: the decision transformer's AdamW.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DtConfig {
    /// Steps over which the step size grows to `learning_rate`.
    pub warmup_steps: u64,
    /// Of every parameter, times the step size.
    pub weight_decay: f64,
    /// A longer gradient is shortened to this.
    pub clip_norm: f64,
}

impl Default for DtConfig {
    /// The public code's.
    fn default() -> Self {
        Self { warmup_steps: 10_000, weight_decay: 1e-4, clip_norm: 0.25 }
    }
}

impl DtConfig {
    pub(super) fn validate(&self) -> Result<(), TrainError> {
        check(self.warmup_steps >= 1, "dt.warmup_steps", self.warmup_steps, "at least 1")?;
        not_negative("dt.weight_decay", self.weight_decay)?;
        positive("dt.clip_norm", self.clip_norm)
    }
}
