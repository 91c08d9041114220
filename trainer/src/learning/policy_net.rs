//! The policy of the reference recipe, as a Burn module over one flat vector of parameters.
//!
//! The flat vector is the truth: the optimiser, checkpoints and exports work on it, and the module
//! is built from it for a pass. It holds the layers in the order of [`PolicyShape::layers`], each
//! with its weight, `[inputs, outputs]` row-major, and then its bias.

use burn::module::{Module, Param};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Gradients, Tensor, TensorData};

use crate::learning::error::TrainError;
use crate::learning::streams::{Purpose, stream};

/// Width of the first layer.
const ENCODER_SIZE: usize = 128;
/// Width of φ, the representation.
pub const REPRESENTATION_SIZE: usize = 64;
/// Width of the layer before the heads.
const HIDDEN_SIZE: usize = 128;
/// Slope of LeakyReLU below 0.
pub const NEGATIVE_SLOPE: f64 = 0.2;
/// Bounds of the log standard deviation.
pub const LOG_STD_RANGE: [f64; 2] = [-20.0, 2.0];

/// What decides the sizes of a policy's layers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PolicyShape {
    /// D, of a stacked observation.
    pub observation_size: usize,
    /// A.
    pub action_size: usize,
}

/// A linear layer's place in the policy.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LayerShape {
    /// Name in exported files.
    pub name: &'static str,
    /// Rows of the weight.
    pub inputs: usize,
    /// Columns of the weight.
    pub outputs: usize,
    /// False: the layer is `x W`; true: `x W + b`.
    pub has_bias: bool,
}

impl LayerShape {
    /// Number of parameters.
    #[must_use]
    pub fn len(&self) -> usize {
        self.inputs * self.outputs + if self.has_bias { self.outputs } else { 0 }
    }

    /// True if there is no parameter, which no layer of a policy is.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl PolicyShape {
    /// The layers, from observation to heads.
    ///
    /// # Source
    /// The reference implementation's tanh-Gaussian policy: only the first layer has no bias.
    #[must_use]
    pub fn layers(self) -> [LayerShape; 5] {
        let layer = |name, inputs, outputs| LayerShape {
            name,
            inputs,
            outputs,
            has_bias: name != "encoder_1",
        };
        [
            layer("encoder_1", self.observation_size, ENCODER_SIZE),
            layer("encoder_2", ENCODER_SIZE, REPRESENTATION_SIZE),
            layer("hidden", REPRESENTATION_SIZE, HIDDEN_SIZE),
            layer("mean", HIDDEN_SIZE, self.action_size),
            layer("log_std", HIDDEN_SIZE, self.action_size),
        ]
    }

    /// Length of the flat vector.
    #[must_use]
    pub fn parameter_count(self) -> usize {
        self.layers().iter().map(LayerShape::len).sum()
    }

    /// The parameters before step 1: torch's default, uniform within ±1/√inputs for weight and bias.
    #[must_use]
    pub fn initial_parameters(self, seed: u64) -> Vec<f32> {
        let mut generator = stream(seed, Purpose::InitialParameters, 0);
        let mut parameters = Vec::with_capacity(self.parameter_count());
        for layer in self.layers() {
            let bound = 1.0 / (layer.inputs as f64).sqrt();
            parameters.extend((0..layer.len()).map(|_| generator.uniform(-bound, bound) as f32));
        }
        parameters
    }

    /// Each layer with its weight and bias within `parameters`.
    ///
    /// # Errors
    /// [`TrainError::Size`] if `parameters` has another length than [`Self::parameter_count`].
    pub fn split(self, parameters: &[f32]) -> Result<[LayerParameters<'_>; 5], TrainError> {
        if parameters.len() != self.parameter_count() {
            return Err(TrainError::Size {
                what: "the list of parameters",
                got: parameters.len(),
                want: self.parameter_count(),
            });
        }
        let mut rest = parameters;
        Ok(self.layers().map(|shape| {
            let (layer, after) = rest.split_at(shape.len());
            rest = after;
            let (weight, bias) = layer.split_at(shape.inputs * shape.outputs);
            LayerParameters { shape, weight, bias: shape.has_bias.then_some(bias) }
        }))
    }
}

/// A layer's part of the flat vector.
#[derive(Debug, Clone, Copy)]
pub struct LayerParameters<'a> {
    /// Name and sizes.
    pub shape: LayerShape,
    /// `[inputs, outputs]`.
    pub weight: &'a [f32],
    /// `[outputs]`.
    pub bias: Option<&'a [f32]>,
}

#[derive(Module, Debug)]
struct Layer {
    weight: Param<Tensor<2>>,
    bias: Option<Param<Tensor<1>>>,
}

impl Layer {
    fn new(parameters: &LayerParameters<'_>, device: &Device) -> Self {
        let LayerParameters { shape, weight, bias } = parameters;
        let weight = tensor(weight.to_vec(), shape.outputs, device);
        let bias = bias.map(|bias| {
            let data = TensorData::new(bias.to_vec(), [shape.outputs]);
            Param::from_tensor(Tensor::from_data(data, device))
        });
        Self { weight: Param::from_tensor(weight), bias }
    }

    /// `[n, inputs]` -> `[n, outputs]`.
    fn forward(&self, input: Tensor<2>) -> Tensor<2> {
        let output = input.matmul(self.weight.val());
        match &self.bias {
            Some(bias) => output + bias.val().unsqueeze(),
            None => output,
        }
    }
}

/// The policy: observation -> φ -> mean and log standard deviation of the action before tanh.
#[derive(Module, Debug)]
pub struct PolicyNet {
    encoder_1: Layer,
    encoder_2: Layer,
    hidden: Layer,
    mean: Layer,
    log_std: Layer,
}

/// Of a batch of n observations.
#[derive(Debug, Clone)]
pub struct PolicyTensors {
    /// φ before its activation, `[n, 64]`.
    pub representation: Tensor<2>,
    /// `[n, action_size]`.
    pub mean: Tensor<2>,
    /// `[n, action_size]`, within [`LOG_STD_RANGE`].
    pub log_std: Tensor<2>,
}

impl PolicyNet {
    /// The module with these parameters, on `device`; gradients need a device with autodiff.
    ///
    /// # Errors
    /// [`TrainError::Size`].
    pub fn new(
        shape: PolicyShape,
        parameters: &[f32],
        device: &Device,
    ) -> Result<Self, TrainError> {
        let layers = shape.split(parameters)?;
        let [encoder_1, encoder_2, hidden, mean, log_std] =
            layers.each_ref().map(|layer| Layer::new(layer, device));
        Ok(Self { encoder_1, encoder_2, hidden, mean, log_std })
    }

    /// φ: `[n, observation_size]`, standardised -> `[n, 64]`.
    #[must_use]
    pub fn encode(&self, observations: Tensor<2>) -> Tensor<2> {
        let encoded = leaky_relu(self.encoder_1.forward(observations));
        self.encoder_2.forward(encoded)
    }

    /// Everything: `[n, observation_size]`, standardised.
    #[must_use]
    pub fn forward(&self, observations: Tensor<2>) -> PolicyTensors {
        let representation = self.encode(observations);
        let hidden = self.hidden.forward(leaky_relu(representation.clone()));
        let hidden = leaky_relu(hidden);
        let [low, high] = LOG_STD_RANGE;
        PolicyTensors {
            representation,
            mean: self.mean.forward(hidden.clone()),
            log_std: self.log_std.forward(hidden).clamp(low, high),
        }
    }

    /// The gradient of `loss`, in the order of the flat vector. A parameter that the loss does not
    /// reach has gradient 0.
    ///
    /// # Errors
    /// [`TrainError::Tensor`].
    pub fn gradient(&self, loss: &Tensor<1>) -> Result<Vec<f32>, TrainError> {
        let mut gradients = loss.backward();
        let mut flat = Vec::new();
        for layer in [&self.encoder_1, &self.encoder_2, &self.hidden, &self.mean, &self.log_std] {
            append_gradient(&layer.weight.val(), &mut gradients, &mut flat)?;
            if let Some(bias) = &layer.bias {
                append_gradient(&bias.val(), &mut gradients, &mut flat)?;
            }
        }
        Ok(flat)
    }
}

/// x, or [`NEGATIVE_SLOPE`] x below 0, written with relu: Burn's own selects number by number with
/// a mask, which takes more than half of a step's time.
fn leaky_relu(x: Tensor<2>) -> Tensor<2> {
    x.clone().mul_scalar(NEGATIVE_SLOPE) + relu(x).mul_scalar(1.0 - NEGATIVE_SLOPE)
}

fn append_gradient<const D: usize>(
    parameter: &Tensor<D>,
    gradients: &mut Gradients,
    flat: &mut Vec<f32>,
) -> Result<(), TrainError> {
    match parameter.grad_remove(gradients) {
        Some(gradient) => flat.extend(values(gradient)?),
        None => flat.resize(flat.len() + parameter.shape().num_elements(), 0.0),
    }
    Ok(())
}

/// A matrix with `columns` columns.
pub(crate) fn tensor(values: Vec<f32>, columns: usize, device: &Device) -> Tensor<2> {
    let rows = values.len() / columns;
    Tensor::from_data(TensorData::new(values, [rows, columns]), device)
}

/// A tensor's numbers, row-major.
pub(crate) fn values<const D: usize>(tensor: Tensor<D>) -> Result<Vec<f32>, TrainError> {
    let data = tensor.try_into_data().map_err(|error| TrainError::Tensor(error.to_string()))?;
    data.try_into_vec().map_err(|error| TrainError::Tensor(error.to_string()))
}

#[cfg(test)]
mod tests;
