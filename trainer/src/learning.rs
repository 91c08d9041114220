//! Learning a policy from expert data: behaviour cloning and PALR.
//!
//! Nothing here knows a server, an environment or a data file: arrays in, a policy out.
//!
//! # Layout
//! - [`config`]: what decides a run's bits.
//! - [`data`]: expert data, standardised.
//! - [`adam`], `streams`: the optimiser, random numbers.

pub mod adam;
pub mod config;
pub mod data;
pub mod error;

pub use config::{Algorithm, PalrConfig, TrainConfig, WeightsMode};
pub use data::TrainingSet;
pub use error::TrainError;
