//! PrimeNet: a second network's guess of the action, from the last observation alone, joins the
//! policy of the whole stack.
//!
//! # Source
//! Wen et al. (2022). Their public code, for classification, adds both losses with equal weight and
//! stops no gradient; the code for imitation was not published. The prime network is built like the
//! policy (PALR paper, section C.3); where it joins is a setting.

use burn::tensor::Tensor;

use crate::learning::algorithms::{Method, StepReport, state};
use crate::learning::architecture::{Architecture, Kind};
use crate::learning::config::PrimeJunction;
use crate::learning::context::Context;
use crate::learning::error::TrainError;
use crate::learning::likelihood;
use crate::learning::network::{Initialization, Network};
use crate::learning::policy_net::{Join, PolicyNet, PolicyShape, PolicyTensors};
use crate::learning::state::State;

/// Name of the prime network.
pub const PRIME: &str = "prime";

/// The method.
pub struct Primenet<'a> {
    context: Context<'a>,
}

impl<'a> Primenet<'a> {
    /// For a run of `context`.
    #[must_use]
    pub fn new(context: Context<'a>) -> Self {
        Self { context }
    }
}

/// The shape of the policy that an action joins.
#[must_use]
pub fn policy_shape(
    observation_size: usize,
    action_size: usize,
    junction: PrimeJunction,
) -> PolicyShape {
    let join = match junction {
        PrimeJunction::Input => Join::Input(action_size),
        PrimeJunction::Representation => Join::Representation(action_size),
        PrimeJunction::Hidden => Join::Hidden(action_size),
    };
    PolicyShape { join, ..PolicyShape::plain(observation_size, action_size) }
}

/// Of both networks.
#[derive(Debug, Clone)]
pub struct PrimenetTensors {
    /// Of the prime network.
    pub prime: PolicyTensors,
    /// Of the policy.
    pub policy: PolicyTensors,
}

/// Both networks on `[n, observation_size]`, standardised. The prime network's tanh(mean) joins the
/// policy, without a gradient if `is_detached`.
#[must_use]
pub fn forward(
    prime: &PolicyNet,
    policy: &PolicyNet,
    observations: Tensor<2>,
    architecture: Architecture,
    is_detached: bool,
) -> PrimenetTensors {
    let prime = prime.forward(architecture.last_frame(observations.clone()));
    let action = prime.mean.clone().tanh();
    let action = if is_detached { action.detach() } else { action };
    PrimenetTensors { policy: policy.forward_joined(observations, action), prime }
}

impl Method for Primenet<'_> {
    fn start(&self) -> State {
        let Context { config, data, .. } = &self.context;
        let prime = PolicyShape::plain(data.frame_size(), data.action_size());
        let layers = prime.layers().to_vec();
        state(vec![
            self.architecture().policy_shape().network(config.seed),
            Network::new(PRIME, layers, Initialization::Uniform, config.seed, 1),
        ])
    }

    fn step(&mut self, state: &mut State) -> Result<Option<StepReport>, TrainError> {
        let Context { config, data, device, constants, .. } = &self.context;
        let step = state.step + 1;
        let batch = self.context.batch(state.step).tensors(constants);
        let architecture = self.architecture();
        let [policy_network, prime_network] = &mut state.networks[..] else {
            return Ok(None);
        };
        let prime_shape = PolicyShape::plain(data.frame_size(), data.action_size());
        let prime = PolicyNet::new(prime_shape, &prime_network.parameters, device)?;
        let shape = architecture.policy_shape();
        let policy = PolicyNet::new(shape, &policy_network.parameters, device)?;
        let observations = batch.observations.clone();
        let output = forward(&prime, &policy, observations, architecture, config.primenet.detach);
        let (loss, nll) = likelihood::of_batch(&output.policy, &batch)?;
        let (prime_loss, prime_nll) = likelihood::of_batch(&output.prime, &batch)?;
        let report = StepReport::new(nll).with("prime_nll", prime_nll);
        report.check(step)?;
        // Two Adams over disjoint parameters are one, but for their step sizes.
        let mut gradients = (loss + prime_loss).backward();
        let gradient = policy.layers().gradient(&mut gradients)?;
        policy_network.descend(&gradient, config.learning_rate, step)?;
        let gradient = prime.layers().gradient(&mut gradients)?;
        prime_network.descend(&gradient, config.primenet.learning_rate, step)?;
        Ok(Some(report))
    }

    fn architecture(&self) -> Architecture {
        self.context.architecture(Kind::Primenet(self.context.config.primenet.junction))
    }
}
