//! PALR: the likelihood, and HSCIC of the representation and the past action given the action.

use burn::tensor::{Device, Tensor};

use crate::learning::algorithms::{Method, StepReport, state};
use crate::learning::architecture::{Architecture, Kind};
use crate::learning::config::PalrConfig;
use crate::learning::context::{BatchTensors, Context};
use crate::learning::error::TrainError;
use crate::learning::likelihood;
use crate::learning::network::tensor;
use crate::learning::policy_net::PolicyNet;
use crate::learning::regularizer::{StepWeights, surrogate};
use crate::learning::state::State;

/// The method.
pub struct Palr<'a> {
    context: Context<'a>,
}

impl<'a> Palr<'a> {
    /// For a run of `context`.
    #[must_use]
    pub fn new(context: Context<'a>) -> Self {
        Self { context }
    }
}

/// NLL of `batch` + α HSCIC of φ: a scalar with its gradient, and the terms.
///
/// # Source
/// Equation (8) of the PALR paper.
///
/// # Errors
/// [`TrainError::Tensor`].
pub fn loss(
    policy: &PolicyNet,
    batch: &BatchTensors,
    weights: &StepWeights,
    config: &PalrConfig,
    constants: &Device,
) -> Result<(Tensor<1>, StepReport), TrainError> {
    let output = policy.forward(batch.observations.clone());
    let (likelihood, nll) = likelihood::of_batch(&output, batch)?;
    let representation = match &weights.observations {
        None => output.representation,
        Some(observations) => {
            let columns = observations.len() / weights.weights.n();
            policy.encode(tensor(observations.clone(), columns, constants))
        }
    };
    let (penalty, hscic) =
        surrogate(representation, &weights.weights, config.alpha, config.bandwidth_sq)?;
    Ok((likelihood + penalty, StepReport { hscic: Some(hscic), ..StepReport::new(nll) }))
}

impl Method for Palr<'_> {
    fn start(&self) -> State {
        state(vec![self.architecture().policy_shape().network(self.context.config.seed)])
    }

    fn step(&mut self, state: &mut State) -> Result<Option<StepReport>, TrainError> {
        let Context { config, device, constants, .. } = &self.context;
        let step = state.step + 1;
        let batch = self.context.batch(state.step).tensors(constants);
        let weights = self.context.weights.of_step(state.step)?;
        let network = &mut state.networks[0];
        let shape = self.architecture().policy_shape();
        let policy = PolicyNet::new(shape, &network.parameters, device)?;
        let (loss, report) = loss(&policy, &batch, &weights, &config.palr, constants)?;
        report.check(step)?;
        network.descend(&policy.gradient(&loss)?, config.learning_rate, step)?;
        Ok(Some(report))
    }

    fn architecture(&self) -> Architecture {
        self.context.architecture(Kind::Plain)
    }
}

#[cfg(test)]
mod tests;
