//! Behaviour cloning: the likelihood alone.

use burn::tensor::Device;

use crate::learning::algorithms::Loss;
use crate::learning::data::Batch;
use crate::learning::error::TrainError;
use crate::learning::likelihood::negative_log_likelihood;
use crate::learning::policy_net::{PolicyNet, PolicyTensors, tensor, values};

/// The loss of `batch`.
///
/// # Errors
/// [`TrainError::Tensor`].
pub fn loss(policy: &PolicyNet, batch: &Batch, device: &Device) -> Result<Loss, TrainError> {
    let (loss, _) = loss_and_tensors(policy, batch, device)?;
    Ok(loss)
}

/// The loss, and what the policy made of the batch.
///
/// # Errors
/// [`TrainError::Tensor`].
pub fn loss_and_tensors(
    policy: &PolicyNet,
    batch: &Batch,
    device: &Device,
) -> Result<(Loss, PolicyTensors), TrainError> {
    let observations =
        tensor(batch.observations.clone(), batch.observations.len() / batch.n, device);
    let pre_tanh = tensor(batch.pre_tanh.clone(), batch.pre_tanh.len() / batch.n, device);
    let output = policy.forward(observations);
    let tensor = negative_log_likelihood(output.mean.clone(), output.log_std.clone(), pre_tanh);
    let value: f64 = values(tensor.clone().inner())?.into_iter().map(f64::from).sum();
    Ok((Loss { tensor, nll: value + batch.nll_offset, hscic: None }, output))
}
