//! What every method works with: settings, data, batches and random numbers.

use burn::tensor::{Device, Tensor};

use crate::learning::architecture::{Architecture, Kind};
use crate::learning::config::TrainConfig;
use crate::learning::data::{Batch, TrainingSet};
use crate::learning::network::tensor;
use crate::learning::noise::Normals;
use crate::learning::regularizer::{SharedWeights, WeightSource};
use crate::learning::streams::{Purpose, draw_rows, inner_stream, permutation, stream};

/// Of one run.
#[derive(Debug, Clone)]
pub struct Context<'a> {
    /// What decides its bits.
    pub config: &'a TrainConfig,
    /// What it learns from.
    pub data: &'a TrainingSet,
    /// For what has gradients.
    pub device: Device,
    /// For what has none.
    pub constants: Device,
    /// Where M comes from.
    pub weights: WeightSource<'a>,
}

impl<'a> Context<'a> {
    /// `shared_weights` may be shared with other runs; it changes no bits.
    #[must_use]
    pub fn new(
        config: &'a TrainConfig,
        data: &'a TrainingSet,
        shared_weights: SharedWeights,
    ) -> Self {
        let constants = Device::flex();
        let device = constants.clone().autodiff();
        let weights = WeightSource::new(config, data, shared_weights);
        Self { config, data, device, constants, weights }
    }

    /// The rows of step number `index`, from 0.
    #[must_use]
    pub fn batch(&self, index: u64) -> Batch {
        self.data.batch(&self.rows(Purpose::Batch, index))
    }

    /// Fresh rows for inner update number `update` of step number `index`, both from 0.
    #[must_use]
    pub fn inner_batch(&self, index: u64, update: u32) -> Batch {
        let seed = self.config.batch_seed();
        let mut generator = inner_stream(seed, Purpose::InnerBatch, update, index as u32);
        self.data.batch(&draw_rows(&mut generator, self.data.len(), self.config.batch))
    }

    pub(crate) fn rows(&self, purpose: Purpose, index: u64) -> Vec<usize> {
        rows(self.config, self.data, purpose, index)
    }

    /// Normal numbers for step number `index`, from 0.
    #[must_use]
    pub fn noise(&self, index: u64) -> Normals {
        Normals::new(&mut stream(self.config.seed, Purpose::Noise, index as u32))
    }

    /// A permutation of `n` rows and normal numbers: for step number `index`, or for its inner
    /// update number `update`.
    #[must_use]
    pub fn shuffle(&self, index: u64, update: Option<u32>, n: usize) -> (Vec<usize>, Normals) {
        let mut generator = match update {
            None => stream(self.config.seed, Purpose::Noise, index as u32),
            Some(update) => {
                inner_stream(self.config.seed, Purpose::InnerNoise, update, index as u32)
            }
        };
        let order = permutation(&mut generator, n);
        let normals = Normals::new(&mut generator);
        (order, normals)
    }
}

/// The rows of batch number `index`, from 0.
pub(crate) fn rows(
    config: &TrainConfig,
    data: &TrainingSet,
    purpose: Purpose,
    index: u64,
) -> Vec<usize> {
    // Validation holds steps and pool below 2³².
    let mut generator = stream(config.batch_seed(), purpose, index as u32);
    draw_rows(&mut generator, data.len(), config.batch)
}

/// A batch's arrays as tensors without gradients.
#[derive(Debug, Clone)]
pub struct BatchTensors {
    /// `[n, observation_size]`, standardised.
    pub observations: Tensor<2>,
    /// `[n, action_size]`, raw.
    pub actions: Tensor<2>,
    /// `[n, action_size]`, raw.
    pub past_actions: Tensor<2>,
    /// `[n, action_size]`: atanh of the clamped actions.
    pub pre_tanh: Tensor<2>,
    /// As [`Batch::nll_offset`].
    pub nll_offset: f64,
}

impl Batch {
    /// On `device`.
    #[must_use]
    pub fn tensors(&self, device: &Device) -> BatchTensors {
        let matrix = |values: &[f32]| tensor(values.to_vec(), values.len() / self.n, device);
        BatchTensors {
            observations: matrix(&self.observations),
            actions: matrix(&self.actions),
            past_actions: matrix(&self.past_actions),
            pre_tanh: matrix(&self.pre_tanh),
            nll_offset: self.nll_offset,
        }
    }
}

impl Context<'_> {
    /// With the data's sizes.
    #[must_use]
    pub fn architecture(&self, kind: Kind) -> Architecture {
        Architecture {
            observation_size: self.data.observation_size(),
            frame_size: self.data.frame_size(),
            action_size: self.data.action_size(),
            kind,
        }
    }
}
