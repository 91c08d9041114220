//! MINE as regulariser: a network estimates the mutual information of the past action with action
//! and representation, and the representation is to make it small.
//!
//! # Source
//! Belghazi et al. (2018), as the PALR paper's code has it: policy first, then the estimator, whose
//! input and hidden layers carry Gaussian noise at all times.

use burn::tensor::Tensor;
use burn::tensor::activation::relu;

use crate::learning::algorithms::{Method, StepReport, state};
use crate::learning::architecture::{Architecture, Kind};
use crate::learning::config::MineConfig;
use crate::learning::context::Context;
use crate::learning::data::Batch;
use crate::learning::error::TrainError;
use crate::learning::likelihood;
use crate::learning::network::{
    Initialization, LayerShape, Layers, Network, scalar, tensor, values,
};
use crate::learning::noise::Normals;
use crate::learning::policy_net::{PolicyNet, REPRESENTATION_SIZE};
use crate::learning::state::State;

/// Name of the estimator's network.
pub const ESTIMATOR: &str = "estimator";
/// Keeps the corrected gradient finite (MINE's public code).
const EMA_EPSILON: f64 = 1e-6;

/// The method.
pub struct Mine<'a> {
    context: Context<'a>,
}

/// The estimator's outputs on n samples of the joint distribution and of the product of marginals.
#[derive(Debug, Clone)]
pub struct Outputs {
    /// `[n, 1]`.
    pub joint: Tensor<2>,
    /// `[n, 1]`.
    pub marginal: Tensor<2>,
}

impl<'a> Mine<'a> {
    /// For a run of `context`.
    #[must_use]
    pub fn new(context: Context<'a>) -> Self {
        Self { context }
    }

    /// The estimator on `batch` with φ, `[n, 64]`. Sample i of the marginals is past action
    /// `order[i]` with action and φ number i. Noise: input, first and second hidden layer.
    fn estimate(
        &self,
        estimator: &Layers,
        phi: Tensor<2>,
        batch: &Batch,
        (order, mut noise): (Vec<usize>, Normals),
    ) -> Outputs {
        let Context { config, data, constants, .. } = &self.context;
        let MineConfig { input_noise, hidden_noise, hidden_sizes: [first, second], .. } =
            config.mine;
        let (n, size) = (batch.n, data.action_size());
        let mut actions = Vec::with_capacity(2 * n * 2 * size);
        for (i, past) in (0..n).chain(order).enumerate() {
            let i = i % n;
            actions.extend_from_slice(&batch.past_actions[past * size..(past + 1) * size]);
            actions.extend_from_slice(&batch.actions[i * size..(i + 1) * size]);
        }
        let actions = tensor(actions, 2 * size, constants);
        let input = Tensor::cat(vec![actions, Tensor::cat(vec![phi.clone(), phi], 0)], 1);
        let mut noisy = |x: Tensor<2>, width: usize, std: f64| match std > 0.0 {
            true => x + tensor(noise.draw(2 * n * width, std), width, constants),
            false => x,
        };
        let input = noisy(input, 2 * size + REPRESENTATION_SIZE, input_noise);
        let hidden = noisy(elu(estimator.linear(0, input)), first, hidden_noise);
        let hidden = noisy(elu(estimator.linear(1, hidden)), second, hidden_noise);
        let output = estimator.linear(2, hidden);
        Outputs { joint: output.clone().narrow(0, 0, n), marginal: output.narrow(0, n, n) }
    }
}

/// x, or exp(x) - 1 below 0, without the mask of Burn's own.
fn elu(x: Tensor<2>) -> Tensor<2> {
    let below = relu(x.clone().neg()).neg();
    relu(x) + below.exp() - 1.0
}

/// The Donsker–Varadhan bound: mean of the joint's outputs - log mean exp of the marginals'.
///
/// # Errors
/// [`TrainError::Tensor`].
pub fn bound(outputs: Outputs) -> Result<Tensor<1>, TrainError> {
    let Outputs { joint, marginal } = outputs;
    let [n, _] = marginal.dims();
    // The largest output stays outside of exp, which would overflow.
    let numbers = values(marginal.clone().inner())?;
    let largest = f64::from(numbers.into_iter().fold(f32::NEG_INFINITY, f32::max));
    let log_sum = (marginal - largest).exp().sum().log() + largest;
    Ok(joint.mean() - (log_sum - (n as f64).ln()))
}

/// The same bound's gradient with a moving average in the place of the batch's mean of exp.
fn corrected(outputs: Outputs, average: f64) -> Tensor<1> {
    let Outputs { joint, marginal } = outputs;
    joint.mean() - marginal.exp().mean().div_scalar(average + EMA_EPSILON)
}

impl Method for Mine<'_> {
    fn start(&self) -> State {
        let Context { config, data, .. } = &self.context;
        let [first, second] = config.mine.hidden_sizes;
        let layers = vec![
            LayerShape::new("estimator_1", 2 * data.action_size() + REPRESENTATION_SIZE, first),
            LayerShape::new("estimator_2", first, second),
            LayerShape::new("estimator_3", second, 1),
        ];
        let networks = vec![
            self.architecture().policy_shape().network(config.seed),
            Network::new(ESTIMATOR, layers, Initialization::Kaiming, config.seed, 1),
        ];
        // The moving average; 0 before the first update.
        let scalars = config.mine.ema_decay.map_or_else(Vec::new, |_| vec![0.0]);
        State { scalars, ..state(networks) }
    }

    fn step(&mut self, state: &mut State) -> Result<Option<StepReport>, TrainError> {
        let Context { config, device, constants, .. } = &self.context;
        let (index, step) = (state.step, state.step + 1);
        let batch = self.context.batch(index);
        let shape = self.architecture().policy_shape();
        let State { networks, scalars, .. } = state;
        let [policy_network, estimator_network] = &mut networks[..] else {
            return Ok(None);
        };
        let mine = &config.mine;

        let policy = PolicyNet::new(shape, &policy_network.parameters, device)?;
        let estimator = estimator_network.tensors(constants)?;
        let tensors = batch.tensors(constants);
        let output = policy.forward(tensors.observations.clone());
        let (likelihood, nll) = likelihood::of_batch(&output, &tensors)?;
        let shuffle = self.context.shuffle(index, None, batch.n);
        let bound_now = bound(self.estimate(&estimator, output.representation, &batch, shuffle))?;
        let report = StepReport::new(nll).with("mutual_information", scalar(&bound_now)?);
        report.check(step)?;
        let mut gradient = policy.gradient(&(likelihood + bound_now.mul_scalar(mine.alpha)))?;
        if mine.freeze_hidden {
            // Adam never moves what never had a gradient.
            gradient[shape.hidden_range()].fill(0.0);
        }
        policy_network.descend(&gradient, config.learning_rate, step)?;

        let policy = PolicyNet::new(shape, &policy_network.parameters, constants)?;
        for update in 0..mine.inner_updates {
            let batch = self.context.inner_batch(index, update);
            let phi = policy.encode(batch.tensors(constants).observations);
            let estimator = estimator_network.tensors(device)?;
            let shuffle = self.context.shuffle(index, Some(update), batch.n);
            let outputs = self.estimate(&estimator, phi, &batch, shuffle);
            let gain = match (mine.ema_decay, scalars.first_mut()) {
                (Some(decay), Some(average)) => {
                    let now = scalar(&outputs.marginal.clone().exp().mean())?;
                    *average =
                        if *average == 0.0 { now } else { decay * *average + (1.0 - decay) * now };
                    corrected(outputs, *average)
                }
                _ => bound(outputs)?,
            };
            let gradient = estimator.gradient(&mut gain.neg().backward())?;
            estimator_network.descend(&gradient, mine.learning_rate, step)?;
        }
        Ok(Some(report))
    }

    fn architecture(&self) -> Architecture {
        self.context.architecture(Kind::Plain)
    }
}
