//! The Rust client of the service, and what is built on it: recorded data, evaluations, runs and
//! their pictures.
//!
//! Everything here reaches environments through gRPC only; nothing links to MuJoCo.
//!
//! # Layout
//! - [`client`]: connections, calls, errors.
//! - [`session`]: a session of environments, stepped over a stream.
//! - [`benchmark`]: how fast a server is.
//! - [`evaluate`]: evaluation on the server.
//! - [`film`]: pictures of episodes.
//! - [`collect`]: demonstrations to a file, resumable; [`journal`] is what makes them so.
//! - [`leakage`]: leakage of a policy on recorded demonstrations.
//! - [`runs`]: run folders that never mix.
//! - [`imitate`]: runs of imitation learning, from recorded demonstrations to an evaluated policy.
//! - [`expert`]: experts trained by soft actor-critic, from nothing.
//! - [`learning`]: policies from arrays: behaviour cloning and PALR.
//! - [`plot`]: figures, as SVG and PNG.

pub mod benchmark;
pub mod client;
pub mod collect;
pub mod error;
pub mod evaluate;
pub mod expert;
pub mod film;
pub mod imitate;
pub mod journal;
pub mod leakage;
pub mod learning;
pub mod plot;
pub mod policy;
pub mod runs;
pub mod session;

pub use client::{Client, ServerAddress};
pub use error::ClientError;
pub use policy::PolicySource;
