//! Behaviour cloning: the likelihood alone.

use crate::learning::algorithms::{Method, StepReport, state};
use crate::learning::architecture::{Architecture, Kind};
use crate::learning::context::Context;
use crate::learning::error::TrainError;
use crate::learning::likelihood;
use crate::learning::policy_net::PolicyNet;
use crate::learning::state::State;

/// The method.
pub struct Bc<'a> {
    context: Context<'a>,
}

impl<'a> Bc<'a> {
    /// For a run of `context`.
    #[must_use]
    pub fn new(context: Context<'a>) -> Self {
        Self { context }
    }
}

impl Method for Bc<'_> {
    fn start(&self) -> State {
        state(vec![self.architecture().policy_shape().network(self.context.config.seed)])
    }

    fn step(&mut self, state: &mut State) -> Result<Option<StepReport>, TrainError> {
        let Context { config, device, constants, .. } = &self.context;
        let step = state.step + 1;
        let batch = self.context.batch(state.step).tensors(constants);
        let network = &mut state.networks[0];
        let policy =
            PolicyNet::new(self.architecture().policy_shape(), &network.parameters, device)?;
        let output = policy.forward(batch.observations.clone());
        let (loss, nll) = likelihood::of_batch(&output, &batch)?;
        let report = StepReport::new(nll);
        report.check(step)?;
        network.descend(&policy.gradient(&loss)?, config.learning_rate, step)?;
        Ok(Some(report))
    }

    fn architecture(&self) -> Architecture {
        self.context.architecture(Kind::Plain)
    }
}
