//! What a report of progress measures.

use burn::tensor::Device;
use palr_gym_core::random::Generator;

use crate::learning::architecture::Architecture;
use crate::learning::config::TrainConfig;
use crate::learning::data::{Batch, TrainingSet};
use crate::learning::error::TrainError;
use crate::learning::kernel::hscic_gradient;
use crate::learning::likelihood;
use crate::learning::network::values;
use crate::learning::weights::{KernelConfig, WeightMatrix};

/// Of a policy on fixed rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measurement {
    /// Mean negative log-likelihood, in nats.
    pub nll: f64,
    /// The same, each row weighted by the squared change of its action, ‖a_t - a_{t-1}‖²: how good
    /// the policy is where copying the past action is wrong. Rows without a past action do not
    /// count; `None` if no action changes.
    pub change_nll: Option<f64>,
    /// HSCIC of the representation and the past action given the action, with the run's kernels.
    pub hscic: f64,
    /// HSCIC of a sampled action of the policy, raw actions throughout (as the paper's Table 13).
    pub action_hscic: f64,
}

/// Fixed rows of a set, and their M, which is computed once.
pub(crate) struct Probe {
    batch: Batch,
    weights: WeightMatrix,
    raw_weights: WeightMatrix,
    /// Of each row, summing to 1; empty if no action changes.
    change_weights: Vec<f64>,
    /// `[n, action_size]`: which sample of the policy is measured, the same in every report.
    noise: Vec<f32>,
    bandwidth_sq: f64,
}

impl Probe {
    /// At most `metric_rows` rows, evenly spaced: consecutive rows are not independent.
    pub(crate) fn new(set: &TrainingSet, config: &TrainConfig) -> Result<Self, TrainError> {
        let count = config.metric_rows.min(set.len());
        let rows: Vec<usize> = (0..count).map(|i| i * set.len() / count).collect();
        let weights = |is_standardized| {
            let (past, given) = set.hscic_actions(&rows, is_standardized);
            WeightMatrix::new(&past, &given, set.action_size(), kernels(config))
        };
        let raw_weights = weights(false)?;
        let is_standardized = config.palr.standardize_actions;
        let weights = if is_standardized { weights(true)? } else { raw_weights.clone() };
        let mut generator = Generator::from_seed(0);
        let noise = (0..count * set.action_size()).map(|_| generator.standard_normal() as f32);
        let noise = noise.collect();
        let bandwidth_sq = config.palr.bandwidth_sq;
        let batch = set.batch(&rows);
        let change_weights = change_weights(&batch, set.action_size());
        Ok(Self { batch, weights, raw_weights, change_weights, noise, bandwidth_sq })
    }

    pub(crate) fn measure(
        &self,
        architecture: Architecture,
        parameters: &[f32],
    ) -> Result<Measurement, TrainError> {
        let device = Device::flex();
        let batch = self.batch.tensors(&device);
        let output = architecture.forward(parameters, batch.observations.clone(), &device)?;
        let (_, nll) = likelihood::of_batch(&output, &batch)?;
        let [_, width] = output.representation.dims();
        let phi = values(output.representation)?;
        let hscic = hscic_gradient(&phi, width, &self.weights, self.bandwidth_sq);
        let (mean, log_std) = (values(output.mean)?, values(output.log_std)?);
        let change_nll = self.change_nll(&mean, &log_std, architecture.action_size);
        let sampled = mean.iter().zip(&log_std).zip(&self.noise);
        let actions: Vec<f32> =
            sampled.map(|((mean, log_std), noise)| (mean + log_std.exp() * noise).tanh()).collect();
        let size = architecture.action_size;
        let action = hscic_gradient(&actions, size, &self.raw_weights, self.bandwidth_sq);
        Ok(Measurement { nll, change_nll, hscic: hscic.value, action_hscic: action.value })
    }

    fn change_nll(&self, mean: &[f32], log_std: &[f32], size: usize) -> Option<f64> {
        let gaussians = mean.chunks_exact(size).zip(log_std.chunks_exact(size));
        let rows = self.batch.pre_tanh.chunks_exact(size).zip(gaussians);
        let nll = rows
            .zip(&self.change_weights)
            .map(|((u, (mean, log_std)), weight)| weight * likelihood::of_row(u, mean, log_std));
        (!self.change_weights.is_empty()).then(|| nll.sum())
    }
}

/// The squared change of each row's action as a share of all; none for rows whose past action is 0,
/// as it is where an episode begins.
fn change_weights(batch: &Batch, size: usize) -> Vec<f64> {
    let rows = batch.actions.chunks_exact(size).zip(batch.past_actions.chunks_exact(size));
    let changes: Vec<f64> = rows
        .map(|(action, past)| {
            let is_first = past.iter().all(|&entry| entry == 0.0);
            let change = action.iter().zip(past).map(|(a, p)| f64::from(a - p).powi(2)).sum();
            if is_first { 0.0 } else { change }
        })
        .collect();
    let sum: f64 = changes.iter().sum();
    if sum > 0.0 { changes.into_iter().map(|change| change / sum).collect() } else { Vec::new() }
}

/// The kernels of a run.
pub(crate) fn kernels(config: &TrainConfig) -> KernelConfig {
    KernelConfig { ridge: config.palr.ridge, bandwidth_sq: config.palr.bandwidth_sq }
}
