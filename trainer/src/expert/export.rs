//! The finished policy, as ONNX and safetensors.

use safetensors::tensor::{Dtype, TensorView, serialize};

use crate::expert::actor;
use crate::learning::error::TrainError;
use crate::learning::export::relu_policy;
use crate::learning::network::{LayerParameters, LayerShape, split};

/// A layer that owns its numbers.
struct Owned {
    shape: LayerShape,
    weight: Vec<f32>,
    bias: Vec<f32>,
}

/// An actor's parameters with its sizes.
#[derive(Debug, Clone, Copy)]
pub struct ExpertPolicy<'a> {
    /// D.
    pub observation_size: usize,
    /// Width of the hidden layers.
    pub hidden: usize,
    /// A.
    pub action_size: usize,
    /// In the order of [`actor::layers`].
    pub parameters: &'a [f32],
}

impl ExpertPolicy<'_> {
    /// The layers, with a head each for mean and log_std.
    fn layers(&self) -> Result<Vec<Owned>, TrainError> {
        let layers = actor::layers(self.observation_size, self.hidden, self.action_size);
        let mut owned = Vec::new();
        for LayerParameters { shape, weight, bias } in split(&layers, self.parameters)? {
            let bias = bias.unwrap_or_default();
            if shape.name != "head" {
                owned.push(Owned { shape, weight: weight.to_vec(), bias: bias.to_vec() });
                continue;
            }
            let size = self.action_size;
            for (name, start) in [("mean", 0), ("log_std", size)] {
                let rows = weight.chunks_exact(shape.outputs);
                owned.push(Owned {
                    shape: LayerShape::new(name, shape.inputs, size),
                    weight: rows.flat_map(|row| &row[start..start + size]).copied().collect(),
                    bias: bias[start..start + size].to_vec(),
                });
            }
        }
        Ok(owned)
    }

    /// An ONNX model, opset 17: input `observation` `[N, D]`, raw; outputs `action` = tanh(mean),
    /// `mean` and `log_std` in [-20, 2], `[N, A]`; all float32.
    ///
    /// # Errors
    /// [`TrainError::Size`] if the parameters are not those of the sizes.
    pub fn to_onnx(&self) -> Result<Vec<u8>, TrainError> {
        let owned = self.layers()?;
        let layers: Vec<_> = owned
            .iter()
            .map(|layer| LayerParameters {
                shape: layer.shape,
                weight: &layer.weight,
                bias: Some(&layer.bias),
            })
            .collect();
        relu_policy(self.observation_size, self.action_size, &layers)
    }

    /// The parameters as safetensors: `<layer>.weight`, `[inputs, outputs]`, and `<layer>.bias` of
    /// hidden_1, hidden_2, mean and log_std.
    ///
    /// # Errors
    /// As [`Self::to_onnx`].
    pub fn to_safetensors(&self) -> Result<Vec<u8>, TrainError> {
        let failed = |error: safetensors::SafeTensorError| TrainError::Tensor(error.to_string());
        let owned = self.layers()?;
        let arrays = owned.iter().flat_map(|Owned { shape, weight, bias }| {
            [
                (format!("{}.weight", shape.name), vec![shape.inputs, shape.outputs], weight),
                (format!("{}.bias", shape.name), vec![shape.outputs], bias),
            ]
        });
        let views = arrays.map(|(name, dims, array)| {
            Ok((name, TensorView::new(Dtype::F32, dims, bytemuck::cast_slice(array))?))
        });
        let views: Vec<_> = views.collect::<Result<_, _>>().map_err(failed)?;
        serialize(views, None).map_err(failed)
    }
}
