//! The tanh-Gaussian policy of the reference recipe.
//!
//! Every method's policy is this one; for some, something joins it on the way ([`Join`]).

use burn::tensor::{Device, Tensor};

use crate::learning::error::TrainError;
use crate::learning::network::{
    Initialization, LayerShape, Layers, Network, leaky_relu, parameter_count,
};

/// Width of the first layer.
const ENCODER_SIZE: usize = 128;
/// Width of φ, the representation.
pub const REPRESENTATION_SIZE: usize = 64;
/// Width of the layer before the heads.
const HIDDEN_SIZE: usize = 128;
/// Bounds of the log standard deviation.
pub const LOG_STD_RANGE: [f64; 2] = [-20.0, 2.0];
/// Name of the policy's network in files.
pub const POLICY: &str = "policy";

/// Place of a layer in [`PolicyShape::layers`].
const ENCODER_1: usize = 0;
const ENCODER_2: usize = 1;
pub(crate) const HIDDEN: usize = 2;
const MEAN: usize = 3;
const LOG_STD: usize = 4;

/// Where something from outside joins the policy, and its width. It stands before what it joins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Join {
    /// Nothing does.
    Nowhere,
    /// Beside the observation.
    Input(usize),
    /// Beside φ, before its activation.
    Representation(usize),
    /// Beside the last hidden layer, after its activation.
    Hidden(usize),
}

/// What decides the sizes of a policy's layers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PolicyShape {
    /// Width of the input, without what joins it.
    pub observation_size: usize,
    /// A.
    pub action_size: usize,
    /// What joins it.
    pub join: Join,
    /// True: the encoder has two outputs for each entry of φ, a mean and a spread.
    pub is_bottleneck: bool,
}

impl PolicyShape {
    /// Of a policy that nothing joins.
    #[must_use]
    pub fn plain(observation_size: usize, action_size: usize) -> Self {
        Self { observation_size, action_size, join: Join::Nowhere, is_bottleneck: false }
    }

    /// The layers, from observation to heads.
    ///
    /// # Source
    /// The reference implementation's tanh-Gaussian policy: only the first layer has no bias.
    #[must_use]
    pub fn layers(self) -> [LayerShape; 5] {
        let [mut input, mut representation, mut hidden] =
            [self.observation_size, REPRESENTATION_SIZE, HIDDEN_SIZE];
        match self.join {
            Join::Nowhere => {}
            Join::Input(width) => input += width,
            Join::Representation(width) => representation += width,
            Join::Hidden(width) => hidden += width,
        }
        let encoded = if self.is_bottleneck { 2 } else { 1 } * REPRESENTATION_SIZE;
        [
            LayerShape::new("encoder_1", input, ENCODER_SIZE).without_bias(),
            LayerShape::new("encoder_2", ENCODER_SIZE, encoded),
            LayerShape::new("hidden", representation, HIDDEN_SIZE),
            LayerShape::new("mean", hidden, self.action_size),
            LayerShape::new("log_std", hidden, self.action_size),
        ]
    }

    /// Length of the flat vector.
    #[must_use]
    pub fn parameter_count(self) -> usize {
        parameter_count(&self.layers())
    }

    /// The policy's network before step 1.
    #[must_use]
    pub fn network(self, seed: u64) -> Network {
        Network::new(POLICY, self.layers().to_vec(), Initialization::Uniform, seed, 0)
    }

    /// Where the parameters of layer [`HIDDEN`] are.
    pub(crate) fn hidden_range(self) -> std::ops::Range<usize> {
        let layers = self.layers();
        let start = parameter_count(&layers[..HIDDEN]);
        start..start + layers[HIDDEN].len()
    }
}

/// The policy for one pass: observation -> φ -> mean and log standard deviation before tanh.
#[derive(Debug, Clone)]
pub struct PolicyNet {
    layers: Layers,
    join: Join,
}

/// Of a batch of n observations.
#[derive(Debug, Clone)]
pub struct PolicyTensors {
    /// φ before its activation, with what joined it: `[n, 64]`, or more.
    pub representation: Tensor<2>,
    /// `[n, action_size]`.
    pub mean: Tensor<2>,
    /// `[n, action_size]`, within [`LOG_STD_RANGE`].
    pub log_std: Tensor<2>,
}

impl PolicyNet {
    /// With these parameters, on `device`; gradients need a device with autodiff.
    ///
    /// # Errors
    /// [`TrainError::Size`].
    pub fn new(
        shape: PolicyShape,
        parameters: &[f32],
        device: &Device,
    ) -> Result<Self, TrainError> {
        let layers = Layers::new(&shape.layers(), parameters, device)?;
        Ok(Self { layers, join: shape.join })
    }

    /// Its layers.
    #[must_use]
    pub fn layers(&self) -> &Layers {
        &self.layers
    }

    /// φ: `[n, observation_size]`, standardised -> `[n, 64]`; twice as wide for a bottleneck.
    #[must_use]
    pub fn encode(&self, observations: Tensor<2>) -> Tensor<2> {
        let encoded = leaky_relu(self.layers.linear(ENCODER_1, observations));
        self.layers.linear(ENCODER_2, encoded)
    }

    /// The action's distribution, from φ with what joined it.
    #[must_use]
    pub fn decode(&self, representation: Tensor<2>) -> PolicyTensors {
        self.decode_joined(representation, None)
    }

    /// Everything: `[n, observation_size]`, standardised.
    #[must_use]
    pub fn forward(&self, observations: Tensor<2>) -> PolicyTensors {
        self.decode(self.encode(observations))
    }

    /// Everything, with `joined`, `[n, width]`, where the shape says.
    #[must_use]
    pub fn forward_joined(&self, observations: Tensor<2>, joined: Tensor<2>) -> PolicyTensors {
        match self.join {
            Join::Nowhere => self.forward(observations),
            Join::Input(_) => self.forward(Tensor::cat(vec![joined, observations], 1)),
            Join::Representation(_) => {
                let own = self.encode(observations);
                self.decode(Tensor::cat(vec![joined, own], 1))
            }
            Join::Hidden(_) => self.decode_joined(self.encode(observations), Some(joined)),
        }
    }

    fn decode_joined(&self, representation: Tensor<2>, joined: Option<Tensor<2>>) -> PolicyTensors {
        let hidden = self.layers.linear(HIDDEN, leaky_relu(representation.clone()));
        let mut hidden = leaky_relu(hidden);
        if let Some(joined) = joined {
            hidden = Tensor::cat(vec![joined, hidden], 1);
        }
        let [low, high] = LOG_STD_RANGE;
        PolicyTensors {
            representation,
            mean: self.layers.linear(MEAN, hidden.clone()),
            log_std: self.layers.linear(LOG_STD, hidden).clamp(low, high),
        }
    }

    /// The gradient of `loss`, in the order of the flat vector. A parameter that the loss does not
    /// reach has gradient 0.
    ///
    /// # Errors
    /// [`TrainError::Tensor`].
    pub fn gradient(&self, loss: &Tensor<1>) -> Result<Vec<f32>, TrainError> {
        self.layers.gradient(&mut loss.backward())
    }
}

#[cfg(test)]
mod tests;
