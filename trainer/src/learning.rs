//! Learning a policy from expert data: behaviour cloning and PALR.
//!
//! Nothing here knows a server, an environment or a data file: arrays in, a policy out.
//!
//! # Layout
//! - [`config`]: what decides a run's bits.
//! - [`data`]: expert data, standardised.
//! - [`policy_net`], [`likelihood`]: the policy and what it maximises.
//! - [`weights`], [`kernel`]: HSCIC, split into what depends on data only and what depends on φ.
//! - [`algorithms`]: the losses.
//! - [`adam`], `streams`: the optimiser, random numbers.
//! - [`mod@train`], [`checkpoint`]: the loop, and how it survives being killed.
//! - [`metrics`]: what a report of progress measures.
//! - [`export`]: the finished policy, as ONNX and safetensors.

pub mod adam;
pub mod algorithms;
pub mod checkpoint;
pub mod config;
pub mod data;
pub mod error;
pub mod export;
pub mod kernel;
pub mod likelihood;
pub mod metrics;
pub mod policy_net;
mod streams;
pub mod train;
pub mod weights;

pub use config::{Algorithm, PalrConfig, TrainConfig, WeightsMode, defaults};
pub use data::TrainingSet;
pub use error::TrainError;
pub use export::TrainedPolicy;
pub use train::{Progress, Trained, train};
