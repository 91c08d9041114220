//! How much a policy's action (or representation) depends on the expert's past action beyond what
//! the expert's current action explains.
//!
//! # Layout
//! - [`mod@hscic`]: the estimator of the PALR paper, exact, in double precision, point by point.
//! - [`kernel`]: the Gaussian kernel that it uses everywhere.
//! - [`bootstrap`]: an interval for it, from blocks of consecutive points.
//!
//! Not here: where actions come from.

pub mod bootstrap;
pub mod error;
pub mod hscic;
pub mod kernel;

pub use bootstrap::{Interval, block_bootstrap};
pub use error::LeakageError;
pub use hscic::{Hscic, HscicConfig, effective_dimension, hscic, refuse_constant};
