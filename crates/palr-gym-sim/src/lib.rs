//! Tasks, physics and vector environments: everything that touches MuJoCo.
//!
//! # Layout
//! - [`tasks`]: the registry, and one file a task (dynamics, reward, termination, reset).
//! - [`physics`]: MuJoCo's model and data, and nothing of any task.
//! - [`mod@env`]: one environment: task + mask + frame stack + time limit + generator.
//! - [`vector`]: N of them, stepped together by the simulation threads.
//! - [`mujoco_log`]: where MuJoCo's own messages go.
//!
//! Not here: sessions, clients, policies.

pub mod env;
pub mod error;
pub mod mujoco_log;
pub mod physics;
pub mod tasks;
pub mod vector;

pub use env::{Env, Transition};
pub use error::SimError;
pub use tasks::{Task, resolve};
pub use vector::{SimulationThreads, StepFrame, VectorEnv, VectorOptions};
