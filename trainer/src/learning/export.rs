//! A trained policy, and the files that it becomes.

mod graphs;
mod onnx;
mod transformer;

use burn::tensor::Device;
use safetensors::tensor::{Dtype, TensorView, serialize};

use crate::learning::architecture::Architecture;
use crate::learning::data::Standardization;
use crate::learning::error::TrainError;
use crate::learning::network::{
    LayerParameters, LayerShape, parameter_count, split, tensor, values,
};
use crate::learning::policy_net::POLICY;

/// A policy with the statistics that its observations are standardised by.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainedPolicy {
    /// How it is built.
    pub architecture: Architecture,
    /// Of raw stacked observations.
    pub observation_statistics: Standardization,
    /// The flat vectors of [`Architecture::networks`], one after the other.
    pub parameters: Vec<f32>,
}

/// What a policy does with n observations; `[n, action_size]` each.
#[derive(Debug, Clone, PartialEq)]
pub struct PolicyOutput {
    /// tanh of the mean.
    pub action: Vec<f32>,
    /// Of the Gaussian before tanh.
    pub mean: Vec<f32>,
    /// Of the Gaussian before tanh.
    pub log_std: Vec<f32>,
}

impl TrainedPolicy {
    /// Runs the policy on raw stacked observations, `[n, observation_size]`.
    ///
    /// # Errors
    /// [`TrainError::Size`] or [`TrainError::Tensor`].
    pub fn act(&self, observations: &[f32]) -> Result<PolicyOutput, TrainError> {
        let device = Device::flex();
        let standardized = self.observation_statistics.apply(observations);
        let input = tensor(standardized, self.architecture.observation_size, &device);
        let output = self.architecture.forward(&self.parameters, input, &device)?;
        let mean = values(output.mean)?;
        let action = mean.iter().map(|mean| mean.tanh()).collect();
        Ok(PolicyOutput { action, mean, log_std: values(output.log_std)? })
    }

    /// The policy as an ONNX model, opset 17: input `observation` `[N, observation_size]`, raw and
    /// stacked; outputs `action`, `mean` and `log_std`, `[N, action_size]`; all float32.
    ///
    /// # Errors
    /// [`TrainError::Size`] if the parameters are not those of the shape.
    pub fn to_onnx(&self) -> Result<Vec<u8>, TrainError> {
        graphs::model(self)
    }

    /// The parameters as safetensors: `<layer>.weight`, `[inputs, outputs]`, `<layer>.bias`, and
    /// `observation.mean` and `observation.std`. Layers of networks that a plain policy has not are
    /// `<network>.<layer>`.
    ///
    /// # Errors
    /// [`TrainError::Size`] if the parameters are not those of the shape.
    pub fn to_safetensors(&self) -> Result<Vec<u8>, TrainError> {
        let failed = |error: safetensors::SafeTensorError| TrainError::Tensor(error.to_string());
        let statistics = &self.observation_statistics;
        let observation_size = vec![self.architecture.observation_size];
        let mut arrays: Vec<(String, Vec<usize>, &[f32])> = vec![
            ("observation.mean".into(), observation_size.clone(), &statistics.mean),
            ("observation.std".into(), observation_size, &statistics.std),
        ];
        for (prefix, layers, parameters) in self.networks()? {
            for layer in split(&layers, parameters)? {
                let shape = layer.shape;
                let name = format!("{prefix}{}", shape.name);
                let dims = vec![shape.inputs, shape.outputs];
                arrays.push((format!("{name}.weight"), dims, layer.weight));
                if let Some(bias) = layer.bias {
                    arrays.push((format!("{name}.bias"), vec![shape.outputs], bias));
                }
            }
        }
        let views = arrays.into_iter().map(|(name, shape, array)| {
            let view = TensorView::new(Dtype::F32, shape, bytemuck::cast_slice(array))?;
            Ok((name, view))
        });
        let views: Vec<_> = views.collect::<Result<_, _>>().map_err(failed)?;
        serialize(views, None).map_err(failed)
    }
}

/// The policy of `layers` with ReLU between them, hidden ones and then those of mean and log_std, as
/// an ONNX model with the inputs and outputs of [`TrainedPolicy::to_onnx`].
pub(crate) fn relu_policy(
    observation_size: usize,
    action_size: usize,
    layers: &[LayerParameters<'_>],
) -> Result<Vec<u8>, TrainError> {
    graphs::relu_model(observation_size, action_size, layers)
}

/// A network's prefix in files, its layers and its part of the parameters.
type Part<'a> = (String, Vec<LayerShape>, &'a [f32]);

impl TrainedPolicy {
    /// The networks that act.
    fn networks(&self) -> Result<Vec<Part<'_>>, TrainError> {
        let (got, want) = (self.parameters.len(), self.architecture.parameter_count());
        if got != want {
            return Err(TrainError::Size { what: "the list of parameters", got, want });
        }
        let mut rest = self.parameters.as_slice();
        let networks = self.architecture.networks().into_iter().map(|(name, layers)| {
            let (own, after) = rest.split_at(parameter_count(&layers));
            rest = after;
            let prefix = if name == POLICY { String::new() } else { format!("{name}.") };
            (prefix, layers, own)
        });
        Ok(networks.collect())
    }
}

#[cfg(test)]
mod tests;
