//! The service: sessions of environments, rollouts of policies, and the gRPC face of both.
//!
//! # Layout
//! - [`config`]: limits, and nothing read from files or flags.
//! - [`session`], [`sessions`]: one session as an actor on the simulation threads; all of them.
//! - [`rollout`]: whole episodes played by the server itself, for evaluation and collection.
//! - [`leakage`]: HSCIC of uploaded arrays, or of what a policy does on them.
//! - [`pictures`]: what sessions look like; [`vision`]: what agents see.
//! - [`dm_env_rpc`]: DeepMind's protocol, on top of sessions.
//! - [`experts`]: the policies that ship with the server.
//! - [`error`], [`status`]: domain errors; the one map from them to gRPC statuses.
//! - [`convert`]: domain values to messages and back; [`encode`]: answers of sessions.
//! - [`services`]: one file a gRPC service. `tonic::Status` is spoken only there and in [`status`].
//! - [`transport`]: listening, health, reflection, draining.

pub mod config;
pub mod convert;
pub mod dm_env_rpc;
pub mod encode;
pub mod error;
pub mod experts;
pub mod leakage;
pub mod pictures;
pub mod rollout;
pub mod services;
pub mod session;
pub mod sessions;
pub mod status;
pub mod transport;
pub mod vision;

pub use config::{Limits, ServerConfig};
pub use error::ServerError;
pub use transport::{Listener, Server};

/// Version of palr-gym.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
