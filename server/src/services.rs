//! One file a gRPC service: requests in, domain calls, answers out.

mod collection;
mod dm_env_rpc;
mod environment;
mod evaluation;
mod leakage;
mod rollouts;
mod server_info;
mod snapshot;

use std::sync::Arc;

use palr_gym_sim::SimulationThreads;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

use crate::config::Limits;
use crate::encode::WireEncode;
use crate::dm_env_rpc::Worlds;
use crate::sessions::Sessions;

/// What the services share.
#[derive(Clone)]
pub struct Services {
    /// Open sessions.
    pub sessions: Arc<Sessions<WireEncode>>,
    /// Worlds of dm_env_rpc.
    pub worlds: Arc<Worlds>,
    /// What clients may ask for.
    pub limits: Limits,
    /// Where physics runs.
    pub threads: SimulationThreads,
    /// One permit for each evaluation or collection that may run.
    pub rollouts: Arc<Semaphore>,
    /// Cancelled when the server begins to shut down.
    pub draining: CancellationToken,
}
