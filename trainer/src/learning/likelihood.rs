//! The likelihood of expert actions under a Gaussian squashed by tanh.

use burn::tensor::Tensor;

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
    let z = (pre_tanh - mean) * log_std.clone().neg().exp();
    ((z.clone() * z).mul_scalar(0.5) + log_std).sum().div_scalar(n as f64)
}
