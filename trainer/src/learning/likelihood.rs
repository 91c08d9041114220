//! The likelihood of expert actions under a Gaussian squashed by tanh.

use burn::tensor::Tensor;

use crate::learning::context::BatchTensors;
use crate::learning::data::nll_offset;
use crate::learning::error::TrainError;
use crate::learning::network::scalar;
use crate::learning::policy_net::PolicyTensors;

/// What the parameters change of the mean negative log-likelihood of a batch, in nats; a batch's
/// `nll_offset` is the rest.
///
/// # Shapes
/// `[n, action_size]` each -> scalar. `pre_tanh` is atanh of the clamped actions.
///
/// # Source
/// Change of variables: with z = (u - mean) / std, -log p = ½z² + log_std + ½ log 2π + log tanh'(u),
/// summed over actuators; the last two terms do not depend on parameters.
#[must_use]
pub fn negative_log_likelihood(
    mean: Tensor<2>,
    log_std: Tensor<2>,
    pre_tanh: Tensor<2>,
) -> Tensor<1> {
    let [n, _] = mean.dims();
    entries(mean, log_std, pre_tanh).sum().div_scalar(n as f64)
}

/// Of a batch: the term for its gradient, and its value in nats.
///
/// # Errors
/// [`TrainError::Tensor`].
pub fn of_batch(
    output: &PolicyTensors,
    batch: &BatchTensors,
) -> Result<(Tensor<1>, f64), TrainError> {
    let PolicyTensors { mean, log_std, .. } = output.clone();
    let term = negative_log_likelihood(mean, log_std, batch.pre_tanh.clone());
    let value = scalar(&term)? + batch.nll_offset;
    Ok((term, value))
}

/// The same with a weight for each sample, `[n, 1]`, in the place of 1/n; the value is that of the
/// unweighted mean.
///
/// # Errors
/// [`TrainError::Tensor`].
pub fn of_weighted_batch(
    output: &PolicyTensors,
    batch: &BatchTensors,
    weights: Tensor<2>,
) -> Result<(Tensor<1>, f64), TrainError> {
    let PolicyTensors { mean, log_std, .. } = output.clone();
    let [n, _] = mean.dims();
    let entries = entries(mean, log_std, batch.pre_tanh.clone());
    let value = scalar(&entries.clone().inner().sum())? / n as f64 + batch.nll_offset;
    Ok(((entries * weights).sum(), value))
}

/// -log p of one action, in nats: `u` is its atanh, `[action_size]` each.
#[must_use]
pub fn of_row(u: &[f32], mean: &[f32], log_std: &[f32]) -> f64 {
    let entry = |((&u, &mean), &log_std): ((&f32, &f32), &f32)| {
        let log_std = f64::from(log_std);
        let z = (f64::from(u) - f64::from(mean)) * (-log_std).exp();
        0.5 * z * z + log_std
    };
    let entries = u.iter().zip(mean).zip(log_std).map(entry).sum::<f64>();
    entries + nll_offset(u)
}

fn entries(mean: Tensor<2>, log_std: Tensor<2>, pre_tanh: Tensor<2>) -> Tensor<2> {
    let z = (pre_tanh - mean) * log_std.clone().neg().exp();
    (z.clone() * z).mul_scalar(0.5) + log_std
}
