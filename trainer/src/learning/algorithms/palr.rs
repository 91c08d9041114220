//! PALR: the likelihood, and HSCIC of the representation and the past action given the action.

use burn::tensor::{Device, Tensor};

use crate::learning::algorithms::{Loss, bc};
use crate::learning::data::Batch;
use crate::learning::error::TrainError;
use crate::learning::kernel::hscic_gradient;
use crate::learning::policy_net::{PolicyNet, REPRESENTATION_SIZE, tensor, values};
use crate::learning::weights::WeightMatrix;

/// What the regulariser is made of.
#[derive(Debug, Clone, Copy)]
pub struct Regularizer<'a> {
    /// M of the regularised rows.
    pub weights: &'a WeightMatrix,
    /// Their standardised observations, `[n, observation_size]`; `None` if they are the batch's own.
    pub observations: Option<&'a [f32]>,
    /// α.
    pub alpha: f64,
    /// σ² of the representation's kernel.
    pub bandwidth_sq: f64,
}

/// NLL of `batch` + α HSCIC.
///
/// # Errors
/// [`TrainError::Tensor`].
pub fn loss(
    policy: &PolicyNet,
    batch: &Batch,
    regularizer: Regularizer<'_>,
    device: &Device,
) -> Result<Loss, TrainError> {
    let (likelihood, output) = bc::loss_and_tensors(policy, batch, device)?;
    let representation = match regularizer.observations {
        None => output.representation,
        Some(observations) => {
            let columns = observations.len() / regularizer.weights.n();
            policy.encode(tensor(observations.to_vec(), columns, device))
        }
    };
    let (penalty, hscic) = surrogate(representation, regularizer, device)?;
    Ok(Loss { tensor: likelihood.tensor + penalty, hscic: Some(hscic), ..likelihood })
}

/// A scalar with the gradient of α HSCIC, and HSCIC itself.
///
/// The scalar is `α Σ φ ∘ D` with D, the derivative of HSCIC by φ, held constant: autodiff then
/// carries D to the parameters and never sees an n × n matrix.
///
/// # Errors
/// [`TrainError::Tensor`].
pub fn surrogate(
    representation: Tensor<2>,
    regularizer: Regularizer<'_>,
    device: &Device,
) -> Result<(Tensor<1>, f64), TrainError> {
    let phi = values(representation.clone().inner())?;
    let Regularizer { weights, alpha, bandwidth_sq, .. } = regularizer;
    let hscic = hscic_gradient(&phi, REPRESENTATION_SIZE, weights, bandwidth_sq);
    let derivative = tensor(hscic.gradient, REPRESENTATION_SIZE, device);
    Ok(((representation * derivative).sum().mul_scalar(alpha), hscic.value))
}

#[cfg(test)]
mod tests;
