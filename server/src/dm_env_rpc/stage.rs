//! Where a connection's environment comes from.

use std::sync::Arc;

use palr_gym_core::{AutoresetMode, EnvSpec, OutOfBounds};
use palr_gym_proto::v1;
use palr_gym_sim::{VectorOptions, resolve};

use crate::encode::{WireAnswer, WireEncode};
use crate::error::ServerError;
use crate::session::{Command, Session};
use crate::sessions::Sessions;

/// What a step came to.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// `[observation_size]`.
    pub observation: Vec<f64>,
    /// As the task defines it.
    pub reward: f64,
    /// The task ended the episode.
    pub terminated: bool,
    /// The time limit ended the episode.
    pub truncated: bool,
}

/// An environment of one connection. Dropping it frees it.
pub trait Env: Send + Sync + 'static {
    /// What it is.
    fn spec(&self) -> &EnvSpec;

    /// Starts an episode: from a seed, or with the generator as it stands. Returns the first
    /// observation.
    fn reset(
        &self,
        seed: Option<u64>,
    ) -> impl Future<Output = Result<Vec<f64>, ServerError>> + Send;

    /// One step within an episode. A refused action changes nothing.
    fn step(&self, action: Vec<f32>) -> impl Future<Output = Result<Outcome, ServerError>> + Send;
}

/// Where environments come from. Sessions in a server; something lighter where the state machine
/// itself is tried.
pub trait Stage: Send + Sync + 'static {
    /// What it opens.
    type Env: Env;

    /// Refuses ids of no environment.
    ///
    /// # Errors
    /// As [`resolve`].
    fn check(&self, env_id: &str) -> Result<(), ServerError>;

    /// An environment that has never been reset.
    fn open(&self, env_id: &str) -> impl Future<Output = Result<Self::Env, ServerError>> + Send;
}

/// Environments as sessions of one, within the server's limits.
pub struct SessionStage(pub Arc<Sessions<WireEncode>>);

/// A session of one environment, closed when it is dropped.
pub struct SessionEnv {
    sessions: Arc<Sessions<WireEncode>>,
    session_id: String,
    spec: EnvSpec,
}

impl Stage for SessionStage {
    type Env = SessionEnv;

    fn check(&self, env_id: &str) -> Result<(), ServerError> {
        resolve(env_id)?;
        Ok(())
    }

    async fn open(&self, env_id: &str) -> Result<SessionEnv, ServerError> {
        let sessions = Arc::clone(&self.0);
        let env_id = env_id.to_owned();
        let options = VectorOptions {
            autoreset_mode: AutoresetMode::Disabled,
            out_of_bounds: OutOfBounds::Reject,
        };
        // If the caller goes meanwhile, the environment is dropped with the task's result.
        let opened = tokio::task::spawn_blocking(move || {
            let session = sessions.open(&env_id, None, 1, options, WireEncode::default())?;
            let session_id = session.id().to_string();
            Ok(SessionEnv { session_id, spec: session.spec().clone(), sessions })
        });
        opened.await.map_err(|error| ServerError::Internal(error.to_string()))?
    }
}

impl SessionEnv {
    async fn ask(&self, command: Command) -> Result<WireAnswer, ServerError> {
        // Looked up each time: it may have been idle for too long.
        let session: Arc<Session<WireEncode>> = self.sessions.get(&self.session_id)?;
        let promise = session.submit(command)?;
        promise.await.map_err(|_| ServerError::Internal("a session dropped a request".into()))?
    }
}

impl Env for SessionEnv {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    async fn reset(&self, seed: Option<u64>) -> Result<Vec<f64>, ServerError> {
        let command = Command::Reset { seeds: seed.into_iter().collect(), env_indices: vec![] };
        match self.ask(command).await? {
            WireAnswer::Reset(answer) => Ok(floats(answer.observations)),
            _ => Err(mismatch()),
        }
    }

    async fn step(&self, action: Vec<f32>) -> Result<Outcome, ServerError> {
        match self.ask(Command::Step { actions: action }).await? {
            WireAnswer::Step(answer) => Ok(Outcome {
                observation: floats(answer.observations),
                reward: floats(answer.rewards).first().copied().ok_or_else(mismatch)?,
                terminated: is_set(answer.terminated),
                truncated: is_set(answer.truncated),
            }),
            _ => Err(mismatch()),
        }
    }
}

impl Drop for SessionEnv {
    fn drop(&mut self) {
        // It may have been reaped already.
        let _ = self.sessions.close(&self.session_id);
    }
}

fn floats(tensor: Option<v1::Tensor>) -> Vec<f64> {
    match tensor {
        None => Vec::new(),
        Some(tensor) if tensor.dtype() == v1::DataType::Uint8 => {
            tensor.data.iter().copied().map(f64::from).collect()
        }
        Some(tensor) => bytemuck::allocation::pod_collect_to_vec(&tensor.data),
    }
}

fn is_set(tensor: Option<v1::Tensor>) -> bool {
    tensor.is_some_and(|tensor| tensor.data.contains(&1))
}

fn mismatch() -> ServerError {
    ServerError::Internal("a session answered another request than the one it got".into())
}
