//! ONNX models from strangers, run under a contract and within limits.
//!
//! # Layout
//! - [`runtime`]: finds and loads ONNX Runtime, once, when the first model needs it.
//! - [`inspect`]: what is checked in a model's bytes before ONNX Runtime sees them.
//! - [`model`]: a model of any contract, run under watch.
//! - [`policy`]: the policy contract: observation in, action (and mean, log_std) out.
//! - `watchdog`: ends an inference that takes too long.
//!
//! Not here: where observations come from, and what becomes of actions.

pub mod error;
pub mod inspect;
pub mod model;
pub mod policy;
pub mod runtime;
mod watchdog;

pub use error::OnnxError;
pub use model::{Limits, Model, Outputs};
pub use policy::{Policy, PolicyLimits, PolicyOutput};
