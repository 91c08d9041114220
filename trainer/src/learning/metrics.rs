//! What a report of progress measures.

use burn::tensor::Device;

use crate::learning::algorithms::bc;
use crate::learning::config::TrainConfig;
use crate::learning::data::{Batch, TrainingSet};
use crate::learning::error::TrainError;
use crate::learning::kernel::hscic_gradient;
use crate::learning::policy_net::{PolicyNet, PolicyShape, REPRESENTATION_SIZE, values};
use crate::learning::weights::{KernelConfig, WeightMatrix};

/// Of a policy on fixed rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measurement {
    /// Mean negative log-likelihood, in nats.
    pub nll: f64,
    /// HSCIC of the representation and the past action given the action, with the run's kernels.
    pub hscic: f64,
}

/// Fixed rows of a set, and their M, which is computed once.
pub(crate) struct Probe {
    batch: Batch,
    weights: WeightMatrix,
    bandwidth_sq: f64,
}

impl Probe {
    /// At most `metric_rows` rows, evenly spaced: consecutive rows are not independent.
    pub(crate) fn new(set: &TrainingSet, config: &TrainConfig) -> Result<Self, TrainError> {
        let count = config.metric_rows.min(set.len());
        let rows: Vec<usize> = (0..count).map(|i| i * set.len() / count).collect();
        let (past, given) = set.hscic_actions(&rows, config.palr.standardize_actions);
        let weights = WeightMatrix::new(&past, &given, set.action_size(), kernels(config))?;
        let batch = set.batch(&rows);
        Ok(Self { batch, weights, bandwidth_sq: config.palr.bandwidth_sq })
    }

    pub(crate) fn measure(
        &self,
        shape: PolicyShape,
        parameters: &[f32],
    ) -> Result<Measurement, TrainError> {
        let device = Device::flex();
        let policy = PolicyNet::new(shape, parameters, &device)?;
        let (loss, output) = bc::loss_and_tensors(&policy, &self.batch, &device)?;
        let phi = values(output.representation)?;
        let hscic = hscic_gradient(&phi, REPRESENTATION_SIZE, &self.weights, self.bandwidth_sq);
        Ok(Measurement { nll: loss.nll, hscic: hscic.value })
    }
}

/// The kernels of a run.
pub(crate) fn kernels(config: &TrainConfig) -> KernelConfig {
    KernelConfig { ridge: config.palr.ridge, bandwidth_sq: config.palr.bandwidth_sq }
}
