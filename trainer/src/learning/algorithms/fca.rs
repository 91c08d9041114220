//! FCA, fighting copycat agents: an adversary predicts the past action from representation and
//! action, and the representation is to make that hard.
//!
//! # Source
//! Wen et al. (2020), as the PALR paper's code has it: policy first, then the adversary; the
//! bottleneck is ½φ², a *sum* over the batch.

use burn::tensor::Tensor;

use crate::learning::algorithms::{Method, StepReport, state};
use crate::learning::architecture::{Architecture, Kind};
use crate::learning::context::{BatchTensors, Context};
use crate::learning::error::TrainError;
use crate::learning::likelihood;
use crate::learning::network::{Initialization, LayerShape, Layers, Network, scalar};
use crate::learning::policy_net::{PolicyNet, REPRESENTATION_SIZE};
use crate::learning::state::State;

/// Name of the adversary's network.
pub const ADVERSARY: &str = "adversary";

/// The method.
pub struct Fca<'a> {
    context: Context<'a>,
}

impl<'a> Fca<'a> {
    /// For a run of `context`.
    #[must_use]
    pub fn new(context: Context<'a>) -> Self {
        Self { context }
    }
}

/// The mean squared error, over samples and entries, of past actions predicted from the action and
/// `representation`, `[n, 64]`.
#[must_use]
pub fn prediction_error(
    adversary: &Layers,
    representation: Tensor<2>,
    batch: &BatchTensors,
) -> Tensor<1> {
    let input = Tensor::cat(vec![batch.actions.clone(), representation], 1);
    let difference = adversary.leaky_forward(input) - batch.past_actions.clone();
    (difference.clone() * difference).mean()
}

impl Method for Fca<'_> {
    fn start(&self) -> State {
        let Context { config, data, .. } = &self.context;
        let (size, width) = (data.action_size(), config.fca.hidden_size);
        let layers = vec![
            LayerShape::new("adversary_1", size + REPRESENTATION_SIZE, width),
            LayerShape::new("adversary_2", width, size),
        ];
        state(vec![
            self.architecture().policy_shape().network(config.seed),
            Network::new(ADVERSARY, layers, Initialization::Uniform, config.seed, 1),
        ])
    }

    fn step(&mut self, state: &mut State) -> Result<Option<StepReport>, TrainError> {
        let Context { config, device, constants, .. } = &self.context;
        let (index, step) = (state.step, state.step + 1);
        let batch = self.context.batch(index).tensors(constants);
        let shape = self.architecture().policy_shape();
        let [policy_network, adversary_network] = &mut state.networks[..] else {
            return Ok(None);
        };
        let fca = &config.fca;

        let policy = PolicyNet::new(shape, &policy_network.parameters, device)?;
        let adversary = adversary_network.tensors(constants)?;
        let output = policy.forward(batch.observations.clone());
        let (likelihood, nll) = likelihood::of_batch(&output, &batch)?;
        let phi = output.representation;
        let error = prediction_error(&adversary, phi.clone(), &batch);
        let report = StepReport::new(nll).with("adversary_error", scalar(&error)?);
        report.check(step)?;
        let bottleneck = (phi.clone() * phi).sum().mul_scalar(0.5 * fca.bottleneck);
        let loss = likelihood - error.mul_scalar(fca.alpha) + bottleneck;
        let mut gradient = policy.gradient(&loss)?;
        if fca.freeze_hidden {
            // Adam never moves what never had a gradient.
            gradient[shape.hidden_range()].fill(0.0);
        }
        policy_network.descend(&gradient, config.learning_rate, step)?;

        let policy = PolicyNet::new(shape, &policy_network.parameters, constants)?;
        for update in 0..fca.inner_updates {
            let batch = self.context.inner_batch(index, update).tensors(constants);
            let adversary = adversary_network.tensors(device)?;
            let phi = policy.encode(batch.observations.clone());
            let loss = prediction_error(&adversary, phi, &batch);
            let gradient = adversary.gradient(&mut loss.backward())?;
            adversary_network.descend(&gradient, fca.learning_rate, step)?;
        }
        Ok(Some(report))
    }

    fn architecture(&self) -> Architecture {
        self.context.architecture(Kind::Plain)
    }
}
