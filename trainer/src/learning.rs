//! Learning a policy from expert data: PALR, and the methods that its paper compares it with.
//!
//! Nothing here knows a server, an environment or a data file: arrays in, a policy out.
//!
//! # Layout
//! - [`config`]: what decides a run's bits.
//! - [`data`]: expert data, standardised.
//! - [`algorithms`]: the methods.
//! - [`network`], [`policy_net`], [`architecture`]: layers, the policy, and how policies differ.
//! - [`likelihood`], [`regularizer`], [`weights`], [`kernel`]: what is minimised; HSCIC is split
//!   into what depends on data only and what depends on the policy.
//! - [`context`], [`noise`], `streams`: batches and random numbers.
//! - [`adam`], [`state`], [`checkpoint`], [`mod@train`]: the optimiser, the loop, and how it
//!   survives being killed; [`lockstep`]: many runs that share what they can.
//! - [`metrics`]: what a report of progress measures.
//! - [`export`]: the finished policy, as ONNX and safetensors.

pub mod adam;
pub mod algorithms;
pub mod architecture;
pub mod checkpoint;
pub mod config;
pub mod context;
pub mod data;
pub mod error;
pub mod export;
pub mod kernel;
pub mod likelihood;
pub mod lockstep;
pub mod metrics;
pub mod network;
pub mod noise;
pub mod policy_net;
pub mod regularizer;
pub mod state;
pub(crate) mod streams;
pub mod train;
pub mod weights;

pub use config::{Algorithm, PalrConfig, TrainConfig, WeightsMode, defaults};
pub use data::TrainingSet;
pub use error::TrainError;
pub use export::TrainedPolicy;
pub use lockstep::{LockstepRun, train_lockstep};
pub use train::{Progress, Trained, train};
