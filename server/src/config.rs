//! What a server allows.

use std::sync::Arc;
use std::time::Duration;

use palr_gym_onnx::PolicyLimits;
use palr_gym_sim::render::GlChoice;
use palr_gym_vision::Extractor;

/// Everything that can be chosen about a server, but for where it listens.
#[derive(Debug, Clone)]
pub struct ServerConfig {
    /// Threads that simulate, shared by all sessions.
    pub simulation_threads: usize,
    /// What pictures are drawn with; loaded when the first one is asked for.
    pub gl: GlChoice,
    /// What makes features of agents' pictures; unset: the one that ships.
    pub extractor: Option<Arc<Extractor>>,
    /// What clients may ask for.
    pub limits: Limits,
    /// How long a shutdown waits for running work.
    pub drain_timeout: Duration,
}

impl Default for ServerConfig {
    /// As many simulation threads as the machine has cores, ten seconds to drain.
    fn default() -> Self {
        Self {
            simulation_threads: std::thread::available_parallelism().map_or(1, usize::from),
            gl: GlChoice::default(),
            extractor: None,
            limits: Limits::default(),
            drain_timeout: Duration::from_secs(10),
        }
    }
}

/// What clients may ask for at most.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Open connections.
    pub max_connections: usize,
    /// Open sessions.
    pub max_sessions: usize,
    /// Environments in one session or rollout.
    pub max_envs_per_session: usize,
    /// Environments in all sessions together.
    pub max_envs: usize,
    /// Requests of one session that wait for their turn.
    pub max_queued_requests: usize,
    /// Requests of one stream that are worked on before their answers are read.
    pub max_pipelined_requests: usize,
    /// Evaluations and collections that run side by side.
    pub max_rollouts: usize,
    /// Episodes in one evaluation or collection.
    pub max_episodes: u32,
    /// Transitions in one collection.
    pub max_transitions: u64,
    /// Samples in one estimate of leakage; its work grows with their cube.
    pub max_leakage_samples: usize,
    /// Bytes in a request without a policy.
    pub max_message_bytes: usize,
    /// Bytes of arrays in the answer to an open loop.
    pub max_answer_bytes: usize,
    /// Steps in an open loop.
    pub max_open_loop_steps: usize,
    /// Bytes in a snapshot.
    pub max_snapshot_bytes: usize,
    /// Bytes of all large messages together that have begun to arrive.
    pub max_arriving_bytes: usize,
    /// How long a message may take to arrive.
    pub message_deadline: Duration,
    /// An evaluation or collection is given up when nobody reads its results for this long.
    pub results_unread: Duration,
    /// Size and speed of policies.
    pub policy: PolicyLimits,
    /// A session without requests is closed after this long.
    pub session_idle: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            max_connections: 4096,
            max_sessions: 1024,
            max_envs_per_session: 4096,
            max_envs: 16_384,
            max_queued_requests: 64,
            max_pipelined_requests: 16,
            max_rollouts: 8,
            max_episodes: 1_000_000,
            max_transitions: 1_000_000_000,
            max_leakage_samples: 4096,
            max_message_bytes: 4 << 20,
            max_answer_bytes: 64 << 20,
            max_open_loop_steps: 1000,
            max_snapshot_bytes: 64 << 20,
            max_arriving_bytes: 512 << 20,
            message_deadline: Duration::from_secs(120),
            results_unread: Duration::from_secs(60),
            policy: PolicyLimits::default(),
            session_idle: Duration::from_secs(600),
        }
    }
}
