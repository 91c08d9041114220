//! The registry of tasks: scene file, task module and entry here stand one to one.

mod ant;
mod halfcheetah;
mod hopper;
mod locomotion;
mod toy;
mod walker2d;

use palr_gym_core::nearest::nearest;
use palr_gym_core::random::Generator;
use palr_gym_core::{EnvId, EnvSpec, Fidelity, TaskSpec};

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

    /// True if contact forces must be computed after each step.
    fn needs_contact_forces(&self) -> bool {
        false
    }

    /// Moves the initial state to where an episode starts, drawing from `generator` in
    /// Gymnasium's order.
    fn perturb(&self, generator: &mut Generator, qpos: &mut [f64], qvel: &mut [f64]);

    /// Draws what chance decides in the course of an episode: once the initial state is there
    /// (`is_start`), and after each step, once it is paid. `drawn` is the scene's userdata, part of
    /// the state; Gymnasium's tasks have none.
    fn draw(&self, _generator: &mut Generator, _drawn: &mut [f64], _is_start: bool) {}

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

    /// Writes what a reset that led to `physics` reports: `spec().reset_info_names` entries.
    fn reset_info(&self, _physics: &Physics, _info: &mut [f64]) {}
}

/// Every task, Gymnasium's as `-v4` defines them, in alphabetical order.
pub static TASKS: [&dyn Task; 5] = [
    &ant::Ant(Fidelity::Gym4),
    &halfcheetah::Halfcheetah(Fidelity::Gym4),
    &hopper::Hopper(Fidelity::Gym4),
    &toy::Toy,
    &walker2d::Walker2d(Fidelity::Gym4),
];

/// Gymnasium's tasks as `-v5` defines them.
pub static TASKS_GYM5: [&dyn Task; 4] = [
    &ant::Ant(Fidelity::Gym5),
    &halfcheetah::Halfcheetah(Fidelity::Gym5),
    &hopper::Hopper(Fidelity::Gym5),
    &walker2d::Walker2d(Fidelity::Gym5),
];

/// The tasks of a fidelity.
#[must_use]
pub fn tasks(fidelity: Fidelity) -> &'static [&'static dyn Task] {
    match fidelity {
        Fidelity::Gym4 => &TASKS,
        Fidelity::Gym5 => &TASKS_GYM5,
    }
}

/// The task and environment that an id such as `hopper-w2` names.
///
/// # Errors
/// [`SimError::EnvId`] or [`SimError::UnknownTask`].
pub fn resolve(env_id: &str) -> Result<(&'static dyn Task, EnvSpec), SimError> {
    let env_id: EnvId = env_id.parse()?;
    let known = tasks(env_id.fidelity);
    let names = || known.iter().map(|task| task.spec().name);
    match known.iter().find(|task| task.spec().name == env_id.task) {
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
