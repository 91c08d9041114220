//! A trained policy, and the files that it becomes.

mod onnx;

use burn::tensor::Device;
use safetensors::tensor::{Dtype, TensorView, serialize};

use crate::learning::data::Standardization;
use crate::learning::error::TrainError;
use crate::learning::policy_net::{PolicyNet, PolicyShape, tensor, values};

/// A policy with the statistics that its observations are standardised by.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainedPolicy {
    /// Sizes.
    pub shape: PolicyShape,
    /// Of raw stacked observations.
    pub observation_statistics: Standardization,
    /// The flat vector, in the order of [`PolicyShape::layers`].
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
        let policy = PolicyNet::new(self.shape, &self.parameters, &device)?;
        let standardized = self.observation_statistics.apply(observations);
        let output = policy.forward(tensor(standardized, self.shape.observation_size, &device));
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
        onnx::encode(self)
    }

    /// The parameters as safetensors: `<layer>.weight`, `[inputs, outputs]`, `<layer>.bias`, and
    /// `observation.mean` and `observation.std`.
    ///
    /// # Errors
    /// [`TrainError::Size`] if the parameters are not those of the shape.
    pub fn to_safetensors(&self) -> Result<Vec<u8>, TrainError> {
        let failed = |error: safetensors::SafeTensorError| TrainError::Tensor(error.to_string());
        let statistics = &self.observation_statistics;
        let observation_size = vec![self.shape.observation_size];
        let mut arrays: Vec<(String, Vec<usize>, &[f32])> = vec![
            ("observation.mean".into(), observation_size.clone(), &statistics.mean),
            ("observation.std".into(), observation_size, &statistics.std),
        ];
        for layer in self.shape.split(&self.parameters)? {
            let (name, shape) = (layer.shape.name, layer.shape);
            arrays.push((
                format!("{name}.weight"),
                vec![shape.inputs, shape.outputs],
                layer.weight,
            ));
            if let Some(bias) = layer.bias {
                arrays.push((format!("{name}.bias"), vec![shape.outputs], bias));
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

#[cfg(test)]
mod tests;
