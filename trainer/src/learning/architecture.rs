//! The policies that methods leave behind, and how each acts.

use burn::tensor::{Device, Tensor};

use crate::learning::algorithms::{dt, primenet, rap, vib};
use crate::learning::config::PrimeJunction;
use crate::learning::error::TrainError;
use crate::learning::network::{LayerShape, Layers, parameter_count};
use crate::learning::policy_net::{
    POLICY, PolicyNet, PolicyShape, PolicyTensors, REPRESENTATION_SIZE,
};

/// How a policy is built.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The policy network alone.
    Plain,
    /// RAP's memory of the whole stack joins the policy of the last frame.
    Rap,
    /// The action of PrimeNet's network of the last frame joins the policy of the stack.
    Primenet(PrimeJunction),
    /// DT's transformer over the stack.
    Transformer,
    /// VIB's policy, averaged over so many fixed samples of its bottleneck.
    Sampled(usize),
}

/// How a policy is built, with its sizes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Architecture {
    /// D, of a stacked observation.
    pub observation_size: usize,
    /// Width of a frame; the last one is the newest.
    pub frame_size: usize,
    /// A.
    pub action_size: usize,
    /// The rest.
    pub kind: Kind,
}

impl Architecture {
    /// Observations in a stack.
    #[must_use]
    pub fn frame_stack(self) -> usize {
        self.observation_size / self.frame_size
    }

    /// The shape of the network [`POLICY`], if it is a multi-layer perceptron.
    #[must_use]
    pub fn policy_shape(self) -> PolicyShape {
        let plain = PolicyShape::plain(self.observation_size, self.action_size);
        match self.kind {
            Kind::Plain | Kind::Transformer => plain,
            Kind::Rap => rap::policy_shape(self.frame_size, self.action_size),
            Kind::Primenet(junction) => {
                primenet::policy_shape(self.observation_size, self.action_size, junction)
            }
            Kind::Sampled(_) => PolicyShape { is_bottleneck: true, ..plain },
        }
    }

    /// The networks that act, and their layers.
    #[must_use]
    pub fn networks(self) -> Vec<(&'static str, Vec<LayerShape>)> {
        let policy = (POLICY, self.policy_shape().layers().to_vec());
        match self.kind {
            Kind::Plain => vec![policy],
            Kind::Transformer => {
                let Self { frame_size, action_size, .. } = self;
                vec![(POLICY, dt::layers(frame_size, self.frame_stack(), action_size))]
            }
            Kind::Rap => vec![(rap::MEMORY, rap::memory_layers(self.observation_size)), policy],
            Kind::Primenet(_) => {
                let shape = PolicyShape::plain(self.frame_size, self.action_size);
                vec![(primenet::PRIME, shape.layers().to_vec()), policy]
            }
            Kind::Sampled(samples) => {
                let noise = LayerShape::new("samples", samples, REPRESENTATION_SIZE);
                vec![policy, (vib::NOISE, vec![noise.without_bias()])]
            }
        }
    }

    /// Length of the flat vector of all networks that act.
    #[must_use]
    pub fn parameter_count(self) -> usize {
        self.networks().iter().map(|(_, layers)| parameter_count(layers)).sum()
    }

    /// What the policy with these parameters makes of `[n, observation_size]`, standardised.
    ///
    /// # Errors
    /// [`TrainError::Size`].
    pub fn forward(
        self,
        parameters: &[f32],
        observations: Tensor<2>,
        device: &Device,
    ) -> Result<PolicyTensors, TrainError> {
        let (got, want) = (parameters.len(), self.parameter_count());
        if got != want {
            return Err(TrainError::Size { what: "the list of parameters", got, want });
        }
        let shape = self.policy_shape();
        let policy = |parameters: &[f32]| PolicyNet::new(shape, parameters, device);
        match self.kind {
            Kind::Plain => Ok(policy(parameters)?.forward(observations)),
            Kind::Transformer => {
                let Self { frame_size, action_size, .. } = self;
                let layers = dt::layers(frame_size, self.frame_stack(), action_size);
                let layers = Layers::new(&layers, parameters, device)?;
                Ok(dt::forward(&layers, observations, self.frame_stack()))
            }
            Kind::Rap => {
                let layers = rap::memory_layers(self.observation_size);
                let (memory, rest) = parameters.split_at(parameter_count(&layers));
                let memory = Layers::new(&layers, memory, device)?;
                let memory = memory.leaky_forward(observations.clone());
                Ok(rap::forward(&policy(rest)?, memory, observations, self.frame_size))
            }
            Kind::Primenet(_) => {
                let prime = PolicyShape::plain(self.frame_size, self.action_size);
                let (parameters, rest) = parameters.split_at(prime.parameter_count());
                let prime = PolicyNet::new(prime, parameters, device)?;
                let outputs = primenet::forward(&prime, &policy(rest)?, observations, self, false);
                Ok(outputs.policy)
            }
            Kind::Sampled(_) => {
                let (parameters, samples) = parameters.split_at(shape.parameter_count());
                Ok(vib::forward_samples(&policy(parameters)?, observations, samples, device))
            }
        }
    }

    /// The newest frame of stacked observations.
    #[must_use]
    pub fn last_frame(self, observations: Tensor<2>) -> Tensor<2> {
        last_columns(observations, self.frame_size)
    }
}

/// The last `count` columns.
pub(crate) fn last_columns(matrix: Tensor<2>, count: usize) -> Tensor<2> {
    let [_, columns] = matrix.dims();
    if columns == count { matrix } else { matrix.narrow(1, columns - count, count) }
}
