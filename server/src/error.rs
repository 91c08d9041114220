//! What can go wrong in the service, with the values that caused it.

use palr_gym_core::EnvIdError;
use palr_gym_leakage::LeakageError;
use palr_gym_onnx::OnnxError;
use palr_gym_sim::SimError;
use palr_gym_vision::VisionError;

use crate::dm_env_rpc::DmEnvRpcError;
use crate::session::SessionId;

/// Why a request failed. [`crate::status`] says which gRPC status each becomes.
#[derive(Debug, Clone, thiserror::Error)]
pub enum ServerError {
    /// From the simulation.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// From the feature extractor.
    #[error(transparent)]
    Vision(#[from] VisionError),
    /// From the policy, before any episode.
    #[error(transparent)]
    Policy(#[from] OnnxError),
    /// From the policy, in the middle of an episode.
    #[error("episode {episode}, step {step}: {source}")]
    PolicyInEpisode {
        /// Index of the episode.
        episode: u32,
        /// Steps taken in it.
        step: u32,
        /// What went wrong.
        source: OnnxError,
    },
    /// From the estimate of leakage.
    #[error(transparent)]
    Leakage(#[from] LeakageError),
    /// From a client of dm_env_rpc.
    #[error(transparent)]
    DmEnvRpc(#[from] DmEnvRpcError),
    /// An array of the wrong type or shape.
    #[error("{field} is {got}; expected {want}")]
    Array {
        /// Path of the field.
        field: &'static str,
        /// What it is.
        got: String,
        /// What it should be.
        want: String,
    },
    /// No session has this id.
    #[error(
        "session {id:?} not found: it was closed, idle for more than {idle_limit_s} s, or never opened on this server"
    )]
    SessionNotFound {
        /// The id as it came.
        id: String,
        /// After which sessions are closed.
        idle_limit_s: u64,
    },
    /// A session whose simulation panicked.
    #[error("session {id} failed inside the simulation and was closed; open a new one")]
    SessionBroken {
        /// The session.
        id: SessionId,
    },
    /// Too few or too many environments.
    #[error("num_envs is {got}; expected 1 to {max}")]
    NumEnvs {
        /// What was asked for.
        got: u64,
        /// The limit.
        max: usize,
    },
    /// The server is full.
    #[error(
        "{open} sessions are open, as many as this server allows; close one or try again later"
    )]
    TooManySessions {
        /// How many are open.
        open: usize,
    },
    /// The server is full.
    #[error(
        "{asked} more environments would make {total}; this server allows {max} in all sessions together"
    )]
    TooManyEnvs {
        /// What was asked for.
        asked: usize,
        /// What it would come to.
        total: usize,
        /// The limit.
        max: usize,
    },
    /// The session has more requests waiting than it may.
    #[error(
        "session {id} has {queued} requests waiting, as many as it may; read answers before sending more"
    )]
    QueueFull {
        /// The session.
        id: SessionId,
        /// How many wait.
        queued: usize,
    },
    /// The server is full.
    #[error("this server has as many connections as it allows; close one or try again later")]
    TooManyConnections,
    /// More is being sent to the server than it can hold.
    #[error(
        "a message of {asked} bytes would make {} bytes that are arriving; this server allows {max} in all messages together; try again later", asked + arriving
    )]
    TooMuchArriving {
        /// Size of the message.
        asked: usize,
        /// Sizes of those that are arriving.
        arriving: usize,
        /// The limit.
        max: usize,
    },
    /// A message whose end did not come.
    #[error("a message began and did not end within {deadline_s} s")]
    TooSlow {
        /// The limit.
        deadline_s: u64,
    },
    /// Results that nobody reads.
    #[error("the results were not read for {limit_s} s; the work was given up")]
    NotRead {
        /// The limit.
        limit_s: u64,
    },
    /// Too many evaluations and collections at once.
    #[error(
        "{running} evaluations and collections are running, as many as this server allows; try again later"
    )]
    TooManyRollouts {
        /// How many run.
        running: usize,
    },
    /// Actions of the wrong type.
    #[error("actions have dtype {got}; expected float32")]
    ActionDtype {
        /// The dtype found.
        got: String,
    },
    /// Actions of the wrong shape.
    #[error("actions have shape {got:?} and {bytes} bytes; expected [{num_envs}, {action_size}] (environments, action size) and {} bytes", num_envs * action_size * 4)]
    ActionShape {
        /// The shape found.
        got: Vec<i64>,
        /// The bytes found.
        bytes: usize,
        /// Environments of the session.
        num_envs: usize,
        /// Entries of an action.
        action_size: usize,
    },
    /// More steps in an open loop than allowed, or a larger answer.
    #[error(
        "an open loop of {steps} steps, whose answer has {answer_bytes} bytes; expected 1 to {max_steps} steps and at most {max_answer_bytes} bytes"
    )]
    OpenLoop {
        /// Steps asked for.
        steps: usize,
        /// Bytes of arrays that the answer would have.
        answer_bytes: usize,
        /// The limit of steps.
        max_steps: usize,
        /// The limit of bytes.
        max_answer_bytes: usize,
    },
    /// A snapshot of a session whose observations have another type.
    #[error(
        "the snapshot is of a session with another observation_dtype; open one from the snapshot instead"
    )]
    SnapshotTag,
    /// A session too large for a snapshot.
    #[error("a snapshot of session {id} has {got} bytes; this server allows {max}")]
    SnapshotTooLarge {
        /// The session.
        id: SessionId,
        /// Bytes it would have.
        got: usize,
        /// The limit.
        max: usize,
    },
    /// Pictures too large for an answer.
    #[error(
        "the pictures have {got} bytes together; this server sends {max} at most: ask for fewer or smaller ones"
    )]
    PicturesTooLarge {
        /// Bytes they would have, unpacked.
        got: usize,
        /// The limit.
        max: usize,
    },
    /// A required field is unset.
    #[error("{field} is not set; expected {want}")]
    Missing {
        /// Path of the field.
        field: &'static str,
        /// What it should be.
        want: &'static str,
    },
    /// An enum value that this server does not know.
    #[error("{field} is {got}, which this server does not know; expected {want}")]
    UnknownEnum {
        /// Path of the field.
        field: &'static str,
        /// The number found.
        got: i32,
        /// The names of the values there are.
        want: &'static str,
    },
    /// A number outside its range.
    #[error("{field} is {got}; expected {min} to {max}")]
    OutOfRange {
        /// Path of the field.
        field: &'static str,
        /// The number found.
        got: u64,
        /// The least.
        min: u64,
        /// The most.
        max: u64,
    },
    /// The task has no expert that is a model; a controller may be there, which sees the scene and not
    /// observations.
    #[error(
        "no expert model ships for task {task:?}; models ship for {available}. Give a policy of your own as ONNX, or ask for the random policy"
    )]
    NoExpert {
        /// The task.
        task: &'static str,
        /// The tasks that have one.
        available: String,
    },
    /// A controller has no density to draw actions from.
    #[error(
        "the expert of task {task:?} is a controller, which states no density; ask for action_mode = DETERMINISTIC"
    )]
    NotStochastic {
        /// The task.
        task: &'static str,
    },
    /// The server is about to stop.
    #[error("the server is shutting down")]
    Draining,
    /// The caller has gone; nobody reads this.
    #[error("the call was cancelled")]
    Cancelled,
    /// A bug.
    #[error("internal error: {0}")]
    Internal(String),
}

impl From<EnvIdError> for ServerError {
    fn from(error: EnvIdError) -> Self {
        Self::Sim(error.into())
    }
}
