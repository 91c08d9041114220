//! Losses, one file for each method.
//!
//! A loss is a pure function of parameters and data. Its tensor is for its gradient; what is logged
//! are the numbers beside it.

pub mod bc;
pub mod palr;

use burn::tensor::Tensor;

/// What a step minimises.
#[derive(Debug, Clone)]
pub struct Loss {
    /// A scalar whose gradient is the loss's; its value need not be.
    pub tensor: Tensor<1>,
    /// Mean negative log-likelihood of the batch, in nats.
    pub nll: f64,
    /// HSCIC of the representation, if the method has it.
    pub hscic: Option<f64>,
}
