//! RAP, residual action prediction: a memory of the whole stack learns to predict changes of the
//! action, and joins the policy of the last observation, which cannot change it.
//!
//! # Source
//! Chuang et al. (2022), as the PALR paper's code has it (sections 5.2 and C.3).

use burn::tensor::Tensor;

use crate::learning::algorithms::{Method, StepReport, state};
use crate::learning::architecture::{Architecture, Kind, last_columns};
use crate::learning::context::Context;
use crate::learning::error::TrainError;
use crate::learning::likelihood;
use crate::learning::network::{Initialization, LayerShape, Network, scalar};
use crate::learning::policy_net::{
    Join, PolicyNet, PolicyShape, PolicyTensors, REPRESENTATION_SIZE,
};
use crate::learning::state::State;

/// Name of the memory's network.
pub const MEMORY: &str = "memory";
/// Name of the head that predicts the action's change.
pub const RESIDUAL: &str = "residual";
const MEMORY_HIDDEN_SIZE: usize = 128;

/// The method.
pub struct Rap<'a> {
    context: Context<'a>,
}

impl<'a> Rap<'a> {
    /// For a run of `context`.
    #[must_use]
    pub fn new(context: Context<'a>) -> Self {
        Self { context }
    }

    /// An update of memory and residual head; returns the mean squared error before it.
    fn update_memory(
        &self,
        memory_network: &mut Network,
        residual_network: &mut Network,
        observations: &Tensor<2>,
        change: &Tensor<2>,
        step: u64,
    ) -> Result<f64, TrainError> {
        let Context { config, device, .. } = &self.context;
        let memory = memory_network.tensors(device)?;
        let residual = residual_network.tensors(device)?;
        let predicted = residual.leaky_forward(memory.leaky_forward(observations.clone()));
        let difference = predicted - change.clone();
        let loss = (difference.clone() * difference).mean();
        let error = scalar(&loss)?;
        let mut gradients = loss.backward();
        let rate = config.rap.learning_rate;
        memory_network.descend(&memory.gradient(&mut gradients)?, rate, step)?;
        residual_network.descend(&residual.gradient(&mut gradients)?, rate, step)?;
        Ok(error)
    }
}

/// The memory's layers; the last one's output is the memory, without an activation.
#[must_use]
pub fn memory_layers(observation_size: usize) -> Vec<LayerShape> {
    vec![
        LayerShape::new("memory_1", observation_size, MEMORY_HIDDEN_SIZE).without_bias(),
        LayerShape::new("memory_2", MEMORY_HIDDEN_SIZE, REPRESENTATION_SIZE),
    ]
}

/// The shape of the policy of the last frame that the memory joins.
#[must_use]
pub fn policy_shape(frame_size: usize, action_size: usize) -> PolicyShape {
    let join = Join::Representation(REPRESENTATION_SIZE);
    PolicyShape { join, ..PolicyShape::plain(frame_size, action_size) }
}

/// The policy, given the memory of `[n, observation_size]`; its representation is both.
#[must_use]
pub fn forward(
    policy: &PolicyNet,
    memory: Tensor<2>,
    observations: Tensor<2>,
    frame_size: usize,
) -> PolicyTensors {
    policy.forward_joined(last_columns(observations, frame_size), memory)
}

impl Method for Rap<'_> {
    fn start(&self) -> State {
        let Context { config, data, .. } = &self.context;
        let uniform = Initialization::Uniform;
        let width = config.rap.residual_size;
        let residual = vec![
            LayerShape::new("residual_1", REPRESENTATION_SIZE, width),
            LayerShape::new("residual_2", width, data.action_size()),
        ];
        let memory = memory_layers(data.observation_size());
        state(vec![
            self.architecture().policy_shape().network(config.seed),
            Network::new(MEMORY, memory, uniform, config.seed, 1),
            Network::new(RESIDUAL, residual, uniform, config.seed, 2),
        ])
    }

    fn step(&mut self, state: &mut State) -> Result<Option<StepReport>, TrainError> {
        let Context { config, device, constants, .. } = &self.context;
        let step = state.step + 1;
        let batch = self.context.batch(state.step).tensors(constants);
        let architecture = self.architecture();
        let [policy_network, memory, residual] = &mut state.networks[..] else {
            return Ok(None);
        };
        let change = batch.actions.clone() - batch.past_actions.clone();
        let observations = &batch.observations;
        let error = self.update_memory(memory, residual, observations, &change, step)?;
        for _ in 1..config.rap.inner_updates {
            self.update_memory(memory, residual, observations, &change, step)?;
        }
        let memory = memory.tensors(constants)?.leaky_forward(observations.clone());
        let shape = architecture.policy_shape();
        let policy = PolicyNet::new(shape, &policy_network.parameters, device)?;
        let output = forward(&policy, memory, observations.clone(), architecture.frame_size);
        let (loss, nll) = likelihood::of_batch(&output, &batch)?;
        let report = StepReport::new(nll).with("residual_error", error);
        report.check(step)?;
        policy_network.descend(&policy.gradient(&loss)?, config.learning_rate, step)?;
        Ok(Some(report))
    }

    fn architecture(&self) -> Architecture {
        self.context.architecture(Kind::Rap)
    }
}
