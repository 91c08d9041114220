//! The registry of tasks: scene file, task module and entry here stand one to one.

mod ant;
mod halfcheetah;
mod hopper;
mod locomotion;
mod walker2d;

use palr_gym_core::nearest::nearest;
use palr_gym_core::random::Generator;
use palr_gym_core::{EnvId, EnvSpec, TaskSpec};

use crate::error::SimError;
use crate::physics::{Physics, Scene};

/// What a step earned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outcome {
    /// As the task defines it, in f64.
    pub reward: f64,
    /// The task ended the episode.
    pub terminated: bool,
}

/// A task: what a simulation means.
pub trait Task: Send + Sync {
    /// Names, sizes, masks and limits.
    fn spec(&self) -> &'static TaskSpec;

    /// The scene.
    fn scene(&self) -> &'static Scene;

    /// Moves the initial state to where an episode starts, drawing from `generator` in
    /// Gymnasium's order.
    fn perturb(&self, generator: &mut Generator, qpos: &mut [f64], qvel: &mut [f64]);

    /// Writes the full observation, `spec().observation` entries.
    fn observe(&self, physics: &Physics, observation: &mut [f64]);

    /// The positions (x, y) from which the reward's velocity is taken, in metres.
    fn position_m(&self, physics: &Physics) -> [f64; 2];

    /// Reward and end of the step that began at `before_m` with `action` and led to `physics`.
    /// Writes `spec().info_names` entries to `info`.
    fn outcome(
        &self,
        physics: &Physics,
        before_m: [f64; 2],
        action: &[f32],
        info: &mut [f64],
    ) -> Outcome;
}

/// Every task, in alphabetical order.
pub static TASKS: [&dyn Task; 4] =
    [&ant::Ant, &halfcheetah::Halfcheetah, &hopper::Hopper, &walker2d::Walker2d];

/// The task and environment that an id such as `hopper-w2` names.
///
/// # Errors
/// [`SimError::EnvId`] or [`SimError::UnknownTask`].
pub fn resolve(env_id: &str) -> Result<(&'static dyn Task, EnvSpec), SimError> {
    let env_id: EnvId = env_id.parse()?;
    let names = || TASKS.iter().map(|task| task.spec().name);
    match TASKS.iter().find(|task| task.spec().name == env_id.task) {
        Some(task) => Ok((*task, EnvSpec::new(env_id, task.spec()))),
        None => Err(SimError::UnknownTask {
            suggestion: nearest(&env_id.task, names()),
            known: names().collect(),
            task: env_id.task,
        }),
    }
}

#[cfg(test)]
mod tests;
