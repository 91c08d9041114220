//! PALR-ACT: PALR with the policy's action in the place of its representation.

use burn::tensor::Tensor;

use crate::learning::algorithms::{Method, StepReport, state};
use crate::learning::architecture::{Architecture, Kind};
use crate::learning::config::ActionSource;
use crate::learning::context::Context;
use crate::learning::error::TrainError;
use crate::learning::likelihood;
use crate::learning::network::tensor;
use crate::learning::policy_net::{PolicyNet, PolicyTensors};
use crate::learning::regularizer::surrogate;
use crate::learning::state::State;

/// The method.
pub struct PalrAct<'a> {
    context: Context<'a>,
}

impl<'a> PalrAct<'a> {
    /// For a run of `context`.
    #[must_use]
    pub fn new(context: Context<'a>) -> Self {
        Self { context }
    }
}

/// tanh(mean + std · `noise`), or tanh(mean) without: `[n, action_size]`, with gradients to both.
#[must_use]
pub fn action(output: PolicyTensors, noise: Option<Tensor<2>>) -> Tensor<2> {
    match noise {
        None => output.mean.tanh(),
        Some(noise) => (output.mean + output.log_std.exp() * noise).tanh(),
    }
}

impl Method for PalrAct<'_> {
    fn start(&self) -> State {
        state(vec![self.architecture().policy_shape().network(self.context.config.seed)])
    }

    /// # Source
    /// Section D.1 of the PALR paper: NLL + α HSCIC(a^I; a_{t-1} | a_t), a^I reparameterised.
    fn step(&mut self, state: &mut State) -> Result<Option<StepReport>, TrainError> {
        let Context { config, data, device, constants, .. } = &self.context;
        let step = state.step + 1;
        let batch = self.context.batch(state.step).tensors(constants);
        let regularized = self.context.weights.of_step(state.step)?;
        let network = &mut state.networks[0];
        let shape = self.architecture().policy_shape();
        let policy = PolicyNet::new(shape, &network.parameters, device)?;
        let output = policy.forward(batch.observations.clone());
        let (likelihood, nll) = likelihood::of_batch(&output, &batch)?;
        let output = match regularized.observations {
            None => output,
            Some(observations) => {
                policy.forward(tensor(observations, data.observation_size(), constants))
            }
        };
        let (n, size) = (regularized.weights.n(), data.action_size());
        let noise = (config.palr_act.action == ActionSource::Sampled)
            .then(|| tensor(self.context.noise(state.step).draw(n * size, 1.0), size, constants));
        let palr = &config.palr;
        let (penalty, hscic) =
            surrogate(action(output, noise), &regularized.weights, palr.alpha, palr.bandwidth_sq)?;
        let report = StepReport { hscic: Some(hscic), ..StepReport::new(nll) };
        report.check(step)?;
        let gradient = policy.gradient(&(likelihood + penalty))?;
        network.descend(&gradient, config.learning_rate, step)?;
        Ok(Some(report))
    }

    fn architecture(&self) -> Architecture {
        self.context.architecture(Kind::Plain)
    }
}
