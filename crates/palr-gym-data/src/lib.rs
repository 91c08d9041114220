//! Demonstrations on disk, and what a learner is given of them.
//!
//! # Layout
//! - [`d4rl`]: the HDF5 layout of D4RL, written episode by episode.
//! - [`transitions`]: what one episode holds.
//! - [`source`]: recordings of either layout, read an episode at a time; [`minari`]: the other
//!   layout; [`mod@copy`]: from one to the other, or a part.
//! - [`recording`]: what a data set holds, and its rows as they are asked for.
//! - [`read`]: any D4RL file, ours or theirs, as such a recording, checked.
//! - [`demonstrations`]: one in memory.
//! - [`selection`]: training rows and held-out rows.
//! - [`samples`]: rows as a learner meets them: masked, stacked, with past actions.
//! - [`statistics`]: what a data set is like.
//! - [`standardize`]: their columns with zero mean and unit variance.
//!
//! Not here: where transitions come from; what is learnt from them.

pub mod copy;
pub mod d4rl;
pub mod demonstrations;
pub mod error;
pub mod minari;
pub mod read;
pub mod recording;
pub mod samples;
pub mod selection;
pub mod source;
pub mod standardize;
pub mod statistics;
pub mod transitions;

pub use copy::{Copied, Layout};
pub use d4rl::{D4rlShape, D4rlWriter, Metadata};
pub use demonstrations::{Arrays, Demonstrations};
pub use error::DataError;
pub use read::RecordedFile;
pub use recording::{Outline, Recording, Rows};
pub use samples::{Samples, View};
pub use selection::{HeldOut, Selection};
pub use source::{Part, Source};
pub use transitions::Episode;
