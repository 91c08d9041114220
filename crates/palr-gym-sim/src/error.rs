//! What can go wrong between a name and a step.

use palr_gym_core::{EnvIdError, SceneOptionsError};

use crate::divergence::Divergence;
use crate::guard::EngineError;
use crate::render::RenderError;
use crate::sight::ExtractorError;
use crate::snapshot::SnapshotError;

/// Why an environment could not be made, reset or stepped.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SimError {
    /// The text is no environment id.
    #[error(transparent)]
    EnvId(#[from] EnvIdError),
    /// The id's task is not in the registry.
    #[error("unknown task {task:?}{}; expected one of {}",
        suggestion.map(|name| format!(" (did you mean {name:?}?)")).unwrap_or_default(),
        known.join(", "))]
    UnknownTask {
        /// The task asked for.
        task: String,
        /// The closest name there is.
        suggestion: Option<&'static str>,
        /// Every task.
        known: Vec<&'static str>,
    },
    /// The task is not defined that way.
    #[error("task {task:?} has no {asked:?} variant; expected {}",
        if available.is_empty() { "an id without it".to_owned() }
        else { format!("-{}", available.join(" or -")) })]
    View {
        /// The task.
        task: &'static str,
        /// The mask or definition asked for.
        asked: &'static str,
        /// Those there are.
        available: Vec<&'static str>,
    },
    /// Options that do not fit the scene.
    #[error(transparent)]
    SceneOptions(#[from] SceneOptionsError),
    /// The scene of a task does not compile. Only a broken build can cause it.
    #[error("the scene of task {task:?} does not compile: {message}")]
    Scene {
        /// The task.
        task: &'static str,
        /// What MuJoCo said.
        message: String,
    },
    /// MuJoCo could not allocate.
    #[error("no memory for an environment of task {task:?}: {message}")]
    Memory {
        /// The task.
        task: &'static str,
        /// What MuJoCo said.
        message: String,
    },
    /// Bytes that are no snapshot, or not one of these environments.
    #[error(transparent)]
    Snapshot(#[from] SnapshotError),
    /// There is no picture.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// There are no features of a picture.
    #[error(transparent)]
    Extractor(#[from] ExtractorError),
    /// MuJoCo failed in a reset.
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// No thread could be started.
    #[error("cannot start {threads} simulation threads: {message}")]
    Threads {
        /// How many were asked for.
        threads: usize,
        /// What the system said.
        message: String,
    },
    /// The actions do not fit the environments.
    #[error("actions hold {got} numbers; expected {num_envs} x {action_size}")]
    ActionCount {
        /// Numbers received.
        got: usize,
        /// Environments.
        num_envs: usize,
        /// Entries of one action.
        action_size: usize,
    },
    /// An action is not a number.
    #[error(
        "action of environment {env_index} has NaN at index {index} ({name}); expected a number within [-1, 1]"
    )]
    ActionNan {
        /// Which environment.
        env_index: usize,
        /// Which entry.
        index: usize,
        /// The entry's actuator.
        name: &'static str,
    },
    /// An action lies outside the action space, and the session rejects such actions.
    #[error(
        "action of environment {env_index} has {got} at index {index} ({name}); expected a number within [-1, 1] (open the session with out_of_bounds = clip or raw to allow it)"
    )]
    ActionOutOfBounds {
        /// Which environment.
        env_index: usize,
        /// Which entry.
        index: usize,
        /// The entry's actuator.
        name: &'static str,
        /// The entry's value.
        got: f32,
    },
    /// Neither no seed, one seed, nor one for each environment.
    #[error("{got} seeds for {num_envs} environments; expected none, one, or {num_envs}")]
    SeedCount {
        /// Seeds received.
        got: usize,
        /// Environments.
        num_envs: usize,
    },
    /// An environment that does not exist, or indices out of order.
    #[error(
        "environment index {got} after {previous:?}; expected ascending indices below {num_envs}"
    )]
    EnvIndex {
        /// The index.
        got: usize,
        /// The index before it.
        previous: Option<usize>,
        /// Environments.
        num_envs: usize,
    },
    /// The episode has ended, and the session does not reset by itself.
    #[error(
        "the episode of environment {env_index} has ended; reset it before the next step (autoreset is disabled)"
    )]
    ResetNeeded {
        /// Which environment.
        env_index: usize,
    },
    /// The environment was never reset.
    #[error("the environments were never reset; reset them before the first step")]
    NeverReset,
}

impl SimError {
    /// What it means for an episode that it ends.
    pub(crate) fn divergence(&self) -> Divergence {
        match self {
            Self::Render(_) | Self::Extractor(_) => Divergence::Unseen,
            _ => Divergence::EngineError,
        }
    }
}
