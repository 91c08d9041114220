//! Networks: layers in one flat vector of parameters, with the optimiser that trains them.
//!
//! The flat vector is the truth: the optimiser, checkpoints and exports work on it, and tensors are
//! made from it for a pass. It holds the layers in order, each with its weight, `[inputs, outputs]`
//! row-major, and then its bias.

use burn::tensor::activation::relu;
use burn::tensor::{Device, Gradients, Tensor, TensorData};

use crate::learning::adam::Adam;
use crate::learning::error::TrainError;
use crate::learning::streams::{Purpose, stream};

/// Slope of LeakyReLU below 0.
pub const NEGATIVE_SLOPE: f64 = 0.2;

/// Of a transformer's first weights.
const TRANSFORMER_STD: f64 = 0.02;

/// A linear layer's place in a network.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LayerShape {
    /// Name in files.
    pub name: &'static str,
    /// Rows of the weight.
    pub inputs: usize,
    /// Columns of the weight.
    pub outputs: usize,
    /// False: the layer is `x W`; true: `x W + b`.
    pub has_bias: bool,
}

impl LayerShape {
    /// A layer with a bias.
    #[must_use]
    pub fn new(name: &'static str, inputs: usize, outputs: usize) -> Self {
        Self { name, inputs, outputs, has_bias: true }
    }

    /// The layer without its bias.
    #[must_use]
    pub fn without_bias(self) -> Self {
        Self { has_bias: false, ..self }
    }

    /// Number of parameters.
    #[must_use]
    pub fn len(&self) -> usize {
        self.inputs * self.outputs + if self.has_bias { self.outputs } else { 0 }
    }

    /// True if there is no parameter, which no layer of ours is.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Number of parameters of `layers`.
#[must_use]
pub fn parameter_count(layers: &[LayerShape]) -> usize {
    layers.iter().map(LayerShape::len).sum()
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

/// Each layer with its weight and bias within `parameters`.
///
/// # Errors
/// [`TrainError::Size`] if `parameters` has not the length of all `layers`.
pub fn split<'a>(
    layers: &[LayerShape],
    parameters: &'a [f32],
) -> Result<Vec<LayerParameters<'a>>, TrainError> {
    let want = parameter_count(layers);
    if parameters.len() != want {
        let what = "the list of parameters";
        return Err(TrainError::Size { what, got: parameters.len(), want });
    }
    let mut rest = parameters;
    Ok(layers
        .iter()
        .map(|&shape| {
            let (layer, after) = rest.split_at(shape.len());
            rest = after;
            let (weight, bias) = layer.split_at(shape.inputs * shape.outputs);
            LayerParameters { shape, weight, bias: shape.has_bias.then_some(bias) }
        })
        .collect())
}

/// How parameters begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Initialization {
    /// torch's default for linear layers: uniform within ±1/√inputs, weight and bias.
    Uniform,
    /// Kaiming's normal for relu, √2/√inputs, with 1/√inputs for the last layer; zero biases.
    Kaiming,
    /// GPT-2's: N(0, 0.02²), zero biases; gains of norms, layers whose name begins so, are 1.
    Transformer,
}

/// A network and its optimiser: together they decide every later step.
#[derive(Debug, Clone, PartialEq)]
pub struct Network {
    /// Name in files.
    pub name: &'static str,
    /// In the order of the parameters.
    pub layers: Vec<LayerShape>,
    /// The flat vector.
    pub parameters: Vec<f32>,
    /// Its optimiser.
    pub adam: Adam,
}

impl Network {
    /// Before its first step. `number` tells the networks of a run apart.
    #[must_use]
    pub fn new(
        name: &'static str,
        layers: Vec<LayerShape>,
        initialization: Initialization,
        seed: u64,
        number: u32,
    ) -> Self {
        let mut generator = stream(seed, Purpose::InitialParameters, number);
        let mut parameters = Vec::with_capacity(parameter_count(&layers));
        for (at, layer) in layers.iter().enumerate() {
            let bound = 1.0 / (layer.inputs as f64).sqrt();
            match initialization {
                Initialization::Uniform => parameters
                    .extend((0..layer.len()).map(|_| generator.uniform(-bound, bound) as f32)),
                Initialization::Transformer => {
                    let weights = layer.inputs * layer.outputs;
                    let is_norm = layer.name.starts_with("norm");
                    parameters.extend((0..weights).map(|_| match is_norm {
                        true => 1.0,
                        false => (TRANSFORMER_STD * generator.standard_normal()) as f32,
                    }));
                    parameters.resize(parameters.len() + layer.len() - weights, 0.0);
                }
                Initialization::Kaiming => {
                    let is_last = at + 1 == layers.len();
                    let std = if is_last { bound } else { std::f64::consts::SQRT_2 * bound };
                    let weights = layer.inputs * layer.outputs;
                    parameters
                        .extend((0..weights).map(|_| (std * generator.standard_normal()) as f32));
                    parameters.resize(parameters.len() + layer.len() - weights, 0.0);
                }
            }
        }
        let adam = Adam::new(parameters.len());
        Self { name, layers, parameters, adam }
    }

    /// Its layers as tensors on `device`; gradients need a device with autodiff.
    ///
    /// # Errors
    /// [`TrainError::Size`] if somebody changed the parameters' number.
    pub fn tensors(&self, device: &Device) -> Result<Layers, TrainError> {
        Layers::new(&self.layers, &self.parameters, device)
    }

    /// A step of Adam against `gradient`, in step number `step` of the run.
    ///
    /// # Errors
    /// [`TrainError::Diverged`] with the layer's name if a gradient or, after the step, a parameter
    /// is not finite.
    pub fn descend(
        &mut self,
        gradient: &[f32],
        learning_rate: f64,
        step: u64,
    ) -> Result<(), TrainError> {
        self.check_finite(gradient, "the gradient of ", step)?;
        self.adam.update(&mut self.parameters, gradient, learning_rate);
        self.check_finite(&self.parameters, "", step)
    }

    fn check_finite(&self, values: &[f32], prefix: &str, step: u64) -> Result<(), TrainError> {
        let Some(at) = values.iter().position(|value| !value.is_finite()) else { return Ok(()) };
        let mut start = 0;
        let layer = self.layers.iter().find(|layer| {
            start += layer.len();
            at < start
        });
        let layer = layer.map_or("", |layer| layer.name);
        let tensor = format!("{prefix}{}.{layer}", self.name);
        Err(TrainError::Diverged { step, tensor, value: f64::from(values[at]) })
    }
}

/// Layers as tensors, for one pass.
#[derive(Debug, Clone)]
pub struct Layers(Vec<Layer>);

#[derive(Debug, Clone)]
struct Layer {
    weight: Tensor<2>,
    bias: Option<Tensor<1>>,
}

impl Layers {
    /// On `device`; gradients need a device with autodiff.
    ///
    /// # Errors
    /// [`TrainError::Size`].
    pub fn new(
        layers: &[LayerShape],
        parameters: &[f32],
        device: &Device,
    ) -> Result<Self, TrainError> {
        let layers = split(layers, parameters)?.into_iter().map(|layer| {
            let bias = layer.bias.map(|bias| {
                let data = TensorData::new(bias.to_vec(), [bias.len()]);
                Tensor::<1>::from_data(data, device)
            });
            let weight = tensor(layer.weight.to_vec(), layer.shape.outputs, device);
            if device.is_autodiff() {
                Layer { weight: weight.require_grad(), bias: bias.map(Tensor::require_grad) }
            } else {
                Layer { weight, bias }
            }
        });
        Ok(Self(layers.collect()))
    }

    /// Layer number `at`: `[n, inputs]` -> `[n, outputs]`.
    ///
    /// # Panics
    /// If there is no such layer.
    #[must_use]
    pub fn linear(&self, at: usize, input: Tensor<2>) -> Tensor<2> {
        let Layer { weight, bias } = &self.0[at];
        let output = input.matmul(weight.clone());
        match bias {
            Some(bias) => output + bias.clone().unsqueeze(),
            None => output,
        }
    }

    /// The weight of layer number `at`, `[inputs, outputs]`.
    ///
    /// # Panics
    /// If there is no such layer.
    #[must_use]
    pub fn weight(&self, at: usize) -> Tensor<2> {
        self.0[at].weight.clone()
    }

    /// The bias of layer number `at` as a row, zeros if it has none.
    ///
    /// # Panics
    /// If there is no such layer.
    #[must_use]
    pub fn bias(&self, at: usize) -> Tensor<2> {
        let Layer { weight, bias } = &self.0[at];
        match bias {
            Some(bias) => bias.clone().unsqueeze(),
            None => Tensor::zeros([1, weight.dims()[1]], &weight.device()),
        }
    }

    /// All layers in order, with LeakyReLU between them.
    #[must_use]
    pub fn leaky_forward(&self, input: Tensor<2>) -> Tensor<2> {
        (0..self.0.len()).fold(input, |input, at| {
            self.linear(at, if at == 0 { input } else { leaky_relu(input) })
        })
    }

    /// The gradient of each parameter, in the order of the flat vector. A parameter that the loss
    /// does not reach has gradient 0.
    ///
    /// # Errors
    /// [`TrainError::Tensor`].
    pub fn gradient(&self, gradients: &mut Gradients) -> Result<Vec<f32>, TrainError> {
        let mut flat = Vec::new();
        for Layer { weight, bias } in &self.0 {
            append_gradient(weight, gradients, &mut flat)?;
            if let Some(bias) = bias {
                append_gradient(bias, gradients, &mut flat)?;
            }
        }
        Ok(flat)
    }
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

/// x, or [`NEGATIVE_SLOPE`] x below 0, written with relu: Burn's own selects number by number with
/// a mask, which takes more than half of a step's time.
#[must_use]
pub fn leaky_relu(x: Tensor<2>) -> Tensor<2> {
    x.clone().mul_scalar(NEGATIVE_SLOPE) + relu(x).mul_scalar(1.0 - NEGATIVE_SLOPE)
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

/// A scalar's number.
pub(crate) fn scalar(tensor: &Tensor<1>) -> Result<f64, TrainError> {
    Ok(values(tensor.clone().inner())?.into_iter().map(f64::from).sum())
}
