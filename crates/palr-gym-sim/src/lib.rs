//! Tasks, physics and vector environments: everything that touches MuJoCo.
//!
//! # Layout
//! - [`tasks`]: the registry, and one file a task (dynamics, reward, termination, reset).
//! - [`physics`]: MuJoCo's model and data, the workbench on which each thread puts one simulation's
//!   state after the other; nothing of any task; [`guard`] around its errors,
//!   [`divergence`] for states that are none.
//! - [`mod@env`]: one environment: task + mask + frame stack + time limit + generator.
//! - [`vector`]: N of them, stepped together; [`snapshot`]: their state as bytes.
//! - [`threads`], [`parts`]: the simulation threads, and work that they share.
//! - [`render`]: pictures, drawn off screen; [`sight`]: agents that see them.
//! - [`mujoco_log`]: where MuJoCo's own messages go.
//!
//! Not here: sessions, clients, policies.

pub mod divergence;
pub mod env;
pub mod error;
pub mod guard;
pub mod mujoco_log;
pub mod parts;
pub mod physics;
pub mod render;
pub mod sight;
pub mod snapshot;
pub mod tasks;
pub mod threads;
pub mod vector;

pub use divergence::Divergence;
pub use env::{Env, Transition};
pub use error::SimError;
pub use parts::{Part, Parts};
pub use sight::{ExtractorError, FeatureExtractor, Onlooker, Sight};
pub use snapshot::{Snapshot, SnapshotError};
pub use tasks::{Task, resolve, resolve_scene};
pub use threads::{Job, SimulationThreads};
pub use vector::{DivergedEpisode, OpenLoop, StepFrame, VectorEnv, VectorOptions};
