//! Whole episodes, played by the server itself.
//!
//! Episode `i` is reset with `seed + i` and draws its actions from a stream of its own, so what
//! happens in it does not depend on which episodes run beside it. Policies see batches of always
//! the same size, so that their floating-point sums do not depend on it either.

mod actor;
mod evaluate;
mod play;
mod record;

pub use actor::{Actor, PolicyChoice};
pub use evaluate::{EpisodeResult, EvaluationSummary, evaluate};
pub use play::{Plan, STREAM_OF_ACTIONS};
pub use record::{Amount, EpisodeTransitions, collect};

/// Environments that run side by side when the caller does not choose. A constant, not the
/// machine's size: equal requests give equal bits on all machines of a kind.
pub const DEFAULT_NUM_ENVS: usize = 32;
