//! DeepMind's dm_env_rpc, for clients that already speak it.
//!
//! A world is an environment id and a seed, known by a name. A connection that joins it gets an
//! environment of its own, behind an ordinary session, and walks it through the protocol's states.
//!
//! # Layout
//! - [`connection`]: the state machine of one connection; knows neither gRPC nor simulation.
//! - [`worlds`]: every world of a server.
//! - [`stage`]: where a connection's environment comes from.
//! - `settings`, `tensors`: what comes in, checked; specs and observations going out.
//! - [`error`]: what a client can do wrong.

pub mod connection;
pub mod error;
mod settings;
pub mod stage;
mod tensors;
pub mod worlds;

pub use connection::Connection;
pub use error::DmEnvRpcError;
pub use stage::{Env, Outcome, SessionStage, Stage};
pub use worlds::Worlds;
