//! Demonstrations on disk.
//!
//! # Layout
//! - [`d4rl`]: the HDF5 layout of D4RL, written episode by episode.
//! - [`transitions`]: what one episode holds.
//!
//! Not here: where transitions come from.

pub mod d4rl;
pub mod error;
pub mod transitions;

pub use d4rl::{D4rlShape, D4rlWriter, Metadata};
pub use error::DataError;
pub use transitions::Episode;
