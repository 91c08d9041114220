//! The targets. Each has `run`, which panics over what must not be, and `corpus`, valid inputs.

pub mod decode;
pub mod dm_env_rpc;
pub mod snapshot;
