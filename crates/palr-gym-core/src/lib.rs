//! Plain types and pure functions that every other room shares: what an environment is called,
//! what its agent sees, how returns become scores, and where random numbers come from.
//!
//! # Layout
//! - [`env_id`]: `hopper-w2-v0` and its grammar.
//! - [`task`], [`spec`], [`space`]: the facts of a task, and of an environment made from it.
//! - [`frame_stack`]: the stacked observation, zero-padded.
//! - [`standardize`]: columns of zero mean and unit variance.
//! - [`options`]: autoreset modes, out-of-bounds handling, masks, fidelity.
//! - [`scene_options`]: what can be chosen about a driving scene.
//! - [`score`]: normalised scores and their statistics.
//! - [`random`]: NumPy's generator, bit for bit.
//! - [`tanh_gaussian`]: the distribution of stochastic policies.
//! - [`nearest`]: "did you mean" for names.
//!
//! Not here: anything that reads a file, opens a socket or calls MuJoCo.

pub mod env_id;
pub mod frame_stack;
pub mod nearest;
pub mod options;
pub mod random;
pub mod scene_options;
pub mod score;
pub mod space;
pub mod spec;
pub mod standardize;
pub mod tanh_gaussian;
pub mod task;

pub use env_id::{EnvId, EnvIdError};
pub use frame_stack::FrameStack;
pub use options::{ActionMode, AutoresetMode, Fidelity, Mask, OutOfBounds};
pub use scene_options::{SceneOption, SceneOptions, SceneOptionsError, WeatherMode};
pub use space::BoxSpace;
pub use spec::{EnvSpec, ObservationKind};
pub use standardize::{StandardizeError, Standardizer};
pub use task::{ReferenceReturns, TaskSpec};
