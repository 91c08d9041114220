//! One file a gRPC service: requests in, domain calls, answers out.

mod collection;
mod dm_env_rpc;
mod environment;
mod evaluation;
pub(crate) mod guard;
mod leakage;
mod render;
mod rollouts;
mod server_info;
mod snapshot;

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use palr_gym_sim::SimulationThreads;
use palr_gym_sim::render::GlChoice;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

use crate::config::Limits;
use crate::dm_env_rpc::Worlds;
use crate::encode::WireEncode;
use crate::sessions::Sessions;
use crate::vision::Vision;

/// What the services share.
#[derive(Clone)]
pub struct Services {
    /// Open sessions.
    pub sessions: Arc<Sessions<WireEncode>>,
    /// Worlds of dm_env_rpc.
    pub worlds: Arc<Worlds>,
    /// What clients may ask for.
    pub limits: Limits,
    /// What pictures are drawn with.
    pub gl: GlChoice,
    /// What agents see.
    pub vision: Arc<Vision>,
    /// Where physics runs.
    pub threads: SimulationThreads,
    /// One permit for each evaluation or collection that may run.
    pub rollouts: Arc<Semaphore>,
    /// Rollouts that are at work: not waiting for somebody to read what they have found.
    pub rollouts_at_work: Arc<AtomicUsize>,
    /// Cancelled when the server begins to shut down.
    pub draining: CancellationToken,
}

impl Services {
    /// True while something is computed, and not only waiting to be read.
    #[must_use]
    pub fn is_at_work(&self) -> bool {
        self.rollouts_at_work.load(Ordering::Relaxed) > 0 || self.sessions.is_at_work()
    }
}
