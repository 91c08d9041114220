//! Feature extractors: ONNX models that make vectors of pictures, under a contract.
//!
//! # Layout
//! - [`contract`]: what a model's metadata say of its pictures, and pixels to its input.
//! - [`extractor`]: the model, held to the contract and run on batches.
//!
//! Not here: where pictures come from, and what becomes of features.

pub mod contract;
pub mod error;
pub mod extractor;

pub use contract::Preprocessing;
pub use error::VisionError;
pub use extractor::{Extractor, ExtractorLimits};
