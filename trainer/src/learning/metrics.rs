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
        Ok(Self { batch: set.batch(&rows), weights, raw_weights, noise, bandwidth_sq })
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
        let sampled = mean.iter().zip(&log_std).zip(&self.noise);
        let actions: Vec<f32> =
            sampled.map(|((mean, log_std), noise)| (mean + log_std.exp() * noise).tanh()).collect();
        let size = architecture.action_size;
        let action = hscic_gradient(&actions, size, &self.raw_weights, self.bandwidth_sq);
        Ok(Measurement { nll, hscic: hscic.value, action_hscic: action.value })
    }
}

/// The kernels of a run.
pub(crate) fn kernels(config: &TrainConfig) -> KernelConfig {
    KernelConfig { ridge: config.palr.ridge, bandwidth_sq: config.palr.bandwidth_sq }
}
