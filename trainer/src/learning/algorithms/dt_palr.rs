//! DT-PALR: the decision transformer, and HSCIC of its last hidden state and the past action given the
//! action.

use crate::learning::algorithms::{Method, StepReport, dt, state};
use crate::learning::architecture::{Architecture, Kind};
use crate::learning::context::Context;
use crate::learning::error::TrainError;
use crate::learning::likelihood;
use crate::learning::network::tensor;
use crate::learning::regularizer::surrogate;
use crate::learning::state::State;

/// The method.
pub struct DtPalr<'a> {
    context: Context<'a>,
}

impl<'a> DtPalr<'a> {
    /// For a run of `context`.
    #[must_use]
    pub fn new(context: Context<'a>) -> Self {
        Self { context }
    }
}

impl Method for DtPalr<'_> {
    fn start(&self) -> State {
        state(vec![dt::network(self.architecture(), self.context.config.seed)])
    }

    /// # Source
    /// Section D.4 of the PALR paper.
    fn step(&mut self, state: &mut State) -> Result<Option<StepReport>, TrainError> {
        let Context { config, data, device, constants, .. } = &self.context;
        let step = state.step + 1;
        let batch = self.context.batch(state.step).tensors(constants);
        let weights = self.context.weights.of_step(state.step)?;
        let network = &mut state.networks[0];
        let layers = network.tensors(device)?;
        let frame_stack = self.architecture().frame_stack();
        let output = dt::forward(&layers, batch.observations.clone(), frame_stack);
        let (likelihood, nll) = likelihood::of_batch(&output, &batch)?;
        let representation = match weights.observations {
            None => output.representation,
            Some(observations) => {
                let observations = tensor(observations, data.observation_size(), constants);
                dt::forward(&layers, observations, frame_stack).representation
            }
        };
        let palr = &config.palr;
        let (penalty, hscic) =
            surrogate(representation, &weights.weights, palr.alpha, palr.bandwidth_sq)?;
        let report = StepReport { hscic: Some(hscic), ..StepReport::new(nll) };
        report.check(step)?;
        let gradient = layers.gradient(&mut (likelihood + penalty).backward())?;
        dt::descend(network, gradient, config, step)?;
        Ok(Some(report))
    }

    fn architecture(&self) -> Architecture {
        self.context.architecture(Kind::Transformer)
    }
}
